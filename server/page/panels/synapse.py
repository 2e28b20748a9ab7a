"""The trace and the weight of a network with a single synapse."""

from __future__ import annotations

import numpy as np

from hebbviz.server.live.recent_frames import alike
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart, ChartStyle
from hebbviz.server.page.panels.base import Panel, Place, marks
from hebbviz.sims.figures import palette


class Synapse(Panel):
    """z and w in the latest frames."""

    tabs, order = ("now",), 50

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        series = {"z": palette.TRACE_POSITIVE, "w": palette.WEIGHT_POSITIVE}
        title = "trace z and weight w of the synapse"
        self._chart = self.hold(
            Chart(place.gui, place.tabs["now"], title, series, ChartStyle(height=190))
        )

    @staticmethod
    def wanted(snapshot: Snapshot) -> bool:
        return snapshot.run.live.topology.synapses == 1

    def draw(self, snapshot: Snapshot) -> None:
        frames = alike(snapshot.view.trail)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            z, w = np.array([(f.trace[0], f.weight[0]) for f in frames]).T
            self._chart.draw({"z": (x, z), "w": (x, w)}, marks(snapshot))
