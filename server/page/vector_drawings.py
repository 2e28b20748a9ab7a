"""SVG drawings of two vectors: the angle between them, and their components side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb, Theme, css

Array = NDArray[np.float64]

TRUTH: Rgb = palette.SERIES[0]
ESTIMATE: Rgb = palette.SERIES[1]

DIAL, ARROW = 132, 56.0
"""Width of the dial and length of its arrows."""
WIDTH, MARGIN, ROW, LETTER = 340, 18, 17, 6.0
"""Sizes of the bar chart: full width, right margin, height of a row, width of a letter."""
LONGEST_NAME = 28


def dial(degrees: float, theme: Theme) -> str:
    """The estimate's arrow, at this angle to the exact gradient's, which points to the right."""
    middle, floor = DIAL / 2, ARROW + 8
    known = math.isfinite(degrees)
    turn = math.radians(degrees) if known else 0.0
    end = middle + 0.42 * ARROW * math.cos(turn), floor - 0.42 * ARROW * math.sin(turn)
    arc = (
        f'<path d="M {middle + 0.42 * ARROW:g} {floor:g} A {0.42 * ARROW:g} {0.42 * ARROW:g} 0 0 0 '
        f'{end[0]:.2f} {end[1]:.2f}" fill="none" stroke="{css(theme.ink)}" stroke-width="1.2"/>'
    )
    rim = (
        f'<path d="M {middle - ARROW:g} {floor:g} A {ARROW:g} {ARROW:g} 0 0 1 '
        f'{middle + ARROW:g} {floor:g} Z" fill="{css(theme.zero)}"/>'
    )
    return (
        f'<svg width="{DIAL}" height="{floor + 8:g}" style="flex:none" role="img" '
        f'aria-label="the angle">{rim}'
        f"{_arrow(middle, floor, 0.0, TRUTH)}"
        f"{arc + _arrow(middle, floor, turn, ESTIMATE) if known else ''}</svg>"
    )


def _arrow(x: float, y: float, turn: float, color: Rgb) -> str:
    shape = f"M 0 0 H {ARROW - 8:g} M {ARROW:g} 0 l -11 -5 v 10 z"
    return (
        f'<path d="{shape}" transform="translate({x:g} {y:g}) rotate({-math.degrees(turn):.2f})" '
        f'stroke="{css(color)}" fill="{css(color)}" stroke-width="3"/>'
    )


def bars(
    names: Sequence[str],
    truth: Array,
    estimate: Array | None,
    mark: Array,
    full: float,
    theme: Theme,
) -> str:
    """A row for each name: the exact gradient's bar, the estimate's below it, a `mark` across both.

    Zero is in the middle, `full` at either end; a longer bar is cut off and ends in a point.
    """
    short = [n if len(n) <= LONGEST_NAME else f"{n[: LONGEST_NAME - 1]}…" for n in names]
    left = 8 + LETTER * max(map(len, short))
    half = (WIDTH - left - MARGIN) / 2
    zero, height = left + half, ROW * len(names)
    ink = css(theme.ink)
    parts = [
        _line(zero + half * share, 0, height, css(theme.ink, 0.5 if share == 0 else 0.15))
        for share in (-1, -0.5, 0, 0.5, 1)
    ]
    for k, name in enumerate(short):
        top = ROW * k
        parts.append(
            f'<text x="{left - 6:g}" y="{top + 12}" text-anchor="end" fill="{ink}">'
            f"{escape(name)}</text>"
        )
        parts.append(_bar(zero, top + 3, half, truth[k] / full, TRUTH))
        if estimate is not None:
            parts.append(_bar(zero, top + 9, half, estimate[k] / full, ESTIMATE))
        at = zero + half * float(np.clip(mark[k] / full, -1, 1))
        parts.append(_line(at, top + 1, top + ROW - 1, ink, 2.0))
    ends = ((zero - half, f"−{full:g}"), (zero, "0"), (zero + half, f"+{full:g}"))
    parts += [
        f'<text x="{x:g}" y="{height + 12}" text-anchor="middle" fill="{ink}">{text}</text>'
        for x, text in ends
    ]
    return (
        f'<svg viewBox="0 0 {WIDTH} {height + 16}" width="100%" font-size="10.5" role="img" '
        f'aria-label="exact gradient and estimate of each synapse">{"".join(parts)}</svg>'
    )


def _bar(zero: float, top: float, half: float, share: float, color: Rgb) -> str:
    length = half * min(abs(share), 1.0)
    left = zero if share > 0 else zero - length
    if abs(share) <= 1.0:
        return (
            f'<rect x="{left:.1f}" y="{top}" width="{length:.1f}" height="5" fill="{css(color)}"/>'
        )
    sign = 1.0 if share > 0 else -1.0
    return (
        f'<path d="M {zero:g} {top} h {sign * (half - 5):g} l {sign * 8:g} 2.5 '
        f'l {-sign * 8:g} 2.5 H {zero:g} z" fill="{css(color)}"/>'
    )


def _line(x: float, top: float, bottom: float, color: str, width: float = 1.0) -> str:
    return (
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top}" y2="{bottom}" stroke="{color}" '
        f'stroke-width="{width:g}"/>'
    )
