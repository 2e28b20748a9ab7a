"""The learning curve of any task: its measure over time, each run faint and the median bold."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from server import palette
from server.experiments import Plan
from server.figures.curves import (
    course_columns,
    draw_course,
    outcome,
    preset_note,
    set_measure_axis,
    setting,
    words_of,
)
from server.figures.length import Time, cut, steps_of, time_of
from server.figures.order import KINDS
from server.figures.scales import Course, even_course
from server.figures.sheet import Sheet, Table, blank, color, look
from sims.loading import make_task

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hebbviz.task import Task
    from server.figures.command import Work
    from server.figures.order import Order

_POINTS, _QUICK_POINTS = 100, 25
_TITLE_LETTERS = 76
"""In a line of the title; what a task says of itself may be longer."""


def make(order: Order, work: Work) -> Sheet:
    """Default 16 runs of 10⁶ steps; quick 3 of 20 000."""
    name = order.task or KINDS[order.name].task
    task = make_task(name, order.preset)
    time = time_of(order, task)
    steps = steps_of(order, task) or (20_000 if order.quick else 10**6)
    segments, segment_steps = cut(steps, _QUICK_POINTS if order.quick else _POINTS)
    plan = Plan(
        task=name, preset=order.preset, seed=order.seed,
        lanes=order.lanes or (3 if order.quick else 16), segments=segments,
        segment_steps=segment_steps,
    )  # fmt: skip
    (curves,) = work.curves([plan])
    course = even_course(task, curves)
    with look():
        figure = _draw(plan, task, time, course)
    numbers = setting(plan) | {"steps": plan.steps, "measure": task.measure.key}
    numbers |= outcome(task, course, curves)
    quick = f"quick: {plan.lanes} runs of {plan.steps:,} steps in place of 16 of 1,000,000\n"
    about = f"{plan.lanes} runs, {words_of(plan)}\n"
    notes = (quick if order.quick else "") + about + preset_note(plan)
    return Sheet(figure, _table(task, time, course), numbers, notes)


def _table(task: Task, time: Time, course: Course) -> Table:
    return {
        "step": course.steps.tolist(),
        **({} if time.key == "step" else {time.key: (course.steps / time.steps).tolist()}),
        **course_columns(task.measure, course),
    }  # fmt: skip


def _draw(plan: Plan, task: Task, time: Time, course: Course) -> Figure:
    figure = blank(4.0)
    axes = figure.add_subplot()
    draw_course(axes, course, 1.0 / time.steps, color(palette.BRAND))
    set_measure_axis(axes, task.measure)
    axes.set(xlim=(0, plan.steps / time.steps), xlabel=time.name)
    axes.set_title(fill(f"{task.name}: {task.summary or 'learning'}", _TITLE_LETTERS))
    return figure
