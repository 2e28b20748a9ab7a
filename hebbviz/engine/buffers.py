"""Buffers of the watched lane: notes of each step, and sums over the steps since the last Frame.

Compiled code writes into their arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NOBODY = -1
"""Stands for no watched lane: nothing is noted."""


class Notes(NamedTuple):
    """Arrays with one row per step: spikes, rewards, and on request v and the world's state."""

    fired: NDArray[np.uint8]
    rewards: Array
    potentials: Array
    worlds: Array

    @classmethod
    def of(cls, steps: int, neurons: int, numbers: int | None) -> Notes:
        """Make room for `steps`; `numbers` is the size of the world's state, None to note neither
        v nor the state.
        """
        near = 0 if numbers is None else steps
        return cls(
            np.zeros((steps, neurons), dtype=np.uint8), np.zeros((steps, 3)),
            np.zeros((near, neurons)), np.zeros((near, numbers or 0)),
        )  # fmt: skip

    def part(self, piece: slice) -> Notes:
        """Return views of the rows in `piece`."""
        fired, *others = self
        return Notes(fired[piece], *(rows[piece] for rows in others))


class Sums(NamedTuple):
    """Sums over steps: spike counts, minima and maxima of v and z, rows of the probes."""

    counts: NDArray[np.int64]
    extremes: Array
    probes: NDArray[np.int64]
