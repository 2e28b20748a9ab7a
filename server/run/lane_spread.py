"""Results of many lanes as a middle line and a band around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.server.run.event_windows import pooled, pools
from hebbviz.server.run.history import Curves, Totals
from hebbviz.sims.experiments.statistics import deviation_of, median, quantiles
from hebbviz.task.base import Measure, Tally, Task

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """At steps `x`: the `middle` of all lanes and the band from `low` to `high`, (n,) each.

    Mean and mean ± standard deviation; of a time to an event, or where the measure is logarithmic,
    median and quartiles. A lane without the measure's event counts as infinite, longer than all
    others.
    """

    x: Array
    low: Array
    middle: Array
    high: Array

    @classmethod
    def of(cls, x: Array, values: Array, measure: Measure) -> Spread:
        """The spread of `values` (n, lanes)."""
        if goes_by_rank(measure):
            low, middle, high = quantiles(values, (0.25, 0.5, 0.75))
        else:
            middle, deviation = values.mean(axis=1), np.nan_to_num(deviation_of(values))
            low, high = middle - deviation, middle + deviation
        return cls(x, low, middle, high)


def middle_of(values: Array, measure: Measure) -> float:
    """The middle of lanes (lanes,), as in `Spread`."""
    return float(median(values) if goes_by_rank(measure) else values.mean())


def goes_by_rank(measure: Measure) -> bool:
    """Whether lanes are summarized by their median: their mean says little, or is infinite."""
    return measure.logarithmic or bool(measure.event)


def names(measure: Measure) -> tuple[str, str]:
    """Names of the middle and of the band."""
    if goes_by_rank(measure):
        return "median", "quartiles"
    return "mean", "± standard deviation"


class Scores:
    """A task's measure of every window and lane; a window that has not changed is kept."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._known: dict[tuple[Totals, Totals], Array] = {}

    def of(self, curves: Curves) -> Array:
        """The values, (windows, lanes); of a time to an event those of the pools of windows."""
        windows = list(zip(curves.edges, curves.edges[1:], strict=False))
        known = self._known
        self._known = {w: known[w] if w in known else self._score(*w) for w in windows}
        found = np.array(list(self._known.values())).reshape(-1, curves.lanes, 3)
        value, events, time = np.moveaxis(found, -1, 0)
        if not self._task.measure.event:
            return value
        places = pools(events)
        events, time = pooled(events, places), pooled(time, places)
        return np.divide(time, events, out=np.full_like(time, np.inf), where=events > 0)

    def spread(self, curves: Curves) -> Spread:
        end = np.array([t.steps for t in curves.edges[1:]], dtype=np.float64)
        return Spread.of(end, self.of(curves), self._task.measure)

    def _score(self, start: Totals, end: Totals) -> Array:
        """Value, events and their time in one window, (lanes, 3)."""
        steps = end.steps - start.steps
        scores = [self._task.score(Tally(steps, *s)) for s in (end.sums - start.sums).T.tolist()]
        return np.array([(s.value, s.events or 0, s.time) for s in scores])
