"""Which lanes learn no more is told of all of them, whichever is watched."""

from __future__ import annotations

import numpy as np

from hebbviz.learner.learner import Learner
from hebbviz.server.live.saturation import ENOUGH_LOOKS, ENOUGH_STEPS, StuckLanes
from hebbviz.sims.loading import make_task


def looked_at(learner: Learner, steps: int, looks: int = ENOUGH_LOOKS) -> tuple[int, ...]:
    stuck = StuckLanes()
    stuck.look(learner)
    for _ in range(looks):
        learner.skip(steps // looks + 1)
        stuck.look(learner)
    return stuck.lanes


def with_stuck_lanes(lanes: int, stuck: tuple[int, ...]) -> Learner:
    """Neurons that fire half of the time, but in the lanes that are stuck."""
    learner = Learner(make_task("sonar"), lanes=lanes, gamma=0.0, seed=1)
    weights = np.zeros_like(learner.weights)
    weights[:, stuck] = 50.0
    learner.set_weights(weights)
    learner.skip(10)
    return learner


def test_the_lanes_that_are_stuck_are_found_and_no_others() -> None:
    assert looked_at(with_stuck_lanes(70, (1, 3, 66)), ENOUGH_STEPS) == (1, 3, 66)
    assert looked_at(with_stuck_lanes(4, ()), ENOUGH_STEPS) == ()
    assert looked_at(with_stuck_lanes(4, (2,)), ENOUGH_STEPS // 2) == (), "too soon to tell"
    gone = with_stuck_lanes(3, ())
    weights = gone.weights
    weights[0, 1] = np.inf
    gone.set_weights(weights)
    with np.errstate(invalid="ignore"):
        assert looked_at(gone, ENOUGH_STEPS) == (1,)


def test_learning_that_goes_well_is_not_stuck() -> None:
    learner = Learner(make_task("gradient", "learning"), lanes=6)
    assert looked_at(learner, ENOUGH_STEPS) == ()


def test_another_run_begins_anew_and_a_lane_alone_is_not_counted() -> None:
    learner, stuck = with_stuck_lanes(2, (0,)), StuckLanes()
    stuck.look(learner)
    for _ in range(ENOUGH_LOOKS):
        learner.skip(ENOUGH_STEPS // ENOUGH_LOOKS + 1)
        stuck.look(learner)
    assert stuck.lanes == (0,)
    stuck.forget()
    assert stuck.lanes == ()
    assert looked_at(with_stuck_lanes(1, (0,)), ENOUGH_STEPS) == ()
