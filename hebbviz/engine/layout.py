"""The layout of a network's numbers: one array (rows, width) per tile, the lane last.

A tile holds up to WIDTHS[-1] lanes that are stepped together. Numbers that are read together are
stored together in records: the activity, potential and surprise of a neuron are in consecutive
rows, and so are the weight and trace of a synapse. Within a record compiled code addresses each
row by a constant offset, so the compiler sees that rows do not overlap and vectorizes over lanes
without a check at run time.

Saves, keyframes and checksums do not use records. They hold the same numbers in the fixed order of
SECTIONS; `Layout.pack` converts to that order, and `unpack` converts back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from llvmlite.binding import get_host_cpu_features
from numpy.typing import NDArray

from hebbviz.numerics.compile import WIDTHS
from hebbviz.topology import Topology

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

VECTOR = 16 if get_host_cpu_features().get("avx512f") else 8
"""Lanes in one vector of the processor in float32."""

SECTIONS = (
    "activity",  # u of inputs, then neurons: value; (units, lanes)
    "before",  # u of the previous step, from which v and z were computed, (units, lanes)
    "potential",  # v, (neurons, lanes)
    "probability",  # σ(v), (neurons, lanes)
    "draw",  # the uniform number that u was drawn with, (neurons rounded up to 4, lanes)
    "fired",  # 1 if the neuron fired at this step, 0 if not, (neurons, lanes)
    "surprise",  # fired − σ(v), the neuron's half of the eligibility term, (neurons, lanes)
    "clamp",  # 1 makes a neuron fire, 0 keeps it silent, NaN clamps nothing, (neurons, lanes)
    "weight",  # w, stored folded (see rule), (synapses, lanes)
    "trace",  # z, stored folded (see rule), (synapses, lanes)
    "beta",  # the same for all lanes, (projections, lanes)
    "gamma",  # the step size in force, 0 while frozen, the same for all lanes, (projections, lanes)
    "by_hand",  # manual reward, added to the next r, (1, lanes)
    "reward",  # last r: of the task, and as broadcast, (2, lanes)
    "tally",  # totals: reward of the task, reward broadcast, episodes ended, (3, lanes)
    "decay",  # held input: the product of β since the fold, (projections, lanes)
    "gain",  # held input: Σ γ r · decay since the fold, (projections, lanes)
    "z_input",  # held input: z = decay·z₀ + z_input·x, (rows of post neurons, lanes)
    "w_input",  # held input: w = w₀ + gain·z₀ + w_input·x, (rows of post neurons, lanes)
    "w_drive",  # held input: w₀·x, (rows of post neurons, lanes)
    "z_drive",  # held input: z₀·x, (rows of post neurons, lanes)
    "x_squared",  # held input: |x|², (projections, lanes)
)

ABSENT = ("probability", "draw", "fired", "tally")
"""SECTIONS that are not rows of the state. The tally is float64 whatever the dtype of the state;
the others follow from other sections.
"""

BLOCK = 4
"""Random numbers that one call of the generator gives."""

NEURON = ("activity", "before", "potential", "surprise", "clamp")
PROJECTION = ("beta", "gamma", "decay", "gain", "x_squared", "push")
HELD = ("z_input", "w_input", "w_drive", "z_drive")
SYNAPSE = ("weight", "trace")
"""Rows of each kind of record. `push` is γ times the broadcast reward of the step.

The probability, the draw and the spike of a step are not stored: they follow from the potential,
the step number and the activity.
"""

HEADER = (
    "inputs", "neurons", "outputs", "projections",
    "input", "input_before", "neuron", "output", "projection", "by_hand", "reward",
)  # fmt: skip
"""Columns of the first row of the table: four counts, then the first row of each kind. One row of
COLUMNS per projection follows."""

COLUMNS = ("pre", "pre_size", "post", "post_size", "synapse", "is_held", "held", "is_first")
"""Columns of a projection: first presynaptic row (of an input or of a neuron's record) and size,
first postsynaptic neuron's record and size, first synapse's record, whether the presynaptic values
are held input, first record of the held sums, whether it is the first projection onto its group."""


CACHE_LINE = 64
"""Size in bytes. Fetching a vector that crosses two cache lines takes twice as long."""


def aligned(rows: int, width: int, dtype: type[np.generic] = np.float64) -> NDArray[Any]:
    """Return zeros (rows, width) whose first byte starts a cache line."""
    size = rows * width * np.dtype(dtype).itemsize
    room = np.zeros(size + CACHE_LINE, dtype=np.uint8)
    first = -room.ctypes.data % CACHE_LINE
    return room[first : first + size].view(dtype).reshape(rows, width)


def width_for(lanes: int, *, written_out: bool = False) -> int:
    """Return the width of a tile with this many lanes: the next of WIDTHS.

    Code compiled for one network (`written_out`) takes any multiple of VECTOR.
    """
    if written_out:
        return -(-lanes // VECTOR) * VECTOR
    return next(w for w in WIDTHS if w >= lanes)


@dataclass(frozen=True)
class Layout:
    """The rows of a network of this topology, and the table that compiled code reads.

    `where` maps the name of a section to its rows.
    """

    topology: Topology
    where: dict[str, Rows] = field(init=False)
    rows: int = field(init=False)
    table: NDArray[np.uint32] = field(init=False)

    def __post_init__(self) -> None:
        t = self.topology
        held = sum(t.shape(p)[0] for p in t.projections)
        sizes = {
            "input": t.inputs, "input_before": t.inputs,
            "neuron": t.neurons * len(NEURON), "projection": len(t.projections) * len(PROJECTION),
            "held": held * len(HELD), "synapse": t.synapses * len(SYNAPSE), "by_hand": 1,
            "reward": 2,
        }  # fmt: skip
        ends = np.cumsum(list(sizes.values()))
        starts = {n: int(e) - sizes[n] for n, e in zip(sizes, ends, strict=True)}
        counts = {"neuron": t.neurons, "projection": len(t.projections), "held": held}
        kinds = (("neuron", NEURON), ("projection", PROJECTION), ("held", HELD),
                 ("synapse", SYNAPSE))  # fmt: skip
        where = {
            name: starts[kind] + len(names) * np.arange(counts.get(kind, t.synapses)) + k
            for kind, names in kinds
            for k, name in enumerate(names)
            if name in SECTIONS
        }
        for name in ("by_hand", "reward"):
            where[name] = starts[name] + np.arange(sizes[name])
        for name, inputs in (("activity", "input"), ("before", "input_before")):
            where[name] = np.concatenate([starts[inputs] + np.arange(t.inputs), where[name]])
        object.__setattr__(self, "rows", int(ends[-1]))
        object.__setattr__(self, "where", where)
        object.__setattr__(self, "table", self._table(starts))

    @property
    def draws(self) -> int:
        """Random numbers of a step: one per neuron, rounded up to a multiple of BLOCK."""
        return -(-self.topology.neurons // BLOCK) * BLOCK

    @property
    def packed(self) -> dict[str, slice]:
        """The rows of each of SECTIONS in a keyframe."""
        neurons = self.topology.neurons
        absent = {"probability": neurons, "draw": self.draws, "fired": neurons, "tally": 3}
        sizes = [absent.get(name) or len(self.where[name]) for name in SECTIONS]
        ends = np.cumsum(sizes)
        return {
            name: slice(int(end) - size, int(end))
            for name, size, end in zip(SECTIONS, sizes, ends, strict=True)
        }

    @property
    def packed_rows(self) -> int:
        """Number of rows of a keyframe."""
        return int(self.packed[SECTIONS[-1]].stop)

    def pack(self, state: Array, absent: Mapping[str, Array]) -> Array:
        """Return the rows of a keyframe: all SECTIONS in order, float64.

        `absent` holds the sections of ABSENT.
        """
        parts = [absent[name] if name in ABSENT else self.section(state, name) for name in SECTIONS]
        return np.concatenate(parts, dtype=np.float64)

    def unpack(self, packed: Array, state: Array) -> None:
        """Copy the rows of a keyframe into an existing state."""
        for name, rows in self.packed.items():
            if name not in ABSENT:
                self.put(state, name, packed[rows])

    def section(self, state: Array, name: str) -> Array:
        """Return a copy of one section, (its rows, lanes)."""
        return state[self.where[name]]

    def put(self, state: Array, name: str, values: Array | float) -> None:
        """Set one section."""
        state[self.where[name]] = values

    def empty_state(self, width: int, dtype: type[np.floating] = np.float64) -> Array:
        """Return a network at rest: silent neurons, zero weights and traces, no clamps."""
        state = aligned(self.rows, width, dtype)
        state[self.where["activity"][self.topology.inputs :]] = self.topology.activity[0]
        self.put(state, "clamp", np.nan)
        self.put(state, "decay", 1.0)
        return state

    def _table(self, starts: dict[str, int]) -> NDArray[np.uint32]:
        t = self.topology
        outputs = t.neurons_of(t.output)
        table = np.zeros((1 + len(t.projections), max(len(HEADER), len(COLUMNS))), dtype=np.uint32)

        def neuron(number: int) -> int:
            return starts["neuron"] + number * len(NEURON)

        starts = {**starts, "output": neuron(outputs.start)}
        counts = (t.inputs, t.neurons, outputs.stop - outputs.start, len(t.projections))
        table[0, : len(HEADER)] = (*counts, *(starts[name] for name in HEADER[len(counts) :]))
        synapse, held = starts["synapse"], starts["held"]
        for k, p in enumerate(t.projections):
            post, pre = t.shape(p)
            first = (
                starts["input"] + t.first_unit(p.pre)
                if t.is_held(p)
                else neuron(t.neurons_of(p.pre).start)
            )
            ends = (first, pre, neuron(t.neurons_of(p.post).start), post)
            is_first = p.post not in {before.post for before in t.projections[:k]}
            table[k + 1, : len(COLUMNS)] = (*ends, synapse, t.is_held(p), held, is_first)
            synapse += post * pre * len(SYNAPSE)
            held += post * len(HELD)
        return table
