"""One run seen at several scales, for an axis of time that is logarithmic.

Segments of a plan are of one length. So a plan is run again and again, 100 times as long each
time: the same lanes, hence the same runs, for 1 % more work. Where one ends the next takes over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.experiments import Curves, Plan, figures_of
from hebbviz.sims.experiments.statistics import median
from hebbviz.task.base import Measure, Tally, Task

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

RATIO = 100
"""Of the lengths of two plans."""

SomePlan = TypeVar("SomePlan", bound=Plan)


def scales(plan: SomePlan, *, first: int) -> list[SomePlan]:
    """Plans of the same segments, the shortest first; it ends after `first` steps or sooner.

    The steps of the shorter ones are what is left of the longest, divided by 100, 10 000, …
    """
    plans = [plan]
    while plans[0].steps > first and plans[0].segment_steps > 1:
        plans.insert(0, replace(plan, segment_steps=-(-plans[0].segment_steps // RATIO)))
    return plans


def spaced(steps: Whole, per_decade: int) -> Whole:
    """Places in `steps` (n,), which rise, about equally far apart on a logarithmic axis."""
    decades = float(np.log10(steps[-1] / steps[0]))
    wanted = np.geomspace(steps[0], steps[-1], 1 + round(per_decade * decades))
    return np.unique(np.abs(steps[:, None] - wanted).argmin(axis=0))


@dataclass(frozen=True)
class Course:
    """A task's measure over time: `figures`, each (lanes, n), by the keys of the `measure`, of the
    stretches that end at `steps` (n,).
    """

    measure: Measure
    steps: Whole
    figures: Mapping[str, Array]

    @property
    def values(self) -> Array:
        """The measure itself, (lanes, n); infinite where its event was not seen."""
        return self.figures[self.measure.key]

    @property
    def median(self) -> Array:
        """Over the lanes, (n,); infinite where the event was not seen in half of them."""
        return median(self.values.T)

    @property
    def over(self) -> Array:
        """Lower bound of a time to an event, with 95 % confidence, if some lane has not seen it,
        (n,); NaN elsewhere.
        """
        if not self.measure.event:
            return np.full(len(self.steps), np.nan)
        lows = np.where(np.isinf(self.values), self.figures[self.measure.ends[0]], np.nan)
        over: Array = np.fmax.reduce(lows, axis=0)
        return over


def course(task: Task, curves: Sequence[Curves], *, first: int, per_decade: int) -> Course:
    """The measure over stretches that are equally long on a logarithmic axis, from step `first` on.

    What was before it is one stretch more.
    """
    totals = np.concatenate(
        [np.cumsum([c.reward, c.broadcast, c.ended], axis=2) for c in curves], axis=2
    )  # (reward, broadcast, ended), lanes, segments: since the start
    steps, at = _chosen([c.end for c in curves], first, per_decade)
    return measured(task, steps, totals[:, :, at])


def _chosen(ends: Sequence[Whole], first: int, per_decade: int) -> tuple[Whole, Whole]:
    """Where the stretches of a course end, and the places of these steps in all `ends`."""
    steps, at = np.unique(np.concatenate(ends), return_index=True)
    late = np.searchsorted(steps, min(first, steps[-1]))
    chosen = late + spaced(steps[late:], per_decade)
    return steps[chosen], at[chosen]


def evaluated(plans: Sequence[SomePlan], *, first: int, per_decade: int) -> list[SomePlan]:
    """Plans of several scales, with frozen copies evaluated where the stretches of `course` end."""
    ends = [plan.segment_steps * np.arange(1, plan.segments + 1) for plan in plans]
    steps, _ = _chosen(ends, first, per_decade)
    found: list[SomePlan] = []
    for plan, own in zip(plans, ends, strict=True):
        found.append(replace(plan, evaluate_at=tuple(np.intersect1d(steps, own).tolist())))
        steps = np.setdiff1d(steps, own)
    return found


def frozen_course(task: Task, curves: Sequence[Curves]) -> Course:
    """The measure of frozen copies, at the steps at which they were evaluated."""
    steps = np.concatenate([c.evaluated_at for c in curves])
    order = np.argsort(steps)
    figures = {
        key: np.concatenate([c.figures[key] for c in curves if key in c.figures], axis=1)[:, order]
        for key in task.measure.keys
    }
    return Course(task.measure, steps[order], figures)


def even_course(task: Task, curves: Curves) -> Course:
    """The measure over the segments as they are."""
    return Course(task.measure, curves.end, curves.scores(task))


def measured(task: Task, steps: Whole, totals: Array) -> Course:
    """The measure between one of `steps` (n,) and the next, from totals (3, lanes, n)."""
    sums = np.diff(totals, axis=2, prepend=0.0)
    lengths = np.diff(steps, prepend=0)
    tallies = [
        [Tally(int(n), *map(float, s)) for n, s in zip(lengths, lane.T, strict=True)]
        for lane in sums.transpose(1, 0, 2)
    ]
    return Course(task.measure, steps, figures_of(task, tallies))
