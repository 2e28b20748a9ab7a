"""What is noted of a run: each step of a block, and sums over all steps since the last Frame.

Both are of one lane, the watched one. Compiled code writes into their arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine import held_input
from hebbviz.engine.layout import Layout
from hebbviz.learner.frames import Summary
from hebbviz.task.base import Tally

Array = NDArray[np.float64]

NOBODY = -1
"""In place of a watched lane: nothing is noted."""


class Notes(NamedTuple):
    """What is written of each step: fired, rewards, and if asked for v and the world."""

    fired: NDArray[np.uint8]
    rewards: Array
    potentials: Array
    worlds: Array

    @classmethod
    def of(cls, steps: int, neurons: int, numbers: int | None) -> Notes:
        """Room for `steps`; `numbers` of the world's state, None if v and state are not asked."""
        near = 0 if numbers is None else steps
        return cls(
            np.zeros((steps, neurons), dtype=np.uint8), np.zeros((steps, 3)),
            np.zeros((near, neurons)), np.zeros((near, numbers or 0)),
        )  # fmt: skip

    def part(self, piece: slice) -> Notes:
        """The room for some of the steps, and none where there is none."""
        fired, *others = self
        return Notes(fired[piece], *(rows[piece] for rows in others))


class Sums(NamedTuple):
    """What the engine sums up over steps: spikes, least and greatest v and z, rows of probes."""

    counts: NDArray[np.int64]
    extremes: Array
    probes: NDArray[np.int64]


class Summing:
    """Sums over all steps of the watched lane from a moment on.

    `weight` (synapses,) and `tally` are of that moment; of the synapses `probes` the least and
    greatest z are kept.
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
        """The steps up to now, where `weight` and `tally` are what they are now."""
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
        """Remember this moment."""
        for kept, now in self._kept:
            np.copyto(kept, now)

    def back(self) -> None:
        """As it was when it was last kept."""
        for kept, now in self._kept:
            np.copyto(now, kept)
