"""The rule's memory from step to step, such as a reward baseline."""

from __future__ import annotations

import numpy as np

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart
from hebbviz.server.page.panels.base import Panel, Place, latest_frames, marks
from hebbviz.sims.figures import palette

SERIES = palette.SERIES[2:]
"""Beside the colours of the rewards."""


class Memory(Panel):
    """The rule's memory in the latest frames."""

    tabs, order = ("reward",), 30

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._rule = rule = place.snapshot.run.live.rule
        series = {r.name: SERIES[k % len(SERIES)] for k, r in enumerate(rule.memory)}
        title = f"memory of rule {rule.name} ({rule.memory[0].unit})"
        self._chart = self.hold(Chart(place.gui, place.tabs["reward"], title, series))

    @staticmethod
    def wanted(snapshot: Snapshot) -> bool:
        return bool(snapshot.run.live.rule.memory)

    def draw(self, snapshot: Snapshot) -> None:
        frames = [f for f in latest_frames(snapshot) if type(f.rule) is type(self._rule)]
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            kept = np.array([f.memory for f in frames]).T
            names = (reading.name for reading in self._rule.memory)
            points = {name: (x, row) for name, row in zip(names, kept, strict=True)}
            self._chart.draw(points, marks(snapshot))
