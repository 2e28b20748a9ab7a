"""When a network learns no more: its outputs are constant, its neurons saturated, its weights gone.

Of the watched lane every step is known. Of the others the potentials are looked at once a picture,
which is enough to tell: a neuron fires with probability σ(v), so the mean of σ(v) is its rate.
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
"""Long enough for many patterns or many falls."""
ENOUGH_LOOKS = 60
"""So many pictures: about two seconds."""


class Sign(Enum):
    """Of a network that learns no more."""

    GONE = "the weights have grown beyond all numbers"
    CONSTANT = "all outputs are constant"
    SATURATED = "more than half of the neurons are saturated"


def sign(finite: bool, outputs: Array, low: Array, high: Array) -> Sign | None:
    """The sign in one lane, if there is one.

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
    """Which lanes of a learner are stuck, found out a stretch of the run at a time."""

    def __init__(self) -> None:
        self._looks: _Looks | None = None
        self.lanes: tuple[int, ...] = ()

    def forget(self) -> None:
        """Begin anew, with another run."""
        self._looks, self.lanes = None, ()

    def look(self, learner: Learner) -> None:
        """Look at the learner as it is now, if it has several lanes."""
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
