"""The potentials of the neurons."""

from __future__ import annotations

import numpy as np

from hebbviz.server.live.recent_frames import alike
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart, ChartStyle, Points
from hebbviz.server.page.panels.base import Panel, Place, colors, marks, neuron_curves
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb


class Potentials(Panel):
    """Least and greatest v in each frame, over each curve's neurons."""

    tabs, order = ("now",), 70

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        self._curves = neuron_curves(place.topology)
        hues = colors(self._curves)
        series = {
            f"{name}{end}": color
            for name, color in hues.items()
            for end in ("", " ")  # the second is the greatest of the same picture
        }
        tab = place.tabs["now"]
        self._chart = self.hold(
            Chart(place.gui, tab, "potential v", series, ChartStyle(legend=False, height=140))
        )
        with tab:
            self.hold(place.gui.add_markdown(_key(hues)))

    def draw(self, snapshot: Snapshot) -> None:
        frames = alike(snapshot.view.trail)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            low, high = np.array([f.since.potential_range for f in frames]).transpose(1, 0, 2)
            points: dict[str, Points] = {}
            for name, c in self._curves.items():
                points[name] = (x, low[:, c].min(axis=1))
                points[f"{name} "] = (x, high[:, c].max(axis=1))
            self._chart.draw(points, marks(snapshot))


def _key(colors: dict[str, Rgb]) -> str:
    return " ".join(
        f"<span style='color:{palette.css(color)}'>■</span>&nbsp;" + name.replace(" ", "&nbsp;")
        for name, color in colors.items()
    )
