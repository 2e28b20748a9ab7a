"""Presets `best`: the paper's rule with what its authors later studied, each part a setting."""

import math

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import FIRST_EPISODE, Draws
from hebbviz.rules.baseline import Baseline
from hebbviz.sims.loading import compiled_twin, make_task
from hebbviz.sims.worlds.sonar import ENERGIES, HOLD, PATTERNS, SCALE, TRAINING, Sonar, load

PATTERN, ORDER = 3, 9
MEAN = ORDER + PATTERNS
FACTOR = MEAN + ENERGIES


def seen_by(learner, lane):
    return learner.activities[: len(learner.task.inputs), lane]


def shown_over_both_sets(task, state):
    """What the network is shown of all patterns, (208, inputs), the training set first, and their
    numbers.
    """
    patterns, shown = state[ORDER:MEAN].astype(int), []
    for pattern in patterns:
        state[PATTERN] = pattern
        shown.append(task.observation(state))
    return np.array(shown), patterns


@pytest.mark.parametrize("name", ["sonar", "pendulum"])
def test_the_preset_brings_its_network_rule_and_fall(name):
    learner = Learner(make_task(name, "best"))
    preset = learner.task.preset
    sizes = tuple(g.size for g in learner.topology.neuron_groups)[:-1]
    assert sizes == preset.hidden != type(learner.task).hidden
    assert isinstance(learner.rule, Baseline)
    assert learner.fall == preset.fall < math.inf
    other = Learner(make_task(name, "best"), hidden=(3,))
    assert other.topology.describe().split("-")[1] == "3", "--hidden is stronger"


def test_inputs_are_centred_and_scaled_by_the_lanes_own_training_set():
    task = Sonar("best")
    learner = Learner(task, lanes=3, seed=4)
    for lane in range(3):
        shown, patterns = shown_over_both_sets(task, learner.world[:, lane].copy())
        bands, constant = shown[:, :ENERGIES], shown[:, ENERGIES]
        assert (constant == SCALE).all()
        known = load()[patterns[:TRAINING], :ENERGIES]
        np.testing.assert_allclose(bands[:TRAINING].mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(
            bands[:TRAINING].var(axis=0), SCALE**2 * known.std(axis=0), rtol=1e-12
        )
        assert np.abs(bands[TRAINING:].mean(axis=0)).max() > 0.1, "the test set is not used"
        energies = load()[patterns, :ENERGIES]
        along = [np.corrcoef(bands[:, k], energies[:, k])[0, 1] for k in range(ENERGIES)]
        np.testing.assert_allclose(along, 1.0, rtol=1e-12)


def test_the_test_set_cannot_be_told_from_what_the_network_is_shown():
    """The same split with another test set's energies would have the same means and factors."""
    state = Sonar("best").restart(Draws(0, 0, 0, FIRST_EPISODE))
    known = load()[state[ORDER : ORDER + TRAINING].astype(int), :ENERGIES]
    np.testing.assert_array_equal(state[MEAN:FACTOR], known.mean(axis=0))
    np.testing.assert_array_equal(state[FACTOR:], SCALE / np.sqrt(known.std(axis=0)))


@pytest.mark.parametrize("setting", ["best", "best:scaled=no", "quick:scaled=yes,constant=yes"])
def test_inputs_follow_the_pattern_as_it_changes_and_in_evaluations(setting):
    learner = Learner(Sonar(setting), lanes=2, seed=1, hidden=(3,))
    task, hold = learner.task, learner.task.hold
    for _ in range(4):
        for lane in range(2):
            expected = task.observation(learner.world[:, lane])
            np.testing.assert_array_equal(seen_by(learner, lane), expected)
        learner.skip(hold)
    assert learner.world[0, 0] == 0, "a pattern lasts `hold` steps"
    before = learner.keyframe()
    learner.task.evaluate(learner)
    np.testing.assert_array_equal(learner.world, before.world)
    np.testing.assert_array_equal(learner.network, before.network)


def test_other_presets_keep_their_worlds_and_their_hold():
    for name in ("quick", "paper"):
        task = Sonar(name)
        assert len(task.restart(Draws(0, 0, 0, FIRST_EPISODE))) == MEAN
        assert (task.hold, task.epoch) == (HOLD, TRAINING * HOLD)


@pytest.mark.parametrize("switch", ["centred", "scaled", "constant"])
def test_a_switch_changes_nothing_but_its_part_of_the_inputs(switch):
    best, other = Sonar("best"), Sonar(f"best:{switch}=no")
    for name in ("beta", "gamma", "rule", "fall", "hidden"):
        assert getattr(best.preset, name) == getattr(other.preset, name)
    assert best.hold == other.hold
    states = [task.restart(Draws(5, 2, 0, FIRST_EPISODE)) for task in (best, other)]
    np.testing.assert_array_equal(states[0][:MEAN], states[1][:MEAN])
    (with_it, patterns), (without, _) = (
        shown_over_both_sets(task, state) for task, state in zip((best, other), states, strict=True)
    )
    if switch == "constant":
        np.testing.assert_array_equal(with_it[:, :ENERGIES], without)
    elif switch == "centred":
        shift = with_it - without
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)
        assert (shift[0, :ENERGIES] < 0).all() and shift[0, ENERGIES] == 0
    else:
        np.testing.assert_array_equal(with_it[:, ENERGIES], SCALE)
        np.testing.assert_array_equal(without[:, ENERGIES], 1.0)
        steps = np.diff(load()[patterns, :ENERGIES], axis=0)
        np.testing.assert_allclose(np.diff(without[:, :ENERGIES], axis=0), steps, atol=1e-12)
        factors = with_it[:, :ENERGIES] / without[:, :ENERGIES]
        np.testing.assert_allclose(factors, np.broadcast_to(factors[0], factors.shape))


def test_without_its_switches_best_is_shown_the_energies_themselves():
    task = Sonar("best:centred=no,scaled=no,constant=no")
    shown, patterns = shown_over_both_sets(task, task.restart(Draws(5, 2, 0, FIRST_EPISODE)))
    np.testing.assert_array_equal(shown, load()[patterns, :ENERGIES])


@pytest.mark.slow
def test_errors_of_a_frozen_copy_are_of_a_thousand_steps_a_pattern():
    """Counted once more, pattern by pattern, with a policy that cannot be wrong about mines."""
    learner = Learner(Sonar("best"), lanes=16, seed=2)
    learner.set_weights(np.zeros_like(learner.weights))
    errors = learner.task.evaluate(learner)
    for name, patterns in (("training_error", TRAINING), ("validation_error", PATTERNS - TRAINING)):
        spread = errors[name] - 0.5
        assert np.abs(spread).max() < 6 * 0.5 / np.sqrt(patterns * HOLD)
        assert np.abs(spread).max() > 0.5 / np.sqrt(patterns * HOLD), "no fewer steps than that"


@pytest.mark.slow
def test_best_is_ahead_of_quick_after_as_many_steps():
    steps, errors = 5 * TRAINING * 100, {}
    for preset in ("quick", "best"):
        learner = Learner(Sonar(preset), lanes=16, dtype="float32")
        learner.skip(steps)
        errors[preset] = learner.task.evaluate(learner)["training_error"].mean()
    assert errors["best"] < errors["quick"] - 0.1


@pytest.mark.slow
def test_sonar_best_learns_its_training_set():
    learner = Learner(Sonar("best"), lanes=64, dtype="float32")
    learner.skip(60 * learner.task.epoch)  # a fifth of the figure's
    errors = learner.task.evaluate(learner)
    assert errors["training_error"].mean() < 0.035
    assert errors["validation_error"].mean() < 0.18


@pytest.mark.slow
def test_pendulum_best_leaves_no_run_behind():
    """Time to fall over the last fifth of 10⁵ s, of 64 runs."""
    learner = Learner(compiled_twin(make_task("pendulum", "best")), lanes=64)
    learner.skip(4_000_000)
    seconds = [learner.task.score(t).value for t in learner.skip_tallied(1_000_000)]
    assert min(seconds) > 1000.0
    assert np.median(seconds) > 10_000.0
