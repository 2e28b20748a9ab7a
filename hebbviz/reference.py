"""The paper's equations in plain NumPy: one lane, float64, any topology.

This file is for reading and for checking; all faster code must agree with it.

    v_t = Σ_j w_j u^j_{t−1}                          equation (potential)
    Pr(u_t = 1) = σ(v_t)                             equation (neuron)
    z_{t+1} = β z_t + (u_t − σ(v_t)) u^j_{t−1}       equation (neuron-zupdate)
    w_{t+1} = w_t + γ r_{t+1} z_{t+1}                equation (neuron-update)

Algorithm 1 of the paper differs from these equations in its indices: it has z_{t+1} on both
sides, and its activities lag the reward by one step. This file follows the equations: a step
draws u_t from the activities u_{t−1}, adds to z, lets the world answer u_t with a reward r, and
moves w by γ r z. For activities ±1 the paper's 'essentially identical derivation' gives the
eligibility term ((u_t + 1)/2 − σ(v_t)) u^j_{t−1}.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.numerics.counter_rng import SPIKES, uniforms
from hebbviz.topology import Topology

Array = NDArray[np.float64]


def sigma(v: Array) -> Array:
    """The squashing function σ(v) = 1/(1 + e^{−v})."""
    e = np.exp(-np.abs(v))
    return np.where(v >= 0, 1.0, e) / (1.0 + e)


class Reference:
    """A network of the paper's neurons, stepped one equation at a time.

    `weights` holds one array (post, pre) per projection of the topology; `beta` and `gamma` apply
    to all projections and may change between steps. `traces` has the shapes of `weights`;
    `activities` maps each group's name to its (size,) values.
    """

    def __init__(
        self,
        topology: Topology,
        weights: list[Array],
        *,
        beta: float,
        gamma: float,
        seed: int,
        lane: int = 0,
    ) -> None:
        self.topology = topology
        self.weights = [w.astype(np.float64) for w in weights]
        self.traces = [np.zeros_like(w) for w in self.weights]
        self.beta, self.gamma = beta, gamma
        self.seed, self.lane, self.step = seed, lane, 0
        silent = topology.activity[0]
        self.activities = {
            g.name: np.full(g.size, 0.0 if g.is_input else silent) for g in topology.groups
        }
        self.fired = np.zeros(topology.neurons)

    def observe(self, x: Array) -> None:
        """Set the activities of the input groups to the (inputs,) values x."""
        for g in self.topology.input_groups:
            self.activities[g.name] = np.array(x[self.topology.units_of(g.name)])

    def potential(self, group: str) -> Array:
        """Return v_t of every neuron of a group, (size,): equation (potential)."""
        return sum(
            (
                w @ self.activities[p.pre]
                for p, w in zip(self.topology.projections, self.weights, strict=True)
                if p.post == group
            ),
            start=np.zeros(self.topology.group(group).size),
        )

    def respond(self) -> Array:
        """Draw the spikes and update the traces: equations (neuron) and (neuron-zupdate).

        Returns the activities u_t of the output group.
        """
        low, high = self.topology.activity
        draws = uniforms(
            self.topology.neurons, seed=self.seed, lane=self.lane, purpose=SPIKES, step=self.step
        )
        before, now = self.activities, dict(self.activities)
        surprise: dict[str, Array] = {}
        for g in self.topology.neuron_groups:
            neurons = self.topology.neurons_of(g.name)
            expected = sigma(self.potential(g.name))
            fired = (draws[neurons] < expected).astype(np.float64)
            self.fired[neurons] = fired
            surprise[g.name] = fired - expected
            now[g.name] = low + (high - low) * fired
        for p, z in zip(self.topology.projections, self.traces, strict=True):
            z *= self.beta
            z += np.outer(surprise[p.post], before[p.pre])
        self.activities = now
        self.step += 1
        return now[self.topology.output]

    def reinforce(self, reward: float) -> None:
        """Move the weights by γ r z: equation (neuron-update)."""
        for w, z in zip(self.weights, self.traces, strict=True):
            w += self.gamma * reward * z
