"""What is noted of a run: each step of a block, and sums over all steps since the last Frame.

Both are of one lane, the watched one. Compiled code writes into their arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
