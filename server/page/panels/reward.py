"""The average reward: the task's own, and the broadcast one."""

from __future__ import annotations

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart, ChartStyle
from hebbviz.server.page.panels.base import Panel, Place, cursor, marks, others, since
from hebbviz.sims.figures import palette


class Reward(Panel):
    """Both per step, over windows of the run."""

    tabs, order = ("reward",), 20

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        series = {"of the task": palette.SERIES[0], "as broadcast": palette.SERIES[1]}
        title, tab = "average reward per step", place.tabs["reward"]
        self._chart = self.hold(
            Chart(place.gui, tab, title, series, ChartStyle(dashed=("as broadcast",)))
        )

    def draw(self, snapshot: Snapshot) -> None:
        curve = snapshot.run.curve
        points = {
            "of the task": (curve.end, curve.reward / curve.steps),
            "as broadcast": (curve.end, curve.broadcast / curve.steps),
        }
        more = others(snapshot)
        if snapshot.view.other is not None:
            other = since(snapshot.view.other)
            points |= dict.fromkeys(more, (other.end, other.reward / other.steps))
        self._chart.draw(points, marks(snapshot), cursor=cursor(snapshot), more=more)
