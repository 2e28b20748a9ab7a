"""Training and test error of the sonar task: mean and standard deviation of independent runs.

Errors are those of a frozen copy, in one pass over each set. Every run has a split of its own and
its own first weights. Beside them stand the errors that Gorman and Sejnowski (1988) reached by
back-propagation with six hidden units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from server import palette
from server.experiments import Curves, Plan
from server.figures.curves import count_axis, lane_columns, preset_note, runs, setting, words_of
from server.figures.length import cut, steps_of
from server.figures.sheet import Sheet, Table, blank, color, head, look, mark_end
from server.spread import deviation_of
from server.terminal import finite
from sims.sonar import HOLD, Sonar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from server.figures.command import Work
    from server.figures.order import Order

Array = NDArray[np.float64]

BACK_PROPAGATION = {"training_error": 0.003, "test_error": 0.165}
"""Gorman and Sejnowski, 6 hidden units, fractions of patterns."""

FROZEN = (
    "A frozen copy is the network as it stands, but that it does not learn. It sees each pattern "
    f"of a set for {HOLD:,} steps, and the share of its wrong answers is its error."
)

_EVALUATIONS = 50
_WORDS = 6.0
"""The height of what is said at the end of a curve, in % of error."""
_SHOWN = {
    "test_error": ("test", color(palette.SERIES[4])),
    "training_error": ("training", color(palette.BRAND)),
}


@dataclass(frozen=True)
class _Size:
    preset: str
    lanes: int
    epochs: int


_FULL, _QUICK = _Size("paper", 100, 2000), _Size("quick", 6, 20)
_EPOCHS = {"best": 300}
"""By when a preset has shown what it can; any other is given as many as the paper's."""


def make(order: Order, work: Work) -> Sheet:
    """Errors at about 50 times, which are equally far apart."""
    size = _QUICK if order.quick else _FULL
    task = Sonar(order.preset or size.preset)
    length = size.epochs if order.quick else _EPOCHS.get(task.plain_preset, size.epochs)
    steps = steps_of(order, task) or length * task.epoch
    segments, epochs = cut(steps // task.epoch, _EVALUATIONS)
    plan = Plan(
        task="sonar", preset=task.preset_name, seed=order.seed, lanes=order.lanes or size.lanes,
        segments=segments, segment_steps=epochs * task.epoch, evaluate=1,
        options={"dtype": "float32"},
    )  # fmt: skip
    (curves,) = work.curves([plan])
    with look():
        figure = _draw(plan, curves, task)
    done = plan.steps // task.epoch
    quick = (
        f"preset {plan.preset}, {runs(plan.lanes)} of {done} epochs in place of preset "
        f"{_FULL.preset}, {_FULL.lanes} runs of {_FULL.epochs:,}"
    )
    notes = f"{preset_note(plan)}\n{FROZEN}"
    numbers = _numbers(plan, curves, task)
    return Sheet(figure, _table(curves, task), numbers, notes, quick if order.quick else "")


def _numbers(plan: Plan, curves: Curves, task: Sonar) -> dict[str, Any]:
    """The errors at the end, as fractions."""
    numbers = setting(plan) | {
        "epochs": plan.steps // task.epoch, "steps_a_pattern": task.hold,
    }  # fmt: skip
    for name in sorted(_SHOWN, reverse=True):
        last = curves.figures[name][:, -1]
        numbers |= {
            name: float(last.mean()), f"{name}_sd": finite(deviation_of(last)),
            f"{name}_worst": float(last.max()),
            f"{name}_back_propagation": BACK_PROPAGATION[name],
        }  # fmt: skip
    return numbers


def _stand(ends: dict[str, float]) -> dict[str, str]:
    """How what is said stands at the ends of two curves, so that neither covers the other."""
    lower, upper = sorted(ends, key=lambda name: ends[name])
    if ends[upper] - ends[lower] > _WORDS:
        return dict.fromkeys(ends, "center")
    return {upper: "bottom", lower: "top"}


def _table(curves: Curves, task: Sonar) -> Table:
    columns: dict[str, Any] = {"epoch": [int(s) // task.epoch for s in curves.evaluated_at]}
    for name in _SHOWN:
        errors = curves.figures[name]
        columns |= {f"{name}_mean": errors.mean(axis=0).tolist(),
                    f"{name}_sd": deviation_of(errors, axis=0).tolist()}  # fmt: skip
    for name in _SHOWN:
        columns |= lane_columns(name, curves.figures[name])
    return columns


def _draw(plan: Plan, curves: Curves, task: Sonar) -> Figure:
    figure = blank(4.2)
    axes = figure.add_subplot()
    epochs = curves.evaluated_at / task.epoch
    references = ", ".join(
        f"{words} {100.0 * BACK_PROPAGATION[name]:g}" for name, (words, _) in _SHOWN.items()
    )
    stands = _stand({name: 100.0 * float(curves.figures[name][:, -1].mean()) for name in _SHOWN})
    for name, (words, shade) in _SHOWN.items():
        percent = 100.0 * curves.figures[name]
        mean, sd = percent.mean(axis=0), deviation_of(percent, axis=0)
        axes.fill_between(epochs, np.maximum(mean - sd, 0.0), mean + sd, color=shade, alpha=0.18,
                          lw=0)  # fmt: skip
        axes.plot(epochs, mean, color=shade)
        spread = f" ± {sd[-1]:.1f}" if plan.lanes > 1 else ""
        said = f"{words}\n{mean[-1]:.1f}{spread} %"
        mark_end(axes, epochs[-1], mean[-1], said, shade, stands=stands[name])
        axes.axhline(100.0 * BACK_PROPAGATION[name], color=shade, lw=1.0, ls=(0, (1, 1.6)))
    axes.set(
        xlim=(0, epochs[-1]), ylim=(-1.5, 55), ylabel="error of a frozen copy, %",
        xlabel=f"epochs of 187 patterns, {task.hold:,} steps each",
    )  # fmt: skip
    count_axis(axes.xaxis)
    spread = f"mean ± standard deviation of {plan.lanes} runs" if plan.lanes > 1 else "1 run"
    head(
        axes, f"Sonar: mines or rocks, {spread}",
        f"preset {plan.preset}: {words_of(plan)}\n"
        f"dotted: back-propagation, 6 hidden units (Gorman and Sejnowski 1988), {references} %",
    )  # fmt: skip
    return figure
