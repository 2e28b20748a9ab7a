"""Output of a learner: immutable snapshots, and records of the steps between them.

Views see only a `Frame`. A `Block` holds every step of an interval, for a recorder or a raster. A
run can be recomputed from a `Keyframe`. All own their arrays.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.layout import Layout
from hebbviz.limits import LARGEST_BETA, check_beta, check_fall, check_gamma, check_step
from hebbviz.rules.base import Rule
from hebbviz.rules.paper import PAPER
from hebbviz.task.base import Tally
from hebbviz.topology import Topology

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Keyframe:
    """A learner's whole state at a step: network (rows, lanes) and world (numbers, lanes).

    `gamma` (projections, lanes) is γ as set, `fall` its decay time in steps (infinite for no
    decay); `memory` (its rows, lanes) is the memory of the `rule`.
    """

    step: int
    network: Array
    world: Array
    gamma: Array
    frozen: bool
    rule: Rule
    memory: Array
    fall: float

    def check_fit(
        self, layout: Layout, world: tuple[int, ...], dtype: type[np.floating[Any]]
    ) -> None:
        """Raise ValueError unless this is a valid state of a network with this layout and `dtype`
        in a world of shape (numbers, lanes).
        """
        lanes = world[-1]
        for what, array, shape in (
            ("this network has", self.network, (layout.packed_rows, lanes)),
            ("this task has a world of", self.world, world),
            ("this network has γ of", self.gamma, (len(layout.topology.projections), lanes)),
            (f"rule {self.rule} has a memory of", self.memory, (len(self.rule.memory), lanes)),
        ):
            if array.shape != shape:
                raise ValueError(f"a keyframe of {what} shape {shape}, got {array.shape}")
        check_step(self.step)
        check_fall(self.fall)
        in_force, beta = (self.network[layout.packed[name]] for name in ("gamma", "beta"))
        for gamma in (self.gamma, in_force):
            for extreme in (gamma.min(), gamma.max()):  # both are NaN if one is
                check_gamma(float(extreme))
        for extreme in (beta.min(), beta.max()):
            if extreme != dtype(LARGEST_BETA):
                check_beta(float(extreme))

    def lane(self, lane: int) -> Keyframe:
        """Return a keyframe of one lane; the lane is the last axis of every array."""
        alone: dict[str, Any] = {
            name: value[..., lane : lane + 1].copy()
            for name, value in vars(self).items()
            if isinstance(value, np.ndarray)
        }
        return replace(self, **alone)

    def digest(self) -> str:
        """Return the SHA-256 of the whole keyframe as 64 hexadecimal digits."""
        said = f"{self.step} {self.frozen}"
        arrays = [self.network, self.world, self.gamma]
        if (self.rule, self.fall) != (PAPER, math.inf):  # the first recordings do not have these
            said += f" {self.rule} {self.fall!r}"
            arrays.append(self.memory)
        digest = hashlib.sha256(said.encode())
        for array in arrays:
            digest.update(f" {array.shape} ".encode())
            digest.update(array.astype("<f8").tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Block:
    """Every one of the n steps from `start`: who fired, and the rewards.

    `fired` (n, neurons) of 0 and 1; `reward` and `broadcast` (n,); `ended` (n,) bool. Seen
    closely, also `potential` v (n, neurons) and `world` (n, numbers), the state that each step's
    reward was given for: where an episode ended, the one that ended it. Else these have no rows.
    """

    start: int
    fired: NDArray[np.uint8]
    reward: Array
    broadcast: Array
    ended: NDArray[np.bool_]
    potential: Array
    world: Array

    @property
    def end(self) -> int:
        """The step after the last."""
        return self.start + len(self.fired)

    def events(self, rule: Rule) -> Array:
        """Return the rewards among which to look for events, (n,).

        For the paper's rule these are the broadcast ones. Other rules may broadcast something at
        every step, so for them these are the task's.
        """
        return self.broadcast if rule == PAPER else self.reward

    def tail(self, steps: int) -> Block:
        """Return the last `steps` steps, or all if there are fewer."""
        return self.part(max(self.start, self.end - steps), self.end)

    def part(self, first: int, end: int) -> Block:
        """Return the steps from `first` to before `end`."""
        cut = slice(max(0, first - self.start), max(0, end - self.start))
        start = min(max(first, self.start), self.end)
        return Block(start, **{name: getattr(self, name)[cut] for name in _BLOCK_ARRAYS})


_BLOCK_ARRAYS = ("fired", "reward", "broadcast", "ended", "potential", "world")


def join(blocks: Sequence[Block]) -> Block:
    """Join consecutive blocks; raise ValueError if they are not consecutive.

    The result has potentials and world states if all blocks have them.
    """
    for before, after in pairwise(blocks):
        if before.end != after.start:
            raise ValueError(f"a block that starts at {after.start} does not follow on")
    arrays = {name: [getattr(b, name) for b in blocks] for name in _BLOCK_ARRAYS}
    if any(len(b.potential) < len(b.fired) for b in blocks):
        arrays["potential"], arrays["world"] = [np.zeros((0, 0))], [np.zeros((0, 0))]
    return Block(blocks[0].start, **{name: np.concatenate(a) for name, a in arrays.items()})


@dataclass(frozen=True)
class Summary:
    """Sums over every step since the previous Frame; none of it is sampled.

    `spikes` (neurons,) counts spikes; `potential_range` (2, neurons) is the minimum and maximum of
    v; `probe_range` (2, probes) is the minimum and maximum of z of the probed synapses;
    `weight_change` (synapses,) is Σ γ m z, with m the broadcast reward; `tally` holds the rewards
    and ended episodes of these steps.
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
    """The watched lane at the end of a step, and a summary of all steps since the previous Frame.

    `activity` and `before` (units,) are u of this step and of the previous one; `potential`,
    `probability`, `draw` and `fired` have shape (neurons,), `weight` and `trace` (synapses,),
    `beta` and `gamma` (projections,). `gamma` is γ in force, 0 while frozen; `step_size` is γ as
    set, `fall` its decay time in steps. `memory` is the rule's memory, `world` the task's state,
    `reward` the last step's (task, broadcast), and `tally` the totals since the start.
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
    step_size: float
    fall: float
    frozen: bool
    rule: Rule
    memory: Array
    world: Array
    reward: tuple[float, float]
    tally: Tally
    since: Summary
