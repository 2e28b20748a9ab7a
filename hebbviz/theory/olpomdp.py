"""Direct reinforcement learning with any policy, as in section 2 of the paper.

    z_{t+1} = β z_t + ∇μ_{u_t}(y_t, θ) / μ_{u_t}(y_t, θ)        equation (zupdate)
    θ_{t+1} = θ_t + γ r_{t+1} z_{t+1}                           equation (update)

The reward r_{t+1} belongs to the state that control u_t led to, and multiplies a trace that
includes the term of u_t, as in Baxter and Bartlett's GPOMDP and in the network's rule.

OLPOMDP moves θ at every step. GPOMDP leaves θ alone and averages r z, an estimate of ∇η whose
limit is `Chain.biased_gradient` and whose variance is `Chain.noise` divided by the steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.limits import check_beta, check_gamma, check_steps
from hebbviz.theory.policies import Policy
from hebbviz.theory.pomdp import POMDP

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class Agent:
    """An agent: a policy, its parameters θ (K,), its trace z (K,), and the two equations.

    It knows its observations, its controls and the reward, but neither the state nor other agents.
    Raises ValueError if θ has another shape, or β or γ is out of range.
    """

    def __init__(self, policy: Policy, theta: Array, *, beta: float, gamma: float) -> None:
        if theta.shape != (policy.parameters,):
            raise ValueError(f"theta must have shape ({policy.parameters},), got {theta.shape}")
        self.policy = policy
        self.theta = theta.astype(np.float64)
        self.trace = np.zeros(policy.parameters)
        self.beta, self.gamma = check_beta(beta), check_gamma(gamma)

    def choose(self, y: int, draw: float) -> int:
        """Return a control for observation y, given a uniform draw in (0, 1)."""
        return _drawn(self.policy.probabilities(self.theta)[y], draw)

    def remember(self, y: int, u: int) -> None:
        """Update the trace after control u was chosen for observation y: equation (zupdate)."""
        self.trace = self.beta * self.trace + self.policy.score(self.theta)[y, u]

    def reinforce(self, reward: float) -> None:
        """Update θ with the reward that followed: equation (update)."""
        self.theta = self.theta + self.gamma * reward * self.trace


def olpomdp(world: POMDP, agent: Agent, *, steps: int, seed: int, start: int = 0) -> Array:
    """Let the agent learn for `steps` steps from state `start`; return the rewards, (steps,)."""
    draws = np.random.default_rng(seed).random((check_steps(steps), 3))
    rewards, x = np.empty(steps), start
    for t, (of_sight, of_control, of_state) in enumerate(draws):
        y = _drawn(world.observations[x], of_sight)
        u = agent.choose(y, of_control)
        agent.remember(y, u)
        x = _drawn(world.transitions[u, x], of_state)
        rewards[t] = world.rewards[x]
        agent.reinforce(rewards[t])
    return rewards


def gpomdp(
    world: POMDP, policy: Policy, theta: Array, *, beta: float, steps: int, runs: int, seed: int
) -> Array:
    """Return the mean of r z over `steps` steps in each of `runs` independent runs, (runs, K).

    The runs advance together; each starts in its own random state, with z = 0.
    """
    check_beta(beta)
    if runs < 1 or check_steps(steps) < 1:
        raise ValueError(f"runs and steps must be at least 1, got {runs} and {steps}")
    rng = np.random.default_rng(seed)
    mu, score = policy.probabilities(theta).cumsum(axis=1), policy.score(theta)
    nu, p = world.observations.cumsum(axis=1), world.transitions.cumsum(axis=2)
    x = rng.integers(world.states, size=runs)
    z = np.zeros((runs, policy.parameters))
    total = np.zeros_like(z)
    for _ in range(steps):
        of_sight, of_control, of_state = rng.random((3, runs))
        y = _first_above(nu[x], of_sight)
        u = _first_above(mu[y], of_control)
        z = beta * z + score[y, u]
        x = _first_above(p[u, x], of_state)
        total += world.rewards[x][:, None] * z
    mean: Array = total / steps
    return mean


def _drawn(probabilities: Array, draw: float) -> int:
    return int(_first_above(probabilities.cumsum()[None], np.array([draw]))[0])


def _first_above(cumulative: Array, draws: Array) -> Whole:
    """Return the first index above the draw in each row of cumulative sums (n, m).

    The last index is the default, so rounding cannot exceed it.
    """
    places: Whole = (cumulative[:, :-1] <= draws[:, None]).sum(axis=1)
    return places
