"""All weights and eligibility traces, as heat maps."""

from __future__ import annotations

import numpy as np

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.images import heat_map
from hebbviz.server.page.panels.base import Panel, Place
from hebbviz.server.scene.appearance import Scale
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb


class Synapses(Panel):
    """Two maps for each projection."""

    tabs, order = ("synapses",), 80

    def __init__(self, place: Place) -> None:
        super().__init__(place)
        projections = place.topology.projections
        self._weight_scales = [Scale() for _ in projections]
        self._trace_scales = [Scale() for _ in projections]
        gui, blank = place.gui, np.zeros((8, 8, 3), dtype=np.uint8)
        self._maps = []
        with place.tabs["synapses"]:
            for p in projections:
                pair = []
                for letter, name in (("w", "weights"), ("z", "eligibility traces")):
                    image = gui.add_image(blank, label=f"{letter}: {name}, {p.name}", format="png")
                    pair.append((self.hold(image), self.hold(gui.add_markdown(""))))
                self._maps.append(pair)

    def draw(self, snapshot: Snapshot) -> None:
        frame, topology = snapshot.view.frame, self.place.topology
        for k, p in enumerate(topology.projections):
            where, shape = topology.synapses_of(k), topology.shape(p)
            p_hues = (palette.WEIGHT_POSITIVE, palette.WEIGHT_NEGATIVE)
            z_hues = (palette.TRACE_POSITIVE, palette.TRACE_NEGATIVE)
            kinds = (
                (frame.weight, self._weight_scales[k], *p_hues),
                (frame.trace, self._trace_scales[k], *z_hues),
            )
            for (image, text), (values, scale, positive, negative) in zip(
                self._maps[k], kinds, strict=True
            ):
                matrix = values[where].reshape(shape)
                full = scale.fit(float(np.abs(matrix).max(initial=0.0)))
                image.image = heat_map(matrix, full, positive, negative, self.place.theme)
                text.content = _map_words(full, positive, negative)


def _map_words(full: float, positive: Rgb, negative: Rgb) -> str:
    return (
        f"<span style='color:{palette.css(negative)}'>■</span> −{full:g} · 0 · "
        f"<span style='color:{palette.css(positive)}'>■</span> +{full:g} · "
        "rows: to, columns: from"
    )
