"""Outcome of one point of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.experiments import Curves, Done, Plan
from hebbviz.sims.experiments.statistics import median, quantiles
from hebbviz.task.base import Measure, Task

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Over the last fifth of the steps, lane by lane (lanes,): the figures of the task's `measure`,
    and the average reward.
    """

    plan: Plan
    measure: Measure
    figures: Mapping[str, Array]
    reward: Array

    @property
    def values(self) -> Array:
        """The measure itself; infinite where its event was not seen."""
        return self.figures[self.measure.key]

    @property
    def middle(self) -> int:
        """The lane whose measure is the median, or of an even number the one below it."""
        return int(np.argsort(self.values, kind="stable")[(len(self.values) - 1) // 2])

    @property
    def median(self) -> float:
        """Infinite where the event was not seen in half of the lanes."""
        return float(median(self.values))

    @property
    def quartiles(self) -> tuple[float, float]:
        low, high = quantiles(self.values, (0.25, 0.75))
        return float(low), float(high)

    @property
    def without(self) -> int:
        """Lanes in which the event was not seen."""
        return int(np.isinf(self.values).sum())

    @property
    def drawn(self) -> float:
        """The median, or what a lane without an event is over, with 95 % confidence."""
        if math.isfinite(self.median):
            return self.median
        return float(self.figures[self.measure.ends[0]][np.isinf(self.values)].max())

    def failing(self, untrained: Outcome) -> float:
        """The fraction of lanes that were rewarded no more than the luckiest untrained one."""
        return float(np.mean(self.reward <= untrained.reward.max()))


def outcome(done: Done, task: Task) -> Outcome:
    """Outcome of a plan."""
    curves: Curves = done.curves()
    last = {key: values[:, -1].copy() for key, values in curves.scores(task).items()}
    reward = np.array([tally.average_reward for tally in curves.last()])
    return Outcome(done.plan, task.measure, last, reward)
