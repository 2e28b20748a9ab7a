"""How the rule's estimate comes to the true gradient: the angle between them, for several β.

    Δw / (γ t), where w stands as good as still, is the mean of r z over t steps

of a real learner in the lamps, 2-3-1. It goes to E[r z], which lies at an angle of its own from
∇η, the bias of β: a short trace forgets what came late. A long one takes longer to come there:
it gathers the noise of all rewards in between. The bias, and the expected angle after t steps (for
t long against 1/(1 − β)), are computed by `hebbviz.theory.network_chain` and drawn beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.experiments import Curves, Plan
from hebbviz.sims.experiments.statistics import deviation_of
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.log_time import scales, spaced
from hebbviz.sims.figures.sheet import (
    INK,
    Sheet,
    Table,
    apart,
    blank,
    color,
    dark,
    head,
    look,
    mark_end,
)
from hebbviz.sims.worlds.lamps import Lamps, small_example
from hebbviz.task.base import Evaluable, Task
from hebbviz.theory.exact_gradient import GradientTruth, angle_between, degrees_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hebbviz.sims.figures.request import Order
    from hebbviz.sims.figures.run_figure import Work

Array = NDArray[np.float64]

BETAS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99)
STILL = 1e-9
"""A step size at which the weights move by less than 1e-3 in 10⁷ steps."""

_TOGETHER = (
    "Together, n estimates x are at the angle to the gradient g whose cosine is "
    "Σ x·g / (|g| √(n Σ |x|²)). Its expectation is exact for t far above 1/(1 − β)."
)

_POINTS = 100
"""Evaluations of a plan."""
_COLORS = (*(color(palette.SERIES[k]) for k in (4, 1, 3, 2, 5)), INK)
_LOW, _HIGH = 0.1, 130.0
"""Degrees: ends of the axis."""
_LABEL = 0.15
"""Decades of the axis that a label takes."""


class Watched(Lamps):
    """The lamps with the weights of `small_example`, evaluated by how the estimate points."""

    name = "gradient"

    def __init__(self) -> None:
        super().__init__()
        network, self._weights = small_example()
        self._gradient = network.at(self._weights).gradient

    def initial_weights(self, draws: Array) -> Array:
        return self._weights.copy()

    def evaluate(self, learner: Evaluable) -> dict[str, Array]:
        """The angle from Δw, which is γ t times the mean of r z, to ∇η in degrees, and the length
        of Δw, each (lanes,).

        The angle is 90 before the first step, when Δw has no direction.
        """
        moved = learner.weights - self._weights[:, None]
        angle = np.where(moved.any(axis=0), angle_between(self._gradient, moved), 90.0)
        return {"angle": angle, "length": np.linalg.norm(moved, axis=0)}


@dataclass(frozen=True, kw_only=True)
class Watching(Plan):
    """A plan of the task above, which has no name on the command line."""

    task: str = Watched.name

    def make_task(self) -> Task:
        return Watched()


def make(order: Order, work: Work) -> Sheet:
    """Default 16 estimates of 10⁷ steps; quick 4 of 10⁵."""
    lanes = order.lanes or (4 if order.quick else 16)
    steps = 10**5 if order.quick else 10**7
    plans = [p for beta in BETAS for p in _plans(beta, lanes, steps, order.seed)]
    found = work.curves(plans)
    each = len(plans) // len(BETAS)
    network, weights = small_example()
    truths = [Lamps().truth(weights, network.topology, beta) for beta in BETAS]
    courses = [
        _course(beta, found[k * each : (k + 1) * each], truth)
        for k, (beta, truth) in enumerate(zip(BETAS, truths, strict=True))
    ]
    with look():
        figure = _draw(courses, lanes)
    numbers: dict[str, Any] = {
        "lanes": lanes,
        "steps": steps,
        "beta": list(BETAS),
        "angle": [float(c.angle[:, -1].mean()) for c in courses],
        "angle_of_all": [float(c.of_all[-1]) for c in courses],
        "bias": [c.bias for c in courses],
        "expected_angle": [float(c.expected[-1]) for c in courses],
    }
    quick = f"{lanes} estimates of {steps:,} steps in place of 16 of 10,000,000"
    return Sheet(figure, _table(courses), numbers, _TOGETHER, quick if order.quick else "")


def _plans(beta: float, lanes: int, steps: int, seed: int) -> list[Watching]:
    whole = Watching(
        beta=beta,
        gamma=STILL,
        seed=seed,
        lanes=lanes,
        segments=_POINTS,
        segment_steps=steps // _POINTS,
        evaluate=1,
    )
    return scales(whole, first=100 * _POINTS)


@dataclass(frozen=True)
class _Course:
    """Of one β: steps (n,), the angle of each estimate and that of all (lanes, n) and (n,), and
    what is exact: the bias, and what is expected of the angle of all.
    """

    beta: float
    steps: NDArray[np.int64]
    angle: Array
    of_all: Array
    bias: float
    expected: Array


def angle_of_all(angle: Array, length: Array) -> Array:
    """Degrees whose cosine is Σ x·g / (|g| √(n Σ |x|²)), from the angles of n estimates x to the
    gradient g and their lengths, (n, ...).

    It goes to `Chain.expected_cosine` as n grows. The mean of the angles does not: a short
    estimate, which has been led astray, counts there as much as a long one.
    """
    along = (length * np.cos(np.radians(angle))).mean(axis=0)
    spread = np.sqrt((length**2).mean(axis=0))
    return degrees_of(along / np.where(spread > 0.0, spread, 1.0))


def _course(beta: float, curves: list[Curves], truth: GradientTruth) -> _Course:
    """The scales joined, at points that are about equally far apart on a logarithmic axis."""
    steps = np.concatenate([c.evaluated_at[1:] for c in curves])
    steps, at = np.unique(steps, return_index=True)
    chosen = spaced(steps, 12)
    steps, at = steps[chosen], at[chosen]
    angle, length = (
        np.concatenate([c.figures[name][:, 1:] for c in curves], axis=1)[:, at]
        for name in ("angle", "length")
    )
    of_all = angle_of_all(angle, length)
    return _Course(beta, steps, angle, of_all, truth.bias_angle, truth.expected_angles(steps))


def _table(courses: list[_Course]) -> Table:
    columns: dict[str, list[float]] = {
        "beta": [],
        "steps": [],
        "angle_mean": [],
        "angle_sd": [],
        "angle_of_all": [],
        "angle_expected": [],
        "angle_of_bias": [],
    }
    lanes = len(courses[0].angle)
    columns |= {f"angle_{k}": [] for k in range(lanes)}
    for c in courses:
        mean, deviation = c.angle.mean(axis=0), deviation_of(c.angle, axis=0)
        rows = zip(c.steps, mean, deviation, c.of_all, c.expected, c.angle.T, strict=True)
        for steps, mean, sd, of_all, expected, each in rows:
            row = (c.beta, int(steps), mean, sd, of_all, expected, c.bias, *each)
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value if isinstance(value, int) else float(value))
    return columns


def _draw(courses: list[_Course], lanes: int) -> Figure:
    figure = blank(4.2)
    axes = figure.add_subplot()
    last = courses[0].steps[-1]
    stands = 10.0 ** apart(np.log10([max(c.of_all[-1], _LOW) for c in courses]), _LABEL)
    for c, shade, stand in zip(courses, _COLORS, stands, strict=True):
        mean, sd = c.angle.mean(axis=0), deviation_of(c.angle, axis=0)
        axes.fill_between(
            c.steps, np.maximum(mean - sd, _LOW), mean + sd, color=shade, alpha=0.18, lw=0
        )
        axes.plot(c.steps, c.expected, color=dark(shade), lw=0.9, ls=(0, (4, 2)), zorder=4)
        axes.plot(c.steps, c.of_all, color=shade, zorder=3)
        axes.axhline(c.bias, color=shade, lw=1.0, ls=(0, (1, 1.6)), zorder=1)
        mark_end(axes, float(last), stand, f"β = {c.beta:g}", dark(shade))
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(100, last),
        ylim=(_LOW, _HIGH),
        xlabel="steps t of the running mean of r z",
        ylabel="angle to the exact gradient, degrees",
    )
    ticks = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 45, 90)
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    together = f"{lanes} independent estimates together; band: mean ± standard deviation of them"
    head(
        axes,
        "The rule's estimate of the gradient: short traces are biased, long ones noisy",
        f"line: {together if lanes > 1 else 'one estimate'}\n"
        "dashed: the line as it is expected at t steps; dotted: the bias of each β; both computed",
    )
    return figure
