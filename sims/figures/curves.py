"""Shared by figures of learning curves: a plan's setting in words, runs as columns, strokes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from hebbviz.rules.paper import PAPER
from hebbviz.sims.experiments import Plan, figures_of
from hebbviz.sims.experiments.statistics import median
from hebbviz.sims.program.terminal import finite

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

    from hebbviz.sims.experiments import Curves
    from hebbviz.sims.figures.log_time import Course
    from hebbviz.sims.figures.sheet import Color
    from hebbviz.task.base import Measure, Task

Array = NDArray[np.float64]

_FLAT = 1e-6
"""A curve whose values differ by less than this part of them is flat."""


def setting(plan: Plan) -> dict[str, Any]:
    """With what a plan is run, its defaults filled in. Raises what running it would at once."""
    rule = plan.rule()
    rule.check_lanes(plan.lanes)
    learner = plan.learner(plan.first_lane, rule.least_lanes)
    return {
        "task": plan.task,
        "preset": learner.task.preset_name,
        "network": learner.topology.describe(),
        "beta": learner.beta,
        "gamma": learner.gamma,
        "rule": str(learner.rule),
        "fall": finite(learner.fall),
        "lanes": plan.lanes,
    }


def words_of(plan: Plan) -> str:
    """`setting` in a line, but for the lanes."""
    s = setting(plan)
    return f"{s['network']}, β {s['beta']:g}, γ {shown(s['gamma'])}{falling(s)}{rule_of(s)}"


def falling(about: dict[str, Any]) -> str:
    """γ of a `setting` in words, if it decays."""
    return "" if about["fall"] is None else f" falling over {about['fall']:,.12g} steps"


def rule_of(about: dict[str, Any]) -> str:
    """Rule of a `setting` in words, if it is not the paper's."""
    return "" if about["rule"] == PAPER.name else f", rule {about['rule']}"


def preset_note(plan: Plan) -> str:
    """The task's note on the plan's preset, and the values that differ from it."""
    task = plan.make_task()
    other = _set_otherwise(plan)
    if not other:
        return f"preset {task.preset_name}: {task.note}"
    return f"preset {task.preset_name}, but another {', '.join(other)}; as it is: {task.note}"


def _set_otherwise(plan: Plan) -> list[str]:
    """Values that differ from the plan's preset."""
    own = Plan(task=plan.task, preset=plan.preset, lanes=plan.lanes, segments=1, segment_steps=1)
    now, before = setting(plan), setting(own)
    names = {"network": "network", "beta": "β", "gamma": "γ", "rule": "rule", "fall": "fall of γ"}
    return [words for name, words in names.items() if now[name] != before[name]]


def shown(number: float) -> str:
    """As 0.01, and 10⁻⁶ in place of 1e-06."""
    digits, _, exponent = f"{number:g}".partition("e")
    if not exponent:
        return digits
    power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"10{power}" if digits == "1" else f"{digits}·10{power}"


def lane_columns(name: str, values: NDArray[Any]) -> dict[str, list[Any]]:
    """A column for each lane of (lanes, n)."""
    return {f"{name}_{k}": lane.tolist() for k, lane in enumerate(values)}


def course_columns(course: Course, prefix: str = "") -> dict[str, list[Any]]:
    """The median and each lane's figures. A time to an event that was not seen is infinite."""
    columns = {f"{prefix}{course.measure.key}_median": course.median.tolist()}
    for key, values in course.figures.items():
        columns |= lane_columns(f"{prefix}{key}", values)
    return columns


def draw_course(axes: Axes, course: Course, step: float, shade: Color) -> None:
    """Each run faint, the median bold; a triangle where it is not known, a small one where it is
    not of some run.

    `step` is the time of a step on the horizontal axis.
    """
    times = course.steps * step
    for values in course.values:
        axes.plot(*known(times, values), color=shade, lw=0.7, alpha=0.35)
    axes.plot(*known(times, course.median), color=shade, lw=2.2)
    some, half = np.isfinite(course.over), np.isinf(course.median)
    for at, size, inside in ((some, 2.5, shade), (half, 5.5, "white")):
        if at.any():
            axes.plot(
                times[at],
                course.over[at],
                "^",
                color=shade,
                ms=size,
                mfc=inside,
                clip_on=False,
                zorder=5,
            )


def known(times: NDArray[Any], values: Array) -> tuple[NDArray[Any], Array]:
    """Those that are finite."""
    finite = np.isfinite(values)
    return times[finite], values[finite]


def triangles(course: Course) -> str:
    """A sentence that explains the triangles of `draw_course`; empty if there are none."""
    event = course.measure.event
    return (
        f"△: no {event} in half of the runs or more, small ▲: in some; their mean time to {event} "
        "is over this, with 95 % confidence."
        if np.isfinite(course.over).any()
        else ""
    )


def beside(values: Array, height: float, width: float) -> Array:
    """How far sideways points stand so that those of about one value are side by side, (n,): within
    `width`, those of a `height` in a row.
    """
    shifts = np.zeros(len(values))
    rows = np.floor(values / height)
    most = int(np.unique(rows, return_counts=True)[1].max())
    for row in np.unique(rows):
        at = np.flatnonzero(rows == row)
        shifts[at] = (np.arange(len(at)) - (len(at) - 1) / 2) * width / max(most, 6)
    return shifts


def set_measure_axis(axes: Axes, measure: Measure) -> None:
    """The vertical axis of a task's measure."""
    unit = f", {measure.unit}" if measure.unit else ""
    axes.set_ylabel(f"{measure.name}{unit}")
    low, high = axes.dataLim.intervaly
    if measure.logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(*decades(axes.dataLim.minposy, high))
        return
    most = max(abs(low), abs(high))
    if most == 0.0 or 1e-4 <= most < 1e6:
        axes.ticklabel_format(axis="y", useOffset=False)
    else:  # each number whole: a factor above the axis would stand on the words there
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: shown(value)))
    if measure.span is not None:
        axes.set_ylim(measure.span[0], max(measure.span[1], high))
    elif high - low <= _FLAT * most:  # its last digits are no news
        room = 0.1 * abs(high) or 1.0
        axes.set_ylim(low - room, high + room)


def decades(low: float, high: float) -> tuple[float, float]:
    """The powers of ten around two numbers above 0, at least one decade."""
    first = math.floor(math.log10(low))
    return 10.0**first, 10.0 ** max(math.ceil(math.log10(high)), first + 1)


def count_axis(axis: Axis) -> None:
    """An axis of whole numbers, written as everywhere in the figures: 20,000."""
    axis.set_major_locator(MaxNLocator("auto", steps=[1, 2, 2.5, 5, 10], integer=True))
    axis.set_major_formatter(FuncFormatter(lambda count, _: f"{count:,.12g}"))


def runs(lanes: int) -> str:
    """So many of them, in words."""
    return "1 run" if lanes == 1 else f"{lanes} runs"


def outcome(task: Task, course: Course, curves: Curves) -> dict[str, Any]:
    """The measure over the last fifth of all steps, as `hebbviz train` has it, and its median;
    and the median at the end of the curve, over the last stretch that is drawn. None is infinite.
    """
    last = {k: v[:, 0] for k, v in figures_of(task, [[t] for t in curves.last()]).items()}
    at_end = f"{task.measure.key}_median_at_end"
    return _lanes(task.measure, last) | {at_end: finite(course.median[-1])}


def frozen_outcome(course: Course) -> dict[str, Any]:
    """The measure of frozen copies at the end, and its median."""
    last = {key: values[:, -1] for key, values in course.figures.items()}
    return {f"frozen_{key}": v for key, v in _lanes(course.measure, last).items()}


def _lanes(measure: Measure, figures: Mapping[str, Array]) -> dict[str, Any]:
    """Figures of each lane (lanes,), and their median. None is infinite."""
    told: dict[str, Any] = {
        key: [v if isinstance(v, int) else finite(v) for v in values.tolist()]
        for key, values in figures.items()
    }
    return told | {f"{measure.key}_median": finite(median(figures[measure.key]))}
