"""The network's appearance in a Frame: pure functions from numbers to colours and sizes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Pixels, Rgb, Theme
from hebbviz.task.base import Task
from hebbviz.task.scene import Prop
from hebbviz.topology import Topology

Array = NDArray[np.float64]

NETWORK_ALONE, NETWORK_OVER_WORLD = (0.0, 0.0, 0.0), (0.0, 1.9, 2.75)
WIDTH, LAYER = 4.4, 1.55
"""Extent of the widest layer and distance between layers, in scene units."""
ROW_OF_NEURONS, ROW_OF_INPUTS = 24, 64
"""Larger groups are laid out in several rows, one behind the other."""
LARGEST_RING, RING_TILT = 8, 0.45
"""Neurons in a ring at most, and how far its back rises, as a share of its depth."""
LARGEST_RADIUS = 0.2
MOST_SYNAPSES_DRAWN = 1200
THICKEST, THINNEST = 0.055, 0.008
TALLEST_TRACE = 0.45
TALLEST_INPUT = 0.5
INPUT_BASE = -0.62
"""Where the zero of an input's level stands, below its unit."""
SLOW_PICTURES = 2
"""Pictures without a step after which spikes leave no afterglow: each step is seen by itself."""
TRACE_AT = 0.68
"""How far along a synapse its trace stands, from the presynaptic side."""


class Scale:
    """A round number that a picture's full size stands for; it holds still while it fits."""

    def __init__(self, least: float = 0.0) -> None:
        self.full = self._least = least

    def fit(self, largest: float) -> float:
        """The scale for values up to `largest`: it grows at once, and shrinks below a fifth."""
        if not math.isfinite(largest) or largest <= 0.0:
            return self.full or 1.0
        if largest > self.full or largest < 0.2 * self.full:
            self.full = max(self._least, _round_up(largest))
        return self.full


def _round_up(x: float) -> float:
    """The next of … 0.1, 0.2, 0.5, 1, 2, 5 …"""
    power = 10.0 ** math.floor(math.log10(x))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if x <= f * power * (1 + 1e-9))


@dataclass(frozen=True)
class Place:
    """Where the units of a network stand: (units, 3), inputs first; and the radius of each."""

    units: Array
    radius: Array
    large: float
    """How much larger than usual things are drawn, in a network of few units."""

    @property
    def middle(self) -> Array:
        mid: Array = (self.units.max(axis=0) + self.units.min(axis=0)) / 2
        return mid


def place(topology: Topology) -> Place:
    """Layers one above the other in the order of the groups, inputs at the bottom.

    A group that projects to itself stands in a ring, so that its synapses do not lie on one line.
    """
    units, radii = [], []
    recurrent = {p.post for p in topology.projections if p.pre == p.post}
    large = float(np.clip(7.0 / topology.units, 1.0, 2.6))
    for level, group in enumerate((*topology.input_groups, *topology.neuron_groups)):
        longest = ROW_OF_INPUTS if group.is_input else ROW_OF_NEURONS
        rows = math.ceil(group.size / longest)
        columns = math.ceil(group.size / rows)
        gap = min(0.95, WIDTH / max(1, columns))
        if group.name in recurrent and 2 < group.size <= LARGEST_RING:
            units.append(_ring(group.size, gap) + (0.0, 0.0, LAYER * level))
            radii.append(np.full(group.size, min(LARGEST_RADIUS * large, 0.36 * gap)))
            continue
        index = np.arange(group.size)
        x = (index % columns - (columns - 1) / 2) * gap
        y = (index // columns) * gap
        units.append(np.stack([x, y, np.full(group.size, LAYER * level)], axis=1))
        radii.append(np.full(group.size, min(LARGEST_RADIUS * large, 0.36 * gap)))
    return Place(np.concatenate(units), np.concatenate(radii), large)


def _ring(size: int, gap: float) -> Array:
    """Places on a circle, neighbours `gap` apart, tilted towards who looks from the front."""
    radius = gap / (2 * np.sin(np.pi / size))
    turn = 2 * np.pi * (np.arange(size) + 0.5) / size
    x, y = -radius * np.cos(turn), radius * np.sin(turn)
    return np.stack([x, y, RING_TILT * y], axis=1)


def network_at(task: Task) -> tuple[float, float, float]:
    """Where a network stands, in scene units: over the world it acts in, alone where none is."""
    return NETWORK_OVER_WORLD if task.props else NETWORK_ALONE


def color_of(prop: Prop, theme: Theme) -> Rgb:
    """Red, green, blue of a prop in a theme."""
    if isinstance(prop.color, str):
        return {
            "world": theme.world,
            "world strong": theme.world_strong,
            "accent": palette.ACCENT,
            "positive": palette.WEIGHT_POSITIVE,
            "negative": palette.WEIGHT_NEGATIVE,
        }[prop.color]
    r, g, b = (round(255 * c) for c in prop.color)
    return r, g, b


def endpoints(topology: Topology) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The presynaptic and postsynaptic unit of every synapse, each (synapses,)."""
    pre, post = [], []
    for p in topology.projections:
        rows, columns = topology.shape(p)
        post.append(np.repeat(topology.first_unit(p.post) + np.arange(rows), columns))
        pre.append(np.tile(topology.first_unit(p.pre) + np.arange(columns), rows))
    return np.concatenate(pre), np.concatenate(post)


def unit_names(topology: Topology, input_names: tuple[str, ...]) -> tuple[str, ...]:
    """A name for every unit: an input's own, a neuron's group and number."""
    return (*input_names, *neuron_names(topology))


def neuron_names(topology: Topology) -> tuple[str, ...]:
    """A name for every neuron: its group's, and its number where the group has several."""
    return tuple(
        g.name if g.size == 1 else f"{g.name} {k + 1}"
        for g in topology.neuron_groups
        for k in range(g.size)
    )


@dataclass(frozen=True)
class Look:
    """One picture of the network; colours (n, 3), sizes in scene units."""

    neuron_colors: Pixels
    neuron_radius: Array
    glow_radius: Array
    input_colors: Pixels
    input_height: Array
    weight_colors: Pixels
    weight_radius: Array
    trace_colors: Pixels
    trace_height: Array


class Looks:
    """Makes Looks of one network, with scales that hold still and an afterglow of spikes."""

    def __init__(self, topology: Topology, theme: Theme) -> None:
        self.topology, self.theme = topology, theme
        least = 1.0 if topology.synapses == 1 else 0.0  # one synapse is to be seen to shrink
        self.weight_scale = Scale(least)
        self.trace_scales = [Scale(least) for _ in topology.projections]
        self.input_scale = Scale()
        self._place = place(topology)
        self._radius = self._place.radius
        self._thick = THICKEST * float(np.clip((40 / topology.synapses) ** 0.3, 0.5, 2.5))
        self._glow = np.zeros(topology.neurons)
        self._drawn = (-1, -1)
        self._pictures_since_step = 0
        self.pre, _ = endpoints(topology)

    def twin(self) -> Looks:
        """For another network of the same making, to the same scales."""
        made = Looks(self.topology, self.theme)
        made.weight_scale, made.input_scale = self.weight_scale, self.input_scale
        made.trace_scales = self.trace_scales
        return made

    def look(self, frame: Frame, *, beside: Frame | None = None, leaps: int = 0) -> Look:
        """Appearance of a frame after `leaps` discontinuities, to scales that fit `beside` too."""
        inputs = self.topology.inputs
        self._afterglow(frame, leaps)
        radius = self._radius[inputs:]
        both = (frame,) if beside is None else (frame, beside)
        size = np.abs(frame.weight) / self.weight_scale.fit(_largest(f.weight for f in both))
        trace = self._trace_shares(both)
        value = frame.activity[:inputs]
        height = value / self.input_scale.fit(_largest(f.activity[:inputs] for f in both))
        signs = palette.signed
        return Look(
            neuron_colors=palette.blend(self._glow, self.theme.idle, palette.SPIKE),
            neuron_radius=radius * (1.0 + 0.25 * self._glow),
            glow_radius=radius * np.where(self._glow > 0.05, 1.15 + 0.75 * self._glow, 0.0),
            input_colors=signs(
                height, palette.INPUT_POSITIVE, palette.INPUT_NEGATIVE, self.theme.idle, floor=0.5
            ),
            input_height=height * TALLEST_INPUT,
            weight_colors=signs(
                np.sign(frame.weight) * np.sqrt(size),
                palette.WEIGHT_POSITIVE,
                palette.WEIGHT_NEGATIVE,
                self.theme.idle,
                floor=0.5,
            ),
            weight_radius=THINNEST + (self._thick - THINNEST) * size,
            trace_colors=signs(
                trace, palette.TRACE_POSITIVE, palette.TRACE_NEGATIVE, self.theme.idle, floor=0.6
            ),
            trace_height=np.clip(trace, -1, 1) * TALLEST_TRACE * self._place.large,
        )

    def _afterglow(self, frame: Frame, leaps: int) -> None:
        """Light of the neurons: their rate, fading; where steps are slow, spikes alone; of a step
        that nothing was shown to lead to, who fired in it.
        """
        before, self._drawn = self._drawn, (leaps, frame.step)
        if before == self._drawn:
            self._pictures_since_step += 1
            return
        follows = before[0] == leaps and self._pictures_since_step < SLOW_PICTURES
        fade, self._pictures_since_step = 0.35 * follows, 0
        if not frame.since.steps:
            self._glow = (frame.activity[self.topology.inputs :] > 0).astype(float)
            return
        rate = frame.since.spikes / frame.since.steps
        self._glow = np.maximum(rate, fade * self._glow)

    def _trace_shares(self, both: Sequence[Frame]) -> Array:
        """Traces of the first as shares of the full size, projection by projection."""
        frame = both[0]
        shares = np.empty_like(frame.trace)
        for k, scale in enumerate(self.trace_scales):
            where = self.topology.synapses_of(k)
            largest = _largest(f.trace[where] for f in both)
            shares[where] = frame.trace[where] / scale.fit(largest)
        return shares

    def legend(self) -> str:
        """The scales in words, for the page."""
        bars = ", ".join(
            f"{p.name} |z| = {scale.full:g}"
            for p, scale in zip(self.topology.projections, self.trace_scales, strict=True)
        )
        inputs = f"; full input bar: {self.input_scale.full:g}" if self.topology.inputs else ""
        return f"full width: |w| = {self.weight_scale.full:g}; full trace bar: {bars}{inputs}"


def _largest(arrays: Iterable[Array]) -> float:
    return max(float(np.abs(a).max(initial=0.0)) for a in arrays)


def largest_synapses(weight: Array, most: int = MOST_SYNAPSES_DRAWN) -> NDArray[np.intp]:
    """The synapses to draw: all, or those of largest |w|, in their order."""
    if len(weight) <= most:
        return np.arange(len(weight))
    return np.sort(np.argpartition(-np.abs(weight), most)[:most])
