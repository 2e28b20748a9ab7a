"""Signs that learning has stopped: constant outputs, saturated neurons, non-finite weights.

Every step of the watched lane is known. The potentials of other lanes are sampled once a snapshot,
which is enough: a neuron fires with probability σ(v), so the mean of σ(v) is its rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.learner import Learner
from hebbviz.reference import sigma

Array = NDArray[np.float64]

CONSTANT = 0.995
"""An output that does the same in this share of the steps, or more, counts as constant."""
SATURATED = 12.0
"""|v| beyond which a neuron's spikes are certain, to about 1 in 10⁵."""
ENOUGH_STEPS = 20_000
"""Enough steps for many patterns or many falls."""
ENOUGH_LOOKS = 60
"""Number of snapshots: about two seconds."""


class Sign(Enum):
    """A sign that a network has stopped learning."""

    GONE = "the weights are no longer finite"
    CONSTANT = "all outputs are constant"
    SATURATED = "more than half of the neurons are saturated"


def sign(finite: bool, outputs: Array, low: Array, high: Array) -> Sign | None:
    """The sign in one lane, or None.

    `finite` says whether its weights are, `outputs` at which rates the output neurons fire, `low`
    and `high` (neurons,) between which their potentials were.
    """
    if not finite:
        return Sign.GONE
    if (np.maximum(outputs, 1 - outputs) >= CONSTANT).all():
        return Sign.CONSTANT
    if ((low > SATURATED) | (high < -SATURATED)).mean() > 0.5:
        return Sign.SATURATED
    return None


@dataclass
class _Looks:
    """Sums over the pictures since a step: of σ(v) of the outputs, and the ends of v."""

    since: int
    count: int
    rates: Array
    low: Array
    high: Array


class StuckLanes:
    """The stuck lanes of a learner, determined chunk by chunk."""

    def __init__(self) -> None:
        self._looks: _Looks | None = None
        self.lanes: tuple[int, ...] = ()

    def forget(self) -> None:
        """Restart with another run."""
        self._looks, self.lanes = None, ()

    def look(self, learner: Learner) -> None:
        """Sample the learner's current state, if it has several lanes."""
        if learner.lanes == 1:
            return
        potential, outputs = (
            learner.potentials,
            learner.topology.neurons_of(learner.topology.output),
        )
        rates, seen = sigma(potential[outputs]), self._looks
        if seen is None:
            self._looks = _Looks(learner.step, 1, rates, potential, potential)
            return
        seen.count += 1
        seen.rates = seen.rates + rates
        seen.low, seen.high = np.minimum(seen.low, potential), np.maximum(seen.high, potential)
        if seen.count >= ENOUGH_LOOKS and learner.step - seen.since >= ENOUGH_STEPS:
            finite = [bool(np.isfinite(w).all()) for w in learner.weights.T]
            rates = seen.rates / seen.count
            self.lanes = tuple(
                k
                for k in range(learner.lanes)
                if sign(finite[k], rates[:, k], seen.low[:, k], seen.high[:, k]) is not None
            )
            self._looks = None
