"""Errors of the sonar task, of independent runs: each of them at the end, and all as mean ± sd.

Errors are those of a frozen copy, in one pass over each set. Every run has a split of its own and
its own first weights. Preset `best` was chosen by errors on these very patterns; so its figure is
of the whole procedure, which chooses within each split (see `selection`). Beside the errors stand
those that Gorman and Sejnowski (1988) reached by back-propagation with six hidden units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.experiments import Curves, Plan
from hebbviz.sims.experiments.statistics import deviation_of
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.curves import (
    beside,
    count_axis,
    lane_columns,
    preset_note,
    runs,
    setting,
    shown,
    words_of,
)
from hebbviz.sims.figures.run_length import cut, steps_of
from hebbviz.sims.figures.selection import Selection, inner_plan, select
from hebbviz.sims.figures.sheet import Sheet, Table, blank, color, dark, head, look, mark_end
from hebbviz.sims.figures.sonar_splits import Inner
from hebbviz.sims.program.terminal import finite
from hebbviz.sims.worlds.sonar import BEST, GRID, HOLD, PATTERNS, Sonar

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hebbviz.sims.figures.request import Order
    from hebbviz.sims.figures.run_figure import Work
    from hebbviz.sims.figures.sheet import Color

Array = NDArray[np.float64]

BACK_PROPAGATION = {"training_error": 0.003, "test_error": 0.165}
"""Gorman and Sejnowski, 6 hidden units, fractions of patterns."""
PROTOCOL = "another protocol: 13-fold, 192 and 16 patterns, deterministic units"
"""Theirs."""

FROZEN = (
    "A frozen copy is the network as it stands, but that it does not learn. It sees each pattern "
    f"of a set for {HOLD:,} steps, and the share of its wrong answers is its error."
)

VALIDATED = (
    "Validation: the settings of best were chosen by errors on these 208 patterns, so this is "
    "not a test error; --preset best chooses within each split, and has one."
)

_EVALUATIONS, _QUICK_EVALUATIONS = 50, 10
_WORDS = 6.0
"""The height of what is said at the end of a curve, in % of error."""
_HELD_OUT = color(palette.SERIES[4])
_COLORS = {
    "training_error": color(palette.BRAND),
    "test_error": _HELD_OUT,
    "validation_error": _HELD_OUT,
}


@dataclass(frozen=True)
class _Size:
    preset: str
    lanes: int
    epochs: int


_FULL, _QUICK = _Size("paper", 100, 2000), _Size("quick", 6, 20)
_EPOCHS = {BEST: 300}
"""By when a preset has shown what it can; any other is given as many as the paper's."""


@dataclass(frozen=True)
class _Result:
    """Of a figure's runs: their plan and task, what came of them, and how settings were chosen
    where they were.
    """

    plan: Plan
    task: Sonar
    curves: Curves
    selection: Selection | None = None

    @property
    def names(self) -> list[str]:
        """Of the errors, that of held-out patterns first: it is the higher one."""
        return sorted(self.curves.figures, key="training_error".__eq__)

    @property
    def epochs(self) -> int:
        return self.plan.steps // self.task.epoch


def make(order: Order, work: Work) -> Sheet:
    """Errors at about 50 times, which are equally far apart."""
    size = _QUICK if order.quick else _FULL
    task = Sonar(order.preset or size.preset)
    length = size.epochs if order.quick else _EPOCHS.get(task.plain_preset, size.epochs)
    steps = steps_of(order, task) or length * task.epoch
    evaluations = _QUICK_EVALUATIONS if order.quick else _EVALUATIONS
    segments, epochs = cut(steps // task.epoch, evaluations)
    plan = Plan(
        task="sonar",
        preset=task.preset_name,
        seed=order.seed,
        lanes=order.lanes or size.lanes,
        segments=segments,
        segment_steps=epochs * task.epoch,
        evaluate=1,
        options={"dtype": "float32"},
    )
    result = _result(plan, task, work)
    with look():
        figure = _draw(result)
    notes = [*_chosen(result), preset_note(plan), FROZEN]
    quick = _quick(plan, result) if order.quick else ""
    return Sheet(figure, _table(result), _numbers(result), "\n".join(notes), quick)


def _result(plan: Plan, task: Sonar, work: Work) -> _Result:
    if task.preset_name == BEST:
        selection = select(plan, work)
        return _Result(plan, task, selection.curves, selection)
    (curves,) = work.curves([plan])
    return _Result(plan, task, curves)


# In words and numbers


def _quick(plan: Plan, result: _Result) -> str:
    whole = _EPOCHS.get(result.task.plain_preset, _FULL.epochs)
    preset = _FULL.preset if plan.preset == _QUICK.preset else plan.preset
    return (
        f"preset {plan.preset}, {runs(plan.lanes)} of {result.epochs} epochs in place of preset "
        f"{preset}, {_FULL.lanes} runs of {whole:,}"
    )


def _chosen(result: _Result) -> list[str]:
    """How settings were chosen, and what came of it."""
    selection, task = result.selection, result.task
    if selection is None:
        return [VALIDATED] if "validation_error" in result.names else []
    training, inner = task.training, Inner.training
    grid = "; ".join(
        f"{g.preset}, γ {shown(g.gamma)}, {count} of {len(errors)} times, {_percent(errors)}"
        for g, count, errors in zip(GRID, selection.counts, selection.validation, strict=True)
    )
    test = result.curves.figures["test_error"][:, -1]
    said = [
        f"Nested selection: in each split of the {PATTERNS} patterns, every setting of the grid "
        f"learns from {inner} of the {training} training patterns; that with the least error on "
        f"the other {Inner.held_out} is chosen, and a new run with it learns from all {training}. "
        f"Test errors are of these runs, on {task.held_out} patterns that neither they nor the "
        "choice have seen; what all settings share (rule, hidden units, fall) was chosen before, "
        "on all of them.",
        f"Grid, how often each was chosen, and its validation error: {grid}. Most often: "
        f"{selection.most_often.preset}, γ {shown(selection.most_often.gamma)}.",
    ]
    if len(test) > 1:
        said.append(
            f"Standard error of the test error: {100.0 * _error_of_mean(test):.1f} % over splits; "
            f"{100.0 * _of_patterns(test):.1f} % for {PATTERNS} patterns that stand for all echoes."
        )
    return said


def _percent(errors: Array) -> str:
    """Mean ± standard deviation of fractions."""
    spread = f" ± {100.0 * deviation_of(errors):.1f}" if len(errors) > 1 else ""
    return f"{100.0 * errors.mean():.1f}{spread} %"


def _error_of_mean(errors: Array) -> float:
    """Over splits, which share their patterns."""
    return float(deviation_of(errors)) / math.sqrt(len(errors))


def _of_patterns(errors: Array) -> float:
    """Standard error of a proportion among this many patterns, each right or wrong."""
    p = float(errors.mean())
    return math.sqrt(p * (1.0 - p) / PATTERNS)


def _numbers(result: _Result) -> dict[str, Any]:
    """The errors at the end, as fractions."""
    numbers = setting(result.plan) | {
        "epochs": result.epochs,
        "steps_a_pattern": result.task.hold,
        "back_propagation_protocol": PROTOCOL,
    }
    for name, value in BACK_PROPAGATION.items():
        numbers[f"{name}_back_propagation"] = value
    for name in reversed(result.names):
        last = result.curves.figures[name][:, -1]
        numbers |= {
            name: float(last.mean()),
            f"{name}_sd": finite(deviation_of(last)),
            f"{name}_se": finite(_error_of_mean(last)),
            f"{name}_worst": float(last.max()),
        }
    return numbers if result.selection is None else numbers | _of_selection(result)


def _of_selection(result: _Result) -> dict[str, Any]:
    """The grid and what was chosen of it; γ and network are those of a setting."""
    selection = result.selection
    assert selection is not None
    grid = [
        {
            "preset": g.preset,
            "gamma": g.gamma,
            "network": setting(inner_plan(result.plan, g))["network"],
            "chosen": count,
            "validation_error": float(errors.mean()),
            "validation_error_sd": finite(deviation_of(errors)),
        }
        for g, count, errors in zip(GRID, selection.counts, selection.validation, strict=True)
    ]
    most = selection.most_often
    test = result.curves.figures["test_error"][:, -1]
    return {
        "network": None,
        "gamma": None,
        "selection": "nested",
        "grid": grid,
        "most_often": {"preset": most.preset, "gamma": most.gamma},
        "validation_error_of_chosen": float(selection.of_chosen.mean()),
        "test_error_se_of_patterns": _of_patterns(test),
    }


def _table(result: _Result) -> Table:
    curves, task = result.curves, result.task
    columns: dict[str, Any] = {"epoch": [int(s) // task.epoch for s in curves.evaluated_at]}
    for name in result.names:
        errors = curves.figures[name]
        columns |= {
            f"{name}_mean": errors.mean(axis=0).tolist(),
            f"{name}_sd": deviation_of(errors, axis=0).tolist(),
        }
    for name in result.names:
        columns |= lane_columns(name, curves.figures[name])
    if result.selection is not None:
        rows = len(columns["epoch"])
        chosen = [GRID[k] for k in result.selection.chosen]
        columns |= {
            f"setting_{k}": [f"{g.preset} gamma={g.gamma}"] * rows for k, g in enumerate(chosen)
        }
    return columns


# The drawing


def _draw(result: _Result) -> Figure:
    figure = blank(4.2)
    axes = figure.add_subplot()
    ends = axes.inset_axes((1.02, 0.0, 0.22, 1.0), sharey=axes)
    last = {name: 100.0 * result.curves.figures[name][:, -1] for name in result.names}
    stands = _stand({name: float(values.mean()) for name, values in last.items()})
    for place, name in enumerate(reversed(result.names)):
        shade = _COLORS[name]
        _curve(axes, result, name, shade)
        said = f"{_label(name)}\n{_percent(last[name] / 100.0)}"
        _runs(ends, last[name], place, shade)
        mark_end(ends, 1.55, float(last[name].mean()), said, shade, stands=stands[name])
    for name, value in BACK_PROPAGATION.items():
        for each in (axes, ends):
            each.axhline(100.0 * value, color=_COLORS[name], lw=1.0, ls=(0, (1, 1.6)), zorder=1)
    axes.set(
        xlim=(0, result.epochs),
        ylim=(-1.5, 55),
        ylabel="error of a frozen copy, %",
        xlabel=f"epochs of {result.task.training} patterns, {result.task.hold:,} steps each",
    )
    count_axis(axes.xaxis)
    ends.set(xlim=(-0.55, 1.55), xticks=[], xlabel="each run at the\nend, bar: mean")
    ends.grid(visible=False, axis="x")
    ends.tick_params(left=False, labelleft=False)
    ends.spines.left.set_visible(False)
    _head(axes, result)
    return figure


def _curve(axes: Axes, result: _Result, name: str, shade: Color) -> None:
    epochs, percent = result.curves.evaluated_at / result.task.epoch, result.curves.figures[name]
    mean, sd = 100.0 * percent.mean(axis=0), 100.0 * deviation_of(percent, axis=0)
    axes.fill_between(epochs, np.maximum(mean - sd, 0.0), mean + sd, color=shade, alpha=0.18, lw=0)
    axes.plot(epochs, mean, color=shade)


def _runs(axes: Axes, percent: Array, place: float, shade: Color) -> None:
    """Each run at the end as a dot, and their mean as a bar."""
    axes.plot(
        place + beside(percent, 1.0, 0.9), percent, ".", color=shade, ms=3.2, mew=0, alpha=0.7
    )
    axes.plot([place - 0.4, place + 0.4], [percent.mean()] * 2, color=dark(shade), lw=1.6)


def _head(axes: Axes, result: _Result) -> None:
    plan = result.plan
    spread = f"mean ± standard deviation of {plan.lanes} runs" if plan.lanes > 1 else "1 run"
    about = setting(plan)
    how = (
        f"preset {plan.preset}: {words_of(plan)}"
        if result.selection is None
        else f"preset {plan.preset}: β {about['beta']:g}, rule {about['rule']}; γ and inputs are "
        "chosen in each split"
    )
    theirs = ", ".join(f"{_label(n)} {100.0 * v:g}" for n, v in BACK_PROPAGATION.items())
    head(
        axes,
        f"Sonar: mines or rocks, {spread}",
        f"{how}\ndotted: back-propagation, 6 hidden units (Gorman and Sejnowski 1988), {theirs} %;"
        f"\n{PROTOCOL}",
    )


def _label(name: str) -> str:
    return name.removesuffix("_error")


def _stand(ends: dict[str, float]) -> dict[str, str]:
    """How what is said stands at the ends of two curves, so that neither covers the other."""
    lower, upper = sorted(ends, key=lambda name: ends[name])
    if ends[upper] - ends[lower] > _WORDS:
        return dict.fromkeys(ends, "center")
    return {upper: "bottom", lower: "top"}
