"""Randomized policies of finitely many observations and controls, and their scores.

A policy gives μ_u(y, θ), the probability of control u at observation y, and the score

    ∇μ_u(y, θ) / μ_u(y, θ)  =  ∇ log μ_u(y, θ)

which is all that equation (zupdate) needs. Both are tables over Y observations and U controls, for
K parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hebbviz.reference import sigma

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class Policy(Protocol):
    """A parameterized randomized policy; its tables are functions of θ (K,)."""

    @property
    def parameters(self) -> int:
        """K, the size of θ."""

    def probabilities(self, theta: Array) -> Array:
        """Return μ_u(y, θ), (Y, U); every row sums to 1."""

    def score(self, theta: Array) -> Array:
        """Return ∇μ_u(y, θ) / μ_u(y, θ), (Y, U, K)."""


class Gibbs:
    """The soft-max policy μ_u(y, θ) = exp(θ·φ(y, u)) / Σ_a exp(θ·φ(y, a)).

    `features` (Y, U, K) holds φ. The score is φ(y, u) − Σ_a μ_a(y, θ) φ(y, a). Raises ValueError
    unless the features are finite and have three axes.
    """

    def __init__(self, features: Array) -> None:
        if features.ndim != 3 or not np.isfinite(features).all():
            raise ValueError(
                "features must be finite and of shape (observations, controls, parameters), "
                f"got {features.shape}"
            )
        self.features = features.astype(np.float64)

    @classmethod
    def table(cls, observations: int, controls: int) -> Gibbs:
        """Make a policy with one parameter per observation and control, fully general."""
        return cls(np.eye(observations * controls).reshape(observations, controls, -1))

    @classmethod
    def linear(cls, seen: Array, controls: int) -> Gibbs:
        """Make a policy with φ·θ = θ_u·seen(y), for `seen` (Y, features)."""
        features = np.einsum("yf,ua->yuaf", seen, np.eye(controls))
        return cls(features.reshape(len(seen), controls, -1))

    @property
    def parameters(self) -> int:
        return int(self.features.shape[2])

    def probabilities(self, theta: Array) -> Array:
        logits = self.features @ theta
        weights = np.exp(logits - logits.max(axis=1, keepdims=True))
        mu: Array = weights / weights.sum(axis=1, keepdims=True)
        return mu

    def score(self, theta: Array) -> Array:
        expected = np.einsum("yu,yuk->yk", self.probabilities(theta), self.features)
        return np.array(self.features - expected[:, None])


class Neuron:
    """The paper's neuron: it fires, u = 1, with probability σ(v), where v = Σ_j w_j u^j.

    Observation y is row y of `inputs` (Y, K), the presynaptic activities u^j; θ holds its K
    synaptic weights. The score is (u − σ(v)) u^j, the term of equation (neuron-zupdate). Raises
    ValueError unless the inputs are finite and have two axes.
    """

    def __init__(self, inputs: Array) -> None:
        if inputs.ndim != 2 or not np.isfinite(inputs).all():
            raise ValueError(
                f"inputs must be finite and of shape (observations, synapses), got {inputs.shape}"
            )
        self.inputs = inputs.astype(np.float64)

    @property
    def parameters(self) -> int:
        return int(self.inputs.shape[1])

    def probabilities(self, theta: Array) -> Array:
        v = self.inputs @ theta
        return np.stack([sigma(-v), sigma(v)], axis=1)

    def score(self, theta: Array) -> Array:
        surprise = np.array([0.0, 1.0]) - sigma(self.inputs @ theta)[:, None]
        return surprise[:, :, None] * self.inputs[:, None, :]


@dataclass(frozen=True, eq=False)
class Independent:
    """n independent agents as a single policy: the combined agent of the paper's Theorem 1.

    Agent i has the policy `agents[i]` and observes y^i = `sees[i, y]`, where y is the joint
    observation and `sees` has shape (n, Y). θ concatenates the agents' θ^i; the joint control is
    u = u^1 + U_1 (u^2 + U_2 (u^3 + …)). Given y, the agents choose independently:

        μ_u(y, θ) = Π_i μ_{u^i}(y^i, θ^i)

    Raises ValueError if there is no agent, or if `sees` has another shape.
    """

    agents: tuple[Policy, ...]
    sees: Whole

    def __post_init__(self) -> None:
        if not self.agents:
            raise ValueError("there must be at least one independent agent, got none")
        if self.sees.ndim != 2 or len(self.sees) != len(self.agents):
            raise ValueError(
                f"sees must be of shape ({len(self.agents)} agents, observations), "
                f"got {self.sees.shape}"
            )

    @property
    def parameters(self) -> int:
        return sum(agent.parameters for agent in self.agents)

    def parts(self, theta: Array) -> list[Array]:
        """Split θ into the agents' θ^i."""
        ends = np.cumsum([agent.parameters for agent in self.agents])
        return np.split(theta, ends[:-1])

    def controls(self, theta: Array) -> Whole:
        """Return the agents' controls u^i for each joint control u, (n, U)."""
        return mixed_digits([len(p[0]) for p in self._own(theta)])

    def probabilities(self, theta: Array) -> Array:
        own = self._own(theta)
        digits = mixed_digits([p.shape[1] for p in own])
        chosen = [p[y][:, u] for p, y, u in zip(own, self.sees, digits, strict=True)]
        mu: Array = np.prod(chosen, axis=0)
        return mu

    def score(self, theta: Array) -> Array:
        scores = [a.score(part) for a, part in zip(self.agents, self.parts(theta), strict=True)]
        digits = mixed_digits([s.shape[1] for s in scores])
        chosen = [s[y][:, u] for s, y, u in zip(scores, self.sees, digits, strict=True)]
        return np.concatenate(chosen, axis=2)

    def _own(self, theta: Array) -> list[Array]:
        return [
            a.probabilities(part) for a, part in zip(self.agents, self.parts(theta), strict=True)
        ]


def mixed_digits(sizes: Sequence[int]) -> Whole:
    """Return the digits of 0, 1, 2, … in the mixed base `sizes`, (n, product), first fastest."""
    places = np.cumprod([1, *sizes])
    numbers = np.arange(places[-1])
    return np.array([numbers // p % s for p, s in zip(places[:-1], sizes, strict=True)])
