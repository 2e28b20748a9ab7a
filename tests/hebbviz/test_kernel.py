"""The compiled rule is the paper's: against the reference, and against calculus."""

import math
from decimal import Decimal, localcontext
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from hebbviz.engine.kernel import sigmoid
from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import FIRST_EPISODE, Draws
from hebbviz.reference import Reference, sigma
from hebbviz.task.base import Input, Output, Task
from hebbviz.task.presets import Preset
from hebbviz.topology import BINARY, SYMMETRIC, Group, Projection, Topology

STEPS = 10_000


class Chatter(Task):
    """State: tick, reward, then an input that changes every `hold` steps (0: never).

    Rewards are of both signs, and positive on average: under punishment alone the rule moves
    away from where it is, and a difference of rounding would grow exponentially.
    """

    name = "chatter"
    presets: ClassVar = {"only": Preset(0.5, 0.1, "a test")}

    def __init__(self, topology, hold=1, reward_scale=1.0, gain=1.0):
        self.inputs = tuple(Input(str(k)) for k in range(topology.inputs))
        size = topology.group(topology.output).size
        self.outputs = tuple(Output(str(k), "1", "0") for k in range(size))
        self.hold, self.reward_scale, self.gain = hold, reward_scale, gain
        super().__init__()

    def restart(self, draws):
        return np.array([0.0, 0.0, *self._shown(draws(1 + len(self.inputs)))])

    def transition(self, state, action, draws):
        after, chances = state.copy(), draws(1 + len(self.inputs))
        after[0] += 1.0
        after[1] = self.reward_scale * (chances[0] - 0.3 + 0.3 * (action.sum() > 0.0))
        if self.hold and after[0] % self.hold == 0.0:
            after[2:] = self._shown(chances)
        return after

    def _shown(self, chances):
        return self.gain * (2.0 * chances[1:] - 1.0)

    def observation(self, state):
        return state[2:]

    def reward(self, state):
        return state[1]


@st.composite
def topologies(draw):
    """Up to two input groups and three of neurons in any order, any projections among them."""
    inputs = [Group(f"in {k}", draw(st.integers(1, 5)), is_input=True)
              for k in range(draw(st.integers(1, 2)))]  # fmt: skip
    neurons = [Group(f"n {k}", draw(st.integers(1, 6))) for k in range(draw(st.integers(1, 3)))]
    possible = [Projection(a.name, b.name) for a in inputs + neurons for b in neurons]
    chosen = draw(st.lists(st.sampled_from(possible), min_size=2, max_size=6, unique=True))
    return Topology(
        tuple(draw(st.permutations(inputs + neurons))),
        tuple(chosen),
        draw(st.sampled_from(neurons)).name,
        draw(st.sampled_from([BINARY, SYMMETRIC])),
    )


TWELVE = settings(max_examples=12)
RUNS = given(
    topology=topologies(),
    hold=st.sampled_from([0, 1, 2, 7, 1000]),
    beta=st.sampled_from([0.0, 0.5, 0.9, 0.995]),
    gamma=st.floats(1e-4, 0.02),
    scale=st.floats(0.1, 2.0),
    seed=st.integers(0, 2**32 - 1),
    lane=st.integers(0, 1000),
)


@TWELVE
@RUNS
def test_two_thousand_steps_are_those_of_the_reference(**run):
    check_against_the_reference(2_000, **run)


@pytest.mark.slow
@TWELVE
@RUNS
def test_ten_thousand_steps_are_those_of_the_reference(**run):
    check_against_the_reference(STEPS, **run)


def check_against_the_reference(steps, *, topology, hold, beta, gamma, scale, seed, lane):
    task = Chatter(topology, hold, scale)
    learner = Learner(task, topology=topology, beta=beta, gamma=gamma, seed=seed, first_lane=lane)
    fired, reference = follow(learner, task, steps)
    assert np.array_equal(learner.advance(steps).fired, fired)
    assert_close(learner.weights[:, 0], flat(reference.weights))
    assert_close(learner.traces[:, 0], flat(reference.traces))


def follow(learner, task, steps):
    """The reference's spikes from a learner's start, and the reference after them."""
    topology = learner.topology
    reference = Reference(
        topology, apart(topology, learner.weights[:, 0]), beta=learner.beta,
        gamma=learner.gamma, seed=learner.seed, lane=learner.first_lane,
    )  # fmt: skip
    state = task.restart(Draws(learner.seed, learner.first_lane, 0, FIRST_EPISODE))
    reference.observe(task.observation(state))
    fired = np.empty((steps, topology.neurons))
    for step in range(steps):
        action = reference.respond()
        fired[step] = reference.fired
        state = task.transition(state, action, Draws(learner.seed, learner.first_lane, step))
        reference.reinforce(task.reward(state))
        reference.observe(task.observation(state))
    return fired, reference


def apart(topology, weights):
    """Flat weights as one (post, pre) array per projection."""
    return [
        weights[topology.synapses_of(k)].reshape(topology.shape(p))
        for k, p in enumerate(topology.projections)
    ]


def flat(arrays):
    return np.concatenate([a.ravel() for a in arrays])


def assert_close(got, expected):
    assert np.all(np.abs(got - expected) <= 1e-9 * np.maximum(1.0, np.abs(expected)))


# A network with everything: two input groups, a loop, a self-loop, a projection past a layer.
EVERYTHING = (
    (
        Group("hidden", 5),
        Group("left", 3, is_input=True),
        Group("out", 2),
        Group("right", 4, is_input=True),
    ),
    tuple(
        Projection(*names.split())
        for names in (
            "left hidden", "right out", "hidden out", "hidden hidden", "out hidden", "right hidden",
        )
    ),
)  # fmt: skip


def everything(activity):
    return Topology(*EVERYTHING, "out", activity)


ACTIVITIES = pytest.mark.parametrize("activity", [BINARY, SYMMETRIC])


def log_probability(topology, weights, before, fired):
    """log P(who fires | activities before), by equations (potential) and (neuron)."""
    v = np.zeros(topology.neurons)
    for p, w in zip(topology.projections, apart(topology, weights), strict=True):
        v[topology.neurons_of(p.post)] += w @ before[topology.units_of(p.pre)]
    return float(np.sum(np.where(fired > 0, -np.logaddexp(0.0, -v), -np.logaddexp(0.0, v))))


def gradient(topology, weights, before, fired, h=1e-5):
    """Its derivatives by each weight, from central differences."""
    steps = h * np.eye(weights.size)
    return np.array([
        (log_probability(topology, weights + s, before, fired)
         - log_probability(topology, weights - s, before, fired)) / (2 * h)
        for s in steps
    ])  # fmt: skip


@ACTIVITIES
@pytest.mark.parametrize("hold", [1, 5])
def test_the_eligibility_term_is_the_gradient_of_log_probability(activity, hold):
    topology = everything(activity)
    learner = Learner(Chatter(topology, hold), topology=topology, beta=0.0, gamma=0.05, seed=4)
    learner.set_weights(np.random.default_rng(0).normal(size=(topology.synapses, 1)))
    for _ in range(30):
        weights, before = learner.weights[:, 0], learner.activities[:, 0]
        fired = learner.advance(1).fired[0]
        expected = gradient(topology, weights, before, fired)
        assert np.allclose(learner.traces[:, 0], expected, rtol=0, atol=1e-8)


@ACTIVITIES
def test_so_is_that_of_the_reference(activity):
    topology = everything(activity)
    rng = np.random.default_rng(1)
    weights = rng.normal(size=topology.synapses)
    reference = Reference(topology, apart(topology, weights), beta=0.0, gamma=0.0, seed=3)
    reference.observe(rng.normal(size=topology.inputs))
    for _ in range(30):
        before = np.concatenate(
            [reference.activities[n] for n in ("left", "right", "hidden", "out")]
        )
        reference.respond()
        expected = gradient(topology, weights, before, reference.fired)
        assert np.allclose(flat(reference.traces), expected, rtol=0, atol=1e-8)


@ACTIVITIES
def test_the_eligibility_term_has_mean_zero(activity):
    """Over 4 096 lanes with the same weights and input, at each of three steps."""
    topology = everything(activity)
    lanes = 4096
    task = Chatter(topology, hold=0)
    learner = Learner(task, topology=topology, beta=0.0, gamma=0.0, lanes=lanes)
    one = np.random.default_rng(2).normal(size=(topology.synapses, 1))
    learner.set_weights(np.repeat(one, lanes, axis=1))
    learner.place(np.repeat(learner.world[:, :1], lanes, axis=1))
    for _ in range(3):
        learner.skip(1)
        term = learner.traces
        spread = term.std(axis=1, ddof=1) / math.sqrt(lanes)
        assert np.all(np.abs(term.mean(axis=1)) <= 4.0 * spread + 1e-15)
        assert np.any(spread > 1e-3)


def test_and_exactly_so_in_expectation():
    """σ(1 − σ) + (1 − σ)(−σ) = 0, with the numbers the compiled rule uses."""
    topology = everything(SYMMETRIC)
    learner = Learner(Chatter(topology), topology=topology)
    learner.advance(10)
    moment = learner.keyframe()
    terms = []
    for forced in (1.0, 0.0):
        learner.restore(moment)
        learner._tiles.put("clamp", forced)
        learner.advance(1)
        terms.append(learner._tiles.read("surprise"))
    chance = learner.frame().probability[:, None]
    assert np.array_equal(terms[0], 1.0 - chance)
    assert np.array_equal(terms[1], -chance)
    assert np.all(chance * terms[0] + (1.0 - chance) * terms[1] == 0.0)


def test_neurons_fire_with_probability_sigma():
    """4 096 lanes and three steps: counts within 4.5 standard errors."""
    topology = everything(SYMMETRIC)
    lanes = 4096
    learner = Learner(Chatter(topology), topology=topology, gamma=0.0, lanes=lanes)
    learner.set_weights(np.random.default_rng(3).normal(size=(topology.synapses, lanes)))
    for _ in range(3):
        learner.skip(1)
        chance = sigma(learner.potentials)
        fired = learner.activities[-topology.neurons :] == topology.activity[1]
        error = np.sqrt((chance * (1.0 - chance)).sum(axis=1))
        assert np.all(np.abs((fired - chance).sum(axis=1)) < 4.5 * error)


@njit
def squash(v):
    out = np.empty_like(v)
    for k in range(v.size):
        out[k] = sigmoid(v[k])
    return out


def exact_sigmoid(v):
    with localcontext() as context:
        context.prec = 40
        return Decimal(1) / (Decimal(1) + (-Decimal(v)).exp())


def test_sigmoid_is_accurate():
    rng = np.random.default_rng(0)
    v = np.concatenate([
        rng.uniform(-1, 1, 400), rng.uniform(-40, 40, 800), rng.uniform(-690, 690, 400),
        rng.uniform(-1, 1, 100) * 1e-8, [0.0, -0.0, 36.7, -36.7, 5e-324],
    ])  # fmt: skip
    for x, got in zip(v.tolist(), squash(v).tolist(), strict=True):
        expected = exact_sigmoid(x)
        assert abs(Decimal(got) - expected) <= Decimal("1e-15") * expected, x
    assert np.allclose(squash(v), sigma(v), rtol=1e-15, atol=0)


def test_sigmoid_is_safe_far_out_and_never_falls():
    far = np.array([-np.inf, -1e308, -1e4, -745.0, -700.0])
    assert np.all(squash(far) <= 1e-300)
    assert np.all(squash(far) >= 0.0)
    assert np.array_equal(squash(-far), np.ones(5))
    near = np.linspace(-2.0, 2.0, 200_001)
    wide = np.linspace(-750.0, 750.0, 200_001)
    for v in (near, wide):
        assert np.all(np.diff(squash(v)) >= -2.3e-16 * squash(v)[1:])
    assert np.all(np.diff(squash(np.linspace(-30.0, 30.0, 10_001))) > 0.0)


@ACTIVITIES
def test_weights_move_by_gamma_r_z(activity):
    """And only by that; for held input and for the rest, to rounding."""
    topology = everything(activity)
    learner = Learner(Chatter(topology, hold=4), topology=topology, beta=0.9, gamma=0.03, seed=1)
    for step in range(200):
        if step == 100:
            learner.freeze(frozen=True)
        before = learner.weights
        reward = learner.advance(1).broadcast[0]
        force = 0.0 if step >= 100 else 0.03
        assert np.allclose(learner.weights - before, force * reward * learner.traces,
                           rtol=0, atol=1e-14)  # fmt: skip


def test_a_single_synapse_moves_exactly_so():
    """One dense synapse from zero: the same product to the bit."""
    topology = Topology(
        (Group("in", 1, is_input=True), Group("a", 1), Group("b", 1)),
        (Projection("in", "a"), Projection("a", "b")), "b",
    )  # fmt: skip
    learner = Learner(Chatter(topology), topology=topology, beta=0.7, gamma=0.03)
    learner.set_weights(np.zeros((2, 1)))
    reward = learner.advance(1).broadcast[0]
    assert learner.weights[1, 0] == 0.03 * reward * learner.traces[1, 0]
    assert reward != 0.0


@ACTIVITIES
@pytest.mark.parametrize("beta", [0.0, 0.8, 0.999])
def test_the_trace_is_a_leaky_sum_of_terms(beta, activity):
    """z_T = Σ_t β^(T−t) (fired_t − σ_t) u_{t−1}, whatever the inputs did meanwhile."""
    topology = everything(activity)
    learner = Learner(Chatter(topology, hold=6), topology=topology, beta=beta, gamma=0.01, seed=2)
    terms = []
    for _ in range(300):
        before = learner.activities[:, 0]
        learner.advance(1)
        frame = learner.frame()
        surprise = frame.fired - frame.probability
        rows = (
            (topology.neurons_of(p.post), topology.units_of(p.pre)) for p in topology.projections
        )
        terms.append(flat([np.outer(surprise[post], before[pre]) for post, pre in rows]))
    weights = beta ** np.arange(len(terms) - 1, -1, -1)
    assert np.allclose(learner.traces[:, 0], weights @ np.array(terms), rtol=0, atol=1e-11)


def test_the_potential_uses_the_activities_before():
    topology = everything(SYMMETRIC)
    learner = Learner(Chatter(topology, hold=3), topology=topology, beta=0.5, gamma=0.05)
    for _ in range(50):
        weights, before = learner.weights[:, 0], learner.activities[:, 0]
        learner.advance(1)
        v = np.zeros(topology.neurons)
        for p, w in zip(topology.projections, apart(topology, weights), strict=True):
            v[topology.neurons_of(p.post)] += w @ before[topology.units_of(p.pre)]
        frame = learner.frame()
        assert np.allclose(frame.potential, v, rtol=0, atol=1e-13)
        assert np.array_equal(frame.fired, frame.draw < frame.probability)
        low, high = topology.activity
        assert np.array_equal(frame.activity[topology.inputs :], low + (high - low) * frame.fired)
