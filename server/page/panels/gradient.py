"""The exact gradient beside the rule's estimate, for tasks that know their exact gradient."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.server.live.gradient_estimate import (
    AngleCurve,
    Estimate,
    knows_its_truth,
    tells_the_mean,
    truth_of,
)
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import status_text
from hebbviz.server.page.charts import Chart, ChartStyle, Points
from hebbviz.server.page.panels.base import Panel, Place
from hebbviz.server.page.vector_drawings import ESTIMATE, TRUTH, bars, dial
from hebbviz.server.page.widgets import assign
from hebbviz.server.scene.appearance import Scale, endpoints, unit_names
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb, css
from hebbviz.theory.exact_gradient import GradientTruth

Array = NDArray[np.float64]

NOW, THEORY = "now", "by theory"
THEORY_COLOR: Rgb = (150, 150, 160)
EARLIER: tuple[Rgb, ...] = (palette.SERIES[2], palette.SERIES[3], palette.SERIES[5])
SPAN = (1.0, 180.0)
THEORY_POINTS = 60
MOST_ROWS = 40
"""At most this many synapses have bars: the first ones of a larger network."""
NOTHING = 1e-12
"""Below this share of the gradient, E[r z] of a layer is zero to rounding."""


_THEORY_WORDS = (
    "Dashed: the prediction of the exact chain for a mean over that many steps: noise and bias. "
    "Every change of the run starts a new curve; curves of other β stay."
)


class Gradient(Panel):
    """Angle, text and bars in one tab, the curve in another; `draw` redraws them all."""

    tabs, order = ("gradient", "angle"), 90

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        gui, tabs, topology = place.gui, place.tabs, place.topology
        self._theme = place.theme
        names = unit_names(topology, tuple(i.name for i in place.snapshot.run.task.inputs))
        self._names = [
            f"{names[pre]} → {names[post]}" for pre, post in zip(*endpoints(topology), strict=True)
        ]
        self._scale = Scale()
        with tabs["gradient"]:
            self._head = self.hold(gui.add_html(""))
            self._words = self.hold(gui.add_markdown(""))
            self._bars = self.hold(gui.add_html(""))
        chart = Chart(
            gui,
            tabs["angle"],
            "angle (°) over steps since the last change",
            {NOW: ESTIMATE, THEORY: THEORY_COLOR},
            ChartStyle(dashed=(THEORY,), logarithmic=True, log_steps=True, span=SPAN, height=230),
        )
        self._chart = self.hold(chart)
        with tabs["angle"]:
            self._chart_words = self.hold(gui.add_markdown(""))

    @staticmethod
    def wanted(snapshot: Snapshot) -> bool:
        return knows_its_truth(snapshot.run.task)

    def draw(self, snapshot: Snapshot) -> None:
        """Redraw everything, for the run itself or for the past that is shown."""
        frame = snapshot.run.live if snapshot.view.past is None else snapshot.view.frame
        estimate = snapshot.findings.estimate if snapshot.view.past is None else None
        truth = truth_of(snapshot.run.task, frame)
        if not isinstance(truth, GradientTruth):
            assign(self._head, "content", "")
            assign(self._bars, "content", "")
            assign(self._words, "content", f"The exact gradient is not available: {truth}.")
            assign(self._chart_words, "content", "")
            return
        assign(self._head, "content", self._heading(truth, estimate))
        assign(self._words, "content", _explained(snapshot, frame, truth, estimate))
        assign(self._bars, "content", self._compared(truth, estimate, frame))
        if estimate is not None:
            self._draw_chart(truth, estimate)
            assign(self._chart_words, "content", _THEORY_WORDS if estimate.reaches_back else "")

    def _heading(self, truth: GradientTruth, estimate: Estimate | None) -> str:
        """The angle as a picture and in numbers, and how well the network does."""
        angle = float("nan") if estimate is None else truth.angle(estimate.mean)
        large, small = "–", "no estimate"
        if estimate is not None and np.isfinite(angle):
            large = f"{angle:.1f}°"
            small = (
                f"cosine {np.cos(np.radians(angle)):.4f}<br>mean of "
                f"{status_text.steps(estimate.steps)}"
            )
        best = "" if truth.best_reward is None else f" of at most {truth.best_reward:.3g}"
        return (
            '<div style="display:flex; gap:14px; align-items:center; padding:0 12px 6px; '
            f'font-size:13px; line-height:1.35">{dial(angle, self._theme)}<div>'
            f'<div style="font-size:26px; font-weight:600; color:{css(ESTIMATE)}">{large}</div>'
            f"{small}<br>η now {truth.average_reward:.3f}{best}</div></div>"
        )

    def _compared(self, truth: GradientTruth, estimate: Estimate | None, frame: Frame) -> str:
        largest = max(float(np.abs(v).max()) for v in (truth.gradient, truth.biased))
        mean = None if estimate is None else estimate.mean[:MOST_ROWS]
        beta = float(frame.beta[0])
        key = (
            f'<div style="padding:0 12px 4px; font-size:13px">'
            f'<span style="color:{css(TRUTH)}">■</span> exact ∂η/∂w &nbsp; '
            f'<span style="color:{css(ESTIMATE)}">■</span> mean of r z &nbsp; '
            f"<b>|</b> its limit, β {beta:.6g}</div>"
        )
        drawn = bars(
            self._names[:MOST_ROWS],
            truth.gradient[:MOST_ROWS],
            mean,
            truth.biased[:MOST_ROWS],
            self._scale.fit(largest),
            self._theme,
        )
        return f'{key}<div style="padding:0 12px">{drawn}</div>'

    def _draw_chart(self, truth: GradientTruth, estimate: Estimate) -> None:
        curve = estimate.curve
        points: dict[str, Points] = {NOW: (curve.steps, curve.degrees)}
        if estimate.reaches_back and len(curve.steps) > 1:
            steps = np.geomspace(curve.steps[0], curve.steps[-1], THEORY_POINTS)
            points[THEORY] = (steps, truth.expected_angles(steps))
        earlier = {_name(c): color for c, color in zip(estimate.earlier, EARLIER, strict=False)}
        points |= {_name(c): (c.steps, c.degrees) for c in estimate.earlier}
        self._chart.draw(points, (), more=earlier)


def _name(curve: AngleCurve) -> str:
    return f"before, β {curve.beta:.6g}"


def _explained(
    snapshot: Snapshot, frame: Frame, truth: GradientTruth, estimate: Estimate | None
) -> str:
    """One or two sentences that explain the angle, or why there is none."""
    if estimate is None:
        return _missing(snapshot, frame)
    beta, bias = float(frame.beta[0]), truth.bias_angle
    if _is_starved(truth):
        return (
            f"At β {beta:.6g} a trace decays before the reward for a hidden neuron's spike "
            f"arrives: its mean of r z goes to 0, whatever the gradient is. The hidden layer is "
            f"starved, and the angle goes to **{bias:.1f}°**."
        )
    if not estimate.reaches_back:
        return (
            f"The weights move, and the gradient moves with them: the mean covers the latest "
            f"{status_text.steps(estimate.steps)}, in which they moved by a tenth of their "
            f"length. A "
            "smaller γ gives a longer mean and a smaller angle."
        )
    return (
        f"The angle falls like 1/√steps, down to **{bias:.2g}°**: the bias of β {beta:.6g}. "
        "β nearer to 1 has less bias and more noise. Try it: the mean then restarts."
    )


def _missing(snapshot: Snapshot, frame: Frame) -> str:
    """The reason why there is no estimate."""
    if snapshot.view.past is not None:
        return (
            "This is the exact gradient at the past weights. The estimate belongs to the live "
            "run: go back to now to see it."
        )
    if not frame.gamma.any():
        return (
            "Learning is frozen: the estimate is computed from weight changes, and there are none. "
            "Unfreeze learning (F), with a step size so small that the weights hardly move."
        )
    if not tells_the_mean(frame):
        return (
            "The estimate is computed from weight changes under the paper's rule with a constant "
            "γ. Under another rule, or while γ falls, there is none."
        )
    return "No step since the last change yet."


def _is_starved(truth: GradientTruth) -> bool:
    """Whether some synapses with a nonzero gradient get no estimate at all."""
    size = NOTHING * float(np.abs(truth.gradient).max())
    return bool(((np.abs(truth.biased) <= size) & (np.abs(truth.gradient) > 1e3 * size)).any())
