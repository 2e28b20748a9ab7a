"""Plots of a recording: over the whole run, or over the latest steps up to the cursor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import rerun.blueprint as rrb

from hebbviz.task.base import Task

WINDOW, SLOW_WINDOW = 200, 60
"""Steps before the cursor in the detailed plots; fewer for a task under manual control."""
ALL = rrb.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
"""The whole run, even while the viewer follows a live run."""


def plot(
    name: str,
    origin: str,
    window: Sequence[rrb.VisibleTimeRange] | None = None,
    *,
    only: Iterable[str] | None = None,
    y: tuple[float, float] | None = None,
    legend: bool = True,
) -> rrb.TimeSeriesView:
    """Scalars under `origin`, all of them or `only` some, over `window` or the whole run."""
    contents = ["$origin/**"] if only is None else [f"$origin/{one}" for one in only]
    return rrb.TimeSeriesView(
        origin=origin,
        contents=contents,
        name=name,
        axis_y=None if y is None else rrb.ScalarAxis(range=y),
        plot_legend=rrb.PlotLegend("LeftTop", visible=legend),
        axis_x=None if window else rrb.TimeAxis(view_range=ALL),
        time_ranges=window,
    )


def steps_of(task: Task) -> int:
    """Number of steps that the detailed plots show."""
    return WINDOW if task.natural_speed is None else SLOW_WINDOW


def span_of(task: Task) -> str:
    """The span of the detailed plots as text."""
    steps = steps_of(task)
    return f"latest {steps} steps" if task.dt is None else f"latest {steps * task.dt:g} s"


def up_to_cursor(task: Task, steps: int) -> list[rrb.VisibleTimeRange]:
    """The latest `steps` steps on every timeline of the recording."""
    ends = rrb.TimeRangeBoundary.cursor_relative
    ranges = [rrb.VisibleTimeRange("step", start=ends(seq=-steps), end=ends(seq=0))]
    if task.dt is not None:
        start = ends(seconds=-steps * task.dt)
        ranges.append(rrb.VisibleTimeRange("sim_time", start=start, end=ends(seconds=0.0)))
    return ranges


def in_title(unit: str) -> str:
    """A unit as it stands in a title."""
    return f" {unit}" if unit.startswith("per ") else f" ({unit})" if unit else ""
