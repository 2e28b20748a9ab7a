"""The learning curve of a run: of the watched lane, and of all lanes where there are several."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from hebbviz.task import IS_LOWER_BOUND, Measure, Score, Task
from server import palette, spread, words
from server.charts import Chart, Cursor, Points
from server.commands import GiveReward
from server.evaluation import Evaluation
from server.history import Curve
from server.palette import Rgb, Theme
from server.picture import Other, Picture
from server.spread import Bools, Scores, Spread, middle_is_bound, middle_of

Array = NDArray[np.float64]
Bands = dict[str, tuple[Points, Points]]

OTHER: Rgb = palette.SERIES[3]
"""Of the other copy of a fork."""
EARLIER: Rgb = (140, 140, 140)
HEIGHT, HEIGHT_WITH_LANES = 215, 230
MOST_WINDOWS = 128
"""With several lanes longer windows are shown, so that the curve of one does not hide the rest."""


class Learning:
    """The chart and the words beneath it, for one task and number of lanes."""

    def __init__(self, gui: viser.GuiApi, tab: Any, picture: Picture, theme: Theme) -> None:
        task, lanes = picture.task, picture.lanes
        self._scores, self._ghost_scores = Scores(task), Scores(task)
        self._has_lanes = lanes > 1
        self._run = "watched lane" if self._has_lanes else "this run"
        self._middle = f"{spread.names(task.measure)[0]} of {lanes} lanes"
        frozen = dict(zip(_frozen_names(task), FROZEN, strict=False))
        series = {self._run: theme.ink if self._has_lanes else palette.SERIES[0]}
        series |= {"at least": palette.SERIES[1], "earlier run": EARLIER}
        banded: tuple[str, ...] = ()
        if self._has_lanes:
            banded = (self._middle, *frozen)
            series[self._middle] = palette.SERIES[0]
        series |= frozen
        measure = task.measure
        unit = f" ({measure.unit})" if measure.unit else ""
        self._chart = Chart(
            gui, tab, f"{measure.name}{unit}", series, banded=banded,
            widths=dict.fromkeys(banded, 2.5) | ({self._run: 0.8} if self._has_lanes else {}),
            dashed=("earlier run",), dotted=("at least",), logarithmic=measure.logarithmic,
            span=measure.span, height=HEIGHT_WITH_LANES if self._has_lanes else HEIGHT,
        )  # fmt: skip
        with tab:
            self._words = gui.add_markdown("")

    def remove(self) -> None:
        for handle in (self._chart, self._words):
            handle.remove()

    def draw(self, picture: Picture) -> None:
        curve, all_lanes = picture.curve, None
        if self._has_lanes:
            curves = picture.curves.coarser(MOST_WINDOWS)
            curve, all_lanes = curves.lane(picture.lane), self._scores.spread(curves)
        points = dict(zip((self._run, "at least"), _scores(picture, curve), strict=True))
        bands: Bands = {}
        if all_lanes is not None:
            points[self._middle], bands[self._middle] = _drawn(all_lanes)
        for name, of_copies in _frozen(picture).items():
            points[name], bands[name] = _drawn(of_copies)
        points |= self._earlier(picture)
        more = others(picture)
        if picture.other is not None:
            points |= dict.fromkeys(more, _scores(picture, since(picture.other))[0])
        self._chart.draw(points, marks(picture), bands=bands, cursor=cursor(picture), more=more)
        at_least = len(points["at least"][0]) > 0
        self._words.content = _said(picture, curve, all_lanes, at_least=at_least)

    def _earlier(self, picture: Picture) -> dict[str, Points]:
        """The run before: the middle of its lanes. Of one lane alone the windows are too unlike
        each other to be read beside the middle of many.
        """
        ghost = picture.ghost
        if ghost is None or (self._has_lanes and ghost.lanes == 1):
            return {}
        if ghost.lanes == 1:
            return {"earlier run": _scores(picture, ghost.lane(0))[0]}
        return {"earlier run": _drawn(self._ghost_scores.spread(ghost.coarser(MOST_WINDOWS)))[0]}


# What other charts of a run show too


def marks(picture: Picture) -> list[float]:
    """The steps at which something was changed."""
    return [float(c.step) for c in picture.changes]


def cursor(picture: Picture) -> Cursor | None:
    """Where in the run the step is that is shown of its past."""
    past = picture.past
    return None if past is None else Cursor(past.cursor, picture.first, picture.live.step)


def since(other: Other) -> Curve:
    """The other copy's curve from the fork on; before it there was but one."""
    c, late = other.curve, other.curve.end > other.start
    return Curve(
        c.window, c.end[late], c.steps[late], c.reward[late], c.broadcast[late], c.ended[late]
    )


def others(picture: Picture) -> dict[str, Rgb]:
    """Name and colour of the other copy's curve, while there is one."""
    return {} if picture.other is None else {f"other: {picture.other.words}": OTHER}


def evaluated(picture: Picture) -> str:
    """What the latest frozen copy did, in the watched lane, and in the middle of several."""
    if not picture.evaluations:
        return ""
    latest = picture.evaluations[-1]
    said = [_figure(picture, latest, key) for key in latest.figures if key != IS_LOWER_BOUND]
    return f"Frozen copy at step {words.count(latest.step)}: {', '.join(said)}."


# Inside

FROZEN: tuple[Rgb, ...] = (palette.SERIES[2], palette.SERIES[4])


def _drawn(of_lanes: Spread) -> tuple[Points, tuple[Points, Points]]:
    """The line and its band."""
    x = of_lanes.x
    return (x, of_lanes.middle), ((x, of_lanes.low), (x, of_lanes.high))


def _scores(picture: Picture, curve: Curve) -> tuple[Points, Points]:
    """The task's measure of every window; bounds apart."""
    scores = [picture.task.score(t) for t in curve.tallies()]
    value = np.array([s.value for s in scores])
    bound = np.array([s.is_bound for s in scores], dtype=bool)
    if picture.task.measure.logarithmic:
        value = np.where(value > 0, value, np.nan)
    return (curve.end, value), (curve.end[bound], value[bound])


def _frozen_names(task: Task) -> list[str]:
    return [_spaced(key) for key in task.frozen_figures]


def _spaced(key: str) -> str:
    return key.replace("_", " ")


def _frozen(picture: Picture) -> dict[str, Spread]:
    """What frozen copies of the run did; with one lane the middle is that lane."""
    task, done = picture.task, picture.evaluations
    x = np.array([e.step for e in done], dtype=np.float64)
    spreads = {}
    for key in task.frozen_figures:
        shape = len(done), picture.lanes
        values = np.array([e.figures[key] for e in done]).reshape(shape)
        bounds = np.array([_bounds(task, e, key) for e in done], dtype=bool).reshape(shape)
        spreads[_spaced(key)] = Spread.of(x, _in_unit(task, key, values), bounds, task.measure)
    return spreads


def _said(picture: Picture, curve: Curve, all_lanes: Spread | None, *, at_least: bool) -> str:
    measure = picture.task.measure
    newest = curve.tallies()[-1:]
    now = "".join(f", now **{words.score(picture.task.score(t), measure)}**" for t in newest)
    if now and all_lanes is not None:
        name, band = spread.names(measure)
        middle = Score(float(all_lanes.middle[-1]), bool(all_lanes.is_bound[-1]))
        now += f" in lane {picture.lane}; {name} **{words.score(middle, measure)}** (band: {band})"
    bound = " Dots: no fall in that window, so at least this." if at_least else ""
    both = "" if picture.other is None else words.compared(picture, picture.other)
    return (
        f"{both}\n\nEach point sums up {words.steps(curve.window)}{now}.{bound} "
        f"{_by_hand(picture)} {_changes(picture)} {evaluated(picture)}"
    )


def _by_hand(picture: Picture) -> str:
    """The rewards by hand: the curve is of the task's own."""
    given = [c.change.reward for c in picture.changes if isinstance(c.change, GiveReward)]
    if not given:
        return ""
    return f"Rewards by hand, **{sum(given):+.3g}** in all, are not in the curve."


def _figure(picture: Picture, done: Evaluation, key: str) -> str:
    """One figure of a frozen copy in words: of the watched lane, and of the middle of several."""
    measure = _measure_of(picture.task, key)
    values = _in_unit(picture.task, key, done.figures[key])
    bounds = _bounds(picture.task, done, key)
    one = Score(float(values[picture.lane]), bool(bounds[picture.lane]))
    said = f"{measure.name} **{words.score(one, measure)}**"
    if picture.lanes == 1:
        return said
    middle = middle_of(measure)
    many = Score(float(middle(values)), bool(middle_is_bound(middle, values, bounds)))
    return f"{said} ({spread.names(measure)[0]} {words.score(many, measure)})"


def _bounds(task: Task, done: Evaluation, key: str) -> Bools:
    """Where a figure is a lower bound, (lanes,): the measure alone can be."""
    values = done.figures[key]
    if key != task.measure.key:
        return np.zeros(len(values), dtype=bool)
    return done.figures.get(IS_LOWER_BOUND, np.zeros(len(values))) > 0


def _measure_of(task: Task, key: str) -> Measure:
    """The name and unit of a figure of `Task.evaluate`: none is known but of those on the curve."""
    if key == task.measure.key:
        return task.measure
    if key in task.frozen_figures:
        return replace(task.measure, name=_spaced(key), key=key)
    return Measure(_spaced(key), key)


def _in_unit(task: Task, key: str, values: Array) -> Array:
    """What a frozen copy did, in % where `Task.evaluate` gives fractions of it."""
    is_fraction = key in task.frozen_figures and key != task.measure.key
    return 100.0 * values if is_fraction and task.measure.unit == "%" else values


def _changes(picture: Picture) -> str:
    """The latest changes in words, for the marks."""
    latest = picture.changes[-3:]
    if not latest:
        return ""
    said = "; ".join(f"{c.change} at {words.count(c.step)}" for c in latest)
    return f"Changed: {said}."
