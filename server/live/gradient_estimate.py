"""The rule's running estimate of the gradient: the mean of r z, from what the weights did.

    w ← w + γ r z at every step, so over T steps with one γ    mean of r z = (w − w_before) / (γ T)

which is a sum over every step, however it was cut into pictures. It restarts at every change of the
run (of β, of γ, a manual reward), and reaches back only as far as the weights were nearly the
current ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.rules.paper import PAPER
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.run import Follower, Run
from hebbviz.task.base import Task
from hebbviz.theory.exact_gradient import GradientTruth

Array = NDArray[np.float64]

STAYED = 0.1
"""The mean reaches back until the weights have moved by this share of their length."""
MOST_MARKS = 256
SPACING = 1.05
"""The steps since the last change grow by this factor from one point of a curve to the next."""
LEAST_POINTS = 12
"""A shorter curve is dropped at the change that ends it: a slider was being dragged."""
MOST_EARLIER = 3


@dataclass(frozen=True)
class AngleCurve:
    """Degrees between exact gradient and estimate (n,), over steps since a change (n,), at a β."""

    beta: float
    steps: Array
    degrees: Array


@dataclass(frozen=True)
class Estimate:
    """The `mean` of r z (synapses,) over the latest `steps`, of `since` steps since a change.

    `curve` is its angle since then; `earlier` are the curves of other β before the change.
    """

    mean: Array
    steps: int
    since: int
    curve: AngleCurve
    earlier: tuple[AngleCurve, ...]

    @property
    def reaches_back(self) -> bool:
        """Whether it covers all steps since the last change: the weights hardly moved."""
        return self.steps == self.since


def truth_of(task: Task, frame: Frame) -> GradientTruth | str | None:
    """The exact gradient for a frame's weights and β, the reason for its absence, or None if
    unknown.
    """
    try:
        return task.truth(frame.weight, frame.topology, float(frame.beta[0]))
    except ValueError as error:
        return str(error)


def knows_its_truth(task: Task) -> bool:
    """Whether the exact gradient of the task's own network is known, and has tabs."""
    topology = task.topology()
    try:
        truth = task.truth(np.zeros(topology.synapses), topology, task.preset.beta)
    except ValueError:
        return False
    return truth is not None


def tells_the_mean(frame: Frame) -> bool:
    """Whether the weight change is γ times the sum of r z: the paper's rule with a constant γ."""
    return frame.rule == PAPER and math.isinf(frame.fall)


@dataclass(frozen=True)
class _Mark:
    """The weights at a step."""

    step: int
    weight: Array


class Estimating(Follower):
    """Follows a run whose task knows its exact gradient; `estimate` is None if unavailable.

    It is unavailable before the first step after a change, while learning is frozen (no weight
    moves), under another rule, and while γ falls.
    """

    def __init__(self) -> None:
        self.estimate: Estimate | None = None
        self._task: Task | None = None
        self._is_known = False
        self._earlier: list[AngleCurve] = []
        self._marks: list[_Mark] = []
        self._start = 0
        self._points: list[tuple[float, float]] = []
        self._beta = 0.0

    def follow(self, task: Task, frame: Frame) -> None:
        """Take the weights of a frame, and note the angle if it is time for a point."""
        if task is not self._task:
            self._task, self._is_known = task, knows_its_truth(task)
        if not self._is_known:
            self._marks.clear()
            self.estimate = None
            return
        if not self._marks:
            before = frame.since
            self._begin(frame.step - before.steps, frame.weight - before.weight_change)
        self._beta, gamma = float(frame.beta[0]), float(frame.gamma[0])
        self._note(_Mark(frame.step, frame.weight))
        first = self._marks[0]
        steps = frame.step - first.step
        if gamma == 0.0 or steps == 0 or not tells_the_mean(frame):
            self.estimate = None
            return
        mean = (frame.weight - first.weight) / (gamma * steps)
        since = frame.step - self._start
        self._add_point(task, frame, mean, since)
        self.estimate = Estimate(mean, steps, since, self._curve(), tuple(self._earlier))

    def change(self, run: Run, logged: Logged) -> None:
        """Restart at a change; the curve so far is kept if β changes."""
        if self._marks:
            self._keep_curve(run.learner.beta)
            self._begin(run.learner.step, run.learner.weights[:, run.learner.watch])

    def leap(self, run: Run, words: str) -> None:
        """Forget everything: the run was replaced."""
        self._marks.clear()
        self._earlier.clear()
        self.estimate = None

    def frame(self, run: Run, frame: Frame) -> None:
        self.follow(run.learner.task, frame)

    def _begin(self, step: int, weight: Array) -> None:
        self._marks = [_Mark(step, weight.copy())]
        self._start, self._points, self.estimate = step, [], None

    def _note(self, mark: _Mark) -> None:
        """Remember the weights, and forget those that are too far away by now."""
        marks = self._marks
        if mark.step > marks[-1].step:
            marks.append(mark)
        if len(marks) > MOST_MARKS:
            del marks[1:-1:2]
        most = STAYED * float(np.linalg.norm(mark.weight))
        while len(marks) > 2 and np.linalg.norm(mark.weight - marks[0].weight) > most:
            marks.pop(0)

    def _add_point(self, task: Task, frame: Frame, mean: Array, since: int) -> None:
        if self._points and since < SPACING * self._points[-1][0]:
            return
        truth = truth_of(task, frame)
        if isinstance(truth, GradientTruth) and np.isfinite(degrees := truth.angle(mean)):
            self._points.append((float(since), degrees))

    def _curve(self) -> AngleCurve:
        steps, degrees = np.array(self._points).reshape(-1, 2).T
        return AngleCurve(self._beta, steps, degrees)

    def _keep_curve(self, beta: float) -> None:
        """Keep the latest curve of each β, except the new β."""
        kept = [c for c in self._earlier if c.beta not in (self._beta, beta)]
        if self._beta != beta:
            curve = self._curve()
            if len(curve.steps) >= LEAST_POINTS:
                kept.append(curve)
        self._earlier = kept[-MOST_EARLIER:]
