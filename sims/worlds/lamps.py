"""A world small enough for its exact gradient to be computed between two pictures.

One of two lamps is lit, and they change places with probability 0.2 a step. The output is to fire
while it is the left one; the reward is 1 after a right answer, else 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.task.base import Input, Output
from hebbviz.task.finite import FiniteWorld
from hebbviz.task.presets import Preset
from hebbviz.theory.network_chain import ExactNetwork
from hebbviz.theory.pomdp import POMDP
from hebbviz.topology import Topology

Array = NDArray[np.float64]

SWITCH = 0.2
"""The chance that the lamps change places at a step."""

LEFT, RIGHT = 0, 1


def _lamps() -> POMDP:
    """State 2·lamp + whether the last answer was right; control 1 says left."""
    moves = np.zeros((2, 2, 2, 2, 2))  # control, lamp and right before, lamp and right after
    for control in (0, 1):
        for lamp in (LEFT, RIGHT):
            right = int((control == 1) == (lamp == LEFT))
            moves[control, lamp, :, :, right] = SWITCH
            moves[control, lamp, :, lamp, right] = 1.0 - SWITCH
    sees = np.repeat(np.eye(2), 2, axis=0)
    return POMDP(moves.reshape(2, 4, 4), sees, np.array([0.0, 1.0, 0.0, 1.0]))


class Lamps(FiniteWorld):
    """State: 2·lamp + right, and the lamp that is seen.

    An answer of a network with one hidden layer is a step late, so that none earns more than
    1 − SWITCH = 0.8 a step, see `best_reward`; chance earns 0.5.
    """

    name = "lamps"
    summary = "fire while the left lamp is lit"
    inputs = (Input("left lamp"), Input("right lamp"))
    outputs = (Output("answer", "left", "right"),)
    hidden = (3,)
    presets = {"quick": Preset(0.8, 0.02, "not in the paper")}
    pomdp = _lamps()
    vectors = np.eye(2)

    def best_reward(self, topology: Topology) -> float | None:
        """½ + ½ (1 − 2 SWITCH)^d after d hidden layers; not known of other networks.

        That is the chance that the lamp is, d steps later, the one that was seen.
        """
        layers = len(topology.neuron_groups)
        if len(topology.projections) != layers:
            return None
        return 0.5 + 0.5 * float((1.0 - 2.0 * SWITCH) ** (layers - 1))


SMALL_EXAMPLE = (0.9, -0.6, -0.4, 0.8, 0.5, -0.9, 0.7, -0.8, 0.5)
"""Weights of the 2-3-1 network at which every synapse has a slope."""


def small_example() -> tuple[ExactNetwork, Array]:
    """The lamps, 2-3-1, with weights (9,) at which every synapse has a slope.

    The chain has 64 states and mixes in 3 steps; `at` with `gradient` takes about 1 ms. At β = 0.8
    and γ = 0.02 it is learnt in 60 000 steps, to 0.79 and more; at β = 0 the hidden layer only
    diffuses, and most runs stay below 0.65.
    """
    lamps = Lamps()
    return ExactNetwork(lamps.pomdp, lamps.vectors, lamps.topology()), np.array(SMALL_EXAMPLE)
