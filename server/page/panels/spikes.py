"""The spikes of the latest steps, one by one."""

from __future__ import annotations

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import status_text
from hebbviz.server.page.images import raster
from hebbviz.server.page.panels.base import Panel, Place


class Spikes(Panel):
    """A raster, with rewards and changes in its top row."""

    tabs, order = ("now",), 60

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        gui, topology = place.gui, place.topology
        groups = ", ".join(f"{g.name} {g.size}" for g in topology.neuron_groups)
        blank = raster(None, topology, place.theme)
        with place.tabs["now"]:
            self._image = self.hold(
                gui.add_image(blank, label=f"spikes: {groups}", format="jpeg", jpeg_quality=90)
            )
            self._words = self.hold(gui.add_markdown(""))

    def draw(self, snapshot: Snapshot) -> None:
        recent, topology = snapshot.view.recent, self.place.topology
        changes = [c.step for c in snapshot.run.changes]
        self._image.image = raster(
            recent, topology, self.place.theme, changes, snapshot.view.frame.rule
        )
        upto = "No step has been played yet."
        if recent is not None:
            upto = f"Every step up to {status_text.count(recent.end)}, newest at the right."
        self._words.content = f"{upto} Top row: reward yellow, punishment red, a change grey."
