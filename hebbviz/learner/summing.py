"""Sums over all steps since the last Frame, which become its `Summary`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine import held_input
from hebbviz.engine.buffers import Sums
from hebbviz.engine.layout import Layout
from hebbviz.learner.frames import Summary
from hebbviz.task.base import Tally

Array = NDArray[np.float64]


class Summing:
    """Sums over the steps of the watched lane since a given moment.

    `weight` (synapses,) and `tally` are the values at that moment. For the synapses `probes` the
    minimum and maximum of z are kept.
    """

    def __init__(
        self, layout: Layout, *, probes: Sequence[int], weight: Array, tally: Tally
    ) -> None:
        self._probes, self._weight, self._tally = tuple(probes), weight, tally
        neurons = layout.topology.neurons
        rows = [held_input.trace_rows(layout, synapse) for synapse in probes]
        extremes = np.empty((2, neurons + len(rows)))
        extremes[0], extremes[1] = np.inf, -np.inf
        self.sums = Sums(
            np.zeros(neurons, dtype=np.int64), extremes,
            np.array(rows, dtype=np.int64).reshape(-1, 4),
        )  # fmt: skip
        self._kept = [(np.empty_like(now), now) for now in self.sums[:2]]

    def summary(self, weight: Array, tally: Tally) -> Summary:
        """Return the summary of the steps until now, given the present `weight` and `tally`."""
        counts, extremes, _ = self.sums
        since = tally - self._tally
        return Summary(
            steps=since.steps,
            spikes=counts.copy(),
            potential_range=extremes[:, : len(counts)].copy(),
            probes=self._probes,
            probe_range=extremes[:, len(counts) :].copy(),
            weight_change=weight - self._weight,
            tally=since,
        )

    # Going back

    def keep(self) -> None:
        """Store the present sums for `back`."""
        for kept, now in self._kept:
            np.copyto(kept, now)

    def back(self) -> None:
        """Return to the sums of the last `keep`."""
        for kept, now in self._kept:
            np.copyto(now, kept)
