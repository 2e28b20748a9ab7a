"""The settings of a run: everything that a learner is made from, except its task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hebbviz.rules.base import Rule
from hebbviz.topology import Topology


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings of a run, as `Learner` takes them; they are checked there.

    Attributes:
        topology: The network.
        beta: Trace decay β, in [0, 1).
        gamma: Step size γ, before any decay.
        fall: T in steps: γ in force at step t is γ T/(T + t); infinity for a constant γ.
        rule: The learning rule.
        seed: 0 to 2³² − 1, of all lanes.
        lanes: Number of replicas.
        first_lane: Number of the first replica.
        dtype: Type of weights, traces and potentials: float64 or float32.
        written_out: Whether `skip` runs code compiled for this network alone.
        frozen: Whether the weights are held.
    """

    topology: Topology
    beta: float
    gamma: float
    fall: float
    rule: Rule
    seed: int = 0
    lanes: int = 1
    first_lane: int = 0
    dtype: type[np.floating[Any]] | str = np.float64
    written_out: bool = False
    frozen: bool = False
