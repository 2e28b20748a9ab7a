"""Finite partially observable Markov decision processes: section 2 of the paper.

    x_t → y_t ~ ν(x_t)          observation of the state
    y_t → u_t ~ μ(y_t, θ)       control by the agent
    x_{t+1} ~ row x_t of P(u_t)
    r_{t+1} = r(x_{t+1})        reward in the state that the control led to

Under a policy the states are a Markov chain with

    P(θ)_ij = Σ_y ν_y(i) Σ_u μ_u(y, θ) p_ij(u)

`markov_chain.py` gives its average reward, gradient and mixing time exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.theory.markov_chain import Chain
from hebbviz.theory.policies import Gibbs, Policy

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Largest deviation of a probability row's sum from 1."""


@dataclass(frozen=True, eq=False)
class POMDP:
    """A finite world: S states, Y observations, U controls. Its arrays are read-only copies.

    `transitions` (U, S, S) holds P(u) for every control, `observations` (S, Y) holds ν,
    `rewards` (S,) holds r.

    Raises
    ------
    ValueError
        If shapes do not fit, a number is not finite, or a row is not a probability distribution.
    """

    transitions: Array
    observations: Array
    rewards: Array

    def __post_init__(self) -> None:
        for name in ("transitions", "observations", "rewards"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        _check_shapes(self.transitions.shape, self.observations.shape, self.rewards.shape)
        _check_rows("transitions", self.transitions)
        _check_rows("observations", self.observations)
        if not np.isfinite(self.rewards).all():
            raise ValueError(f"rewards must be finite numbers, got {self.rewards}")

    @property
    def controls(self) -> int:
        return len(self.transitions)

    @property
    def states(self) -> int:
        return len(self.rewards)

    @property
    def sights(self) -> int:
        """Y, the number of different observations."""
        return int(self.observations.shape[1])

    def under(self, policy: Policy, theta: Array) -> Chain:
        """Return the chain of states under `policy` with parameters θ (K,).

        Raises ValueError if the policy does not fit this world's observations and controls, or if
        the average reward depends on the initial state (see `Chain`).
        """
        mu, score = policy.probabilities(theta), policy.score(theta)
        if mu.shape != (self.sights, self.controls):
            raise ValueError(
                f"the policy has {mu.shape[0]} observations and {mu.shape[1]} controls, "
                f"the world {self.sights} and {self.controls}"
            )
        slope, square = (self._by_step(mu[:, :, None] * s) for s in (score, score * score))
        transition = self._by_step(mu[:, :, None])[0]
        return Chain(transition, slope, square, self.rewards)

    def lazy(self, stays: float) -> POMDP:
        """Return a world that keeps its state with probability `stays` in [0, 1) at each step.

        Under every policy π and η are the same, and each eigenvalue λ of P becomes
        stays + (1 − stays) λ: the gap 1 − λ shrinks by the factor 1 − stays.
        """
        if not 0.0 <= stays < 1.0:
            raise ValueError(f"stays must be in [0, 1), got {stays}")
        slower = stays * np.eye(self.states) + (1.0 - stays) * self.transitions
        return POMDP(slower, self.observations, self.rewards)

    def _by_step(self, weights: Array) -> Array:
        """Return Σ_y ν_y(i) Σ_u weights(y, u, k) p_ij(u), from (Y, U, K) to (K, S, S)."""
        by_state = np.tensordot(self.observations, weights, axes=1)
        steps = by_state.transpose(0, 2, 1) @ self.transitions.transpose(1, 0, 2)
        return steps.transpose(1, 0, 2)


def three_state_chain() -> tuple[POMDP, Gibbs]:
    """Make the three-state world of Baxter and Bartlett and their soft-max policy of 4 weights.

    Source: 'Infinite-horizon policy-gradient estimation' and its companion 'Experiments with
    infinite-horizon, policy-gradient estimation' (2001). The states are A, B, C; the reward is 1
    in C and 0 elsewhere. Always choosing the second control gives the best average reward, 0.8.
    """
    first = [[0.0, 0.8, 0.2], [0.8, 0.0, 0.2], [0.0, 0.8, 0.2]]
    second = [[0.0, 0.2, 0.8], [0.2, 0.0, 0.8], [0.0, 0.2, 0.8]]
    seen = np.array([[12.0, 6.0], [6.0, 12.0], [5.0, 5.0]]) / 18.0
    world = POMDP(np.array([first, second]), np.eye(3), np.array([0.0, 0.0, 1.0]))
    return world, Gibbs.linear(seen, 2)


def _check_shapes(p: tuple[int, ...], nu: tuple[int, ...], r: tuple[int, ...]) -> None:
    if len(p) != 3 or p[1] != p[2] or 0 in p:
        raise ValueError(f"transitions must have shape (controls, states, states), got {p}")
    if len(nu) != 2 or nu[0] != p[1] or 0 in nu:
        raise ValueError(f"observations must have shape ({p[1]} states, observations), got {nu}")
    if r != (p[1],):
        raise ValueError(f"rewards must have shape ({p[1]} states,), got {r}")


def _check_rows(name: str, rows: Array) -> None:
    bad = ~((rows >= 0.0) & np.isfinite(rows)).all(axis=-1)
    if bad.any():
        where = tuple(map(int, np.argwhere(bad)[0]))
        raise ValueError(f"{name} must be finite and >= 0, row {where} is {rows[where]}")
    off = np.abs(rows.sum(axis=-1) - 1.0) > ROUNDING
    if off.any():
        where = tuple(map(int, np.argwhere(off)[0]))
        raise ValueError(f"{name} must sum to 1, row {where} sums to {rows[where].sum():.12g}")
