"""The learning curve of a run: of the watched lane, and of all lanes where there are several."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hebbviz.server.live.evaluation import Evaluation
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import status_text
from hebbviz.server.page.charts import Chart, ChartStyle, Points
from hebbviz.server.page.panels.base import Panel, Place, cursor, marks, others, since
from hebbviz.server.run import lane_spread
from hebbviz.server.run.changes import GiveReward
from hebbviz.server.run.event_windows import ENOUGH, latest, pooled_curve
from hebbviz.server.run.history import Curve
from hebbviz.server.run.lane_spread import Scores, Spread
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb
from hebbviz.task.base import Measure, Tally, Task
from hebbviz.theory.poisson import time_to_event

Array = NDArray[np.float64]
Bands = dict[str, tuple[Points, Points]]

EARLIER: Rgb = (140, 140, 140)
HEIGHT, HEIGHT_WITH_LANES = 215, 230
MOST_WINDOWS = 128
"""Several lanes are shown in longer windows, so that one lane's curve does not hide the rest."""


class Learning(Panel):
    """The chart and the text beneath it."""

    tabs, order = ("run",), 10

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        gui, tab = place.gui, place.tabs["run"]
        task, lanes, theme = place.snapshot.run.task, place.snapshot.run.lanes, place.theme
        self._scores, self._ghost_scores = Scores(task), Scores(task)
        self._has_lanes = lanes > 1
        self._run = "watched lane" if self._has_lanes else "this run"
        self._middle = f"{lane_spread.names(task.measure)[0]} of {lanes} lanes"
        frozen = dict(zip(_frozen_names(task), FROZEN, strict=False))
        series = {self._run: theme.ink if self._has_lanes else palette.SERIES[0]}
        self._dots = _dots_name(task.measure)
        series |= {self._dots: palette.SERIES[1], "earlier run": EARLIER}
        banded: tuple[str, ...] = ()
        if self._has_lanes:
            banded = (self._middle, *frozen)
            series[self._middle] = palette.SERIES[0]
        series |= frozen
        measure = task.measure
        unit = f" ({measure.unit})" if measure.unit else ""
        style = ChartStyle(
            banded=banded,
            widths=dict.fromkeys(banded, 2.5) | ({self._run: 0.8} if self._has_lanes else {}),
            dashed=("earlier run",),
            dotted=(self._dots,),
            logarithmic=measure.logarithmic,
            span=measure.span,
            height=HEIGHT_WITH_LANES if self._has_lanes else HEIGHT,
        )
        chart = Chart(gui, tab, f"{measure.name}{unit}", series, style)
        self._chart = self.hold(chart)
        with tab:
            self._words = self.hold(gui.add_markdown(""))

    def draw(self, snapshot: Snapshot) -> None:
        task, curve, all_lanes, newest = snapshot.run.task, snapshot.run.curve, None, None
        if self._has_lanes:
            curves = snapshot.run.curves.coarser(MOST_WINDOWS)
            curve, all_lanes = curves.lane(snapshot.run.lane), self._scores.spread(curves)
            newest = self._scores.of(curves)[-1:]
        points = {self._run: _scores(snapshot.run.task, curve)}
        bands: Bands = {}
        if all_lanes is not None:
            points[self._middle], bands[self._middle] = _drawn(all_lanes, task.measure)
        for name, of_copies in _frozen(snapshot).items():
            points[name], bands[name] = _drawn(of_copies, task.measure)
        points[self._dots] = _dots(task, curve)
        points |= self._earlier(snapshot)
        more = others(snapshot)
        if snapshot.view.other is not None:
            points |= dict.fromkeys(more, _scores(snapshot.run.task, since(snapshot.view.other)))
        self._chart.draw(points, marks(snapshot), bands=bands, cursor=cursor(snapshot), more=more)
        has_dots = len(points[self._dots][0]) > 0
        self._words.content = _said(snapshot, curve, newest, has_dots=has_dots)

    def _earlier(self, snapshot: Snapshot) -> dict[str, Points]:
        """The previous run: the middle of its lanes. The windows of a single lane vary too much to
        be compared with the middle of many.
        """
        ghost = snapshot.run.ghost
        if ghost is None or (self._has_lanes and ghost.lanes == 1):
            return {}
        if ghost.lanes == 1:
            return {"earlier run": _scores(snapshot.run.task, ghost.lane(0))}
        middle = self._ghost_scores.spread(ghost.coarser(MOST_WINDOWS))
        return {"earlier run": _drawn(middle, snapshot.run.task.measure)[0]}


def evaluated(snapshot: Snapshot) -> str:
    """Results of the latest frozen copy, in the watched lane and in the middle of several; and the
    progress of the next one, if it takes long.
    """
    return " ".join(filter(None, (_last_evaluated(snapshot), _being_evaluated(snapshot))))


def _being_evaluated(snapshot: Snapshot) -> str:
    if snapshot.findings.evaluating is None:
        return ""
    made, steps = snapshot.findings.evaluating
    return f"A frozen copy is being evaluated: step {made:,} of {steps:,}."


def _last_evaluated(snapshot: Snapshot) -> str:
    if not snapshot.findings.evaluations:
        return ""
    latest = snapshot.findings.evaluations[-1]
    besides = snapshot.run.task.measure.keys[1:]
    said = [_figure(snapshot, latest, key) for key in latest.figures if key not in besides]
    return f"Frozen copy at step {status_text.count(latest.step)}: {', '.join(said)}."


# Inside

FROZEN: tuple[Rgb, ...] = (palette.SERIES[2], palette.SERIES[4])


def _drawn(of_lanes: Spread, measure: Measure) -> tuple[Points, tuple[Points, Points]]:
    """The line and its band; an unbounded band is cut at the top of the axis."""
    x, middle = of_lanes.x, of_lanes.middle
    finite = of_lanes.high[np.isfinite(of_lanes.high)]
    top = measure.span[1] if measure.span else finite.max(initial=0.0)
    low, high = (np.where(np.isinf(edge), top, edge) for edge in (of_lanes.low, of_lanes.high))
    return (x, np.where(np.isinf(middle), np.nan, middle)), ((x, low), (x, high))


def _scores(task: Task, curve: Curve) -> Points:
    """The task's measure of every window, or of every pool of windows; NaN where it is infinite."""
    curve = _pooled(task, curve)
    value = np.array([task.score(t).value for t in curve.tallies()])
    if task.measure.logarithmic:
        value = np.where(value > 0, value, np.nan)
    return curve.end, np.where(np.isinf(value), np.nan, value)


def _dots(task: Task, curve: Curve) -> Points:
    """Lower bounds (95 %) of the time to an event, where no event was seen."""
    curve = _pooled(task, curve)
    scores = [task.score(t) for t in curve.tallies()]
    none = np.array([s.events == 0 for s in scores], dtype=bool)
    over = np.array([time_to_event(s.time, 0)[0] for s in scores])
    return curve.end[none], over[none]


def _pooled(task: Task, curve: Curve) -> Curve:
    return pooled_curve(curve, _events(task, curve)) if task.measure.event else curve


def _events(task: Task, curve: Curve) -> Array:
    return np.array([task.score(t).events or 0 for t in curve.tallies()], dtype=np.float64)


def _frozen_names(task: Task) -> list[str]:
    return [_spaced(key) for key in task.frozen_figures]


def _spaced(key: str) -> str:
    return key.replace("_", " ")


def _frozen(snapshot: Snapshot) -> dict[str, Spread]:
    """Results of frozen copies of the run; with one lane the middle is that lane."""
    task, done = snapshot.run.task, snapshot.findings.evaluations
    x = np.array([e.step for e in done], dtype=np.float64)
    spreads = {}
    for key in task.frozen_figures:
        values = np.array([e.figures[key] for e in done]).reshape(len(done), snapshot.run.lanes)
        spreads[_spaced(key)] = Spread.of(x, _in_unit(task, key, values), task.measure)
    return spreads


def _said(snapshot: Snapshot, curve: Curve, newest: Array | None, *, has_dots: bool) -> str:
    """`newest` (1, lanes): the last window of all lanes."""
    measure = snapshot.run.task.measure
    now = _now(snapshot.run.task, curve)
    if now and newest is not None:
        name, band = lane_spread.names(measure)
        now += f" in lane {snapshot.run.lane}; {name} **{status_text.middle(newest[0], measure)}**"
        now += f" (band: {band})"
    dots = f" Dot: {_DOT.format(event=measure.event)}" if has_dots else ""
    both = (
        "" if snapshot.view.other is None else status_text.compared(snapshot, snapshot.view.other)
    )
    return (
        f"{both}\
\
Each point covers "
        f"{status_text.steps(curve.window)}{_or_more(measure)}{now}.{dots} "
        f"{_by_hand(snapshot)} {_changes(snapshot)} {evaluated(snapshot)}"
    )


def _dots_name(measure: Measure) -> str:
    return f"no {measure.event}: lower bound"


_DOT = "no {event} so far: a lower bound of the time to it, with 95 % confidence."


def _or_more(measure: Measure) -> str:
    return f", or enough steps for {ENOUGH} {measure.event}s" if measure.event else ""


def _now(task: Task, curve: Curve) -> str:
    """The measure over the newest window, or over enough windows to have enough events."""
    tallies = curve.tallies()
    if not tallies:
        return ""
    count = latest(_events(task, curve)) if task.measure.event else 1
    steps = int(curve.steps[-count:].sum())
    sums = (float(c[-count:].sum()) for c in (curve.reward, curve.broadcast, curve.ended))
    told = status_text.score(task.score(Tally(steps, *sums)), task.measure)
    over = f" over the last {status_text.steps(steps)}" if task.measure.event else ""
    return f"; now **{told}**{over}"


def _by_hand(snapshot: Snapshot) -> str:
    """The manual rewards, which the curve leaves out."""
    given = [c.change.reward for c in snapshot.run.changes if isinstance(c.change, GiveReward)]
    if not given:
        return ""
    return f"Manual rewards, **{sum(given):+.3g}** in total, are not in the curve."


def _figure(snapshot: Snapshot, done: Evaluation, key: str) -> str:
    """One figure of a frozen copy as text: the watched lane, and the middle of several."""
    measure = _measure_of(snapshot.run.task, key)
    values = _in_unit(snapshot.run.task, key, done.figures[key])
    if measure.event:
        value, count, low, high = (float(done.figures[k][snapshot.run.lane]) for k in measure.keys)
        one = status_text.estimate((value, count, low, high), measure)
    else:
        one = status_text.amount(float(values[snapshot.run.lane]), measure)
    said = f"{measure.name} **{one}**"
    if snapshot.run.lanes == 1:
        return said
    return f"{said} ({lane_spread.names(measure)[0]} {status_text.middle(values, measure)})"


def _measure_of(task: Task, key: str) -> Measure:
    """The name and unit of a figure of `Task.evaluate`; known only for those on the curve."""
    if key == task.measure.key:
        return task.measure
    if key in task.frozen_figures:
        return replace(task.measure, name=_spaced(key), key=key, event="")
    return Measure(_spaced(key), key)


def _in_unit(task: Task, key: str, values: Array) -> Array:
    """Results of a frozen copy, in % where `Task.evaluate` gives fractions."""
    is_fraction = key in task.frozen_figures and key != task.measure.key
    return 100.0 * values if is_fraction and task.measure.unit == "%" else values


def _changes(snapshot: Snapshot) -> str:
    """The latest changes as text, for the marks."""
    latest = snapshot.run.changes[-3:]
    if not latest:
        return ""
    said = "; ".join(f"{c.change} at {status_text.count(c.step)}" for c in latest)
    return f"Changed: {said}."
