"""What leaves a learner: immutable pictures of a moment, and what happened in between.

A `Frame` is the only thing a view sees. A `Block` is every step of a stretch, for a recorder or a
raster. A `Keyframe` is a moment from which a run can be made again. All own their arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Tally
from hebbviz.topology import Topology

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Keyframe:
    """A learner's whole state at a step: network (rows, lanes) and world (numbers, lanes)."""

    step: int
    network: Array
    world: Array
    gamma: Array
    frozen: bool


@dataclass(frozen=True)
class Block:
    """Every one of the n steps from `start`: who fired, and the rewards.

    `fired` (n, neurons) of 0 and 1; `reward` and `broadcast` (n,); `ended` (n,) bool.
    """

    start: int
    fired: NDArray[np.uint8]
    reward: Array
    broadcast: Array
    ended: NDArray[np.bool_]

    @property
    def end(self) -> int:
        """The step after the last."""
        return self.start + len(self.fired)

    def tail(self, steps: int) -> Block:
        """The last `steps` steps, or all if there are fewer."""
        cut = max(0, len(self.fired) - steps)
        return Block(
            self.start + cut,
            self.fired[cut:],
            self.reward[cut:],
            self.broadcast[cut:],
            self.ended[cut:],
        )


def join(blocks: Sequence[Block]) -> Block:
    """Blocks that follow on one another as one; raises ValueError if they do not."""
    for before, after in pairwise(blocks):
        if before.end != after.start:
            raise ValueError(f"a block that starts at {after.start} does not follow on")
    return Block(
        blocks[0].start,
        np.concatenate([b.fired for b in blocks]),
        np.concatenate([b.reward for b in blocks]),
        np.concatenate([b.broadcast for b in blocks]),
        np.concatenate([b.ended for b in blocks]),
    )


@dataclass(frozen=True)
class Summary:
    """Over every step since the Frame before: nothing in it is sampled.

    `spikes` (neurons,) counts; `potential_range` (2, neurons) least and greatest v;
    `probe_range` (2, probes) least and greatest z of the probed synapses; `weight_change`
    (synapses,) is Σ γ r z; `tally` the rewards and ends of these steps.
    """

    steps: int
    spikes: NDArray[np.int64]
    potential_range: Array
    probes: tuple[int, ...]
    probe_range: Array
    weight_change: Array
    tally: Tally


@dataclass(frozen=True)
class Frame:
    """The watched lane at the end of a step, and a summary of all steps since the Frame before.

    `activity` and `before` (units,) are u of this step and of the one before, `potential`,
    `probability`, `draw`, `fired` (neurons,), `weight`, `trace` (synapses,), `beta` and
    `gamma` (projections,; the γ in force, 0 while frozen), `world` the task's state, `reward` the
    last step's (of the task, as broadcast), `tally` since the start.
    """

    step: int
    topology: Topology
    activity: Array
    before: Array
    potential: Array
    probability: Array
    draw: Array
    fired: Array
    weight: Array
    trace: Array
    beta: Array
    gamma: Array
    frozen: bool
    world: Array
    reward: tuple[float, float]
    tally: Tally
    since: Summary
