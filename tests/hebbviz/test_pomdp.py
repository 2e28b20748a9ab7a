"""Finite POMDPs, their policies and their chains: exact gradients, biases, noise, mixing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hebbviz.theory.markov_chain import Chain
from hebbviz.theory.policies import Gibbs, Independent, Neuron, mixed_digits
from hebbviz.theory.pomdp import POMDP, three_state_chain

SEEDS = st.integers(0, 2**32 - 1)


def distributions(rng, *shape):
    """Random rows that sum to 1, some of their entries zero or nearly so."""
    rows = rng.gamma(0.7, size=shape) + 1e-3
    return rows / rows.sum(axis=-1, keepdims=True)


def random_pomdp(rng, *, controls=None, sights=None):
    states = int(rng.integers(2, 7))
    controls = int(rng.integers(2, 5)) if controls is None else controls
    sights = int(rng.integers(1, 5)) if sights is None else sights
    return POMDP(
        distributions(rng, controls, states, states), distributions(rng, states, sights),
        rng.normal(size=states),
    )  # fmt: skip


def random_policy(rng, sights, controls=None):
    """One of the three kinds that fits; a neuron has two controls."""
    kind = rng.integers(3) if controls in (None, 2) else rng.integers(2)
    if kind == 2:
        return Neuron(rng.normal(size=(sights, int(rng.integers(1, 5)))))
    controls = int(rng.integers(2, 4)) if controls is None else controls
    if kind == 0:
        return Gibbs.table(sights, controls)
    return Gibbs.linear(rng.normal(size=(sights, int(rng.integers(1, 4)))), controls)


def random_case(seed):
    rng = np.random.default_rng(seed)
    world = random_pomdp(rng)
    policy = random_policy(rng, world.sights, world.controls)
    return world, policy, rng.normal(size=policy.parameters)


def slopes(function, theta, h=1e-5):
    """Central differences of a function of θ (K,), the parameter on the last axis."""
    steps = h * np.eye(theta.size)
    return np.stack([(function(theta + s) - function(theta - s)) / (2 * h) for s in steps], axis=-1)


# Policies


@given(seed=SEEDS)
def test_a_policy_is_a_distribution_and_its_score_the_slope_of_its_logarithm(seed):
    rng = np.random.default_rng(seed)
    policy = random_policy(rng, int(rng.integers(1, 6)))
    theta = rng.normal(size=policy.parameters)
    mu, score = policy.probabilities(theta), policy.score(theta)
    assert score.shape == (*mu.shape, theta.size)
    assert np.allclose(mu.sum(axis=1), 1.0, rtol=0, atol=1e-14) and np.all(mu > 0.0)
    numeric = slopes(lambda t: np.log(policy.probabilities(t)), theta)
    assert np.allclose(score, numeric, rtol=0, atol=1e-8)
    assert np.allclose(np.einsum("yu,yuk->yk", mu, score), 0.0, rtol=0, atol=1e-13)


def test_a_neuron_fires_by_sigma_even_far_out():
    neuron = Neuron(np.array([[1.0, 2.0], [-800.0, 0.0], [800.0, 0.0]]))
    mu, score = neuron.probabilities(np.array([0.5, 0.25])), neuron.score(np.array([0.5, 0.25]))
    assert mu[0, 1] == pytest.approx(1.0 / (1.0 + math.exp(-1.0)), rel=1e-15)
    assert np.allclose(score[0], np.outer([-mu[0, 1], mu[0, 0]], [1.0, 2.0]), rtol=1e-14)
    assert np.array_equal(mu[1:], [[1.0, mu[1, 1]], [mu[2, 0], 1.0]])
    assert np.isfinite(score).all()


def test_digits_count_the_first_agent_fastest():
    digits = mixed_digits([2, 3])
    assert digits.tolist() == [[0, 1, 0, 1, 0, 1], [0, 0, 1, 1, 2, 2]]


# The chain


@settings(max_examples=40)
@given(seed=SEEDS)
def test_the_transition_matrix_is_the_sum_over_what_is_seen_and_done(seed):
    world, policy, theta = random_case(seed)
    mu, p = policy.probabilities(theta), np.zeros((world.states, world.states))
    for i in range(world.states):
        for y in range(world.sights):
            for u in range(world.controls):
                p[i] += world.observations[i, y] * mu[y, u] * world.transitions[u, i]
    chain = world.under(policy, theta)
    assert np.allclose(chain.transition, p, rtol=0, atol=1e-14)
    assert np.allclose(chain.stationary @ p, chain.stationary, rtol=0, atol=1e-13)
    assert chain.stationary.sum() == pytest.approx(1.0, abs=1e-13)
    long_run = np.linalg.matrix_power(p, 2**20)[0] @ world.rewards
    assert chain.average_reward == pytest.approx(long_run, abs=1e-9)


@settings(max_examples=60)
@given(seed=SEEDS)
def test_the_gradient_is_that_of_finite_differences(seed):
    world, policy, theta = random_case(seed)
    chain = world.under(policy, theta)
    numeric = slopes(lambda t: np.array(world.under(policy, t).average_reward), theta)
    assert np.allclose(chain.gradient, numeric, rtol=0, atol=2e-8)
    of_p = slopes(lambda t: world.under(policy, t).transition, theta)
    assert np.allclose(np.moveaxis(chain.slope, 0, -1), of_p, rtol=0, atol=1e-8)


@settings(max_examples=40)
@given(seed=SEEDS)
def test_the_biased_gradient_is_the_sum_over_delays(seed):
    """Σ_d β^d π ∇P P^d r, at any β; at β = 0 only what follows at once."""
    world, policy, theta = random_case(seed)
    chain = world.under(policy, theta)
    by_delay = chain.gradient_by_delay(400)
    for beta in (0.0, 0.5, 0.9):
        total = beta ** np.arange(400) @ by_delay
        assert np.allclose(chain.biased_gradient(beta), total, rtol=0, atol=1e-12)


@settings(max_examples=60)
@given(seed=SEEDS)
def test_the_bias_vanishes_in_proportion_to_one_minus_beta(seed):
    """∇η − E[r z] = (1 − β) π ∇P Z P Z r + O((1 − β)²): no sampling, so to rounding."""
    world, policy, theta = random_case(seed)
    chain = world.under(policy, theta)
    z, p = chain.fundamental, chain.transition
    first_order = chain.stationary @ chain.slope @ z @ p @ (z @ chain.reward)
    size = np.abs(first_order).max() + np.abs(chain.gradient).max()
    errors = []
    for left in (1e-3, 1e-4):
        bias = chain.gradient - chain.biased_gradient(1.0 - left)
        errors.append(np.abs(bias / left - first_order).max() / size)
    assert errors[0] < 0.3
    assert errors[1] < 0.11 * errors[0] + 1e-10
    near = chain.biased_gradient(1.0 - 1e-12)
    assert np.allclose(near, chain.gradient, rtol=0, atol=1e-10 * size)


@settings(max_examples=30)
@given(seed=SEEDS, shift=st.floats(-10.0, 10.0))
def test_a_constant_added_to_the_reward_changes_no_gradient(seed, shift):
    world, policy, theta = random_case(seed)
    chain = world.under(policy, theta)
    shifted = POMDP(world.transitions, world.observations, world.rewards + shift)
    other = shifted.under(policy, theta)
    assert other.average_reward == pytest.approx(chain.average_reward + shift, abs=1e-12)
    assert np.allclose(other.gradient, chain.gradient, rtol=0, atol=1e-10)
    assert np.allclose(other.biased_gradient(0.9), chain.biased_gradient(0.9), rtol=0, atol=1e-10)


def noise_by_enumeration(chain, k, beta, far):
    """Σ_n Cov(r_t z_t, r_{t+n} z_{t+n}) term by term, with z and n cut off at `far`."""
    kinds = (chain.transition, chain.slope[k], chain.square[k])  # no score, one, two at this step

    def moment(scores, rewards):
        """E of a product of scores of the steps into, and rewards of, states at given times."""
        row = chain.stationary
        for s in range(min(scores), max(rewards) + 1):
            row = (row @ kinds[scores.count(s)]) * chain.reward ** rewards.count(s)
        return row.sum()

    c = sum(beta**i * moment([-i], [0]) for i in range(far))
    lags = [
        sum(beta ** (i + j) * moment([-i, n - j], [0, n]) for i in range(far) for j in range(far))
        for n in range(far)
    ]
    return lags[0] - c * c + 2.0 * sum(lag - c * c for lag in lags[1:])


@pytest.mark.parametrize("beta", [0.0, 0.3, 0.45])
def test_the_noise_is_the_sum_of_all_covariances(beta):
    for seed in (0, 2, 6):
        world, policy, theta = random_case(seed)
        chain = world.under(policy, theta)
        enumerated = noise_by_enumeration(chain, 0, beta, far=13)
        assert chain.noise(beta)[0] == pytest.approx(enumerated, rel=1e-4)


def test_the_noise_grows_with_the_square_of_the_time_constant_and_less_without_a_mean_reward():
    """(1 − β)² noise → η² E[score²]; with η taken off the reward, noise grows as 1/(1 − β)."""
    for seed in range(10):
        world, policy, theta = random_case(seed)
        chain = world.under(policy, theta)
        eta, score2 = chain.average_reward, (chain.stationary @ chain.square).sum(axis=1)
        left = 1e-5
        limit = eta**2 * score2
        assert np.allclose(
            left**2 * chain.noise(1.0 - left), limit, rtol=0, atol=1e-6 + 1e-3 * eta**2
        )
        centred = Chain(chain.transition, chain.slope, chain.square, chain.reward - eta)
        small, large = centred.noise(0.99), centred.noise(0.9999)
        seen = score2 > 1e-9
        assert np.all(np.abs(large[seen] / small[seen] - 100.0) < 10.0)


# Mixing


@settings(max_examples=60)
@given(seed=SEEDS, stays=st.sampled_from([0.0, 0.5, 0.9, 0.99]), beta=st.floats(0.01, 0.99))
def test_a_slower_world_needs_a_longer_memory_exactly(seed, stays, beta):
    """A lazy world at β is the quick one at β', where β'/(1 − β') = (1 − stays) β/(1 − β).

    Same π and η, and E[r z] = (β'/β) E'[r z]: the time constant that suffices follows the world's.
    """
    world, policy, theta = random_case(seed)
    quick, slow = world.under(policy, theta), world.lazy(stays).under(policy, theta)
    odds = (1.0 - stays) * beta / (1.0 - beta)
    same = odds / (1.0 + odds)
    undone = stays * np.eye(world.states) + (1.0 - stays) * quick.transition
    assert np.allclose(slow.transition, undone, rtol=0, atol=1e-14)
    assert np.allclose(slow.stationary, quick.stationary, rtol=0, atol=1e-11)
    assert np.allclose(slow.gradient, quick.gradient, rtol=0, atol=1e-9)
    expected = same / beta * quick.biased_gradient(same)
    assert np.allclose(slow.biased_gradient(beta), expected, rtol=0, atol=1e-12)


LONGEST = 1e6


def sufficient_time(chain, relative_bias):
    """1/(1 − β) at the least β, on a fine grid, from which on the bias is below the share.

    Infinite where it is not below it at 1/(1 − β) = LONGEST.
    """
    times = np.geomspace(1.0, LONGEST, 400)
    size = np.linalg.norm(chain.gradient)
    bias = [
        np.linalg.norm(chain.biased_gradient(1.0 - 1.0 / t) - chain.gradient) / size for t in times
    ]
    too_short = np.flatnonzero(np.array(bias) >= relative_bias)
    return np.append(times, math.inf)[too_short[-1] + 1 if too_short.size else 0]


def lazy_chains():
    """The three-state chain, its steps undone more and more often."""
    world, policy = three_state_chain()
    theta = np.array([1.0, 1.0, -1.0, -1.0])
    return [world.lazy(stays).under(policy, theta) for stays in (0.9, 0.97, 0.99, 0.999)]


def bottleneck(cross):
    """Two pairs of states, a door in each; from door to door with probability `cross`.

    A control leads to one state of the pair with probability 0.8. It is seen which pair it is;
    the second one is rewarded.
    """
    moves = np.zeros((2, 4, 4))
    for control, within in enumerate(([0.8, 0.2], [0.2, 0.8])):
        moves[control] = np.kron(np.eye(2), [within, within])
    for door, other in ((1, 2), (2, 1)):
        moves[:, door] = (1.0 - cross) * moves[:, door] + cross * np.eye(4)[other]
    return POMDP(moves, np.repeat(np.eye(2), 2, axis=0), np.array([0.0, 0.0, 1.0, 1.0]))


def bottlenecks():
    """A narrower and a narrower one: quick within a pair, slow between the two."""
    policy, theta = Gibbs.table(2, 2), np.array([0.5, 0.0, 0.0, 0.3])
    return [bottleneck(cross).under(policy, theta) for cross in (0.03, 0.01, 0.003, 0.001)]


@pytest.mark.parametrize(("chains", "growth"), [(lazy_chains, 80.0), (bottlenecks, 25.0)])
def test_the_beta_that_suffices_follows_the_mixing_time(chains, growth):
    """On ever slower chains: bias 2 % at a fixed multiple of either time, to 15 %."""
    found = chains()
    needed = np.array([sufficient_time(chain, 0.02) for chain in found])
    by_relaxing = needed / [chain.relaxation_time for chain in found]
    by_mixing = needed / [chain.mixing_time for chain in found]
    assert np.all(np.diff(needed) > 0) and needed[-1] > growth * needed[0]
    assert needed[-1] < LONGEST
    assert max(by_relaxing) < 1.15 * min(by_relaxing)
    assert max(by_mixing) < 1.15 * min(by_mixing)


def test_a_time_that_suffices_is_infinite_where_none_is_found():
    world, policy = three_state_chain()
    theta = np.array([1.0, 1.0, -1.0, -1.0])
    assert sufficient_time(world.under(policy, theta), 0.1) == 1.0
    assert sufficient_time(world.lazy(1.0 - 1e-6).under(policy, theta), 0.02) == math.inf


@settings(max_examples=40)
@given(seed=SEEDS, stays=st.sampled_from([0.0, 0.7, 0.97]))
def test_the_mixing_time_is_the_first_step_at_which_starts_are_forgotten(seed, stays):
    world, policy, theta = random_case(seed)
    chain = world.lazy(stays).under(policy, theta)
    t, power = 1, chain.transition
    while max(0.5 * np.abs(a - b).sum() for a in power for b in power) > np.exp(-1.0):
        t, power = t + 1, power @ chain.transition
    assert chain.mixing_time == t
    second = sorted(np.abs(np.linalg.eigvals(chain.transition)))[-2]
    assert chain.relaxation_time == pytest.approx(1.0 / (1.0 - second))


def test_a_periodic_chain_has_an_average_reward_and_never_mixes():
    world = POMDP(np.array([[[0.0, 1.0], [1.0, 0.0]]] * 2), np.ones((2, 1)), np.array([0.0, 1.0]))
    chain = world.under(Gibbs.table(1, 2), np.zeros(2))
    assert chain.average_reward == pytest.approx(0.5)
    assert chain.mixing_time == chain.relaxation_time == math.inf


# The three-state chain of Baxter and Bartlett


def test_the_three_state_chain_is_theirs():
    """Its best average reward is 0.8, by always taking the second control; its worst is 0.2."""
    world, policy = three_state_chain()
    etas = []
    for choice in np.ndindex(2, 2, 2):
        table = Gibbs.table(3, 2)
        theta = 40.0 * np.eye(2)[list(choice)].ravel()
        etas.append(world.under(table, theta).average_reward)
    assert max(etas) == pytest.approx(0.8, abs=1e-9) and etas[-1] == max(etas)
    assert min(etas) == pytest.approx(0.2, abs=1e-9) and etas[0] == min(etas)
    second = world.under(policy, 100.0 * np.array([-1.0, -1.0, 1.0, 1.0]))
    assert second.average_reward == pytest.approx(0.8, abs=1e-9)


def test_its_bias_falls_as_beta_rises():
    """From 7.7 % at β = 0 to below 0.1 % at 0.99: its direction is right at every β."""
    world, policy = three_state_chain()
    chain = world.under(policy, np.array([1.0, 1.0, -1.0, -1.0]))
    size = np.linalg.norm(chain.gradient)
    betas = (0.0, 0.4, 0.8, 0.95, 0.99)
    bias = [np.linalg.norm(chain.biased_gradient(b) - chain.gradient) / size for b in betas]
    assert np.all(np.diff(bias) < 0)
    assert bias[0] == pytest.approx(0.0771, abs=1e-4) and bias[-1] < 1e-3
    cosines = [chain.expected_cosine(b, steps=math.inf) for b in betas]
    assert cosines == pytest.approx([1.0] * len(betas), abs=1e-12)


# What is refused

TWO = np.full((2, 3, 3), 1 / 3)
EYE = np.eye(3)


@pytest.mark.parametrize(
    ("transitions", "observations", "rewards", "words"),
    [
        (TWO[0], EYE, np.zeros(3), r"transitions must have shape \(controls, states, states\)"),
        (TWO[:, :2], EYE, np.zeros(3), "transitions must have shape"),
        (TWO, EYE[:2], np.zeros(3), r"observations must have shape \(3 states"),
        (TWO, EYE, np.zeros(2), r"rewards must have shape \(3 states,\), got \(2,\)"),
        (TWO * 1.01, EYE, np.zeros(3), r"transitions must sum to 1, row \(0, 0\) sums to 1.01"),
        (TWO, EYE * 0.5, np.zeros(3), r"observations must sum to 1, row \(0,\) sums to 0.5"),
        (TWO, EYE + [[0.5, -0.5, 0]] * 3, np.zeros(3), r"observations must be finite and >= 0"),
        (TWO * np.nan, EYE, np.zeros(3), r"transitions must be finite and >= 0, row \(0, 0\)"),
        (TWO, EYE, np.array([0.0, np.inf, 0.0]), "rewards must be finite"),
    ],
)
def test_what_is_no_pomdp_is_refused(transitions, observations, rewards, words):
    with pytest.raises(ValueError, match=words):
        POMDP(transitions, observations, rewards)


def test_a_pomdp_cannot_be_changed():
    transitions = TWO.copy()
    world = POMDP(transitions, EYE, np.zeros(3))
    transitions[:] = 0.0
    assert world.transitions.sum() == pytest.approx(6.0)
    with pytest.raises(ValueError, match="read-only"):
        world.rewards[0] = 1.0


def test_what_does_not_fit_is_refused():
    world, policy = three_state_chain()
    with pytest.raises(ValueError, match="the policy has 2 observations and 2 controls, the world"):
        world.under(Gibbs.table(2, 2), np.zeros(4))
    apart = POMDP(np.array([np.eye(2)]), np.ones((2, 1)), np.zeros(2))
    with pytest.raises(ValueError, match="one recurrent class"):
        apart.under(Gibbs.table(1, 1), np.zeros(1))
    chain = world.under(policy, np.zeros(4))
    for beta in (1.0, -0.1, math.nan):
        with pytest.raises(ValueError, match=r"beta must be in \[0, 1\)"):
            chain.biased_gradient(beta)
    with pytest.raises(ValueError, match="steps must be above 0"):
        chain.expected_cosine(0.5, steps=0.0)
    with pytest.raises(ValueError, match=r"stays must be in \[0, 1\)"):
        world.lazy(1.0)
    flat = POMDP(world.transitions, world.observations, np.ones(3)).under(policy, np.zeros(4))
    exactly_flat = Chain(flat.transition, 0.0 * flat.slope, flat.square, flat.reward)
    with pytest.raises(ValueError, match="no direction"):
        exactly_flat.expected_cosine(0.5, steps=1.0)
    for bad in (np.zeros(3), np.full((1, 1, 1), np.nan)):
        with pytest.raises(ValueError, match="features must be finite"):
            Gibbs(bad)
    with pytest.raises(ValueError, match="inputs must be finite"):
        Neuron(np.zeros(3))
    with pytest.raises(ValueError, match=r"sees must be of shape \(1 agents"):
        Independent((Gibbs.table(1, 2),), np.zeros((2, 4), dtype=np.int64))
    with pytest.raises(ValueError, match="at least one"):
        Independent((), np.zeros((0, 4), dtype=np.int64))
