"""Time to fall against simulated time, preset by preset: each run faint, the median bold.

A point is of a frozen copy, as in the paper: 100 000 steps without learning, their time divided by
the falls in them. Dashed is the median of the runs themselves while they learn: the length of a
block of time, which grows, divided by the falls in it. Beside the curves stand policies that do
not learn, measured in the same world: every thrust by chance, and the same thrust all the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.numerics.counter_rng import NEXT_EPISODE, Draws
from hebbviz.sims.experiments import Curves, Plan
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.curves import (
    course_columns,
    draw_course,
    frozen_outcome,
    known,
    outcome,
    preset_note,
    set_measure_axis,
    setting,
    shown,
    triangles,
    words_of,
)
from hebbviz.sims.figures.log_time import Course, course, evaluated, frozen_course, scales
from hebbviz.sims.figures.run_length import cut, steps_of
from hebbviz.sims.figures.sheet import (
    IDLE,
    TINY,
    Sheet,
    Table,
    blank,
    color,
    dark,
    head,
    look,
    title,
)
from hebbviz.sims.worlds.pendulum.physics import PLANT
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.task.base import FROZEN_STEPS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hebbviz.sims.figures.request import Order
    from hebbviz.sims.figures.run_figure import Work

Array = NDArray[np.float64]

SECONDS = {"quick": 1e5, "raw": 1.5e6, "paper": 4e6, "literal": 1e6}
"""Simulated seconds in which each preset shows what it can, but for `paper`, which stops in
mid-rise. Any other has `OTHER_SECONDS`.
"""
OTHER_SECONDS = 1e5

WHY_FLAT = (
    "Flat, and so it should be: inputs in SI units are small beside the weights that it takes to "
    "balance, and at γ = 10⁻⁶ the weights have hardly moved yet. It takes over 10⁷ s."
)
_FLAT = 2.0
"""The highest median of a flat curve over its lowest, at most."""

_FROZEN_SECONDS = FROZEN_STEPS * PLANT.time_step

POINT = (
    "A point is of a frozen copy, which is the network as it was then, but does not learn: as in "
    f"the paper, the {_FROZEN_SECONDS:,.0f} s of {FROZEN_STEPS:,} steps, divided by the falls in "
    "them."
)
LEARNING = (
    "Dashed: the median of the runs while they learn, the time of a block divided by the falls in "
    "it; blocks are equally long on the axis, so that they grow along it."
)

_QUICK_SECONDS = 10_000.0
_SEGMENTS = 500
_FIRST = round(10.0 / PLANT.time_step)
"""Steps: where the axis of time begins."""
_PER_DECADE, _QUICK_PER_DECADE = 12, 4
_LOWEST, _HIGHEST = 0.15, 3e4
"""Time to fall in s: ends of the axis, unless a run gets higher."""
_LETTERS = 64
"""In a line above a panel."""
_EPISODES, _QUICK_EPISODES = 1000, 200
_COLORS = {"quick": 5, "raw": 2, "paper": 4, "literal": 3}


@dataclass(frozen=True)
class _Curve:
    """Results of a preset: the longest of its plans, and over all of them the course of frozen
    copies and, at the same steps, that of the runs while they learn.
    """

    plan: Plan
    whole: Curves
    frozen: Course
    learning: Course


def make(order: Order, work: Work) -> Sheet:
    """Default 16 runs of every preset, for as long as each needs; quick 3 short ones."""
    presets = [order.preset] if order.preset else list(SECONDS)
    lanes = order.lanes or (3 if order.quick else 16)
    per_decade = _QUICK_PER_DECADE if order.quick else _PER_DECADE
    plans = [
        evaluated(
            _plans(preset, _steps(order, preset), lanes, order.seed),
            first=_FIRST,
            per_decade=per_decade,
        )
        for preset in presets
    ]
    baselines = measured_baselines(order.seed, _QUICK_EPISODES if order.quick else _EPISODES)
    found = iter(work.curves([plan for scale in plans for plan in scale]))
    curves = [_curve(scale, [next(found) for _ in scale], per_decade) for scale in plans]
    with look():
        figure = _draw(curves, baselines)
    notes = [
        POINT,
        *{triangles(c.frozen) for c in curves} - {""},
        LEARNING,
        _not_drawn() if order.preset is None else preset_note(curves[0].plan),
    ]
    if any(_is_flat_literal(c) for c in curves):
        notes.append(f"Preset literal: {WHY_FLAT[0].lower()}{WHY_FLAT[1:]}")
    longest = shown(max(SECONDS.get(preset, OTHER_SECONDS) for preset in presets))
    quick = (
        f"{lanes} short run{'s' * (lanes > 1)} in place of 16 runs of "
        f"{'' if order.preset else 'up to '}{longest} simulated seconds"
    )
    return Sheet(
        figure,
        _table(curves),
        _numbers(curves, baselines),
        "\n".join(notes),
        quick if order.quick else "",
    )


def _not_drawn() -> str:
    """Which presets the figure of all leaves out, and how to get them."""
    left_out = [preset for preset in Pendulum.presets if preset not in SECONDS]
    options = " or ".join(f"--preset {preset}" for preset in left_out)
    return f"Left out: preset {' and '.join(left_out)}, which {options} draws."


def _is_flat_literal(curve: _Curve) -> bool:
    """Whether the words on why it is flat are true of it."""
    median = curve.frozen.median
    return curve.plan.preset == "literal" and bool(median.max() < _FLAT * median.min())


def _curve(scale: Sequence[Plan], found: Sequence[Curves], per_decade: int) -> _Curve:
    plan, task = scale[-1], scale[-1].make_task()
    learning = course(task, found, first=_FIRST, per_decade=per_decade)
    return _Curve(plan, found[-1], frozen_course(task, found), learning)


def _numbers(curves: Sequence[_Curve], baselines: dict[str, float]) -> dict[str, Any]:
    presets = {
        c.plan.preset: {
            **setting(c.plan),
            "simulated_s": c.plan.steps * PLANT.time_step,
            **outcome(c.plan.make_task(), c.learning, c.whole),
            **frozen_outcome(c.frozen),
        }
        for c in curves
    }
    says = {"literal_says": WHY_FLAT} if any(_is_flat_literal(c) for c in curves) else {}
    return {"lanes": curves[0].plan.lanes, **baselines, "presets": presets, **says}


def _steps(order: Order, preset: str) -> int:
    seconds = _QUICK_SECONDS if order.quick else SECONDS.get(preset, OTHER_SECONDS)
    return steps_of(order, Pendulum()) or round(seconds / PLANT.time_step)


def _plans(preset: str, steps: int, lanes: int, seed: int) -> list[Plan]:
    segments, segment_steps = cut(steps, _SEGMENTS)
    whole = Plan(
        task="pendulum",
        preset=preset,
        seed=seed,
        lanes=lanes,
        segments=segments,
        segment_steps=segment_steps,
    )
    whole.make_task()
    return scales(whole, first=_SEGMENTS * _FIRST // 10)


# Policies that do not learn


def measured_baselines(seed: int, episodes: int) -> dict[str, float]:
    """Mean time to fall in s, over `episodes` episodes, of random and of constant thrust."""

    def by_chance(draws: Draws) -> Array:
        return np.where(draws(2) < 0.5, -1.0, 1.0)

    return {
        "random_thrust_s": _time_to_fall(by_chance, seed, episodes),
        "constant_thrust_s": _time_to_fall(lambda _: np.ones(2), seed, episodes),
    }


def _time_to_fall(policy: Callable[[Draws], Array], seed: int, episodes: int) -> float:
    """Lane 0 of the seed, with the draws that a learner's world has; the falling step counts."""
    task = Pendulum()
    state, falls, step = task.restart(Draws(seed, 0, 0, NEXT_EPISODE)), 0, 0
    while falls < episodes:
        step += 1
        draws = Draws(seed, 0, step)
        state = task.transition(state, policy(draws), draws)
        if task.ended(state):
            falls += 1
            state = task.restart(Draws(seed, 0, step, NEXT_EPISODE))
    return step * PLANT.time_step / falls


# The drawing


@dataclass(frozen=True)
class _Line:
    words: str
    key: str
    dashes: tuple[float, float]
    side: str


_LINES = (
    _Line("random thrust", "random_thrust_s", (5.0, 2.0), "bottom"),
    _Line("constant thrust", "constant_thrust_s", (1.0, 1.6), "top"),
)


def _draw(curves: Sequence[_Curve], baselines: dict[str, float]) -> Figure:
    rows = -(-len(curves) // 2)
    figure = blank(0.7 + 2.75 * rows if len(curves) > 1 else 4.2)
    grid = figure.subplots(rows, min(2, len(curves)), sharex=True, sharey=True, squeeze=False)
    for axes, curve in zip(grid.flat, curves, strict=False):
        _panel(axes, curve, baselines)
    for axes in grid[:, -1]:
        _name_lines(axes, baselines)
    for axes in grid[-1]:
        axes.set_xlabel("simulated time, s")
    for axes in grid[:, 0]:
        set_measure_axis(axes, Pendulum.measure)
    last = max(c.plan.steps for c in curves) * PLANT.time_step
    highest = max(_HIGHEST, 1.5 * max(_highest(c) for c in curves))
    grid[0, 0].set(
        ylim=(_LOWEST, highest), xlim=(min(_FIRST * PLANT.time_step, last / 100.0), last)
    )
    lanes = curves[0].plan.lanes
    each = f"each of {lanes} runs, and the median bold" if lanes > 1 else "1 run"
    title(figure, f"Pendulum: time to fall of frozen copies, {each}")
    return figure


def _highest(curve: _Curve) -> float:
    """Of what is drawn."""
    drawn = np.concatenate([curve.frozen.values.ravel(), curve.learning.median])
    return float(drawn[np.isfinite(drawn)].max(initial=0.0))


def _panel(axes: Axes, curve: _Curve, baselines: dict[str, float]) -> None:
    preset = str(curve.plan.preset)
    shade = color(palette.SERIES[_COLORS.get(preset, 5)])
    for line in _LINES:
        axes.axhline(baselines[line.key], color=IDLE, lw=0.9, ls=(0, line.dashes), zorder=1)
    draw_course(axes, curve.frozen, PLANT.time_step, shade)
    times = curve.learning.steps * PLANT.time_step
    axes.plot(*known(times, curve.learning.median), color=dark(shade), lw=1.0, ls=(0, (3, 1.5)))
    axes.set_xscale("log")
    gains = ", ".join(f"{i.gain:g}" for i in curve.plan.make_task().inputs[::2])
    rule = fill(words_of(curve.plan), _LETTERS)
    head(axes, f"preset {preset}", f"{rule}\ninput gains {gains}", shade)


def _name_lines(axes: Axes, baselines: dict[str, float]) -> None:
    for line in _LINES:
        level = baselines[line.key]
        words = f"{line.words}\n{level:.3f} s"
        axes.annotate(
            words,
            (1, level),
            (4, 0),
            ("axes fraction", "data"),
            "offset points",
            fontsize=TINY,
            color=IDLE,
            va=line.side,
            annotation_clip=False,
        )


def _table(curves: Sequence[_Curve]) -> Table:
    columns: dict[str, list[Any]] = {}
    for c in curves:
        part = {
            "preset": [c.plan.preset] * len(c.frozen.steps),
            "simulated_s": (c.frozen.steps * PLANT.time_step).tolist(),
            **course_columns(c.frozen, "frozen_"),
            **course_columns(c.learning),
        }
        for name, values in part.items():
            columns.setdefault(name, []).extend(values)
    return columns
