"""What many lanes did, as a line in the middle of them and a band around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Measure, Tally, Task
from server.history import Curves, Totals

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """At steps `x`: the `middle` of all lanes and the band from `low` to `high`, (n,) each.

    Mean and mean ± standard deviation; where the measure is logarithmic, median and quartiles.
    """

    x: Array
    low: Array
    middle: Array
    high: Array

    @classmethod
    def of(cls, x: Array, values: Array, measure: Measure) -> Spread:
        """Of `values` (n, lanes)."""
        if measure.logarithmic:
            low, middle, high = np.quantile(values, (0.25, 0.5, 0.75), axis=1)
        else:
            middle, deviation = values.mean(axis=1), values.std(axis=1)
            low, high = middle - deviation, middle + deviation
        return cls(x, low, middle, high)


def names(measure: Measure) -> tuple[str, str]:
    """What the middle and the band are."""
    if measure.logarithmic:
        return "median", "quartiles"
    return "mean", "± standard deviation"


class Scores:
    """A task's measure of every window and lane; a window that has not changed is kept."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._known: dict[tuple[Totals, Totals], Array] = {}

    def of(self, curves: Curves) -> Array:
        """Shape (windows, lanes); bounds count as the values that they are."""
        windows = list(zip(curves.edges, curves.edges[1:], strict=False))
        known = self._known
        self._known = {w: known[w] if w in known else self._score(*w) for w in windows}
        return np.array(list(self._known.values())).reshape(-1, curves.lanes)

    def spread(self, curves: Curves) -> Spread:
        end = np.array([t.steps for t in curves.edges[1:]], dtype=np.float64)
        return Spread.of(end, self.of(curves), self._task.measure)

    def _score(self, start: Totals, end: Totals) -> Array:
        steps = end.steps - start.steps
        sums = (end.sums - start.sums).T.tolist()
        return np.array([self._task.score(Tally(steps, *s)).value for s in sums])
