"""Task `gradient`: the truth it knows, and the rule's running estimate of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.server.live.gradient_estimate import (
    LEAST_POINTS,
    STAYED,
    Estimate,
    Estimating,
    knows_its_truth,
    truth_of,
)
from hebbviz.server.run.changes import Freeze, GiveReward, SetBeta, SetFall, SetGamma, SetRule
from hebbviz.server.run.run import Run
from hebbviz.sims import TASKS
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.gradient import Gradient
from hebbviz.sims.worlds.lamps import Lamps, small_example
from hebbviz.theory.exact_gradient import GradientTruth, angle_between


def followed(preset="still", **options):
    run = Run(Learner(make_task("gradient", preset), **options), make_task)
    estimating = Estimating()
    run.followers.append(estimating)
    return run, estimating


def go_on(run, steps, *, pictures=1):
    """Run on, with so many pictures on the way."""
    start = run.learner.step
    for k in range(1, pictures + 1):
        until = start + round(steps * k / pictures)
        while run.learner.step < until:
            run.advance(until - run.learner.step)
        run.frame()


def known(estimating) -> Estimate:
    assert estimating.estimate is not None
    return estimating.estimate


# The truth


def test_the_truth_is_that_of_the_exact_chain():
    net, weights = small_example()
    task, chain = Gradient(), net.at(weights)
    assert np.array_equal(task.initial_weights(np.zeros(9)), weights)
    for beta in (0.0, 0.5, 0.9):
        truth = task.truth(weights, task.topology(), beta)
        np.testing.assert_array_equal(truth.gradient, chain.gradient)
        np.testing.assert_array_equal(truth.biased, chain.biased_gradient(beta))
        assert truth.average_reward == chain.average_reward
        for steps in (1e3, 1e6):
            expected = math.degrees(math.acos(chain.expected_cosine(beta, steps=steps)))
            assert truth.expected_angles(np.array([steps]))[0] == pytest.approx(expected)
        assert truth.angle(truth.biased) == truth.bias_angle


def test_angles():
    assert angle_between(np.array([2.0, 0.0]), np.array([0.0, 3.0])) == pytest.approx(90.0)
    assert angle_between(np.array([1.0, 1.0]), np.array([-2.0, -2.0])) == pytest.approx(180.0)
    assert math.isnan(angle_between(np.zeros(2), np.ones(2)))
    many = np.array([[1.0, 0.0, -2.0, 1.0, 0.0], [0.0, 3.0, 0.0, 1.0, 0.0]])
    found = angle_between(np.array([1.0, 0.0]), many)
    np.testing.assert_allclose(found, [0.0, 90.0, 180.0, 45.0, math.nan], atol=1e-12)


def test_the_expected_angle_falls_with_the_noise_to_that_of_the_bias():
    """Of m = (1, 1) and g along the first axis the cosine is 1/√(2 + noise/T)."""
    truth = GradientTruth(np.array([3.0, 0.0]), np.ones(2), np.array([1.5, 0.5]), 0.0)
    few, some, all_steps = truth.expected_angles(np.array([1e-12, 1.0, math.inf]))
    assert few == pytest.approx(90.0, abs=1e-4)
    assert some == pytest.approx(60.0)
    assert all_steps == pytest.approx(45.0) == pytest.approx(truth.bias_angle)
    flat = GradientTruth(np.zeros(2), np.ones(2), np.ones(2), 0.0)
    assert np.isnan(flat.expected_angles(np.array([1.0, 2.0]))).all()


@pytest.mark.parametrize("hidden", [(), (1,), (1, 1)])
def test_no_network_is_better_than_the_best_and_a_sure_one_reaches_it(hidden):
    """The lamp's news is as many steps late as there are hidden layers."""
    task = Lamps()
    topology, sure = task.topology(hidden), 9.0
    weights = np.array([sure, -sure, *(sure for _ in hidden)])
    truth = task.truth(weights, topology, 0.5)
    best = 0.5 + 0.5 * 0.6 ** len(hidden)
    assert truth.best_reward == pytest.approx(best)
    assert best - 1e-3 < truth.average_reward <= best


def test_where_there_is_no_truth_it_says_why():
    large = Learner(Gradient(), hidden=(200,))
    assert "take fewer neurons" in truth_of(large.task, large.frame())
    other = Learner(make_task("synapse"))
    assert truth_of(other.task, other.frame()) is None
    lost = Learner(Gradient())
    lost.set_weights(np.full((9, 1), np.nan))
    assert "must be finite" in truth_of(lost.task, lost.frame())


def test_tabs_are_for_tasks_whose_own_network_has_a_truth():
    has = {name for name in TASKS.names if knows_its_truth(make_task(name))}
    assert has == {"gradient"}
    large = Learner(make_task("prediction"))
    assert "take fewer neurons" in truth_of(large.task, large.frame())


# The estimate


def test_the_estimate_is_the_mean_of_r_z_over_every_step():
    run, estimating = followed(seed=4)
    total, steps = np.zeros(9), 2_000
    for _ in range(steps):
        block = run.advance(1)
        total += block.broadcast[0] * run.learner.traces[:, 0]
    run.frame()
    estimate = known(estimating)
    assert (estimate.steps, estimate.since, estimate.reaches_back) == (steps, steps, True)
    np.testing.assert_allclose(estimate.mean, total / steps, rtol=0, atol=1e-6)


@pytest.mark.parametrize("pictures", [2, 7, 700])
def test_it_is_the_same_however_the_run_is_cut_into_pictures(pictures):
    run, whole = followed(seed=5)
    go_on(run, 5_000)
    run, cut = followed(seed=5)
    go_on(run, 5_000, pictures=pictures)
    np.testing.assert_array_equal(known(cut).mean, known(whole).mean)
    assert known(cut).steps == known(whole).steps == 5_000


def test_the_angle_falls_to_that_of_the_bias():
    run, estimating = followed(seed=0)
    truth = truth_of(run.learner.task, run.learner.frame())
    assert isinstance(truth, GradientTruth)
    go_on(run, 1_000, pictures=50)
    few = truth.angle(known(estimating).mean)
    go_on(run, 1_999_000, pictures=200)
    many = truth.angle(known(estimating).mean)
    assert few > 30.0
    assert many == pytest.approx(truth.bias_angle, abs=2.0)
    assert np.abs(run.learner.weights[:, 0] - small_example()[1]).max() < 1e-4
    curve = known(estimating).curve
    assert np.all(np.diff(curve.steps) > 0) and len(curve.steps) < 250
    late = curve.steps > 2e4
    ratio = curve.degrees[late] / truth.expected_angles(curve.steps[late])
    assert 0.6 < np.exp(np.mean(np.log(ratio))) < 1.6


def test_another_beta_begins_anew_and_shows_its_bias():
    run, estimating = followed(seed=1)
    go_on(run, 20_000, pictures=100)
    run.change(SetBeta(0.0))
    assert estimating.estimate is None
    go_on(run, 400_000, pictures=50)
    estimate, truth = known(estimating), truth_of(run.learner.task, run.learner.frame())
    assert isinstance(truth, GradientTruth)
    assert estimate.since == estimate.steps == 400_000
    assert [c.beta for c in estimate.earlier] == [0.8]
    assert len(estimate.earlier[0].steps) >= LEAST_POINTS
    hidden = slice(0, 6)
    assert np.all(truth.biased[hidden] == pytest.approx(0.0, abs=1e-15))
    error = np.sqrt(truth.noise / estimate.steps)
    assert np.all(np.abs(estimate.mean - truth.biased) < 4.0 * error)
    assert np.all(np.abs(truth.gradient[hidden]) > 4.0 * error[hidden])
    assert truth.angle(estimate.mean) == pytest.approx(truth.bias_angle, abs=4.0)
    assert truth.bias_angle > 40.0


def test_a_slider_on_its_way_leaves_no_curves_but_the_first():
    run, estimating = followed()
    go_on(run, 20_000, pictures=60)
    for beta in (0.82, 0.84, 0.86):
        run.change(SetBeta(beta))
        go_on(run, 300, pictures=2)
    assert [c.beta for c in known(estimating).earlier] == [0.8]
    run.change(SetBeta(0.8))
    go_on(run, 300)
    assert known(estimating).earlier == ()


@pytest.mark.parametrize("change", [SetGamma(1e-9), GiveReward(1.0), Freeze(frozen=False)])
def test_every_change_begins_anew(change):
    run, estimating = followed()
    go_on(run, 1_000)
    run.advance(400)  # steps that no picture has told of yet
    step = run.learner.step
    run.change(change)
    go_on(run, 500)
    assert known(estimating).since == run.learner.step - step


def test_frozen_weights_tell_nothing():
    run, estimating = followed()
    go_on(run, 1_000)
    run.change(Freeze(frozen=True))
    go_on(run, 1_000)
    assert estimating.estimate is None
    run.change(Freeze(frozen=False))
    go_on(run, 700)
    assert known(estimating).since == 700


@pytest.mark.parametrize("change", [SetRule("baseline"), SetFall(1e6)], ids=["rule", "fall"])
def test_under_another_rule_or_gamma_that_falls_the_weights_tell_no_mean(change):
    run, estimating = followed()
    go_on(run, 1_000)
    run.change(change)
    go_on(run, 1_000)
    assert estimating.estimate is None


def test_another_lane_begins_anew():
    run, estimating = followed(lanes=3)
    go_on(run, 20_000, pictures=60)
    run.change(SetBeta(0.9))
    go_on(run, 1_000)
    before = run.learner.weights[:, 2]
    run.look_at(2)
    assert estimating.estimate is None
    go_on(run, 600)
    estimate = known(estimating)
    moved = run.learner.weights[:, 2] - before
    np.testing.assert_array_equal(estimate.mean, moved / (run.learner.gamma * 600))
    assert (estimate.since, estimate.earlier) == (600, ())


def test_undo_reset_and_taking_over_begin_anew():
    run, estimating = followed()
    go_on(run, 20_000, pictures=60)
    run.change(SetBeta(0.9))
    go_on(run, 1_000)
    assert known(estimating).earlier
    run.undo()
    assert estimating.estimate is None
    go_on(run, 600)
    assert (known(estimating).since, known(estimating).earlier) == (600, ())
    run.reset(seed=3)
    go_on(run, 800)
    assert known(estimating).since == run.learner.step == 800
    replay = run.replay(run.tape.before(0))
    replay.go_to(300)
    run.take_over(replay)
    go_on(run, 200)
    assert known(estimating).since == 200


def test_where_the_weights_move_the_mean_reaches_back_as_far_as_they_stayed():
    run, estimating = followed("learning", gamma=1e-3)
    go_on(run, 60_000, pictures=600)
    estimate, now = known(estimating), run.learner.weights[:, 0]
    assert 100 < estimate.steps < 60_000 == estimate.since
    moved = run.learner.gamma * estimate.steps * np.linalg.norm(estimate.mean)
    assert 0.5 * STAYED < moved / np.linalg.norm(now) <= STAYED


def test_it_learns_at_the_preset_for_it():
    learner = Learner(make_task("gradient", "learning"), gamma=0.02)
    learner.skip(60_000)
    truth = truth_of(learner.task, learner.frame())
    assert isinstance(truth, GradientTruth)
    assert truth.average_reward > 0.75
