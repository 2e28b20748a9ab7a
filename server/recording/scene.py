"""The 3D scene of a recording: what stands still is written once, and then only what changes.

Colours, sizes and places are those of the live page (`hebbviz.server.scene.appearance`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.server.recording.rows import Columns, Rows, Steps
from hebbviz.server.recording.scene_objects import LEAST_EXTENT, Props, packed
from hebbviz.server.scene.appearance import (
    INPUT_BASE,
    THINNEST,
    TRACE_AT,
    Looks,
    endpoints,
    largest_synapses,
    network_at,
    place,
    unit_names,
)
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Pixels, Theme
from hebbviz.task.base import Task
from hebbviz.topology import Topology

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

ROOT = "scene/network"
TRACE_RADIUS, INPUT_WIDTH = 0.03, 0.75
"""Of a trace's bar in scene units; of an input's bar as a share of its diameter."""
FADE, SWELL, MOST_LIT = (1.0, 0.6, 0.3, 0.1), 0.25, 8
"""Light of a neuron in the steps after it fired; how much it swells; the most neurons lit so."""
LABEL_ASIDE = 0.9
"""How far left of a group its name stands."""


class Scene:
    """Writes the scene of one run: to the stream what stands still, to `rows` what changes."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        task: Task,
        topology: Topology,
        rows: Rows,
        *,
        weight: Array | None = None,
        theme: Theme = palette.DARK,
    ) -> None:
        """`weight` (synapses,) chooses those drawn of a large network; without it, the first."""
        self._network = _Network(stream, task, topology, rows, weight, theme)
        self._props = Props(stream, task, rows, theme)

    @property
    def drawn(self) -> NDArray[np.intp]:
        """Numbers of the synapses that are drawn."""
        return self._network.drawn

    def poses(self, steps: Steps, states: Array) -> None:
        """The world after each of these steps: `steps` (n,), `states` (n, numbers)."""
        self._props.add(steps, states)

    def spikes(self, steps: Steps, fired: NDArray[np.uint8]) -> None:
        """Who fired at each of these steps, (n, neurons): light that fades in a few steps.

        For stretches that are kept step by step; of large networks `look` alone tells.
        """
        self._network.add_spikes(steps, fired)

    def look(self, frame: Frame) -> None:
        """The network at the frame's step, lit by the rates since the frame before."""
        self._network.add(frame)


def unlit(topology: Topology, theme: Theme = palette.DARK) -> list[Any]:
    """For a view: how neurons and synapses look before the first look of them."""
    idle = packed(np.array([theme.idle]))
    radius = float(place(topology).radius[topology.inputs :].max())
    return [
        rr.Points3D.from_fields(colors=idle, radii=[radius]),
        rr.LineStrips3D.from_fields(colors=idle, radii=[THINNEST]),
    ]


class _Network:
    def __init__(
        self,
        stream: rr.RecordingStream,
        task: Task,
        topology: Topology,
        rows: Rows,
        weight: Array | None,
        theme: Theme,
    ) -> None:
        self._stream, self._rows, self._inputs = stream, rows, topology.inputs
        self._latest_levels = np.zeros(0, dtype=np.uint32)
        self._looks, self._place = Looks(topology, theme), place(topology)
        self.drawn = largest_synapses(np.zeros(topology.synapses) if weight is None else weight)
        stream.log(ROOT, rr.Transform3D(translation=network_at(task)), static=True, strict=True)
        self._log_synapses(topology)
        self._log_neurons(unit_names(topology, ())[-topology.neurons :])
        self._log_inputs(tuple(one.name for one in task.inputs), theme)
        self._log_labels(topology, theme)

    def add(self, frame: Frame) -> None:
        look, at, drawn = self._looks.look(frame), np.array([frame.step]), self.drawn
        self._rows.add(f"{ROOT}/neurons", at, _both(look.neuron_colors, look.neuron_radius), _balls)
        tubes = _both(look.weight_colors[drawn], look.weight_radius[drawn])
        self._rows.add(f"{ROOT}/synapses", at, tubes, _tubes)
        bars = _both(look.trace_colors[drawn], look.trace_height[drawn])
        self._rows.add(f"{ROOT}/traces", at, bars, self._traces)
        levels = _both(look.input_colors, look.input_height)
        if self._inputs and not np.array_equal(levels, self._latest_levels):
            self._rows.add(f"{ROOT}/inputs", at, levels, self._levels)
            self._latest_levels = levels

    def add_spikes(self, steps: Steps, fired: NDArray[np.uint8]) -> None:
        if fired.shape[1] > MOST_LIT:
            return
        glow = fired.astype(np.float64)
        for ago in range(1, len(FADE)):
            glow[ago:] = np.maximum(glow[ago:], FADE[ago] * fired[:-ago])
        colors = packed(palette.blend(glow, self._looks.theme.idle, palette.SPIKE).reshape(-1, 3))
        radius = self._place.radius[self._inputs :] * (1.0 + SWELL * glow)
        both = np.stack([colors.reshape(glow.shape), _f32(radius).view(np.uint32)], axis=-1)
        self._rows.add(f"{ROOT}/neurons", steps, both, _balls)

    def _traces(self, rows: NDArray[Any]) -> Columns:
        """(looks, synapses, 2) colours and heights, as upright lines."""
        colors, height = _apart(rows)
        ends = np.repeat(self._trace_feet[None, :, None], 2, axis=2).repeat(len(rows), axis=0)
        ends[:, :, 1, 2] += height
        return _split(rows, rr.LineStrips3D.columns(strips=ends.reshape(-1, 2, 3), colors=colors))

    def _levels(self, rows: NDArray[Any]) -> Columns:
        """(looks, inputs, 2) colours and heights, as upright boxes."""
        colors, height = _apart(rows)
        center, half = (a[None].repeat(len(rows), axis=0) for a in (self._feet, self._widths))
        center[:, :, 2] += height / 2
        half[:, :, 2] = np.maximum(np.abs(height) / 2, LEAST_EXTENT)
        boxes = rr.Boxes3D.columns(
            centers=center.reshape(-1, 3), half_sizes=half.reshape(-1, 3), colors=colors
        )
        return _split(rows, boxes)

    # What stands still

    def _log(self, name: str, what: Any) -> None:
        self._stream.log(f"{ROOT}/{name}", what, static=True, strict=True)

    def _log_synapses(self, topology: Topology) -> None:
        pre, post = (ends[self.drawn] for ends in endpoints(topology))
        start, end = self._place.units[pre], self._place.units[post]
        end = np.where((pre == post)[:, None], start + (0.0, 0.0, 0.35), end)
        lines = _f32(np.stack([start, end], axis=1))
        lines += self._to_the_rims(pre, post, end - start)
        self._log("synapses", rr.LineStrips3D.from_fields(strips=lines))
        aside = (0.3 * (self._place.large - 1.0), 0.0, 0.0)
        self._trace_feet = _f32(start + TRACE_AT * (end - start) + aside)
        radius = TRACE_RADIUS * self._place.large
        self._log("traces", rr.LineStrips3D.from_fields(radii=[radius]))

    def _to_the_rims(self, pre: NDArray[np.intp], post: NDArray[np.intp], along: Array) -> Floats:
        """How far in a line's two ends stand from the centres: rerun draws lines over spheres."""
        radius = np.where(np.arange(len(self._place.radius)) < self._inputs, 0, self._place.radius)
        inward = along / np.linalg.norm(along, axis=1, keepdims=True)
        inward[pre == post] = 0.0
        return _f32(np.stack([radius[pre, None] * inward, -radius[post, None] * inward], axis=1))

    def _log_neurons(self, names: tuple[str, ...]) -> None:
        """Names of single units show when they are pointed at."""
        positions = _f32(self._place.units[self._inputs :])
        balls = rr.Points3D.from_fields(positions=positions, labels=names, show_labels=False)
        self._log("neurons", balls)

    def _log_inputs(self, names: tuple[str, ...], theme: Theme) -> None:
        """A plate for the zero of every input; on it, or hanging from it, stands its level."""
        wide = self._place.radius[: self._inputs]
        self._feet = _f32(self._place.units[: self._inputs] + (0.0, 0.0, INPUT_BASE))
        self._widths = _f32(INPUT_WIDTH * np.stack([wide, wide, wide], axis=1))
        if not self._inputs:
            return
        plates = _f32(np.stack([wide, wide, np.full(len(wide), 0.01)], axis=1))
        color = packed(np.array([theme.world_strong]))
        self._log(
            "zeros",
            rr.Boxes3D(
                centers=self._feet,
                half_sizes=plates,
                fill_mode="solid",
                colors=color,
            ),
        )
        bars = rr.Boxes3D.from_fields(fill_mode="solid", labels=names, show_labels=False)
        self._log("inputs", bars)

    def _log_labels(self, topology: Topology, theme: Theme) -> None:
        at, names = [], []
        for group in topology.groups:
            where = topology.units_of(group.name)
            units, radius = self._place.units[where], self._place.radius[where]
            at.append(((units[:, 0] - radius).min() - LABEL_ASIDE, 0.0, units[0, 2]))
            names.append(f"{group.name} · {group.size}" if group.size > 1 else group.name)
        color = packed(np.array([theme.ink]))
        labels = rr.Points3D(
            np.array(at), labels=names, show_labels=True, radii=[0.001], colors=color
        )
        self._log("labels", labels)


def _both(colors: Pixels, size: Array) -> NDArray[np.uint32]:
    """(n, 3) colours and (n,) sizes as one look, (1, n, 2): packed, and as a float's bits."""
    return np.stack([packed(colors), _f32(size).view(np.uint32)], axis=1)[None]


def _apart(rows: NDArray[Any]) -> tuple[NDArray[np.uint32], Floats]:
    """Of (looks, n, 2) the packed colours, one after the other, and the sizes (looks, n)."""
    colors, size = rows[..., 0].ravel(), np.ascontiguousarray(rows[..., 1]).view(np.float32)
    return colors, size


def _balls(rows: NDArray[Any]) -> Columns:
    colors, radius = _apart(rows)
    return _split(rows, rr.Points3D.columns(colors=colors, radii=radius.ravel()))


def _tubes(rows: NDArray[Any]) -> Columns:
    colors, radius = _apart(rows)
    return _split(rows, rr.LineStrips3D.columns(colors=colors, radii=radius.ravel()))


def _split(rows: NDArray[Any], columns: Any) -> Columns:
    """One row of the recording for every look."""
    made: Columns = columns.partition([rows.shape[1]] * len(rows))
    return made


def _f32(array: Array) -> Floats:
    return array.astype(np.float32)
