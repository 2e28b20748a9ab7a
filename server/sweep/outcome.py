"""What comes of a point of a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Task
from server.experiments import Curves, Done, Plan
from server.spread import middle_is_bound

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Over the last fifth of the steps, lane by lane (lanes,): the task's measure, whether that is
    a lower bound, and the average reward.
    """

    plan: Plan
    values: Array
    is_bound: NDArray[np.bool_]
    reward: Array

    @property
    def middle(self) -> int:
        """The lane whose measure is the median, or of an even number the one below it."""
        return int(np.argsort(self.values, kind="stable")[(len(self.values) - 1) // 2])

    @property
    def median(self) -> float:
        return float(np.median(self.values))

    @property
    def median_is_bound(self) -> bool:
        """Whether the true median is this or more."""
        return bool(middle_is_bound(np.median, self.values, self.is_bound))

    def failing(self, untrained: Outcome) -> float:
        """The fraction of lanes that were rewarded no more than the luckiest untrained one."""
        return float(np.mean(self.reward <= untrained.reward.max()))


def outcome(done: Done, task: Task) -> Outcome:
    """What came of a plan."""
    curves: Curves = done.curves()
    values, is_bound = curves.scores(task)
    reward = np.array([tally.average_reward for tally in curves.last()])
    return Outcome(done.plan, values[:, -1].copy(), is_bound[:, -1].copy(), reward)
