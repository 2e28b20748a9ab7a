"""Where everything sits: one flat state array with named sections, the lane on the last axis.

A learner's network is one float64 array of shape (rows, lanes). A single array is what makes the
rest simple: a save is a copy, a keyframe is a copy, and a compiled function gets one pointer.
Sections are cut out by name (`Layout.section`), and compiled code reads their first rows from the
integer table (`Layout.table`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hebbviz.topology import Topology

Array = NDArray[np.float64]

SECTIONS = (
    "activity",  # u of inputs, then neurons: value; (units, lanes)
    "before",  # u of the step before, which this step's v and z were made from, (units, lanes)
    "potential",  # v, (neurons, lanes)
    "probability",  # σ(v), (neurons, lanes)
    "draw",  # the uniform number that u was drawn with, (neurons rounded up to 4, lanes)
    "fired",  # 1 where the neuron fired at this step, else 0, (neurons, lanes)
    "surprise",  # fired − σ(v), the neuron's half of the eligibility term, (neurons, lanes)
    "clamp",  # 1 or 0 makes a neuron fire or not, NaN leaves it to chance, (neurons, lanes)
    "weight",  # w, stored folded (see rule), (synapses, lanes)
    "trace",  # z, stored folded (see rule), (synapses, lanes)
    "beta",  # (projections, lanes)
    "gamma",  # the step size in force, 0 while learning is frozen, (projections, lanes)
    "by_hand",  # reward given by hand, added to the next r, (1, lanes)
    "reward",  # last r: of the task, and as broadcast, (2, lanes)
    "tally",  # totals so far: reward of the task, reward broadcast, episodes ended, (3, lanes)
    "decay",  # held input: the product of β since the fold, (projections, lanes)
    "gain",  # held input: Σ γ r · decay since the fold, (projections, lanes)
    "z_input",  # held input: z = decay·z₀ + z_input·x, (rows of post neurons, lanes)
    "w_input",  # held input: w = w₀ + gain·z₀ + w_input·x, (rows of post neurons, lanes)
    "w_drive",  # held input: w₀·x, (rows of post neurons, lanes)
    "z_drive",  # held input: z₀·x, (rows of post neurons, lanes)
    "x_squared",  # held input: |x|², (projections, lanes)
)

HEADER = ("inputs", "neurons", "outputs", "first_output", "projections", *SECTIONS)
"""Columns of the first row of the table; then one row of COLUMNS per projection."""

COLUMNS = ("pre", "pre_size", "post", "post_size", "synapse", "held", "row")
"""First presynaptic unit, how many, first postsynaptic neuron, how many, first synapse, whether
the presynaptic values are held input, first row of this projection in the z_input kind."""


def _header(name: str) -> int:
    return HEADER.index(name)


@dataclass(frozen=True)
class Layout:
    """The sections of a network of the given topology, and the table that compiled code reads."""

    topology: Topology
    starts: dict[str, int] = field(init=False)
    sizes: dict[str, int] = field(init=False)
    table: NDArray[np.uint32] = field(init=False)

    def __post_init__(self) -> None:
        t = self.topology
        post_rows = sum(t.shape(p)[0] for p in t.projections)
        neurons, projections = t.neurons, len(t.projections)
        sizes = {
            **dict.fromkeys(("activity", "before"), t.units),
            **dict.fromkeys(("potential", "probability", "fired", "surprise", "clamp"), neurons),
            "draw": -(-neurons // 4) * 4,
            **dict.fromkeys(("weight", "trace"), t.synapses),
            **dict.fromkeys(("beta", "gamma", "decay", "gain", "x_squared"), projections),
            **dict.fromkeys(("z_input", "w_input", "w_drive", "z_drive"), post_rows),
            "by_hand": 1,
            "reward": 2,
            "tally": 3,
        }
        ends = np.cumsum([sizes[name] for name in SECTIONS])
        object.__setattr__(self, "sizes", sizes)
        object.__setattr__(
            self, "starts", {n: int(e) - sizes[n] for n, e in zip(SECTIONS, ends, strict=True)}
        )
        object.__setattr__(self, "table", self._table())

    @property
    def rows(self) -> int:
        return sum(self.sizes.values())

    def section(self, state: Array, name: str) -> Array:
        """A view of one section, shape (its rows, lanes)."""
        start = self.starts[name]
        return state[start : start + self.sizes[name]]

    def empty_state(self, lanes: int) -> Array:
        """A network at rest: silent neurons, zero weights and traces, nothing clamped."""
        state = np.zeros((self.rows, lanes))
        self.section(state, "activity")[self.topology.inputs :] = self.topology.activity[0]
        self.section(state, "clamp")[:] = np.nan
        self.section(state, "decay")[:] = 1.0
        return state

    def _table(self) -> NDArray[np.uint32]:
        t = self.topology
        outputs = t.neurons_of(t.output)
        table = np.zeros((1 + len(t.projections), max(len(HEADER), len(COLUMNS))), dtype=np.uint32)
        counts = (t.inputs, t.neurons, outputs.stop - outputs.start, outputs.start)
        table[0, : len(HEADER)] = (*counts, len(t.projections), *self.starts.values())
        synapse = row = 0
        for k, p in enumerate(t.projections):
            post, pre = t.shape(p)
            first = (t.first_unit(p.pre), pre, t.neurons_of(p.post).start, post)
            table[k + 1, : len(COLUMNS)] = (*first, synapse, t.is_held(p), row)
            synapse += post * pre
            row += post
        return table
