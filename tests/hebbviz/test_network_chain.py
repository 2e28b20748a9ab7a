"""A network against the truth: η, ∇η and E[r z] of every synapse, exact and as it learns."""

import math
import time
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hebbviz.conformance import check_task
from hebbviz.learner.learner import Learner
from hebbviz.sims.worlds.lamps import Lamps, small_example
from hebbviz.task.base import Output
from hebbviz.task.finite import FiniteWorld, finite_world
from hebbviz.task.presets import Preset
from hebbviz.theory.network_chain import ExactNetwork, NetworkPolicy
from hebbviz.theory.policies import Gibbs, Independent, Neuron
from hebbviz.theory.pomdp import POMDP
from hebbviz.topology import BINARY, SYMMETRIC, Group, Projection, Topology, feedforward
from tests.hebbviz.test_pomdp import SEEDS, distributions, slopes

LANES = 64
TINY = 1e-9
"""A γ at which weights move too little to matter, and w tells Σ γ r z to seven digits."""


def cosine(a, b):
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def wired(text, activity, *, inputs=2, outputs=1, **sizes):
    """A topology from 'in hidden, hidden out' and the like."""
    groups = (Group("in", inputs, is_input=True), Group("out", outputs))
    groups += tuple(Group(name, size) for name, size in sizes.items())
    projections = tuple(Projection(*pair.split()) for pair in text.split(","))
    return Topology(groups, projections, "out", activity)


NETWORKS = {
    "feedforward": lambda: feedforward(2, (2,), 1),
    "two hidden layers": lambda: feedforward(2, (1, 2), 1, activity=BINARY),
    "no hidden layer": lambda: feedforward(2, (), 2, activity=BINARY),
    "a loop": lambda: wired("in hidden, hidden hidden, hidden out", SYMMETRIC, hidden=2),
    "everything": lambda: wired(
        "in hidden, hidden out, out hidden, in out, out out, hidden hidden", BINARY, hidden=2
    ),
    "output unseen": lambda: wired("in a, a out, out b, b b", SYMMETRIC, a=1, b=2),
    "a ring": lambda: wired("a out, out a, in a", BINARY, a=2, outputs=2),
}
ALL = pytest.mark.parametrize("name", NETWORKS)


def random_world(rng, topology, *, states=3, sights=2):
    outputs = topology.group(topology.output).size
    pomdp = POMDP(
        distributions(rng, 2**outputs, states, states), distributions(rng, states, sights),
        rng.normal(size=states),
    )  # fmt: skip
    vectors = rng.normal(size=(sights, topology.inputs))
    return finite_world(pomdp, vectors, activity=topology.activity)


def network(task, topology):
    return ExactNetwork(task.pomdp, task.vectors, topology)


def random_case(name, seed=0):
    rng = np.random.default_rng(seed)
    topology = NETWORKS[name]()
    net = network(random_world(rng, topology), topology)
    return net, rng.normal(size=topology.synapses)


def learner_at(net, weights, *, beta, gamma=TINY, seed=0, lanes=LANES):
    world = finite_world(net.world, net.vectors, activity=net.topology.activity)
    learner = Learner(world, topology=net.topology, beta=beta, gamma=gamma, seed=seed, lanes=lanes)
    learner.set_weights(np.repeat(weights[:, None], lanes, axis=1))
    learner.skip(300)
    return learner


def measured(net, weights, *, beta, steps, seed=0):
    """From the learner itself: mean of r z in each lane (K, lanes), and of r over all."""
    learner = learner_at(net, weights, beta=beta, seed=seed)

    def rewards():
        return sum(learner.tally(lane).reward for lane in range(LANES))

    before, earned = learner.weights, rewards()
    learner.skip(steps)
    return (learner.weights - before) / TINY / steps, (rewards() - earned) / steps / LANES


# The chain


@ALL
def test_the_gradient_is_that_of_finite_differences(name):
    for seed in range(3):
        net, weights = random_case(name, seed)
        numeric = slopes(lambda w, net=net: np.array(net.at(w).average_reward), weights)
        assert np.allclose(net.at(weights).gradient, numeric, rtol=0, atol=1e-9)


@ALL
def test_a_network_is_its_neurons_as_independent_agents(name):
    """Its policy is the joint one of single neurons, synapse by synapse."""
    net, weights = random_case(name)
    policy, count = net.policy, net.topology.neurons
    mine = [np.flatnonzero(policy.post == i) for i in range(count)]
    sees = np.tile(np.arange(len(policy.seen)), (count, 1))
    neurons = tuple(Neuron(policy.seen[:, policy.pre[own]]) for own in mine)
    joint, order = Independent(neurons, sees), np.concatenate(mine)
    for ours, theirs in (
        (policy.probabilities(weights), joint.probabilities(weights[order])),
        (policy.score(weights)[:, :, order], joint.score(weights[order])),
    ):
        assert np.allclose(ours, theirs, rtol=0, atol=1e-14)


@ALL
def test_every_step_of_the_learner_is_one_of_the_chain(name):
    """Where it goes and how often: counts of one step from each state, over 2·10⁵ steps."""
    net, weights = random_case(name)
    chain = net.at(weights)
    learner = learner_at(net, weights, beta=0.5, gamma=0.0, lanes=1)
    block = learner.advance(200_000, closely=True)
    a = block.fired @ 2 ** np.arange(net.topology.neurons)
    pair = {tuple(p): m for m, p in enumerate(net.pairs.tolist())}
    m = np.array([pair[tuple(p)] for p in block.world.astype(int).tolist()])
    state = a * len(net.pairs) + m
    assert np.allclose(block.reward, chain.reward[state], rtol=0, atol=0)
    counts = np.zeros_like(chain.transition)
    np.add.at(counts, (state[:-1], state[1:]), 1.0)
    visits = counts.sum(axis=1, keepdims=True)
    expected = visits * chain.transition
    assert np.all(counts[chain.transition == 0.0] == 0.0)
    often = expected > 5.0
    off = (counts - expected)[often] / np.sqrt(expected * (1.0 - chain.transition))[often]
    assert np.abs(off).max() < 5.5 and abs(np.mean(off**2) - 1.0) < 0.25


# The learner against the chain


@pytest.mark.parametrize("beta", [0.0, 0.6, 0.9])
@ALL
def test_the_learner_moves_by_the_exact_mean_of_r_z(name, beta):
    """64 lanes of 20 000 steps: η and every synapse within 4.5 standard errors, noise as told."""
    net, weights = random_case(name, seed=1)
    chain, steps = net.at(weights), 20_000
    moved, earned = measured(net, weights, beta=beta, steps=steps)
    noise = chain.noise(beta)
    off = moved.mean(axis=1) - chain.biased_gradient(beta)
    assert np.all(np.abs(off) < 4.5 * np.sqrt(noise / (steps * LANES)) + 1e-7)
    ratio = steps * moved.var(axis=1, ddof=1) / noise
    assert np.all((ratio > 0.4) & (ratio < 2.0))
    assert abs(earned - chain.average_reward) < 0.01


def test_it_is_the_trace_after_the_step_that_meets_the_steps_reward():
    """γ = 0 and r z added up step by step: what the rule itself adds to w, and the exact mean."""
    net, weights = small_example()
    beta, steps = 0.3, 800
    still = learner_at(net, weights, beta=beta, gamma=0.0)
    moving = learner_at(net, weights, beta=beta)
    before, total, wrong = moving.weights, 0.0, 0.0
    for _ in range(steps):
        earlier = still.traces
        still.skip(1)
        reward = still._tiles.read("reward")[0]
        total, wrong = total + reward * still.traces, wrong + reward * earlier
    moving.skip(steps)
    assert np.array_equal(still.weights[:, 0], weights)
    assert np.allclose((moving.weights - before) / TINY, total, rtol=0, atol=1e-3)
    chain = net.at(weights)
    exact, error = chain.biased_gradient(beta), np.sqrt(chain.noise(beta) / (steps * LANES))
    off, late = (np.abs(s.mean(axis=1) / steps - exact) for s in (total, wrong))
    assert np.all(off < 4.5 * error)
    assert np.any(late > 6.0 * error)


def test_the_learner_climbs_along_the_exact_gradient():
    """A hidden layer, β 0.9, 64 lanes of 50 000 steps: cosine 0.997; 0.9986 is the bias's share."""
    net, weights = small_example()
    chain = net.at(weights)
    moved, earned = measured(net, weights, beta=0.9, steps=50_000)
    found = cosine(moved.mean(axis=1), chain.gradient)
    assert found > 0.99
    assert found == pytest.approx(chain.expected_cosine(0.9, steps=50_000 * LANES), abs=0.004)
    assert chain.expected_cosine(0.9, steps=math.inf) == pytest.approx(0.99862, abs=1e-5)
    assert earned == pytest.approx(chain.average_reward, abs=0.003)
    hidden = net.synapses_onto("hidden")
    assert cosine(moved.mean(axis=1)[hidden], chain.gradient[hidden]) > 0.98


def test_and_so_it_learns_where_beta_covers_the_delay():
    """From small weights, by the exact η of what was learnt; the best is 0.8, chance 0.5."""
    net, _ = small_example()
    learnt = {}
    for beta in (0.0, 0.5, 0.8):
        learner = Learner(Lamps(), beta=beta, gamma=0.02, seed=3, lanes=32)
        learner.skip(60_000)
        learnt[beta] = np.array([net.at(w).average_reward for w in learner.weights.T])
    assert learnt[0.5].min() > 0.77 and learnt[0.8].min() > 0.77
    assert max(a.max() for a in learnt.values()) <= 0.8 + 1e-12
    assert np.median(learnt[0.0]) < 0.7


# Delays: what β = 0 leaves out


def steps_to_output(topology):
    """The least number of steps from a group's firing to the outputs, infinite if none."""
    far = {g.name: math.inf for g in topology.neuron_groups} | {topology.output: 0}
    for _ in far:
        for p in topology.projections:
            if not topology.is_held(p):
                far[p.pre] = min(far[p.pre], 1 + far[p.post])
    return far


@ALL
def test_a_synapse_is_credited_from_its_distance_to_the_output_on(name):
    """π ∇P P^d r is zero to rounding for d below the distance, and not at it.

    So E[r z] of a synapse d steps away starts with β^d: at β = 0 it is zero for all but the
    outputs' own synapses, whatever the world, and whatever the gradient is.
    """
    net, weights = random_case(name, seed=3)
    chain, size = net.at(weights), np.abs(net.at(weights).gradient).max()
    by_delay = chain.gradient_by_delay(8)
    for group, distance in steps_to_output(net.topology).items():
        own = net.synapses_onto(group)
        if distance == math.inf:
            assert np.abs(chain.gradient[own]).max() < 1e-12
            continue
        assert np.all(np.abs(by_delay[:distance, own]) < 1e-15)
        assert np.abs(by_delay[distance, own]).max() > 1e-6 * size
        assert np.abs(chain.gradient[own]).max() > 1e-6 * size
        if distance > 0:
            assert np.all(np.abs(chain.biased_gradient(0.0)[own]) < 1e-15)


def test_at_beta_zero_the_hidden_layer_only_diffuses():
    """In the learner too: its mean r z is noise about zero, while the outputs' points uphill."""
    net, weights = small_example()
    chain, steps = net.at(weights), 20_000
    moved = measured(net, weights, beta=0.0, steps=steps)[0].mean(axis=1)
    hidden, output = net.synapses_onto("hidden"), net.synapses_onto("output")
    error = np.sqrt(chain.noise(0.0) / (steps * LANES))
    assert np.all(np.abs(moved[hidden]) < 4.0 * error[hidden])
    assert np.all(np.abs(chain.gradient[hidden]) > 12.0 * error[hidden])
    assert cosine(moved[output], chain.gradient[output]) > 0.99


# A held pattern, and the paper's 'optimal choice of β is 0.5'


def held(rewards, *, right_if_fires=1.0, right_if_silent=0.0):
    """One pattern for ever; a reward of `rewards` (wrong, right) that depends on the output now."""
    right = np.array([[right_if_silent], [right_if_fires]])
    moves = np.repeat(np.stack([1.0 - right, right], axis=2), 2, axis=1)
    pomdp = POMDP(moves, np.ones((2, 1)), np.array(rewards, dtype=float))
    return finite_world(pomdp, np.array([[1.0, -0.5]]))


def held_chain(world, hidden, seed, scale=1.0):
    net = network(world, world.topology(hidden))
    weights = scale * np.random.default_rng(seed).normal(size=net.topology.synapses)
    return net, net.at(weights)


@pytest.mark.parametrize("hidden", [(2,), (1, 2), (1, 1, 1)])
def test_under_a_held_pattern_a_layer_is_credited_at_its_distance_and_never_else(hidden):
    """E[r z] = β^d ∇η exactly, d the steps to the output: each layer's direction is unbiased."""
    net, chain = held_chain(held((-0.3, 1.0)), hidden, seed=4)
    for group, distance in steps_to_output(net.topology).items():
        own = net.synapses_onto(group)
        for beta in (0.1, 0.5, 0.9):
            expected = beta**distance * chain.gradient[own]
            assert np.allclose(chain.biased_gradient(beta)[own], expected, rtol=0, atol=1e-15)


def best_by_model(mean, variance, distance=1):
    """Of β^2d / (m²/(1−β)² + v/(1−β²)): signal per noise if surprises and rewards are unrelated.

    Σ_t r_t z_t = Σ_t g_t R_t, with g the eligibility term and R_t = Σ_d β^d r_{t+d}.
    """
    beta = np.linspace(0.0, 0.9999, 100_000)
    noise = mean**2 / (1.0 - beta) ** 2 + variance / (1.0 - beta**2)
    return beta[np.argmax(beta ** (2 * distance) / noise)]


CASES = {
    # name: world, mean and variance of the reward, the best β for hidden synapses
    "nearly constant": (held((10.0, 10.1)), 10.05, 0.05**2, 0.500),
    "0 or 1, mean 0.9": (
        held((0.0, 1.0), right_if_fires=0.92, right_if_silent=0.88), 0.9, 0.09, 0.506,
    ),
    "0 or 1, mean 0.5": (held((0.0, 1.0)), 0.5, 0.25, 0.540),
    "-1 or 1, mean 0": (held((-1.0, 1.0)), 0.0, 1.0, 0.707),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_the_best_beta_for_hidden_synapses_depends_on_the_reward(case):
    """By the expected cosine, which a held pattern makes signal per noise at any length.

    The paper's 0.5 is the limit of rewards that hardly vary about a mean far from zero; its own
    sonar rewards give 0.54 at chance and 0.506 at 10 % error; rewards ±1 at chance 1/√2.
    """
    world, mean, variance, best = CASES[case]
    assert best_by_model(mean, variance) == pytest.approx(best, abs=1e-3)
    for seed in range(2):
        net, chain = held_chain(world, (2,), seed, scale=0.3)
        hidden = net.synapses_onto("hidden")
        for steps in (1.0, 1e6):
            assert chain.best_beta(steps=steps, of=hidden) == pytest.approx(best, abs=2e-3)
        output = net.synapses_onto("output")
        assert chain.best_beta(steps=1.0, of=output) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("hidden", "distance"), [((2,), 1), ((1, 2), 2), ((1, 1, 1), 3)])
def test_the_share_of_a_trace_that_matters_is_largest_at_d_over_d_plus_1(hidden, distance):
    """(1 − β) β^d: half for a single hidden layer, as the paper has it; 2/3, 3/4 for deeper ones.

    That is the signal per noise where the reward's mean outweighs its variance.
    """
    group = "hidden" if distance == 1 else "hidden 1"
    net, chain = held_chain(held((10.0, 10.1)), hidden, seed=1)
    best = chain.best_beta(steps=1.0, of=net.synapses_onto(group))
    assert best == pytest.approx(distance / (distance + 1), abs=2e-3)


def test_the_longer_the_average_the_longer_the_best_memory():
    """The small example: few steps are ruled by noise, many by the bias of the hidden layer."""
    net, weights = small_example()
    chain = net.at(weights)
    lengths = (1e3, 1e4, 1e5, 1e6)
    best = {steps: chain.best_beta(steps=steps) for steps in lengths}
    assert list(best.values()) == pytest.approx([0.387, 0.604, 0.764, 0.863], abs=2e-3)
    reached = [chain.expected_cosine(beta, steps=steps) for steps, beta in best.items()]
    assert np.all(np.diff(reached) > 0) and reached[-1] > 0.99
    for beta in (0.5, 0.99):
        assert chain.expected_cosine(beta, steps=1e6) < reached[-1]


# The task


class Drawn(FiniteWorld):
    name = "drawn"
    summary = "a random world of three outputs"
    outputs = tuple(Output(str(i), "1", "0") for i in range(3))
    presets: ClassVar = {"only": Preset(0.9, 0.01, "a test")}
    hidden = (2,)
    pomdp = POMDP(
        distributions(np.random.default_rng(0), 8, 5, 5),
        distributions(np.random.default_rng(1), 5, 3), np.arange(5.0),
    )  # fmt: skip
    vectors = np.random.default_rng(2).normal(size=(3, 7))


def test_a_finite_world_keeps_to_the_contract_of_tasks():
    """Compiled as in Python, to the bit, whatever the sizes."""
    check_task(Drawn)
    check_task(Lamps)


@settings(max_examples=20)
@given(seed=SEEDS, draw=st.floats(2**-33, 1 - 2**-33))
def test_what_is_impossible_is_never_drawn(seed, draw):
    """Whatever the draw, also at the ends of the row where its sum is not quite 1."""
    rng = np.random.default_rng(seed)
    rows = distributions(rng, 2, 4, 4) * (rng.random((2, 4, 4)) < 0.5)
    rows[:, :, 1] += 1e-3
    pomdp = POMDP(rows / rows.sum(axis=2, keepdims=True), np.eye(4), np.zeros(4))
    task = finite_world(pomdp, np.zeros((4, 1)))
    for x in range(4):
        for control, action in enumerate((-1.0, 1.0)):
            after = task.transition(
                np.array([x, x], dtype=float), np.array([action]), lambda n: np.full(n, draw)
            )
            assert pomdp.transitions[control, x, int(after[0])] > 0.0
            assert after[1] == after[0]


def test_what_does_not_fit_is_refused():
    world, _ = three_sights()
    with pytest.raises(ValueError, match=r"vectors must be finite and of shape \(3 observations"):
        finite_world(world, np.zeros((2, 1)))
    with pytest.raises(ValueError, match="vectors must be finite"):
        finite_world(world, np.full((3, 1), np.nan))
    with pytest.raises(ValueError, match="2 inputs have names, vectors have 3"):
        type("Wide", (Lamps,), {"vectors": np.zeros((2, 3))})()
    odd = POMDP(np.full((3, 2, 2), 0.5), np.eye(2), np.zeros(2))
    with pytest.raises(ValueError, match="2 outputs make 4 controls, the world has 3"):
        finite_world(odd, np.eye(2))
    task = finite_world(world, np.eye(3))
    with pytest.raises(ValueError, match="3 inputs and 2 controls, the network 2 inputs"):
        network(task, feedforward(2, (), 1))
    with pytest.raises(ValueError, match="take fewer neurons"):
        network(task, feedforward(3, (9,), 1))
    net = network(task, feedforward(3, (), 1))
    for bad in (np.zeros(2), np.full(3, np.inf)):
        with pytest.raises(ValueError, match="weights must be finite and of shape"):
            net.at(bad)


def three_sights():
    return POMDP(np.full((2, 3, 3), 1 / 3), np.eye(3), np.zeros(3)), Gibbs.table(3, 2)


# The small example


def test_the_small_example_is_quick_to_compute_and_quick_to_mix():
    net, weights = small_example()
    times = []
    for _ in range(5):
        start = time.perf_counter()
        chain = net.at(weights)
        gradient = chain.gradient
        times.append(time.perf_counter() - start)
    assert min(times) < 0.02
    assert chain.mixing_time <= 4 and chain.relaxation_time < 3
    assert len(chain.reward) == 64
    assert np.abs(gradient).min() > 0.3 * np.abs(gradient).max()
    assert isinstance(net.policy, NetworkPolicy)
