"""Held input seen from outside: the closed form of `kernel` put into weights and traces, and back.

For every projection from an input group the state holds w₀ and z₀ of each synapse and the sums
since the input came. Here they become w and z as they are now, without changing the state.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.layout import Layout
from hebbviz.topology import Projection

Array = NDArray[np.float64]


def unfolded(layout: Layout, state: Array) -> tuple[Array, Array]:
    """Weights and traces as they are now, each (synapses, lanes)."""

    def section(name: str) -> Array:
        return layout.section(state, name)

    weight, trace = section("weight"), section("trace")
    activity, gain, decay = section("activity"), section("gain"), section("decay")
    z_input, w_input = section("z_input"), section("w_input")
    for k, p, where, rows in _held(layout):
        post, pre = layout.topology.shape(p)
        x = activity[layout.topology.units_of(p.pre)]
        z0 = trace[where].reshape(post, pre, -1)
        w = gain[k] * z0 + w_input[rows, None] * x
        z = decay[k] * z0 + z_input[rows, None] * x
        weight[where] += w.reshape(post * pre, -1)
        trace[where] = z.reshape(post * pre, -1)
    return weight, trace


def refold(layout: Layout, state: Array) -> None:
    """Restart the sums from the weights and traces that were set."""
    for name, value in (("decay", 1.0), ("gain", 0.0), ("z_input", 0.0), ("w_input", 0.0)):
        layout.put(state, name, value)
    activity = layout.section(state, "activity")
    for drive, of in (("w_drive", "weight"), ("z_drive", "trace")):
        drives, values = layout.section(state, drive), layout.section(state, of)
        for _, p, where, rows in _held(layout):
            post, pre = layout.topology.shape(p)
            synapses = values[where].reshape(post, pre, -1)
            drives[rows] = (synapses * activity[layout.topology.units_of(p.pre)]).sum(axis=1)
        layout.put(state, drive, drives)


def trace_rows(layout: Layout, synapse: int) -> tuple[int, int, int, int]:
    """Rows of the state that make up the z of a synapse: z₀, decay (or -1), z_input, x."""
    where, topology, first = layout.where, layout.topology, 0
    for k, p in enumerate(topology.projections):
        synapses, (post, pre) = topology.synapses_of(k), topology.shape(p)
        if synapses.start <= synapse < synapses.stop:
            i, j = divmod(synapse - synapses.start, pre)
            decay = int(where["decay"][k]) if topology.is_held(p) else -1
            unit = where["activity"][topology.first_unit(p.pre) + j]
            return int(where["trace"][synapse]), decay, int(where["z_input"][first + i]), int(unit)
        first += post
    raise ValueError(f"synapse must be below {topology.synapses}, got {synapse}")


def _held(layout: Layout) -> Iterator[tuple[int, Projection, slice, slice]]:
    """Number, projection, synapses, and rows of the z_input kind of each held projection."""
    first = 0
    for k, p in enumerate(layout.topology.projections):
        post, _ = layout.topology.shape(p)
        if layout.topology.is_held(p):
            yield k, p, layout.topology.synapses_of(k), slice(first, first + post)
        first += post
