"""The network in 3D. It draws arrays; `appearance` decides their meaning."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from hebbviz.server.scene import meshes
from hebbviz.server.scene.appearance import INPUT_BASE, TRACE_AT, Look, endpoints, place
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb, Theme
from hebbviz.topology import Topology

Array = NDArray[np.float64]

MOST_LABELS, FEW_LABELS = 16, 4
"""Most inputs with names; only a few have room for larger names side by side."""
BAR = 0.75
"""Width of an input's bar, as a share of its diameter."""
OUT_OF_SIGHT = (0.0, 0.0, -1e4)
"""Position of an empty label: viser's page does not show a label again once it was invisible."""
TRACE_WIDTH = 0.05


class NetworkScene:
    """Draws one topology under `root`, at an offset.

    `on_unit` and `on_synapse` get the number clicked.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        topology: Topology,
        names: tuple[str, ...],
        theme: Theme,
        drawn: NDArray[np.intp],
        *,
        root: str,
        offset: tuple[float, float, float],
        on_unit: Callable[[viser.ClientHandle, int], None],
        on_synapse: Callable[[viser.ClientHandle, int], None],
    ) -> None:
        self._scene, self._topology, self.drawn = scene, topology, drawn
        self._place = place(topology)
        self._inputs = topology.inputs
        self._root = root
        self._frame = scene.add_frame(root, show_axes=False, position=offset)
        self._add_synapses(theme, on_synapse)
        self._add_units(theme, on_unit)
        self._add_reward()
        self._add_labels(names)

    def remove(self) -> None:
        self._scene.remove_by_name(self._root)

    def move(self, offset: tuple[float, float, float]) -> None:
        self._frame.position = offset

    def draw(self, look: Look) -> None:
        """Show a Look; sends a handful of arrays."""
        self._neurons.batched_colors = palette.linear(look.neuron_colors)
        self._neurons.batched_scales = _thrice(2 * look.neuron_radius)
        self._glow.batched_scales = _thrice(2 * look.glow_radius)
        if self._inputs:
            self._draw_inputs(look)
        self._tubes.batched_colors = palette.linear(look.weight_colors[self.drawn])
        self._tubes.batched_scales = self._tube_scales(look.weight_radius[self.drawn])
        height = look.trace_height[self.drawn]
        self._traces.batched_colors = palette.linear(look.trace_colors[self.drawn])
        self._traces.batched_positions = _f32(self._trace_base + _up(height / 2))
        wide = np.full(len(height), TRACE_WIDTH * self._place.large)
        self._traces.batched_scales = _f32(np.stack([wide, wide, np.abs(height)], axis=1))

    def draw_change(self, radius: Array, sign: Array) -> None:
        """Lay the weight changes of a reward over the synapses; radius 0 hides."""
        hues = palette.signed(
            sign[self.drawn],
            palette.WEIGHT_POSITIVE,
            palette.WEIGHT_NEGATIVE,
            (255, 255, 255),
            floor=0.55,
        )
        self._changes.batched_colors = palette.linear(hues)
        self._changes.batched_scales = self._tube_scales(radius[self.drawn])

    def draw_pulse(self, share: float, color: Rgb) -> None:
        """Draw the reward pulse at `share` of its way through the network, 0..1; 0 hides it."""
        reach = float(np.ptp(self._place.units, axis=0).max()) + 1.5
        self._pulse.batched_colors = palette.linear(np.array([color], dtype=np.uint8))
        self._pulse.batched_scales = _f32(np.full((1, 3), share * reach))

    def name(self, title: str) -> None:
        """Set the network's title, above its other labels."""
        self._say(self._title, title, 2)

    def say(self, reward: str, world: str) -> None:
        """Set the labels over the network: the reward and the world."""
        self._say(self._reward_label, reward, 0)
        self._say(self._world_label, world, 1)

    def _say(self, label: Any, words: str, rank: int) -> None:
        """One that says nothing any more is moved away with its words: viser's page would draw a
        label without a text as a bar for a moment.
        """
        position = self._over(rank) if words else OUT_OF_SIGHT
        if not np.array_equal(label.position, position):
            label.position = position
        if words and label.text != words:
            label.text = words

    # Building

    def _add_units(self, theme: Theme, on_unit: Callable[[viser.ClientHandle, int], None]) -> None:
        neurons = self._place.units[self._inputs :]
        radius = self._place.radius[self._inputs :]
        self._neurons = self._batch(
            "neurons", meshes.sphere(2), neurons, _thrice(2 * radius), theme.idle
        )
        self._glow = self._batch(
            "glow", meshes.sphere(2), neurons, np.zeros((len(neurons), 3)), palette.SPIKE, 0.22
        )
        self._neurons.on_click(_picker(on_unit, lambda k: k + self._inputs))
        if self._inputs:
            places = self._place.units[: self._inputs]
            wide = 2 * self._place.radius[: self._inputs]
            plates = np.stack([wide, wide, np.full(len(wide), 0.02)], axis=1)
            zero = places + (0.0, 0.0, INPUT_BASE)
            self._batch("input zeros", meshes.box(), zero, plates, theme.world_strong)
            self._levels = self._batch("inputs", meshes.box(), places, plates, theme.idle)
            self._levels.on_click(_picker(on_unit, lambda k: k))

    def _add_synapses(
        self, theme: Theme, on_synapse: Callable[[viser.ClientHandle, int], None]
    ) -> None:
        pre, post = endpoints(self._topology)
        start, end = self._place.units[pre[self.drawn]], self._place.units[post[self.drawn]]
        loops = pre[self.drawn] == post[self.drawn]
        end = np.where(loops[:, None], start + (0.0, 0.0, 0.35), end)
        along = end - start
        self._lengths = np.linalg.norm(along, axis=1)
        turns, middle = meshes.turns_to(along), (start + end) / 2
        aside = (0.3 * (self._place.large - 1.0), 0.0, 0.0)
        self._trace_base = start + TRACE_AT * along + aside
        hidden = np.zeros((len(middle), 3))
        self._tubes = self._batch(
            "synapses", meshes.tube(), middle, hidden, theme.idle, turns=turns
        )
        self._changes = self._batch(
            "changes", meshes.tube(), middle, hidden, palette.REWARD, 0.4, turns=turns
        )
        self._traces = self._batch("traces", meshes.box(), self._trace_base, hidden, theme.idle)
        for handle in (self._tubes, self._traces):
            handle.on_click(_picker(on_synapse, lambda k: int(self.drawn[k])))

    def _add_reward(self) -> None:
        self._pulse = self._batch(
            "pulse",
            meshes.sphere(3),
            self._place.middle[None],
            np.zeros((1, 3)),
            palette.REWARD,
            0.1,
        )
        self._reward_label, self._world_label, self._title = (
            self._scene.add_label(
                f"{self._root}/{name}", "", position=OUT_OF_SIGHT, anchor="bottom-center"
            )
            for name in ("reward", "words", "title")
        )

    def _over(self, rank: int) -> tuple[float, float, float]:
        """A place over the network, the higher the rank the higher."""
        top = float(self._place.units[:, 2].max() + self._place.radius.max())
        return (0.0, 0.0, top + 0.3 + (0.34 / self._place.large) * rank)

    def _add_labels(self, names: tuple[str, ...]) -> None:
        """Names of the groups, and of the inputs where there is room for them."""
        for group in (*self._topology.input_groups, *self._topology.neuron_groups):
            where = self._topology.units_of(group.name)
            left = self._place.units[where][:, 0].min() - 0.35
            self._scene.add_label(
                f"{self._root}/label/{group.name}",
                f"{group.name} · {group.size}",
                position=(left, 0.0, self._place.units[where][0, 2]),
                anchor="center-right",
            )
        if 1 < self._inputs <= MOST_LABELS:
            step, size = (0.2, 0.62) if self._inputs > FEW_LABELS else (0.0, 0.85)
            for k in range(self._inputs):
                x, y, z = self._place.units[k]
                self._scene.add_label(
                    f"{self._root}/input/{k}",
                    names[k],
                    position=(x, y, z - 1.22 - step * (k % 2)),
                    anchor="top-center",
                    font_screen_scale=size,
                )

    def _batch(
        self,
        name: str,
        mesh: meshes.Mesh,
        positions: Array,
        scales: NDArray[Any],
        color: Rgb,
        opacity: float | None = None,
        *,
        turns: Array | None = None,
    ) -> Any:
        upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(positions), 1))
        return self._scene.add_batched_meshes_simple(
            f"{self._root}/{name}",
            mesh.vertices,
            mesh.faces,
            _f32(upright if turns is None else turns),
            _f32(positions),
            batched_scales=_f32(scales),
            batched_colors=np.tile(palette.linear(np.array(color)), (len(positions), 1)),
            lod="off",
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_inputs(self, look: Look) -> None:
        places = self._place.units[: self._inputs]
        wide = 2 * BAR * self._place.radius[: self._inputs]
        self._levels.batched_colors = palette.linear(look.input_colors)
        self._levels.batched_positions = _f32(places + _up(INPUT_BASE + look.input_height / 2))
        self._levels.batched_scales = _f32(
            np.stack([wide, wide, np.maximum(np.abs(look.input_height), 0.001)], axis=1)
        )

    def _tube_scales(self, radius: Array) -> NDArray[np.float32]:
        return _f32(np.stack([2 * radius, 2 * radius, self._lengths], axis=1))


def _picker(
    pick: Callable[[viser.ClientHandle, int], None], number: Callable[[int], int]
) -> Callable[[Any], None]:
    def clicked(event: Any) -> None:
        if event.instance_index is not None:
            pick(event.client, number(event.instance_index))

    return clicked


def _up(height: Array) -> Array:
    return np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=1)


def _thrice(size: Array) -> NDArray[np.float32]:
    return _f32(np.repeat(size[:, None], 3, axis=1))


def _f32(array: NDArray[Any]) -> NDArray[np.float32]:
    return array.astype(np.float32)
