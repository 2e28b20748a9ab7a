"""What many lanes did, as a line in the middle of them and a band around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Measure, Tally, Task
from server.history import Curves, Totals

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Middle = Callable[..., Any]


@dataclass(frozen=True)
class Spread:
    """At steps `x`: the `middle` of all lanes and the band from `low` to `high`, (n,) each.

    Mean and mean ± standard deviation; where the measure is logarithmic, median and quartiles.
    `is_bound` (n,): the true middle is this or more.
    """

    x: Array
    low: Array
    middle: Array
    high: Array
    is_bound: Bools

    @classmethod
    def of(cls, x: Array, values: Array, is_bound: Bools, measure: Measure) -> Spread:
        """Of `values` (n, lanes); where `is_bound`, the truth is this or more."""
        if measure.logarithmic:
            low, middle, high = np.quantile(values, (0.25, 0.5, 0.75), axis=1)
        else:
            middle, deviation = values.mean(axis=1), values.std(axis=1)
            low, high = middle - deviation, middle + deviation
        return cls(x, low, middle, high, middle_is_bound(middle_of(measure), values, is_bound))


def middle_of(measure: Measure) -> Middle:
    """What the middle of lanes is: the mean, or the median where the measure is logarithmic."""
    return np.median if measure.logarithmic else np.mean


def middle_is_bound(middle: Middle, values: Array, is_bound: Bools) -> Bools:
    """Whether the middle of lanes, (..., lanes), is a lower bound, (...,): whether it would be more
    if the values that are bounds were without end.
    """
    more: Bools = middle(np.where(is_bound, np.inf, values), axis=-1) > middle(values, axis=-1)
    return more


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

    def of(self, curves: Curves) -> tuple[Array, Bools]:
        """The values, and where they are lower bounds, each (windows, lanes)."""
        windows = list(zip(curves.edges, curves.edges[1:], strict=False))
        known = self._known
        self._known = {w: known[w] if w in known else self._score(*w) for w in windows}
        scores = np.array(list(self._known.values())).reshape(-1, curves.lanes, 2)
        return scores[:, :, 0], scores[:, :, 1] > 0

    def spread(self, curves: Curves) -> Spread:
        end = np.array([t.steps for t in curves.edges[1:]], dtype=np.float64)
        return Spread.of(end, *self.of(curves), self._task.measure)

    def _score(self, start: Totals, end: Totals) -> Array:
        """Of one window: (lanes, 2)."""
        steps = end.steps - start.steps
        scores = [self._task.score(Tally(steps, *s)) for s in (end.sums - start.sums).T.tolist()]
        return np.array([(s.value, s.is_bound) for s in scores])
