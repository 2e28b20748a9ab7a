"""A finite Markov chain whose transition probabilities depend on parameters, solved exactly.

A finite POMDP under a policy is such a chain, and so is a network of neurons in a finite world.
All values come from linear solves, without sampling or finite differences.

    π P = π                            the stationary distribution π(θ)
    η = π r                            equation (eta): the long-term average of the reward
    ∇η = π ∇P Z r,  Z = (I − P + 1π)⁻¹
    E[r z] = π ∇P (I − βP)⁻¹ r         the mean of direct reinforcement learning, at any β
           = Σ_d β^d π ∇P P^d r        the same by delay: d steps from an act to its reward

z is the eligibility trace of equation (zupdate); it includes the term of the act that led to the
rewarded state. E[r z] is Baxter and Bartlett's ∇_β η (2001, 'Infinite-horizon policy-gradient
estimation'; the paper cites its Theorems 3, 4 and 6) and tends to ∇η as β → 1. Since ∇P 1 = 0, P
may be replaced by P − 1π in it; the code does so, to lose no precision at β near 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hebbviz.limits import check_beta
from hebbviz.theory.exact_gradient import expected_cosine

Array = NDArray[np.float64]

Index = slice | NDArray[np.int64]
ALL = slice(None)

STILL_UNMIXED = 2**40
"""A chain that has not mixed after this many steps is taken never to mix, like a periodic one."""


@dataclass(frozen=True, eq=False)
class Chain:
    """P(θ) at one θ and its derivatives, for S states and K parameters.

    `transition` (S, S) is P. `slope` (K, S, S) is ∇P, one matrix per parameter: the probability of
    a step times the mean score ∇μ/μ over the acts that cause it. `square` (K, S, S) is the same
    with the mean squared score; only `noise` needs it. `reward` (S,) is r of the state that a step
    leads to.

    Raises
    ------
    ValueError
        If no state is reachable from all states: π and η would depend on the initial state.
    """

    transition: Array
    slope: Array
    square: Array
    reward: Array

    def __post_init__(self) -> None:
        if not _has_one_class(self.transition):
            raise ValueError(
                "the chain must have one recurrent class: no state is reached from all others, so "
                "the average reward depends on the start; make some transitions possible"
            )

    @cached_property
    def stationary(self) -> Array:
        """π (S,), the solution of π(I − P + 11ᵀ) = 1ᵀ."""
        ones = np.ones(len(self.transition))
        return np.array(np.linalg.solve((np.eye(len(ones)) - self.transition).T + 1.0, ones))

    @cached_property
    def fundamental(self) -> Array:
        """Kemeny and Snell's matrix Z = (I − P + 1π)⁻¹, (S, S)."""
        return self._resolvent(1.0)

    @property
    def average_reward(self) -> float:
        """η, equation (eta)."""
        return float(self.stationary @ self.reward)

    @cached_property
    def gradient(self) -> Array:
        """∇η (K,)."""
        gradient: Array = self._start @ (self.fundamental @ self.reward)
        return gradient

    def biased_gradient(self, beta: float) -> Array:
        """Return E[r z] (K,), the long-run limit of GPOMDP and of the rule's Δw/γ per step."""
        biased: Array = self._start @ self._resolvent(check_beta(beta)) @ self.reward
        return biased

    def gradient_by_delay(self, delays: int) -> Array:
        """Return π ∇P P^d r for d = 0, 1, …, (delays, K): the part due to rewards d steps later."""
        terms, ahead = [], self.reward
        for _ in range(delays):
            terms.append(self._start @ ahead)
            ahead = self.transition @ ahead
        return np.array(terms).reshape(delays, len(self.slope))

    def noise(self, beta: float) -> Array:
        """Return the noise (K,): the mean of r z over T steps has the variance noise/T.

        This holds for T ≫ 1/(1 − β) and the mixing time. The noise is Σ_n Cov(r_t z_t,
        r_{t+n} z_{t+n}) over all n. It follows from the moments of z in each state s,

            m = E[z; s] = β m P + π ∇P
            q = E[z²; s] = β² q P + 2β m ∇P + π ∇²          ∇² is `square`

        and the sums over n ≥ 0 of E[r_t z_t; s_{t+n}] and E[r_t z_t z_{t+n}; s_{t+n}], each minus
        its limit: A = (m r − cπ) Z and B = (q r − c m + A ∇P)(I − βP)⁻¹, where c = E[r z].

        As β → 1 the noise grows like η² E[(∇μ/μ)²]/(1 − β)², or like 1/(1 − β) if η = 0.
        """
        r, pi = self.reward, self.stationary
        m = self._start @ self._resolvent(check_beta(beta))
        q = self._ahead(2.0 * beta * _each(m, self.slope) + pi @ self.square, beta * beta)
        c = (m @ r)[:, None]
        a = (m * r - c * pi) @ self.fundamental
        b = self._ahead(q * r - c * m + _each(a, self.slope), beta)
        at_once = (q * r - c * m) @ r
        noise: Array = 2.0 * b @ r - at_once
        return noise

    def expected_cosine(self, beta: float, *, steps: float, of: Index = ALL) -> float:
        """Return how well the mean of r z over `steps` steps aligns with ∇η: m·g / (|g| √E|mean|²).

        m is E[r z] and g is ∇η, both for the parameters `of`. E|mean|² is |m|² + Σ noise/steps,
        which is exact for long averages, see `noise`; at any `steps` the formula weighs bias
        against noise. For many steps (infinity is allowed) only the bias matters; for few steps
        only the signal-to-noise ratio, and the square then grows in proportion to `steps`. The
        result is 0 if the mean is zero. Raises ValueError if ∇η is zero and has no direction.
        """
        if not steps > 0:
            raise ValueError(f"steps must be above 0, got {steps}")
        g, m = self.gradient[of], self.biased_gradient(beta)[of]
        if np.linalg.norm(g) == 0.0:
            raise ValueError("the gradient of these parameters is zero: it has no direction")
        return float(np.nan_to_num(expected_cosine(g, m, self.noise(beta)[of], steps)))

    def best_beta(self, *, steps: float, of: Index = ALL) -> float:
        """Return the β of the largest `expected_cosine`, to 10⁻⁴, by four grid searches."""
        low, high = 0.0, 0.9999
        for _ in range(4):
            grid = np.linspace(low, high, 17)
            cosines = [self.expected_cosine(float(b), steps=steps, of=of) for b in grid]
            best = int(np.argmax(cosines))
            low, high = grid[max(0, best - 1)], grid[min(16, best + 1)]
        return float(grid[best])

    @cached_property
    def relaxation_time(self) -> float:
        """1/(1 − |λ₂|) steps, with λ₂ the second-largest eigenvalue of P; infinite if |λ₂| = 1.

        Theorem 4 of Baxter and Bartlett (2001) bounds the bias of E[r z] by a multiple of
        (1 − β)/(1 − β|λ₂|), which is small if 1/(1 − β) is much longer than this time.
        """
        sizes = np.sort(np.abs(np.linalg.eigvals(self.transition)))
        second = float(sizes[-2]) if len(sizes) > 1 else 0.0
        return 1.0 / (1.0 - second) if second < 1.0 - 1e-12 else float("inf")

    @cached_property
    def mixing_time(self) -> float:
        """The first t with max over i, j of ½ Σ_s |(P^t)_is − (P^t)_js| ≤ 1/e, in steps.

        The total-variation time of Bartlett and Baxter (2002, 'Estimation and approximation
        bounds for gradient-based reinforcement learning'); infinite for a chain that never mixes.
        """
        powers = [self.transition]
        while _apart(powers[-1]) > np.exp(-1.0):
            if 2 ** len(powers) > STILL_UNMIXED:
                return float("inf")
            powers.append(powers[-1] @ powers[-1])
        unmixed, steps = np.eye(len(self.transition)), 0
        for k in reversed(range(len(powers) - 1)):
            longer = unmixed @ powers[k]
            if _apart(longer) > np.exp(-1.0):
                unmixed, steps = longer, steps + 2**k
        return float(steps + 1)

    @cached_property
    def _start(self) -> Array:
        """π ∇P, (K, S): the effect of the parameters on the state one step later."""
        return np.ascontiguousarray(self.stationary @ self.slope)

    def _ahead(self, rows: Array, beta: float) -> Array:
        """Return Σ_d β^d rows P^d = rows (I − βP)⁻¹, (K, S).

        The sum of each row is treated separately, so β near 1 loses no precision.
        """
        stays = beta / (1.0 - beta) * rows.sum(axis=1, keepdims=True) * self.stationary
        ahead: Array = rows @ self._resolvent(beta) + stays
        return ahead

    def _resolvent(self, beta: float) -> Array:
        """Return (I − β(P − 1π))⁻¹, (S, S), which is Z at β = 1."""
        p = self.transition - self.stationary
        return np.array(np.linalg.inv(np.eye(len(p)) - beta * p))


def _each(rows: Array, matrices: Array) -> Array:
    """Multiply row k by matrix k: (K, S) and (K, S, S) to (K, S)."""
    product: Array = (rows[:, None, :] @ matrices)[:, 0]
    return product


def _apart(power: Array) -> float:
    """Return the largest total-variation distance between two rows."""
    return max(float(0.5 * np.abs(power - row).sum(axis=1).max()) for row in power)


def _has_one_class(transition: Array) -> bool:
    """Whether some state is reachable from all states, by squaring 'in at most one step'."""
    reached = (transition > 0.0) | np.eye(len(transition), dtype=bool)
    for _ in range(len(transition).bit_length()):
        reached = reached.astype(np.float32) @ reached.astype(np.float32) > 0.0
    return bool(reached.all(axis=0).any())
