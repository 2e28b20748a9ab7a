"""The learning curve of any task: its measure over time, each run faint and the median bold."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from hebbviz.sims.experiments import Plan, options_of
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.curves import (
    count_axis,
    course_columns,
    draw_course,
    outcome,
    preset_note,
    runs,
    set_measure_axis,
    setting,
    triangles,
    words_of,
)
from hebbviz.sims.figures.log_time import Course, course, even_course, scales
from hebbviz.sims.figures.request import KINDS
from hebbviz.sims.figures.run_length import Time, cut, steps_of, time_of
from hebbviz.sims.figures.sheet import Sheet, Table, blank, color, head, look
from hebbviz.sims.loading import make_task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hebbviz.sims.figures.request import Order
    from hebbviz.sims.figures.run_figure import Work
    from hebbviz.task.base import Task

_POINTS, _QUICK_POINTS = 100, 25
_GROWING, _PER_DECADE = 500, 12
"""Segments that stretches of growing length are made of, and how many of these a decade has."""
_SHOWN, _QUICK_SHOWN = 1000, 100
"""The last step over the first, on an axis of time that is logarithmic."""
_GROW = "Blocks of time, a point each, are equally long on the axis, so that they grow along it."
_TITLE_LETTERS = 76
"""In a line of the title; what a task says of itself may be longer."""


def make(order: Order, work: Work) -> Sheet:
    """Default 16 runs of 10⁶ steps; quick 3 of 20 000."""
    name = order.task or KINDS[order.name].task
    task = make_task(name, order.preset)
    time = time_of(order, task)
    steps = steps_of(order, task) or (20_000 if order.quick else 10**6)
    points = _QUICK_POINTS if order.quick else _POINTS
    segments, segment_steps = cut(steps, _GROWING if task.measure.logarithmic else points)
    plan = Plan(
        task=name,
        preset=order.preset,
        hidden=order.hidden,
        beta=order.beta,
        gamma=order.gamma,
        seed=order.seed,
        lanes=order.lanes or (3 if order.quick else 16),
        segments=segments,
        segment_steps=segment_steps,
        options=options_of(order),
    )
    numbers = setting(plan) | {"steps": plan.steps, "measure": task.measure.key}
    if task.measure.logarithmic:
        first = max(1, steps // (_QUICK_SHOWN if order.quick else _SHOWN))
        found = work.curves(scales(plan, first=_GROWING * first // 10))
        shown = course(task, found, first=first, per_decade=_PER_DECADE)
    else:
        found = work.curves([plan])
        shown = even_course(task, found[-1])
    with look():
        figure = _draw(plan, task, time, shown)
    quick = f"{runs(plan.lanes)} of {plan.steps:,} steps in place of 16 of 1,000,000"
    about = f"{runs(plan.lanes)}, {words_of(plan)}\n{preset_note(plan)}"
    more = [_GROW if task.measure.logarithmic else "", triangles(shown)]
    notes = "\n".join(filter(None, (about, *more)))
    return Sheet(
        figure,
        _table(task, time, shown),
        numbers | outcome(task, shown, found[-1]),
        notes,
        quick if order.quick else "",
    )


def _table(task: Task, time: Time, course: Course) -> Table:
    return {
        "step": course.steps.tolist(),
        **({} if time.key == "step" else {time.key: (course.steps / time.steps).tolist()}),
        **course_columns(course),
    }


def _draw(plan: Plan, task: Task, time: Time, course: Course) -> Figure:
    figure = blank(4.0)
    axes = figure.add_subplot()
    draw_course(axes, course, 1.0 / time.steps, color(palette.BRAND))
    set_measure_axis(axes, task.measure)
    axes.set(xlim=(0, plan.steps / time.steps), xlabel=time.name)
    if task.measure.logarithmic:
        axes.set(xscale="log", xlim=np.array([course.steps[0], plan.steps]) / time.steps)
    elif time.steps == 1.0 or time.key == "epoch":
        count_axis(axes.xaxis)
    words = f"thin: each of {runs(plan.lanes)}; bold: their median" if plan.lanes > 1 else "1 run"
    head(axes, fill(f"{task.name}: {task.summary or 'learning'}", _TITLE_LETTERS), words)
    return figure
