"""The plots and pictures beside the scene: what is shown, the whole run, the synapses."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from hebbviz.rules import Rule
from hebbviz.topology import Topology
from server import palette, words
from server.charts import Chart, Points
from server.gradient_panel import GradientPanel
from server.images import heat_map, raster
from server.learning import Learning, cursor, marks, others, since
from server.look import Scale, neuron_names
from server.palette import Rgb, Theme
from server.picture import Picture
from server.trail import alike

Array = NDArray[np.float64]

SERIES_KEPT = palette.SERIES[2:]
"""Of what the rule keeps, beside the colours of the rewards."""
MOST_CURVES = 8
"""With more neurons than this, charts show groups."""


class Panels:
    """Charts and images for one topology and task; each call of `draw` renews one of them."""

    def __init__(
        self, gui: viser.GuiApi, tabs: dict[str, Any], picture: Picture, theme: Theme
    ) -> None:
        self._theme, self._topology = theme, picture.live.topology
        self._weight_scales = [Scale() for _ in self._topology.projections]
        self._trace_scales = [Scale() for _ in self._topology.projections]
        self._curves = _curves_of(self._topology)
        self._handles: list[Any] = []
        self._turn = 0
        self._tabs = tabs
        self._gradient: GradientPanel | None = None
        if "gradient" in tabs:
            self._gradient = self._hold(GradientPanel(gui, tabs, picture, theme))
        self._learning = self._hold(Learning(gui, tabs["run"], picture, theme))
        self._build_reward(gui, picture.live.rule)
        self._build_now(gui)
        with tabs["synapses"]:
            self._build_synapses(gui)
        self._drawers = (
            self._learning.draw, self._draw_raster, self._draw_reward, self._draw_potentials,
            self._draw_rates, self._draw_maps,
            *((self._draw_synapse,) if self._synapse_chart is not None else ()),
            *((self._draw_kept,) if self._kept_chart is not None else ()),
            *((self._gradient.draw,) if self._gradient is not None else ()),
        )  # fmt: skip

    def remove(self) -> None:
        for handle in self._handles:
            handle.remove()

    def draw(self, picture: Picture) -> None:
        """Renew the next one in turn: all of them several times a second."""
        self._drawers[self._turn](picture)
        self._turn = (self._turn + 1) % len(self._drawers)

    # Building

    def _build_reward(self, gui: viser.GuiApi, rule: Rule) -> None:
        self._reward = self._hold(
            Chart(
                gui, self._tabs["reward"], "average reward per step",
                {"of the task": palette.SERIES[0], "as broadcast": palette.SERIES[1]},
                dashed=("as broadcast",),
            )
        )  # fmt: skip
        self._rule, self._kept_chart = type(rule), None
        if rule.memory:
            series = {r.name: SERIES_KEPT[k % len(SERIES_KEPT)] for k, r in enumerate(rule.memory)}
            title = f"what rule {rule.name} keeps ({rule.memory[0].unit})"
            self._kept_chart = self._hold(Chart(gui, self._tabs["reward"], title, series))
        self._rate_chart = self._hold(
            Chart(
                gui,
                self._tabs["reward"],
                "firing rate (spikes per step)",
                self._colors(),
                span=(0.0, 1.0),
            )
        )

    def _build_now(self, gui: viser.GuiApi) -> None:
        self._synapse_chart = None
        if self._topology.synapses == 1:
            series = {"z": palette.TRACE_POSITIVE, "w": palette.WEIGHT_POSITIVE}
            title = "trace z and weight w of the synapse"
            self._synapse_chart = self._hold(
                Chart(gui, self._tabs["now"], title, series, height=190)
            )
        groups = ", ".join(f"{g.name} {g.size}" for g in self._topology.neuron_groups)
        with self._tabs["now"]:
            self._raster_image = self._hold(
                gui.add_image(
                    raster(None, self._topology, self._theme),
                    label=f"spikes: {groups}",
                    format="jpeg",
                    jpeg_quality=90,
                )
            )
            self._raster_words = self._hold(gui.add_markdown(""))
        series = {
            f"{name}{end}": color
            for name, color in self._colors().items()
            for end in ("", " ")  # the second is the greatest of the same picture
        }
        self._potential_chart = self._hold(
            Chart(gui, self._tabs["now"], "potential v", series, legend=False, height=140)
        )
        with self._tabs["now"]:
            self._hold(gui.add_markdown(_key(self._colors())))

    def _build_synapses(self, gui: viser.GuiApi) -> None:
        blank = np.zeros((8, 8, 3), dtype=np.uint8)
        self._maps = []
        for p in self._topology.projections:
            pair = []
            for letter, name in (("w", "weights"), ("z", "eligibility traces")):
                image = gui.add_image(blank, label=f"{letter}: {name}, {p.name}", format="png")
                pair.append((self._hold(image), self._hold(gui.add_markdown(""))))
            self._maps.append(pair)

    def _colors(self) -> dict[str, Rgb]:
        return {
            name: palette.SERIES[k % len(palette.SERIES)] for k, name in enumerate(self._curves)
        }

    def _hold(self, handle: Any) -> Any:
        self._handles.append(handle)
        return handle

    # Drawing

    def _draw_reward(self, picture: Picture) -> None:
        curve = picture.curve
        points = {
            "of the task": (curve.end, curve.reward / curve.steps),
            "as broadcast": (curve.end, curve.broadcast / curve.steps),
        }
        more = others(picture)
        if picture.other is not None:
            other = since(picture.other)
            points |= dict.fromkeys(more, (other.end, other.reward / other.steps))
        self._reward.draw(points, marks(picture), cursor=cursor(picture), more=more)

    def _draw_kept(self, picture: Picture) -> None:
        """The rule's memory in the latest pictures."""
        trail = alike(picture.live_trail if picture.past is None else picture.shown_trail)
        frames = [f for f in trail if type(f.rule) is self._rule]
        if self._kept_chart is not None and len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            kept = np.array([f.memory for f in frames]).T
            names = (reading.name for reading in self._rule.memory)
            points = {name: (x, row) for name, row in zip(names, kept, strict=True)}
            self._kept_chart.draw(points, marks(picture))

    def _draw_rates(self, picture: Picture) -> None:
        frames = alike(picture.live_trail if picture.past is None else picture.shown_trail)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            rates = np.array([f.since.spikes / f.since.steps for f in frames])
            points = {n: (x, rates[:, c].mean(axis=1)) for n, c in self._curves.items()}
            self._rate_chart.draw(points, marks(picture))

    def _draw_raster(self, picture: Picture) -> None:
        changes = [c.step for c in picture.changes]
        self._raster_image.image = raster(
            picture.recent, self._topology, self._theme, changes, picture.shown.rule
        )
        recent = picture.recent
        upto = "No step is played yet." if recent is None else (
            f"Every step up to {words.count(recent.end)}, newest at the right."
        )  # fmt: skip
        self._raster_words.content = (
            f"{upto} Top row: reward yellow, punishment red, a change grey."
        )

    def _draw_synapse(self, picture: Picture) -> None:
        frames = alike(picture.shown_trail)
        if self._synapse_chart is not None and len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            z, w = np.array([(f.trace[0], f.weight[0]) for f in frames]).T
            self._synapse_chart.draw({"z": (x, z), "w": (x, w)}, marks(picture))

    def _draw_potentials(self, picture: Picture) -> None:
        """Least and greatest v of each picture, of each curve's neurons."""
        frames = alike(picture.shown_trail)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            low, high = np.array([f.since.potential_range for f in frames]).transpose(1, 0, 2)
            points: dict[str, Points] = {}
            for name, c in self._curves.items():
                points[name] = (x, low[:, c].min(axis=1))
                points[f"{name} "] = (x, high[:, c].max(axis=1))
            self._potential_chart.draw(points, marks(picture))

    def _draw_maps(self, picture: Picture) -> None:
        frame, topology = picture.shown, self._topology
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
                image.image = heat_map(matrix, full, positive, negative, self._theme)
                text.content = _map_words(full, positive, negative)


def _map_words(full: float, positive: Rgb, negative: Rgb) -> str:
    return (
        f"<span style='color:{palette.css(negative)}'>■</span> −{full:g} · 0 · "
        f"<span style='color:{palette.css(positive)}'>■</span> +{full:g} · "
        "rows: to, columns: from"
    )


def _curves_of(topology: Topology) -> dict[str, slice]:
    """Name and neurons of each curve: single neurons, or groups if there are too many."""
    if topology.neurons > MOST_CURVES:
        return {g.name: topology.neurons_of(g.name) for g in topology.neuron_groups}
    return {name: slice(k, k + 1) for k, name in enumerate(neuron_names(topology))}


def _key(colors: dict[str, Rgb]) -> str:
    return " ".join(
        f"<span style='color:{palette.css(color)}'>■</span>&nbsp;" + name.replace(" ", "&nbsp;")
        for name, color in colors.items()
    )
