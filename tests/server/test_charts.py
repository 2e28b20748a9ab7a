"""Charts: one plot for ever, an axis that holds what is drawn, a legend of what has points."""

from __future__ import annotations

from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hebbviz.learner.frames import Frame
from hebbviz.server.live.recent_frames import MANY, alike
from hebbviz.server.page import charts
from hebbviz.server.page.charts import Chart, ChartStyle, Cursor, Points

VALUES = st.floats(-1e9, 1e9).map(lambda y: y if abs(y) > 1e-9 else 0.0)
CURVES = st.lists(st.lists(VALUES, min_size=1, max_size=9), min_size=1, max_size=9)


class Plot:
    """What viser makes of a chart, as far as charts know it."""

    def __init__(self, data: Any, series: Any, **looks: Any) -> None:
        self.data, self.series, self.scales = data, series, looks["scales"]

    @property
    def legend_of(self) -> set[str]:
        return {s["label"] for s in self.series[1:] if "class" not in s}


class Gui:
    """Counts the plots that are made."""

    def __init__(self) -> None:
        self.plots: list[Plot] = []

    def add_html(self, content: str) -> None:
        pass

    def add_uplot(self, data: Any, series: Any, **looks: Any) -> Plot:
        self.plots.append(Plot(data, series, **looks))
        return self.plots[-1]


def chart(**options: Any) -> tuple[Gui, Chart]:
    gui = Gui()
    colors = {"a": (1, 2, 3), "b": (3, 2, 1)}
    return gui, Chart(cast(Any, gui), nullcontext(), "a and b", colors, ChartStyle(**options))


def line(values: list[float]) -> Points:
    return np.arange(1.0, 1.0 + len(values)), np.array(values)


@given(CURVES)
def test_one_plot_holds_whatever_is_drawn(curves: list[list[float]]) -> None:
    gui, drawn = chart()
    for k, values in enumerate(curves):
        more = {"c": (9, 9, 9)} if k % 3 == 1 else {}
        cursor = Cursor(2.0, 1.0, 9.0) if k % 3 == 2 else None
        drawn.draw({"a": line(values), "c": line(values)}, [1.0], more=more, cursor=cursor)
        (plot,) = gui.plots
        low, high = plot.scales["y"]["range"]
        assert low <= min(values) <= max(values) <= high
        assert len(plot.series) == len(plot.data)
        assert {len(column) for column in plot.data} == {len(plot.data[0])}


def test_the_legend_is_of_what_has_points() -> None:
    gui, drawn = chart(banded=("b",))
    nothing = np.zeros(0), np.zeros(0)
    bands = {"b": (nothing, nothing)}
    (plot,) = gui.plots
    assert plot.legend_of == set()
    drawn.draw({"a": line([1.0, 2.0])}, [], bands=bands)
    assert plot.legend_of == {"a"}
    drawn.draw({"a": line([1.0, 2.0])}, [2.0], bands=bands)
    assert plot.legend_of == {"a", charts.CHANGED}
    drawn.draw({"a": line([1.0, 2.0]), "c": line([1.0])}, [7.0], bands=bands, more={"c": (9, 9, 9)})
    assert plot.legend_of == {"a", "c"}


def test_the_axis_of_nothing_has_room_on_both_sides() -> None:
    assert charts._around(0.0, 0.0) == (-0.1, 0.1)
    assert charts._width(charts._around(0.0, 1e-15)) < 0.3


@given(VALUES, st.floats(2e-3, 1e3))
def test_what_varies_is_seen_however_small_it_is(value: float, share: float) -> None:
    low, high = sorted((value, value + share * abs(value)))
    bottom, top = charts._around(low, high)
    assert bottom < top
    if high > low:
        assert (high - low) / (top - bottom) > 0.2


@given(st.lists(st.integers(1, 10_000), max_size=30))
def test_single_steps_stand_alone_after_a_fast_run(lengths: list[int]) -> None:
    frames = [cast(Frame, SimpleNamespace(since=SimpleNamespace(steps=n))) for n in lengths]
    kept = [f.since.steps for f in alike(frames)]
    assert kept == lengths[len(lengths) - len(kept) :], "the latest, without a gap"
    if kept:
        assert max(kept) <= MANY * kept[-1]
    if len(kept) < len(lengths):
        assert lengths[-len(kept) - 1] > MANY * kept[-1]
