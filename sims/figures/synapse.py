"""The paper's figure of synaptic updates: sequences (a) to (l), as the rule really made them.

A learner plays the script of the task `synapse`; each step is drawn as the learner made it.
"""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

from matplotlib.patches import Circle, Polygon, Rectangle

from hebbviz.learner.learner import Learner
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.sheet import (
    FAINT,
    IDLE,
    INK,
    SMALL,
    TINY,
    Color,
    Sheet,
    blank,
    color,
    dark,
    look,
)
from hebbviz.sims.worlds.synapse import REWARD, SCRIPT, Synapse

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hebbviz.sims.figures.request import Order
    from hebbviz.sims.figures.run_figure import Work

PRESET = "script"
COLUMNS = ("abcd", "efgh", "ijkl")
HEADINGS = ("no spikes", "presynaptic spike alone", "postsynaptic spike follows")

_SPIKE, _SPIKE_EDGE = color(palette.SPIKE), (0.72, 0.52, 0.0)
_RISEN, _FALLEN = color(palette.TRACE_POSITIVE), color(palette.TRACE_NEGATIVE)
_STRENGTH = color(palette.WEIGHT_POSITIVE)
_BODY: Color = (0.965, 0.97, 0.98)


@dataclass(frozen=True)
class Moment:
    """One step: what is at its end, and the weight before it."""

    step: int
    letter: str
    presynaptic: bool
    postsynaptic: bool
    reward: float
    trace: float
    weight: float
    weight_before: float


def played(seed: int) -> list[Moment]:
    """The script, played once by a learner. Both neurons are clamped: the seed changes nothing."""
    learner = Learner(Synapse(PRESET), seed=seed)
    moments = []
    for letter, *_ in SCRIPT:
        before = float(learner.weights[0, 0])
        learner.advance(1)
        frame = learner.frame()
        pre, post = (bool(fired) for fired in frame.fired)
        moments.append(
            Moment(
                frame.step,
                letter,
                pre,
                post,
                frame.reward[1],
                float(frame.trace[0]),
                float(frame.weight[0]),
                before,
            )
        )
    return moments


def make(order: Order, work: Work) -> Sheet:
    """The script takes no time: it is always played whole."""
    work.progress(0.0)
    moments = played(order.seed)
    work.progress(1.0)
    with look():
        figure = _draw(moments)
    names = Moment.__dataclass_fields__
    table = {n: [_plain(getattr(m, n)) for m in moments] for n in names}
    quick = "the same as without, for the script takes no time" if order.quick else ""
    return Sheet(figure, table, _numbers(moments), _note(), quick)


def _note() -> str:
    """All that Δw can be reckoned by."""
    preset = Synapse(PRESET).preset
    return (
        "Each step: z ← β z + (u − σ(w u′)) u′, then w ← w + γ r z; u′ and u are 1 where the pre- "
        "and, a step later, the postsynaptic neuron fired, else 0.\n"
        f"β = {preset.beta:g}, γ = {preset.gamma:g}; r = {REWARD:g} where it stands, else 0: "
        f"Δw = {preset.gamma * REWARD:g} z. There is no chance in it, whatever the seed."
    )


def _plain(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def _numbers(moments: list[Moment]) -> dict[str, Any]:
    """Δw that the reward at the end of each sequence made, and z then."""
    by_letter = {m.letter: m for m in moments if m.letter}
    numbers: dict[str, Any] = {}
    for letter in "chl":
        m = by_letter[letter]
        numbers[f"trace_{letter}"] = m.trace
        numbers[f"weight_change_{letter}"] = m.weight - m.weight_before
    return numbers


# The drawing


def _draw(moments: list[Moment]) -> Figure:
    figure = blank(6.3)
    grid = figure.add_gridspec(2, 1, height_ratios=(4.5, 1.3))
    panels = grid[0].subgridspec(4, 3, wspace=0.0, hspace=0.0)
    _time(figure.add_subplot(grid[0]))
    by_letter = {m.letter: m for m in moments if m.letter}
    most = max(abs(m.trace) for m in moments)
    words = {letter: what for letter, *_, what in SCRIPT}
    for column, letters in enumerate(COLUMNS):
        for row, letter in enumerate(letters):
            axes = figure.add_subplot(panels[row, column])
            _panel(axes, by_letter[letter], most, words[letter])
            if row == 0:
                axes.set_title(HEADINGS[column], loc="center", fontsize=9, pad=4)
    _course(figure.add_subplot(grid[1]), moments)
    return figure


def _time(axes: Axes) -> None:
    """An arrow down the left side."""
    axes.axis("off")
    axes.annotate(
        "",
        (-0.084, 0.06),
        (-0.084, 0.97),
        "axes fraction",
        "axes fraction",
        annotation_clip=False,
        arrowprops={"arrowstyle": "-|>", "color": IDLE, "lw": 1.0},
    )
    axes.text(-0.1, 0.985, "time", transform=axes.transAxes, fontsize=SMALL, color=IDLE)


_PRE, _POST, _PRE_SIZE, _POST_SIZE = -1.7, 1.25, 0.42, 0.8
_SQUARE, _WIDE = 0.92, 0.33
"""Height and width of the square whose level is z."""
_CLEFT = 0.07


def _panel(axes: Axes, m: Moment, most: float, words: str) -> None:
    axes.set(xlim=(-2.45, 2.55), ylim=(-1.3, 1.05), aspect="equal")
    axes.axis("off")
    _neuron(axes, _PRE, _PRE_SIZE, fired=m.presynaptic)
    _neuron(axes, _POST, _POST_SIZE, fired=m.postsynaptic)
    _synapse(axes, m)
    _level(axes, m.trace / most, m.trace)
    if m.reward:
        _reward(axes)
    axes.text(-2.42, 0.78, f"({m.letter})", fontsize=9, fontweight="bold", va="center")
    axes.text(
        0.1,
        -1.0,
        fill(words, 42),
        fontsize=TINY + 0.3,
        color=INK,
        ha="center",
        va="top",
        alpha=0.75,
    )


def _neuron(axes: Axes, x: float, size: float, *, fired: bool) -> None:
    """A cell body; one that fires is lit, and an action potential leaves along its axon."""
    if fired:
        for wide, alpha in ((0.19, 0.16), (0.09, 0.28)):  # no number lies on it
            axes.add_patch(
                Circle(
                    (x, 0), size + wide, color=_SPIKE, alpha=alpha, lw=0, zorder=1, clip_on=False
                )
            )
    face, edge = (_SPIKE, _SPIKE_EDGE) if fired else (_BODY, IDLE)
    axes.add_patch(Circle((x, 0), size, fc=face, ec=edge, lw=1.2, zorder=3))
    if fired:
        spike = [(-0.30, 0.0), (-0.1, 0.0), (-0.02, 0.30), (0.07, -0.1), (0.14, 0.0), (0.30, 0.0)]
        at = x if size < 0.5 else x + size + 0.26
        up = 0.0 if size < 0.5 else 0.28
        axes.plot(
            *zip(*[(at + a, up + b) for a, b in spike], strict=True),
            color=INK if size < 0.5 else _SPIKE_EDGE,
            lw=1.3,
            zorder=6,
            solid_joinstyle="round",
        )


def _synapse(axes: Axes, m: Moment) -> None:
    """The axon and its ending, as large as w; dashed what it was before this step."""
    touch = _POST - _POST_SIZE - _CLEFT
    size = _ending(m.weight)
    lit = m.presynaptic
    axes.plot(
        [_PRE + _PRE_SIZE, touch - size],
        [0, 0],
        lw=3.2 if lit else 2.0,
        zorder=2,
        color=_SPIKE_EDGE if lit else IDLE,
        solid_capstyle="butt",
    )
    axes.plot(
        [_POST + _POST_SIZE, 2.5],
        [0, 0],
        lw=3.2 if m.postsynaptic else 2.0,
        zorder=2,
        color=_SPIKE_EDGE if m.postsynaptic else IDLE,
        solid_capstyle="butt",
    )
    axes.add_patch(_shape(touch, size, fc=_STRENGTH, ec="none", zorder=4))
    if m.weight != m.weight_before:
        before = _ending(m.weight_before)
        axes.add_patch(_shape(touch, before, fc="none", ec=INK, lw=0.9, ls=(0, (2, 1.6)), zorder=5))
    change = m.weight - m.weight_before
    said = f"w {m.weight:.2f}" + (f"  Δw {change:+.2f}" if change else "")
    axes.text(
        touch + 0.05,
        -0.62,
        said.replace("-", "−"),
        fontsize=TINY,
        ha="right",
        va="top",
        color=dark(_STRENGTH),
    )


def _ending(weight: float) -> float:
    return 0.95 * weight


def _shape(touch: float, size: float, **how: Any) -> Polygon:
    """A terminal: it widens from the axon to a face as high as it is long, before the cleft."""
    half = size * 0.66
    return Polygon(
        [(touch - size, -0.05), (touch, -half), (touch, half), (touch - size, 0.05)],
        closed=True,
        joinstyle="round",
        **how,
    )


def _level(axes: Axes, share: float, trace: float) -> None:
    """z as the level in a square, from the dashed line of zero."""
    x, half = _POST - 0.2, _SQUARE / 2
    left = x - _WIDE
    axes.add_patch(Rectangle((left, -half), 2 * _WIDE, 2 * half, fc="white", ec="none", zorder=4))
    axes.add_patch(
        Rectangle(
            (left, 0),
            2 * _WIDE,
            share * half * 0.94,
            ec="none",
            zorder=5,
            fc=_RISEN if trace >= 0 else _FALLEN,
        )
    )
    axes.plot([left, x + _WIDE], [0, 0], color=INK, lw=0.8, ls=(0, (2.4, 1.8)), zorder=6)
    axes.add_patch(
        Rectangle((left, -half), 2 * _WIDE, 2 * half, fc="none", ec=INK, lw=0.9, zorder=7)
    )
    shade = dark(_RISEN if trace >= 0 else _FALLEN)
    axes.text(
        _POST + _POST_SIZE * 0.87,
        -0.81,
        f"z {trace:+.2f}".replace("-", "−"),
        ha="left",
        fontsize=TINY,
        va="center",
        color=shade,
    )


def _reward(axes: Axes) -> None:
    x = _POST + 0.42
    axes.text(
        x,
        0.0,
        "r",
        fontsize=11,
        fontstyle="italic",
        fontweight="bold",
        color=INK,
        ha="center",
        va="center",
        zorder=8,
    )


def _course(axes: Axes, moments: list[Moment]) -> None:
    """z and w over all steps, those between the sequences too."""
    steps = [m.step for m in moments]
    for letters in COLUMNS:
        within = [m.step for m in moments if m.letter and m.letter in letters]
        axes.axvspan(within[0] - 0.46, within[-1] + 0.46, color=FAINT, alpha=0.55, lw=0)
    colors = [_RISEN if m.trace >= 0 else _FALLEN for m in moments]
    axes.bar(steps, [m.trace for m in moments], width=0.62, color=colors, zorder=3)
    axes.axhline(0, color=INK, lw=0.8, ls=(0, (2.4, 1.8)), zorder=4)
    edges = [0.5, *(s + 0.5 for s in steps)]
    weights = [moments[0].weight_before, *(m.weight for m in moments)]
    axes.step(edges, weights, where="pre", color=_STRENGTH, lw=1.8, zorder=5)
    low, high = -0.95, 0.8
    for m in moments:
        if m.presynaptic or m.postsynaptic:
            side = "pre" if m.presynaptic else "post"
            axes.text(
                m.step, low + 0.03, side, fontsize=TINY, ha="center", va="bottom", color=_SPIKE_EDGE
            )
        if m.reward:
            axes.text(
                m.step,
                low + 0.03,
                "r",
                fontsize=9,
                fontstyle="italic",
                fontweight="bold",
                ha="center",
                va="bottom",
                color=INK,
            )
    axes.set(xlim=(0.5, len(moments) + 0.5), ylim=(low, high))
    axes.set_xticks(steps, [f"({m.letter})" if m.letter else str(m.step) for m in moments])
    axes.tick_params(axis="x", length=0, labelsize=SMALL)
    axes.set(xlabel="step", ylabel="z (bars), w (line)")
    axes.grid(visible=False)
    axes.text(0.7, moments[0].weight_before + 0.05, "w", color=dark(_STRENGTH), fontsize=SMALL)
    axes.text(2.5, 0.3, "z", color=dark(_RISEN), fontsize=SMALL)
