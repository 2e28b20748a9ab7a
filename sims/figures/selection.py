"""Nested selection for the sonar figure: in each split a setting is chosen without its test set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.experiments import Curves, Plan
from hebbviz.sims.experiments.plan import joined
from hebbviz.sims.figures.sonar_splits import Inner, Outer
from hebbviz.sims.worlds.sonar import GRID, Setting, Sonar

if TYPE_CHECKING:
    from hebbviz.sims.figures.run_figure import Work
    from hebbviz.task.base import Task

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class InnerPlan(Plan):
    """Runs inside the training sets of their splits."""

    held_out: int = Inner.held_out

    def make_task(self) -> Task:
        return Inner(self.preset)


@dataclass(frozen=True, kw_only=True)
class OuterPlan(Plan):
    """Runs with the splits of other lanes, see `Outer`."""

    splits: tuple[int, ...]

    def make_task(self) -> Task:
        return Outer(self.preset, first_lane=self.first_lane, splits=self.splits)


@dataclass(frozen=True)
class Selection:
    """Results of nested selection: validation errors (settings, splits), the place in the grid of
    the `chosen` setting (splits,), and the runs with it, in the order of the splits.
    """

    validation: Array
    chosen: NDArray[np.int64]
    curves: Curves

    @property
    def counts(self) -> list[int]:
        """How often each setting was chosen."""
        return [int(n) for n in np.bincount(self.chosen, minlength=len(GRID))]

    @property
    def most_often(self) -> Setting:
        """Of those chosen equally often the one with the least mean validation error."""
        errors = self.validation.mean(axis=1)
        return GRID[min(range(len(GRID)), key=lambda k: (-self.counts[k], errors[k]))]

    @property
    def of_chosen(self) -> Array:
        """The validation error of the setting that was chosen, (splits,)."""
        return self.validation[self.chosen, np.arange(len(self.chosen))]


def select(plan: Plan, work: Work) -> Selection:
    """The whole procedure; `plan` is of a run of each split, as the figure draws it.

    A tie goes to the setting that comes first. Runs of one setting get numbers side by side, so
    that they are stepped together; none has the random numbers of another.
    """
    inner = [inner_plan(plan, setting) for setting in GRID]
    share = sum(map(_cost, inner)) / (sum(map(_cost, inner)) + _cost(plan))
    found = work.part(0.0, share).curves(inner)
    validation = np.array([c.figures["validation_error"][:, -1] for c in found])
    chosen = validation.argmin(axis=0)
    outer = outer_plans(plan, chosen)
    return Selection(validation, chosen, _in_order(outer, work.part(share, 1.0).curves(outer)))


def inner_plan(plan: Plan, setting: Setting) -> InnerPlan:
    """As many epochs with this setting, of fewer patterns; evaluated at the end."""
    steps = plan.steps // Sonar(setting.preset).epoch * Inner(setting.preset).epoch
    return InnerPlan(
        task=plan.task,
        preset=setting.preset,
        gamma=setting.gamma,
        seed=plan.seed,
        lanes=plan.lanes,
        segments=1,
        segment_steps=steps,
        evaluate_at=(steps,),
        options=plan.options,
    )


def outer_plans(plan: Plan, chosen: NDArray[np.int64]) -> list[OuterPlan]:
    """A plan for each setting that was chosen, of the splits in which it was."""
    plans: list[OuterPlan] = []
    first = plan.first_lane
    for k, setting in enumerate(GRID):
        splits = np.flatnonzero(chosen == k)
        if len(splits):
            plans.append(
                OuterPlan(
                    task=plan.task,
                    preset=setting.preset,
                    gamma=setting.gamma,
                    seed=plan.seed,
                    first_lane=first,
                    lanes=len(splits),
                    segments=plan.segments,
                    segment_steps=plan.segment_steps,
                    evaluate=plan.evaluate,
                    options=plan.options,
                    splits=tuple(splits.tolist()),
                )
            )
            first += len(splits)
    return plans


def _in_order(plans: Sequence[OuterPlan], curves: Sequence[Curves]) -> Curves:
    """The lanes of all plans, in the order of their splits."""
    order = np.argsort([split for plan in plans for split in plan.splits])
    found = joined(curves, len(order))
    return replace(
        found,
        reward=found.reward[order],
        broadcast=found.broadcast[order],
        ended=found.ended[order],
        figures={n: v[order] for n, v in found.figures.items()},
    )


def _cost(plan: Plan) -> float:
    return float(plan.steps * plan.lanes)
