"""Line charts on a common x axis in steps: several curves, and a mark at every change."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser import uplot

from hebbviz.server.page.widgets import assign
from hebbviz.sims.figures.palette import Rgb, css

Array = NDArray[np.float64]
Points = tuple[Array, Array]
"""x in steps, ascending, and y; a y of NaN is left out."""

Span = tuple[float, float]

HEIGHT = 132
WIDTH = 1.5
"""Width of a line, in pixels."""
SHRINK = 0.4
SHRINK_DRAWINGS = 40
"""A vertical axis shrinks once the curves have needed only this share of it this many times."""
ROOM = 0.25
"""Margin above and below, as a share of the curves' height, so that the axis seldom changes."""
FLAT = 1e-3
"""Curves that differ by less than this share of their values are drawn flat."""
NOTHING, ROOM_OF_NOTHING = 1e-12, 0.4
"""Curves below the first value count as 0, and leave room for later values."""
WHOLE = (1.0, 2.0, 5.0, *(m * 10.0**k for k in range(1, 15) for m in (1, 2, 2.5, 5)))
"""Between the numbers of an axis of steps: there is no half a step."""
MOST_DECADES = 4
"""Most powers of ten on a logarithmic axis of steps: with more, uPlot's labels overlap."""
MARK_HEIGHT = 0.03
MARK: Rgb = (150, 150, 160)
CHANGED = "changed"
CURSOR: Rgb = (240, 72, 112)


class Cursor(NamedTuple):
    """A step, and the first and last step of its run."""

    at: float
    first: float
    last: float


NO_MORE: Mapping[str, Rgb] = {}
NO_BANDS: Mapping[str, tuple[Points, Points]] = {}

UNNAMED = "hebbviz-unnamed"
LEGENDS = f"""<style>.{UNNAMED} {{ display: none; }}
.u-legend {{ pointer-events: none; }}</style>"""
"""Hides edges of bands, and series without points, in the legends. It also disables switching
series off there, because the next drawing would show them again. Each chart has this style, because
only the tabs in front count.
"""
NO_POINTS: Points = np.zeros(0), np.zeros(0)
BAND_STRENGTH = 0.3


@dataclass(frozen=True)
class ChartStyle:
    """How a chart looks.

    Attributes:
        banded: Series with a band around them.
        widths: Widths of lines in pixels, by series.
        dashed: Series drawn as dashed lines.
        dotted: Series drawn as dots.
        logarithmic: Whether the vertical axis is logarithmic.
        log_steps: Whether the horizontal axis is logarithmic; its steps are above 0 then.
        legend: Whether a legend is shown.
        span: Ends of the vertical axis; None: they fit the curves.
        height: In pixels.
    """

    banded: tuple[str, ...] = ()
    widths: Mapping[str, float] = field(default_factory=dict)
    dashed: tuple[str, ...] = ()
    dotted: tuple[str, ...] = ()
    logarithmic: bool = False
    log_steps: bool = False
    legend: bool = True
    span: Span | None = None
    height: int = HEIGHT


class Chart:
    """A chart with fixed series, named and coloured; `draw` gives the points of each.

    `container` is its tab or folder. Without a `span` the vertical axis stays fixed until the
    curves leave it, and then changes: uPlot's own automatic range treats a NaN, which omits a
    point, as a number. `log_steps`: a logarithmic horizontal axis, of steps above 0.

    Only differences are assigned to viser's plot, which replaces its uPlot before the page is
    painted; removing and adding a plot would leave a gap on the page for a moment. The ends of the
    horizontal axis are sent with each drawing: the page's automatic ends are lost if data arrive
    while a uPlot is being made.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        container: Any,
        title: str,
        series: Mapping[str, Rgb],
        style: ChartStyle = ChartStyle(),
    ) -> None:
        self._usual, self._style = dict(series), style
        self._steps: Span = (1.0, 10.0)
        self._span = style.span or (0.0, 1.0)
        self._small_for = 0
        looks = self._series(self._usual, (), has_cursor=False)
        blank = [np.full(2, np.inf)] * (len(looks) - 1)
        with container:
            self._css = gui.add_html(LEGENDS)
            self._plot = gui.add_uplot(
                (np.array([1.0, 2.0]), *blank),
                looks,
                title=title,
                bands=self._bands(),
                scales=self._scales(),
                height=style.height,
                legend={"show": style.legend, "live": False},
                axes=self._axes(),
                padding=(8, 34, 0, 0),
                cursor={"show": False},
            )

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
        `bands` are the least and greatest values around each of the banded series.
        """
        colors = self._usual | dict(more)
        curves = {name: points.get(name, NO_POINTS) for name in colors}
        named = [name for name, (x, _) in curves.items() if len(x)]
        steps = [curves[name][0] for name in named]
        if not steps:
            return
        line = np.zeros(0)
        if cursor is not None:
            line = _upright(cursor)
            steps.append(np.array([cursor.first, cursor.last]))
        first, last = min(x[0] for x in steps), max(x[-1] for x in steps)
        seen = np.unique([m for m in marks if first <= m <= last])
        x = np.unique(np.concatenate([*steps, seen, line]))
        columns = [edge for name in self._style.banded for edge in _edges_on(x, *bands[name])]
        columns += [
            (_dots_on if name in self._style.dotted else _line_on)(x, *curve)
            for name, curve in curves.items()
        ]
        self._fit(np.concatenate(columns))
        self._fit_steps(x)
        if self._style.logarithmic:  # uPlot clamps NaN to the floor there, and leaves out infinity
            columns = [np.where(np.isnan(c), np.inf, c) for c in columns]
        if cursor is not None:
            columns.append(_dots_on(x, line, np.array([0.0, 1.0])))
        if len(seen):
            named.append(CHANGED)
        assign(self._plot, "series", self._series(colors, named, has_cursor=cursor is not None))
        self._plot.scales = self._scales()  # assigned even if unchanged: this makes a new uPlot
        self._plot.data = (x, *columns, _dots_on(x, seen, np.full(len(seen), MARK_HEIGHT)))

    def show(self, seen: bool) -> None:
        assign(self._plot, "visible", seen)

    def remove(self) -> None:
        self._css.remove()
        self._plot.remove()

    def _fit(self, values: Array) -> None:
        """Change the span of the vertical axis if the values do not fit the current one."""
        values = values[np.isfinite(values)]
        if self._style.span is not None or len(values) == 0:
            return
        low, high = float(values.min()), float(values.max())
        wanted = _around(low, high)
        fits = self._span[0] <= low and high <= self._span[1]
        small = _width(wanted) < SHRINK * _width(self._span)
        self._small_for = self._small_for + 1 if small else 0
        if not fits or self._small_for >= SHRINK_DRAWINGS:
            self._span, self._small_for = wanted, 0

    def _fit_steps(self, x: Array) -> None:
        """All steps, or the latest few powers of ten where their axis is logarithmic."""
        first, last = float(x[0]), float(x[-1])
        if self._style.log_steps:
            high = max(1, math.ceil(math.log10(last)))
            low = min(high - 1, max(high - MOST_DECADES, math.floor(math.log10(first))))
            first, last = 10.0**low, 10.0**high
        self._steps = first, max(last, first + 1.0)

    def _series(
        self, colors: Mapping[str, Rgb], named: Collection[str], *, has_cursor: bool
    ) -> tuple[uplot.Series, ...]:
        """The axis, the curves, the cursor if there is one, and last the marks; the legend contains
        the `named` ones.
        """
        cursor = uplot.Series(
            label="shown", stroke=css(CURSOR), width=2, points={"show": False}, scale="m"
        )
        curves = [self._curve(name, color) for name, color in colors.items()]
        changed = uplot.Series(
            label=CHANGED, stroke=css(MARK), width=0, points=_points(MARK, 9), scale="m"
        )
        for one in (*curves, changed):
            if one["label"] not in named:
                one["class"] = UNNAMED
        edges = (_edge() for _ in range(2 * len(self._style.banded)))
        cursors = (cursor,) if has_cursor else ()
        return (uplot.Series(label="step"), *edges, *curves, *cursors, changed)

    def _curve(self, name: str, color: Rgb) -> uplot.Series:
        if name in self._style.dotted:
            return uplot.Series(label=name, stroke=css(color), width=0, points=_points(color, 5))
        dashed = name in self._style.dashed
        line = uplot.Series(
            label=name,
            stroke=css(color, 0.55 if dashed else 1.0),
            width=self._style.widths.get(name, WIDTH),
            points={"show": False},
            spanGaps=True,
        )
        if dashed:
            line["dash"] = (5, 4)
        return line

    def _bands(self) -> tuple[uplot.Band, ...]:
        """One band between each pair of edges, which come first in the series."""
        return tuple(
            uplot.Band(series=(2 * k + 2, 2 * k + 1), fill=css(self._usual[name], BAND_STRENGTH))
            for k, name in enumerate(self._style.banded)
        )

    def _scales(self) -> Any:
        y: dict[str, Any] = {"auto": False, "range": self._span}
        if self._style.logarithmic:
            y["distr"] = 3
        x: dict[str, Any] = {"time": False, "auto": False, "range": self._steps}
        if self._style.log_steps:
            x["distr"] = 3
        return {"x": x, "y": y, "m": {"auto": False, "range": (0.0, 1.0)}}

    def _axes(self) -> Any:
        steps: dict[str, Any] = {"size": 38, "space": 80}
        steps |= {"ticks": {"show": False}} if self._style.log_steps else {"incrs": WHOLE}
        return steps, {"size": 62, "ticks": {"show": not self._style.logarithmic}}


def _upright(cursor: Cursor) -> Array:
    """Two x values so close together that a line between them is vertical."""
    return np.array([cursor.at, cursor.at + min(0.25, 1e-4 * (cursor.last - cursor.first))])


def _around(low: float, high: float) -> Span:
    """Round numbers that enclose two numbers with a margin."""
    room = max(high - low, FLAT * max(abs(low), abs(high)))
    if room < NOTHING:
        room = ROOM_OF_NOTHING
    unit = 10.0 ** math.floor(math.log10(room)) / 2
    low, high = low - ROOM * room, high + ROOM * room
    return unit * math.floor(low / unit), unit * math.ceil(high / unit)


def _width(span: Span) -> float:
    return span[1] - span[0]


def _points(color: Rgb, size: int) -> Any:
    return {"show": True, "size": size, "fill": css(color), "stroke": css(color), "width": 1}


def _edge() -> Any:
    """An edge of a band: it sets the band's extent and is not drawn itself."""
    return {"label": "", "width": 0, "points": {"show": False}, "class": UNNAMED}


def _line_on(x: Array, own: Array, y: Array) -> Array:
    """A line through (own, y) at the common axis x, NaN before and after it."""
    if len(own) == 0:
        return np.full(len(x), np.nan)
    return np.where((x < own[0]) | (x > own[-1]), np.nan, np.interp(x, own, y))


def _edges_on(x: Array, low: Points, high: Points) -> tuple[Array, Array]:
    """As `_line_on`, but where there is no band its edges meet: uPlot misdraws a fill to a NaN."""
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
