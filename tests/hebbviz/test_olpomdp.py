"""Direct reinforcement learning: estimates against their exact limits, climbing, Theorem 1."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hebbviz.learner.learner import Learner
from hebbviz.task.finite import finite_world
from hebbviz.theory.network_chain import NetworkPolicy
from hebbviz.theory.olpomdp import Agent, gpomdp, olpomdp
from hebbviz.theory.policies import Gibbs, Independent, Neuron, mixed_digits
from hebbviz.theory.pomdp import POMDP, three_state_chain
from hebbviz.topology import BINARY, SYMMETRIC, Group, Projection, Topology
from tests.hebbviz.test_pomdp import SEEDS, distributions, random_case, random_policy

THETA = np.array([1.0, 1.0, -1.0, -1.0])


def cosine(a, b):
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


# GPOMDP

BETAS = (0.0, 0.4, 0.8, 0.95)
STEPS, RUNS = 2000, 400


@pytest.fixture(scope="module")
def estimates():
    """On the three-state chain, for each β: the exact chain and RUNS estimates (RUNS, 4)."""
    world, policy = three_state_chain()
    chain = world.under(policy, THETA)
    runs = [
        gpomdp(world, policy, THETA, beta=b, steps=STEPS, runs=RUNS, seed=k)
        for k, b in enumerate(BETAS)
    ]
    return chain, dict(zip(BETAS, runs, strict=True))


@pytest.mark.parametrize("beta", BETAS)
def test_the_mean_of_r_z_is_the_closed_form_within_its_standard_error(estimates, beta):
    chain, runs = estimates
    error = np.sqrt(chain.noise(beta) / (STEPS * RUNS))
    off = (runs[beta].mean(axis=0) - chain.biased_gradient(beta)) / error
    assert np.all(np.abs(off) < 4.0)
    assert np.all(error < 0.05 * np.abs(chain.gradient))


@pytest.mark.parametrize("beta", BETAS)
def test_its_variance_over_runs_is_the_closed_form(estimates, beta):
    """The ratio of a variance over 400 runs has a standard deviation of 7 %."""
    chain, runs = estimates
    ratio = STEPS * runs[beta].var(axis=0, ddof=1) / chain.noise(beta)
    assert np.all(np.abs(ratio - 1.0) < 0.3)


@pytest.mark.parametrize("beta", BETAS)
def test_it_points_along_the_gradient_as_well_as_is_expected(estimates, beta):
    """m·g / (|g| √E|mean|²) over the runs: what it lacks of 1 has a standard deviation of 7 %."""
    chain, runs = estimates
    along = runs[beta] @ chain.gradient / np.linalg.norm(chain.gradient)
    found = along.mean() / math.sqrt((runs[beta] ** 2).sum(axis=1).mean())
    expected = chain.expected_cosine(beta, steps=STEPS)
    assert 1.0 - found == pytest.approx(1.0 - expected, rel=0.2)


def test_less_bias_is_paid_for_with_variance(estimates):
    """As β rises the bias falls and the measured variance grows, here from 0.8 on sevenfold."""
    chain, runs = estimates
    variances = [runs[b].var(axis=0, ddof=1).mean() for b in BETAS]
    biases = [np.linalg.norm(chain.biased_gradient(b) - chain.gradient) for b in BETAS]
    assert np.all(np.diff(variances) > 0.0) and np.all(np.diff(biases) < 0.0)
    growth = variances[-1] / variances[-2]
    assert 0.2 / 0.05 < growth < (0.2 / 0.05) ** 2


@pytest.mark.parametrize("seed", range(6))
def test_so_it_is_in_random_worlds(seed):
    """Mean and variance of r z, β drawn too: 400 runs of 1 000 steps."""
    world, policy, theta = random_case(100 + seed)
    chain = world.under(policy, theta)
    beta = (0.0, 0.5, 0.8, 0.9, 0.6, 0.3)[seed]
    runs = gpomdp(world, policy, theta, beta=beta, steps=1000, runs=400, seed=seed)
    noise = chain.noise(beta)
    moves = noise > 1e-12
    off = (runs.mean(axis=0) - chain.biased_gradient(beta))[moves]
    assert np.all(np.abs(off) < 4.5 * np.sqrt(noise[moves] / 400_000))
    ratio = 1000 * runs.var(axis=0, ddof=1)[moves] / noise[moves]
    assert np.all(np.abs(ratio - 1.0) < 0.35)


def test_gpomdp_repeats_and_refuses():
    world, policy = three_state_chain()

    def few(**given):
        options = {"beta": 0.5, "steps": 10, "runs": 2, "seed": 1} | given
        return gpomdp(world, policy, THETA, **options)

    assert np.array_equal(few(), few())
    assert not np.array_equal(few(), few(seed=2))
    for wrong in ({"beta": 1.0}, {"steps": 0}, {"runs": 0}):
        with pytest.raises(ValueError, match=r"beta must|must be at least 1"):
            few(**wrong)


# OLPOMDP


def test_olpomdp_climbs_the_three_state_chain():
    """From an average reward of 0.29 to within 2 % of the best, 0.8."""
    world, policy = three_state_chain()
    agent = Agent(policy, THETA, beta=0.8, gamma=0.1)
    assert world.under(policy, agent.theta).average_reward < 0.3
    rewards = olpomdp(world, agent, steps=8000, seed=0)
    assert world.under(policy, agent.theta).average_reward > 0.784
    assert rewards[-2000:].mean() > 0.75


class Noting(Agent):
    """Adds up r z beside what it learns."""

    total = 0.0

    def reinforce(self, reward):
        self.total = self.total + reward * self.trace
        super().reinforce(reward)


def test_its_small_steps_are_gpomdps_estimate():
    """θ moves by γ Σ r z: with γ tiny, Δθ/γ is the sum that GPOMDP averages.

    Of 8 000 steps, so that the mean is told from zero: E[r z] is 9 of its standard errors.
    """
    world, policy = three_state_chain()
    frozen = Agent(policy, THETA, beta=0.8, gamma=0.0)
    agent = Noting(policy, THETA, beta=0.8, gamma=1e-9)
    steps = 8000
    assert np.array_equal(
        olpomdp(world, agent, steps=steps, seed=3), olpomdp(world, frozen, steps=steps, seed=3)
    )
    moved = (agent.theta - THETA) / 1e-9
    assert np.allclose(moved, agent.total, rtol=1e-6, atol=0)
    chain = world.under(policy, THETA)
    exact, error = chain.biased_gradient(0.8), np.sqrt(chain.noise(0.8) / steps)
    assert np.all(np.abs(moved / steps - exact) < 4 * error)
    assert np.all(4 * error < 0.5 * np.abs(exact))
    assert np.array_equal(frozen.theta, THETA)


def patience():
    """At the fork: a snack at once, or a feast two steps on. A slip leads back to the fork."""
    fork, snack, wait, feast = np.eye(4)
    hurry, patient = [snack, fork, feast, fork], [wait, fork, feast, fork]
    moves = 0.95 * np.array([hurry, patient]) + 0.05 * fork
    return POMDP(moves, np.ones((4, 1)), np.array([0.0, 0.3, 0.0, 1.0]))


def test_a_memory_shorter_than_the_delay_climbs_the_wrong_hill():
    """At β = 0 only the snack is credited; exactly, and in what is learnt."""
    world, policy = patience(), Gibbs.table(1, 2)
    chain = world.under(policy, np.zeros(2))
    assert cosine(chain.biased_gradient(0.0), chain.gradient) == pytest.approx(-1.0)
    assert cosine(chain.biased_gradient(0.9), chain.gradient) == pytest.approx(1.0)
    learnt = {}
    for beta in (0.0, 0.9):
        agent = Agent(policy, np.zeros(2), beta=beta, gamma=0.05)
        olpomdp(world, agent, steps=6000, seed=1)
        learnt[beta] = world.under(policy, agent.theta).average_reward
    best, worst = (
        world.under(policy, np.array(t)).average_reward for t in ([0.0, 50.0], [50.0, 0.0])
    )
    assert learnt[0.9] > 0.95 * best
    assert learnt[0.0] < 1.05 * worst < 0.6 * best


def test_a_memory_that_ends_before_the_reward_has_no_direction():
    world = patience()
    late = POMDP(world.transitions, world.observations, np.array([0.0, 0.0, 0.0, 1.0]))
    chain = late.under(Gibbs.table(1, 2), np.zeros(2))
    assert np.array_equal(chain.biased_gradient(0.0), np.zeros(2)) and chain.gradient.all()
    for steps in (1.0, 1e9, math.inf):
        assert chain.expected_cosine(0.0, steps=steps) == 0.0
        assert chain.expected_cosine(0.1, steps=steps) > 0.0


def test_an_agent_refuses_what_does_not_fit():
    policy = Gibbs.table(1, 2)
    with pytest.raises(ValueError, match=r"theta must have shape \(2,\), got \(3,\)"):
        Agent(policy, np.zeros(3), beta=0.5, gamma=0.1)
    with pytest.raises(ValueError, match="beta must be in"):
        Agent(policy, np.zeros(2), beta=1.0, gamma=0.1)
    with pytest.raises(ValueError, match="gamma"):
        Agent(policy, np.zeros(2), beta=0.5, gamma=-1.0)


# Theorem 1


def random_agents(rng, count):
    """A world of `count` agents with a joint observation that each sees a part of."""
    sights = int(rng.integers(1, 5))
    own = [int(rng.integers(1, 4)) for _ in range(count)]
    sees = np.array([rng.integers(n, size=sights) for n in own])
    policies = tuple(random_policy(rng, n) for n in own)
    joint = Independent(policies, sees)
    theta = rng.normal(size=joint.parameters)
    states, controls = int(rng.integers(2, 5)), joint.probabilities(theta).shape[1]
    world = POMDP(
        distributions(rng, controls, states, states), distributions(rng, states, sights),
        rng.normal(size=states),
    )  # fmt: skip
    return world, joint, theta


def features_of(policy):
    """φ(y, u) of the Gibbs policy that this one is; a neuron's is u times what it sees."""
    if isinstance(policy, Neuron):
        return np.array([0.0, 1.0])[:, None] * policy.inputs[:, None]
    return policy.features


def as_one(joint):
    """The combined agent as one Gibbs policy over joint controls, which knows no agents.

    exp(Σ_i θ^i·φ^i) is the product of the agents' own: φ is their φ^i in a row. The score takes
    off its mean over all joint controls.
    """
    own = [features_of(policy) for policy in joint.agents]
    digits = mixed_digits([phi.shape[1] for phi in own])
    rows = [phi[y][:, u] for phi, y, u in zip(own, joint.sees, digits, strict=True)]
    return Gibbs(np.concatenate(rows, axis=2))


@settings(max_examples=60)
@given(seed=SEEDS, count=st.integers(1, 4), beta=st.floats(0.0, 0.99))
def test_independent_agents_are_one_agent_whose_score_is_theirs_in_a_row(seed, count, beta):
    """Theorem 1: what the others may do drops out of the mean over all joint controls."""
    world, joint, theta = random_agents(np.random.default_rng(seed), count)
    one = as_one(joint)
    assert np.allclose(joint.probabilities(theta), one.probabilities(theta), rtol=0, atol=1e-14)
    assert np.allclose(joint.score(theta), one.score(theta), rtol=0, atol=1e-13)
    chain, of_one = world.under(joint, theta), world.under(one, theta)
    biased, of_one_biased = chain.biased_gradient(beta), of_one.biased_gradient(beta)
    assert np.allclose(chain.gradient, of_one.gradient, rtol=0, atol=1e-12)
    assert np.allclose(biased, of_one_biased, rtol=0, atol=1e-12)


@settings(max_examples=40)
@given(seed=SEEDS, count=st.integers(1, 4), beta=st.floats(0.0, 0.99), gamma=st.floats(0.001, 0.5))
def test_the_combined_agents_update_is_each_agents_own(seed, count, beta, gamma):
    """Theorem 1: from the one reward, what each sees and what each did, and nothing else."""
    rng = np.random.default_rng(seed)
    world, joint, theta = random_agents(rng, count)
    combined, one = (
        Agent(policy, theta, beta=beta, gamma=gamma) for policy in (joint, as_one(joint))
    )
    alone = [
        Agent(policy, part, beta=beta, gamma=gamma)
        for policy, part in zip(joint.agents, joint.parts(theta), strict=True)
    ]
    x = 0
    for _ in range(60):
        y = rng.choice(world.sights, p=world.observations[x])
        u = combined.choose(y, rng.random())
        digits = joint.controls(combined.theta)[:, u]
        for whole in (combined, one):
            whole.remember(y, u)
        for agent, seen, did in zip(alone, joint.sees[:, y], digits, strict=True):
            agent.remember(seen, did)
        x = rng.choice(world.states, p=world.transitions[u, x])
        for agent in (combined, one, *alone):
            agent.reinforce(world.rewards[x])
    for name in ("theta", "trace"):
        apart = np.concatenate([getattr(agent, name) for agent in alone])
        for whole in (combined, one):
            assert np.allclose(getattr(whole, name), apart, rtol=1e-12, atol=1e-12)


@settings(max_examples=30)
@given(seed=SEEDS, count=st.integers(1, 3))
def test_a_joint_policy_is_a_distribution_with_its_own_score(seed, count):
    _, joint, theta = random_agents(np.random.default_rng(seed), count)
    mu, score = joint.probabilities(theta), joint.score(theta)
    assert np.allclose(mu.sum(axis=1), 1.0, rtol=0, atol=1e-13)
    for k, step in enumerate(1e-5 * np.eye(theta.size)):
        up, down = joint.probabilities(theta + step), joint.probabilities(theta - step)
        numeric = (np.log(up) - np.log(down)) / 2e-5
        assert np.allclose(score[:, :, k], numeric, rtol=0, atol=1e-8)


def others_as_world(world, joint, theta, agent):
    """The POMDP that one agent lives in if the others are a part of it; its state is (x, y)."""
    parts, digits = joint.parts(theta), joint.controls(theta)
    states, sights, own = world.states, world.sights, digits[agent].max() + 1
    moves = np.zeros((own, states, sights, states, sights))
    for u in range(world.controls):
        chance = np.ones(sights)
        for i, (policy, part) in enumerate(zip(joint.agents, parts, strict=True)):
            if i != agent:
                chance = chance * policy.probabilities(part)[joint.sees[i], digits[i, u]]
        step = np.einsum("ij,jz->ijz", world.transitions[u], world.observations)
        moves[digits[agent, u]] += np.einsum("y,ijz->iyjz", chance, step)
    many = states * sights
    sees = np.zeros((states, sights, joint.sees[agent].max() + 1))
    sees[:, np.arange(sights), joint.sees[agent]] = 1.0
    return POMDP(
        moves.reshape(own, many, many), sees.reshape(many, -1), np.repeat(world.rewards, sights)
    )


class Narrow:
    """A policy's first observations alone."""

    def __init__(self, policy, sights):
        self.policy, self.sights, self.parameters = policy, sights, policy.parameters

    def probabilities(self, theta):
        return self.policy.probabilities(theta)[: self.sights]

    def score(self, theta):
        return self.policy.score(theta)[: self.sights]


@settings(max_examples=25)
@given(seed=SEEDS, count=st.integers(2, 3), beta=st.floats(0.0, 0.99))
def test_to_each_agent_the_others_are_a_part_of_the_world(seed, count, beta):
    """∇η and E[r z] of the combined agent are, put together, those of each in its own world."""
    world, joint, theta = random_agents(np.random.default_rng(seed), count)
    chain = world.under(joint, theta)
    gradient, biased = [], []
    for i, (policy, part) in enumerate(zip(joint.agents, joint.parts(theta), strict=True)):
        own = others_as_world(world, joint, theta, i)
        alone = own.under(Narrow(policy, own.sights), part)
        assert alone.average_reward == pytest.approx(chain.average_reward, abs=1e-12)
        gradient.append(alone.gradient)
        biased.append(alone.biased_gradient(beta))
    assert np.allclose(chain.gradient, np.concatenate(gradient), rtol=0, atol=1e-11)
    assert np.allclose(chain.biased_gradient(beta), np.concatenate(biased), rtol=0, atol=1e-11)


TOPOLOGY = Topology(
    (Group("in", 2, is_input=True), Group("hidden", 2), Group("out", 1)),
    tuple(Projection(*p.split()) for p in ("in hidden", "hidden out", "out hidden", "in out")),
    "out",
    BINARY,
)


@pytest.mark.parametrize("activity", [BINARY, SYMMETRIC])
def test_a_network_is_neurons_that_each_run_olpomdp_on_their_own_synapses(activity):
    """500 steps of the compiled learner, γ large: every spike, and every weight to rounding."""
    topology = Topology(TOPOLOGY.groups, TOPOLOGY.projections, TOPOLOGY.output, activity)
    rng = np.random.default_rng(5)
    vectors = rng.normal(size=(3, 2))
    pomdp = POMDP(distributions(rng, 2, 4, 4), distributions(rng, 4, 3), rng.normal(size=4))
    task = finite_world(pomdp, vectors, activity=activity)
    learner = Learner(task, topology=topology, beta=0.8, gamma=0.1, seed=2)
    policy = NetworkPolicy(topology, vectors)
    mine = [np.flatnonzero(policy.post == i) for i in range(topology.neurons)]
    start = learner.weights[:, 0]
    neurons = [
        Agent(Neuron(policy.seen[:, policy.pre[own]]), start[own], beta=0.8, gamma=0.1)
        for own in mine
    ]
    whole = Agent(policy, start, beta=0.8, gamma=0.1)
    for _ in range(500):
        before = learner.activities[:, 0]
        y = int(np.flatnonzero((policy.seen == before).all(axis=1))[0])
        block, frame = learner.advance(1), learner.frame()
        fired, reward = block.fired[0], block.reward[0]
        chosen = [a.choose(y, 1.0 - d) for a, d in zip(neurons, frame.draw, strict=True)]
        assert chosen == fired.tolist()
        for agent, u in zip(neurons, chosen, strict=True):
            agent.remember(y, u)
        whole.remember(y, int(2 ** np.arange(len(fired)) @ fired))
        for agent in (*neurons, whole):
            agent.reinforce(reward)
    for agent, own in zip(neurons, mine, strict=True):
        assert np.allclose(agent.theta, learner.weights[own, 0], rtol=0, atol=1e-10)
        assert np.allclose(agent.trace, learner.traces[own, 0], rtol=0, atol=1e-10)
    assert np.allclose(whole.theta, learner.weights[:, 0], rtol=0, atol=1e-10)
    assert np.abs(learner.weights[:, 0] - start).max() > 0.1
    assert math.isfinite(learner.weights.sum())
