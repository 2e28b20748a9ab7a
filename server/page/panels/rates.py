"""How often neurons fire."""

from __future__ import annotations

import numpy as np

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart, ChartStyle
from hebbviz.server.page.panels.base import (
    Panel,
    Place,
    colors,
    latest_frames,
    marks,
    neuron_curves,
)


class Rates(Panel):
    """Spikes per step in the latest frames."""

    tabs, order = ("reward",), 40

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._curves = neuron_curves(place.topology)
        title, tab = "firing rate (spikes per step)", place.tabs["reward"]
        self._chart = self.hold(
            Chart(place.gui, tab, title, colors(self._curves), ChartStyle(span=(0.0, 1.0)))
        )

    def draw(self, snapshot: Snapshot) -> None:
        frames = latest_frames(snapshot)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            rates = np.array([f.since.spikes / f.since.steps for f in frames])
            points = {n: (x, rates[:, c].mean(axis=1)) for n, c in self._curves.items()}
            self._chart.draw(points, marks(snapshot))
