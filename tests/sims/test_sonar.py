"""The sonar task: its data, its epochs, its compiled run against the reference, and learning."""

import hashlib
from importlib.resources import files

import numpy as np
import pytest

from hebbviz.conformance import same_learner
from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import FIRST_EPISODE, Draws
from hebbviz.reference import Reference
from hebbviz.sims.worlds.sonar import ENERGIES, HOLD, PATTERNS, TRAINING, Sonar, load
from hebbviz.task.base import Tally

TICK, INDEX, EPOCH, PATTERN, LABEL, ORDER = 0, 1, 2, 3, 4, 9


def test_the_data_is_the_published_one():
    raw = files("hebbviz.sims").joinpath("data/sonar.csv").read_bytes()
    expected = "e90434cdbf00fcf93ffa911fe447ae25606979658e60f1d32e155c3b5240234d"
    assert hashlib.sha256(raw).hexdigest() == expected
    data = load()
    assert data.shape == (208, 61) == (PATTERNS, ENERGIES + 1)
    assert (data[:, 60] == 1.0).sum() == 111
    assert (data[:, 60] == -1.0).sum() == 97
    assert data[:, :60].min() >= 0.0
    assert data[:, :60].max() <= 1.0
    assert len(np.unique(data[:, :60], axis=0)) == 208


def test_nobody_can_change_the_data():
    with pytest.raises(ValueError, match="read-only"):
        load()[0, 0] = 1.0
    task = Sonar()
    state = task.restart(Draws(0, 0, 0, FIRST_EPISODE))
    task.observation(state)[:] = 7.0
    assert load().max() == 1.0


def split(learner, lane=0):
    order = learner.world[ORDER:, lane].astype(int)
    return order[:TRAINING].tolist(), order[TRAINING:].tolist()


def test_each_run_splits_the_patterns_at_random_in_nine_to_one():
    learner = Learner(Sonar(), lanes=20)
    tests = []
    for lane in range(20):
        training, test = split(learner, lane)
        assert (len(training), len(test)) == (187, 21)
        assert sorted(training + test) == list(range(208))
        tests.append(frozenset(test))
    assert len(set(tests)) == 20
    counts = np.bincount([p for t in tests for p in t], minlength=208)
    assert (counts > 0).sum() > 0.7 * 208, "all patterns have their turn in test sets"


def test_each_epoch_shows_every_training_pattern_once_for_a_thousand_steps():
    learner = Learner(Sonar(), gamma=0.0)
    training, test = split(learner)
    orders = []
    for epoch in range(3):
        shown = []
        for place in range(TRAINING):
            pattern = int(learner.world[PATTERN, 0])
            assert learner.world[INDEX, 0] == place
            assert learner.world[EPOCH, 0] == epoch
            assert np.array_equal(learner.activities[:60, 0], load()[pattern, :60])
            learner.skip(HOLD - 1)
            assert learner.world[PATTERN, 0] == pattern
            learner.skip(1)
            shown.append(pattern)
        assert sorted(shown) == sorted(training)
        assert split(learner)[1] == test
        orders.append(tuple(shown))
    assert len(set(orders)) == 3


def test_shuffles_are_fair():
    """Where the first pattern of an epoch comes in the next, over many runs."""
    lanes = 4000
    learner = Learner(Sonar(), gamma=0.0, lanes=lanes)
    world = learner.world
    world[TICK], world[INDEX] = HOLD - 1, TRAINING - 1
    first = world[ORDER].copy()
    learner.place(world)
    learner.skip(1)
    place = np.argmax(learner.world[ORDER : ORDER + TRAINING] == first, axis=0)
    counts = np.bincount(place, minlength=TRAINING)
    assert counts.min() > 3, "every place is possible, the first among them"
    assert counts.max() < 50
    expected = lanes / TRAINING
    chi_square, free = np.sum((counts - expected) ** 2) / expected, TRAINING - 1
    assert abs(chi_square - free) < 4 * np.sqrt(2 * free)


def test_lanes_may_be_out_of_step_and_go_back():
    """One changes its pattern where the other does not, after a return to a keyframe too."""
    learner = Learner(Sonar(), seed=3, lanes=2)
    world = learner.world
    world[TICK, 1] = HOLD // 2
    learner.place(world)
    learner.skip(100)
    moment = learner.keyframe()
    learner.skip(1500)
    end = learner.keyframe()
    learner.restore(moment)
    learner.skip(1500)
    assert np.array_equal(end.network, learner.network, equal_nan=True)
    for lane in range(2):
        pattern = int(learner.world[PATTERN, lane])
        assert np.array_equal(learner.activities[:60, lane], load()[pattern, :60])


def test_the_reward_is_for_the_label_of_the_pattern_shown():
    learner = Learner(Sonar(), gamma=0.0, seed=2)
    for _ in range(5):
        label = load()[int(learner.world[PATTERN, 0]), 60]
        block = learner.advance(HOLD)
        said = 2.0 * block.fired[:, -1] - 1.0
        assert np.array_equal(block.reward, (said == label).astype(float))
        assert not block.ended.any()
    tally = learner.tally()
    assert learner.task.score(Tally(200, 150.0, 150.0, 0.0)).value == pytest.approx(25.0)
    assert tally.steps == 5 * HOLD


def test_steps_are_those_of_the_reference():
    """Over four changes of the pattern, on the eve of a shuffle."""
    task = Sonar("quick")
    learner = Learner(task, seed=11, first_lane=3)
    world = learner.world
    world[INDEX] = TRAINING - 2
    world[PATTERN] = world[ORDER + TRAINING - 2]
    world[LABEL] = load()[int(world[PATTERN, 0]), ENERGIES]
    learner.place(world)
    steps, topology = 4500, learner.topology
    weights = [
        learner.weights[topology.synapses_of(k), 0].reshape(topology.shape(p))
        for k, p in enumerate(topology.projections)
    ]
    reference = Reference(topology, weights, beta=0.5, gamma=1e-3, seed=11, lane=3)
    state = world[:, 0]
    reference.observe(task.observation(state))
    fired = np.empty((steps, topology.neurons))
    for step in range(steps):
        action = reference.respond()
        fired[step] = reference.fired
        state = task.transition(state.copy(), action, Draws(11, 3, step))
        reference.reinforce(task.reward(state))
        reference.observe(task.observation(state))
    assert np.array_equal(learner.advance(steps).fired, fired)
    assert np.array_equal(learner.world[:, 0], state)
    assert state[EPOCH] == 1.0
    both = zip(
        (learner.weights, learner.traces), (reference.weights, reference.traces), strict=True
    )
    for got, expected in both:
        assert np.allclose(got[:, 0], np.concatenate([e.ravel() for e in expected]),
                           rtol=0, atol=1e-9)  # fmt: skip


def _errors(learner):
    return {name: errors[0] for name, errors in learner.task.evaluate(learner).items()}


def test_evaluation_counts_every_step_and_leaves_the_learner():
    learner, untouched = (Learner(Sonar(), seed=1) for _ in range(2))
    for one in (learner, untouched):
        one.advance(150_500)
    errors = _errors(learner)
    assert same_learner(learner, untouched)
    assert errors == _errors(learner), "an evaluation can be repeated"
    for name, patterns in (("training_error", TRAINING), ("test_error", PATTERNS - TRAINING)):
        count = errors[name] * patterns * HOLD
        assert count == pytest.approx(round(count), abs=1e-4)
        assert 0.0 < errors[name] < 1.0
    learner.advance(1500)
    untouched.advance(1500)
    assert same_learner(learner, untouched)


def test_evaluation_is_of_these_weights_on_these_sets():
    """Weights that see one energy alone: errors as counted from the data, but for the lag."""
    learner = Learner(Sonar(), hidden=(), seed=4)
    weights = np.zeros((ENERGIES, 1))
    weights[10], weights[0] = 200.0, -1000.0
    learner.set_weights(weights)
    errors = _errors(learner)
    v = load()[:, :ENERGIES] @ weights[:, 0]
    wrong = 1.0 / (1.0 + np.exp(np.clip(v * load()[:, 60], -700, 700)))
    for name, patterns in zip(("training_error", "test_error"), split(learner), strict=True):
        assert errors[name] == pytest.approx(wrong[patterns].mean(), abs=0.003)


def test_three_million_steps_at_quick_teach_it():
    """Sixteen epochs: training errors of 24 to 31 % in four seeds, from 50 %."""
    learner = Learner(Sonar("quick"), seed=0)
    assert _errors(learner)["training_error"] > 0.4
    learner.skip(3_000_000)
    assert _errors(learner)["training_error"] < 0.33


def test_the_papers_parameters_are_there():
    task = Sonar("paper")
    assert (task.preset.beta, task.preset.gamma) == (0.5, 1e-4)
    learner = Learner(task)
    assert learner.topology.describe() == "60-8-1"
    assert learner.topology.activity == (-1.0, 1.0)
    assert 0.09 < np.abs(learner.weights).max() <= 0.1
    assert abs(learner.weights.mean()) < 0.02
