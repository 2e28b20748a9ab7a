"""Line charts on one x axis in steps: several curves, and a mark where something was changed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from server.palette import Rgb, css

Array = NDArray[np.float64]
Points = tuple[Array, Array]
"""x in steps, ascending, and y; a y of NaN is left out."""

Span = tuple[float, float]

HEIGHT = 132
WIDTH = 1.5
"""Of a line, in pixels."""
SHRINK = 0.4
SHRINK_DRAWINGS = 40
"""A vertical axis is made smaller when the curves did with this share of it so many times."""
ROOM = 0.25
"""Left free above and below, as a share of the curves' height, so that they seldom leave."""
MOST_DECADES = 4
"""Of a logarithmic axis of steps: uPlot writes the numbers of more than these over each other."""
MARK_HEIGHT = 0.03
MARK: Rgb = (150, 150, 160)
CURSOR: Rgb = (240, 72, 112)


class Cursor(NamedTuple):
    """A step, and the ends of the run that it is in."""

    at: float
    first: float
    last: float


NO_MORE: Mapping[str, Rgb] = {}
NO_WIDTHS: Mapping[str, float] = {}
NO_BANDS: Mapping[str, tuple[Points, Points]] = {}

BAND_EDGE = "hebbviz-band-edge"
QUIET_EDGES = f"<style>.{BAND_EDGE} {{ display: none; }}</style>"
"""Keeps the edges of bands out of the legends; a page with bands needs it once."""
BAND_STRENGTH = 0.3


class Chart:
    """A chart with fixed series, named and coloured; `draw` gives the points of each.

    `container` is the tab or folder it stands in. Without a `span` its vertical axis holds still
    until the curves leave it, and is then drawn anew: uPlot's own automatic range takes a NaN,
    which leaves a point out, for a number. `log_steps`: a logarithmic horizontal axis, of steps
    above 0.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        container: Any,
        title: str,
        series: Mapping[str, Rgb],
        *,
        banded: Sequence[str] = (),
        widths: Mapping[str, float] = NO_WIDTHS,
        dashed: Sequence[str] = (),
        dotted: Sequence[str] = (),
        logarithmic: bool = False,
        log_steps: bool = False,
        legend: bool = True,
        span: Span | None = None,
        height: int = HEIGHT,
    ) -> None:
        self._gui, self._container, self._title = gui, container, title
        self._usual, self._dashed, self._dotted = dict(series), frozenset(dashed), frozenset(dotted)
        self._banded, self._widths = tuple(banded), dict(widths)
        self._logarithmic = logarithmic
        self._decades: Span | None = (1.0, 10.0) if log_steps else None
        self._legend, self._height = legend, height
        self._more: dict[str, Rgb] = {}
        self._has_cursor = False
        self._holds = span is not None
        self._span = span or (0.0, 1.0)
        self._small_for = 0
        self._plot: Any = None
        blank = [np.full(2, np.inf)] * (len(self._series()) - 1)
        self._add((np.array([1.0, 2.0]), *blank), None)

    def draw(
        self,
        points: Mapping[str, Points],
        marks: Sequence[float],
        *,
        bands: Mapping[str, tuple[Points, Points]] = NO_BANDS,
        cursor: Cursor | None = None,
        more: Mapping[str, Rgb] = NO_MORE,
    ) -> None:
        """Show the points of each series and a mark at each step of `marks`.

        `more` names and colours series besides the usual ones; `cursor` is drawn as a line upwards;
        `bands` are the least and greatest around each of the banded series.
        """
        names = (*self._usual, *more)
        curves = [points.get(name, (np.zeros(0), np.zeros(0))) for name in names]
        steps = [x for x, _ in curves if len(x)]
        if not steps:
            return
        line = np.zeros(0)
        if cursor is not None:
            line = _upright(cursor)
            steps.append(np.array([cursor.first, cursor.last]))
        first, last = min(x[0] for x in steps), max(x[-1] for x in steps)
        seen = np.unique([m for m in marks if first <= m <= last])
        x = np.unique(np.concatenate([*steps, seen, line]))
        columns = [edge for name in self._banded for edge in _edges_on(x, *bands[name])]
        columns += [
            (_dots_on if name in self._dotted else _line_on)(x, *curve)
            for name, curve in zip(names, curves, strict=True)
        ]
        same = self._has_cursor == (cursor is not None) and self._more == more
        fits = all((self._fit(np.concatenate(columns)), self._fit_steps(x), same))
        if self._logarithmic:  # uPlot clamps NaN to the floor there, and leaves out infinity
            columns = [np.where(np.isnan(c), np.inf, c) for c in columns]
        if cursor is not None:
            columns.append(_dots_on(x, line, np.array([0.0, 1.0])))
        data = (x, *columns, _dots_on(x, seen, np.full(len(seen), MARK_HEIGHT)))
        if fits:  # also the same again: a chart that has just been made may need it for its axes
            self._plot.data = data
        else:
            self._more, self._has_cursor = dict(more), cursor is not None
            self._replace(data)

    def renew(self) -> None:
        """Make it anew with what it shows; viser's charts do not survive a change of theme."""
        self._replace(self._plot.data)

    def remove(self) -> None:
        self._plot.remove()

    def _replace(self, data: tuple[Array, ...]) -> None:
        order = self._plot.order
        self._plot.remove()
        self._add(data, order)

    def _fit(self, values: Array) -> bool:
        """Whether the values fit the vertical axis; if not, its span is another from now on."""
        values = values[np.isfinite(values)]
        if self._holds or len(values) == 0:
            return True
        low, high = float(values.min()), float(values.max())
        wanted = _around(low, high)
        fits = self._span[0] <= low and high <= self._span[1]
        small = _width(wanted) < SHRINK * _width(self._span)
        self._small_for = self._small_for + 1 if small else 0
        if fits and self._small_for < SHRINK_DRAWINGS:
            return True
        self._span, self._small_for = wanted, 0
        return False

    def _fit_steps(self, x: Array) -> bool:
        """Whether the steps fit a logarithmic axis, the latest few powers of ten; likewise."""
        if self._decades is None:
            return True
        high = max(1, math.ceil(math.log10(x[-1])))
        low = min(high - 1, max(high - MOST_DECADES, math.floor(math.log10(x[0]))))
        wanted = 10.0**low, 10.0**high
        fits, self._decades = self._decades == wanted, wanted
        return fits

    def _series(self) -> tuple[uplot.Series, ...]:
        """The axis, the curves, the cursor if there is one, and last the marks."""
        cursor = uplot.Series(
            label="shown", stroke=css(CURSOR), width=2, points={"show": False}, scale="m"
        )
        return (
            uplot.Series(label="step"),
            *(_edge() for _ in range(2 * len(self._banded))),
            *(self._curve(name, color) for name, color in (self._usual | self._more).items()),
            *((cursor,) if self._has_cursor else ()),
            uplot.Series(
                label="changed", stroke=css(MARK), width=0, points=_points(MARK, 9), scale="m"
            ),
        )

    def _curve(self, name: str, color: Rgb) -> uplot.Series:
        if name in self._dotted:
            return uplot.Series(label=name, stroke=css(color), width=0, points=_points(color, 5))
        dashed = name in self._dashed
        line = uplot.Series(
            label=name, stroke=css(color, 0.55 if dashed else 1.0),
            width=self._widths.get(name, WIDTH), points={"show": False}, spanGaps=True,
        )  # fmt: skip
        if dashed:
            line["dash"] = (5, 4)
        return line

    def _bands(self) -> tuple[uplot.Band, ...]:
        """Each between two edges, which are the first of the series."""
        return tuple(
            uplot.Band(series=(2 * k + 2, 2 * k + 1), fill=css(self._usual[name], BAND_STRENGTH))
            for k, name in enumerate(self._banded)
        )

    def _add(self, data: tuple[Array, ...], order: float | None) -> None:
        y: dict[str, Any] = {"auto": False, "range": self._span}
        if self._logarithmic:
            y["distr"] = 3
        x: dict[str, Any] = {"time": False}
        if self._decades is not None:
            x |= {"distr": 3, "auto": False, "range": self._decades}
        scales: Any = {"x": x, "y": y, "m": {"auto": False, "range": (0.0, 1.0)}}
        with self._container:
            self._plot = self._gui.add_uplot(
                data, self._series(), title=self._title, bands=self._bands(), scales=scales,
                height=self._height,
                legend={"show": self._legend, "live": False},
                axes=(
                    {"size": 38, "space": 90, "ticks": {"show": self._decades is None}},
                    {"size": 62, "ticks": {"show": not self._logarithmic}},
                ),
                padding=(8, 24 if self._decades is None else 34, 0, 0),
                cursor={"show": False}, order=order,
            )  # fmt: skip


def _upright(cursor: Cursor) -> Array:
    """Two places so close together that a line between them is upright."""
    return np.array([cursor.at, cursor.at + min(0.25, 1e-4 * (cursor.last - cursor.first))])


def _around(low: float, high: float) -> Span:
    """Round numbers outside of two numbers, with some room."""
    room = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-9)
    unit = 10.0 ** math.floor(math.log10(room)) / 2
    low, high = low - ROOM * room, high + ROOM * room
    return unit * math.floor(low / unit), unit * math.ceil(high / unit)


def _width(span: Span) -> float:
    return span[1] - span[0]


def _points(color: Rgb, size: int) -> Any:
    return {"show": True, "size": size, "fill": css(color), "stroke": css(color), "width": 1}


def _edge() -> Any:
    """A side of a band: its place matters, it is not drawn itself."""
    return {"label": "", "width": 0, "points": {"show": False}, "class": BAND_EDGE}


def _line_on(x: Array, own: Array, y: Array) -> Array:
    """A line through (own, y) at the common axis x, NaN before and after it."""
    if len(own) == 0:
        return np.full(len(x), np.nan)
    return np.where((x < own[0]) | (x > own[-1]), np.nan, np.interp(x, own, y))


def _edges_on(x: Array, low: Points, high: Points) -> tuple[Array, Array]:
    """As `_line_on`, but where there is no band its edges meet: a fill to a NaN goes astray."""
    own = low[0]
    if len(own) == 0:
        return np.full(len(x), np.nan), np.full(len(x), np.nan)
    edges = np.interp(x, own, low[1]), np.interp(x, own, high[1])
    middle, outside = (edges[0] + edges[1]) / 2, (x < own[0]) | (x > own[-1])
    return np.where(outside, middle, edges[0]), np.where(outside, middle, edges[1])


def _dots_on(x: Array, own: Array, y: Array) -> Array:
    """The points (own, y) on the common axis x, NaN elsewhere."""
    column = np.full(len(x), np.nan)
    column[np.searchsorted(x, own)] = y
    return column
