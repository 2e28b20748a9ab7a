"""The map as a picture and a table: one cell for each pair of β and γ."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import Rectangle

from hebbviz.sims.figures.curves import falling, lane_columns, rule_of, runs, setting, shown
from hebbviz.sims.figures.sheet import INK, SMALL, Sheet, Table, blank, head, look
from hebbviz.sims.program.terminal import finite

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage
    from numpy.typing import NDArray

    from hebbviz.sims.sweep.grid import Sweep
    from hebbviz.sims.sweep.outcome import Outcome
    from hebbviz.task.base import Measure, Task

_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of red, green and blue."""
_CELL, _LEAST_HEIGHT, _AROUND = 0.42, 2.7, 1.5
"""Inches: of a cell, of the drawing, and of what is around the cells."""
_MOST_WORDS = 12
"""Cells in a row that still have room for words."""


def sheet(
    sweep: Sweep,
    task: Task,
    points: Sequence[Outcome],
    untrained: Outcome,
    more: Sequence[dict[str, Any]],
) -> Sheet:
    """The map of points, β by β; `more` is what their table says besides."""
    with look():
        figure = _draw(sweep, task, points, untrained)
    best = next((_named(points[k]) for k in _best(points, untrained)), None)
    numbers = {
        "best": best,
        "untrained_median": finite(untrained.median),
        "points": [{**about(p, untrained), **m} for p, m in zip(points, more, strict=True)],
    }
    medians = "The last fifth" if sweep.lanes == 1 else "Medians, over the last fifth,"
    note = (
        f"{medians} of {runs(sweep.lanes)} of {untrained.plan.steps:,} steps; untrained "
        f"{_written(untrained, _digits(task.measure, [untrained]))}; fail: rewarded no more than "
        "the luckiest untrained one; "
        f"{'framed: rewarded most.' if best else 'none is rewarded more.'}"
    )
    if any(math.isinf(p.median) for p in (*points, untrained)):
        note += f"\n{_over(task.measure)}"
    return Sheet(figure, _table(task, points, untrained, more), numbers, note)


def _over(measure: Measure) -> str:
    event = measure.event
    return (
        f">: half of the runs or more had no {event} in that time T; their mean time to {event} is "
        "over T/3.0, with 95 % confidence."
    )


def _written(point: Outcome, digits: Callable[[float], str]) -> str:
    return f"{'> ' if math.isinf(point.median) else ''}{digits(point.drawn)}"


def _best(points: Sequence[Outcome], untrained: Outcome) -> list[int]:
    """The places of those that are rewarded most; none if all their runs fail."""
    rewards = [float(np.median(p.reward)) for p in points]
    return [
        k for k, p in enumerate(points) if rewards[k] == max(rewards) and p.failing(untrained) < 1.0
    ]


def _named(point: Outcome) -> dict[str, Any]:
    return {"beta": point.plan.beta, "gamma": point.plan.gamma, "median": finite(point.median)}


def _digits(measure: Measure, points: Sequence[Outcome]) -> Callable[[float], str]:
    """How medians are written: three digits of the largest, and of all others as many decimals; on
    a logarithmic scale three digits of each.
    """
    most = max(abs(p.drawn) for p in points)
    decimals = 2 - math.floor(math.log10(most)) if 0.0 < most < math.inf else 2

    def write(value: float) -> str:
        if measure.logarithmic or not -3 < decimals < 6:
            digits, e, exponent = f"{value:#.3g}".partition("e")
            return f"{digits.rstrip('.')}{e}{exponent}"
        return f"{value:.{max(0, decimals)}f}"

    return write


def about(point: Outcome, untrained: Outcome) -> dict[str, Any]:
    """A point in numbers."""
    low, high = point.quartiles
    event = point.measure.event
    return {
        "beta": point.plan.beta,
        "gamma": point.plan.gamma,
        "median": finite(point.median),
        "lower_quartile": finite(low),
        "upper_quartile": finite(high),
        **({f"lanes_without_{event}": point.without} if event else {}),
        "failing": point.failing(untrained),
        "average_reward": finite(np.median(point.reward)),
    }


def _table(
    task: Task, points: Sequence[Outcome], untrained: Outcome, more: Sequence[dict[str, Any]]
) -> Table:
    rows = [{**about(p, untrained), **m} for p, m in zip(points, more, strict=True)]
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in rows[0]}
    for key in task.measure.keys:
        columns |= lane_columns(key, np.array([p.figures[key] for p in points]).T)
    return columns


def _draw(sweep: Sweep, task: Task, points: Sequence[Outcome], untrained: Outcome) -> Figure:
    rows, columns = len(sweep.betas), len(sweep.gammas)
    figure = blank(max(_LEAST_HEIGHT, _AROUND + _CELL * rows))
    axes = figure.add_subplot()
    medians = np.array([p.drawn for p in points]).reshape(rows, columns)
    image = axes.imshow(
        medians,
        cmap=_colors(points),
        norm=_norm(task.measure, medians),
        aspect="auto",
        origin="lower",
    )
    axes.grid(visible=False)
    axes.set_xticks(range(columns), [shown(g) for g in sweep.gammas])
    axes.set_yticks(range(rows), [f"{b:.16g}" for b in sweep.betas])
    axes.set(xlabel="step size γ", ylabel="β")
    unit = f", {task.measure.unit}" if task.measure.unit else ""
    figure.colorbar(image, ax=axes, label=f"{task.measure.name}{unit}", pad=0.02)
    if columns <= _MOST_WORDS:
        _write_cells(axes, points, untrained, image, _digits(task.measure, points))
    for k in _best(points, untrained):
        _frame(axes, *divmod(k, columns))
    about = setting(sweep.untrained)
    falls = falling(about) and f", γ{falling(about)}"
    words = f"{about['network']}, preset {task.preset_name}{rule_of(about)}{falls}"
    head(axes, f"{task.name}: β against γ", words)
    return figure


def _colors(points: Sequence[Outcome]) -> str:
    """Brighter is better: where more reward goes with a smaller measure, the other way round."""
    measure = np.array([p.drawn for p in points])
    reward = np.array([np.median(p.reward) for p in points])
    agree = np.sum((measure - measure.mean()) * (reward - reward.mean())) >= 0.0
    return "viridis" if agree else "viridis_r"


def _norm(measure: Measure, medians: NDArray[np.float64]) -> Normalize:
    above = medians[medians > 0.0]
    if measure.logarithmic and above.size:
        return LogNorm(above.min(), max(above.max(), 1.001 * above.min()), clip=True)
    return Normalize(medians.min(), medians.max())


def _write_cells(
    axes: Axes,
    points: Sequence[Outcome],
    untrained: Outcome,
    image: AxesImage,
    digits: Callable[[float], str],
) -> None:
    """The median, and below it the lanes that fail."""
    shades = image.cmap(image.norm(np.array([p.drawn for p in points])))
    columns = round(image.get_extent()[1] + 0.5)
    for k, (point, shade) in enumerate(zip(points, shades, strict=True)):
        y, x = divmod(k, columns)
        ink = INK if shade[:3] @ _LUMINANCE > 0.45 else "white"
        failing = point.failing(untrained)
        words = _written(point, digits) + (f"\n{failing:.0%} fail" if failing else "")
        axes.text(x, y, words, color=ink, fontsize=SMALL, ha="center", va="center")


def _frame(axes: Axes, y: int, x: int) -> None:
    """Around a cell."""
    axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, fill=False, ec=INK, lw=2.0, clip_on=False))
