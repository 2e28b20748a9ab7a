"""A finite Markov chain whose transition probabilities depend on parameters: all of it exact.

A finite POMDP under a policy is such a chain, and so is a network of neurons in a finite world.
Nothing here is sampled and nothing is a finite difference; every figure is a linear solve.

    π P = π                            the stationary distribution π(θ)
    η = π r                            equation (eta): the long-term average of the reward
    ∇η = π ∇P Z r,  Z = (I − P + 1π)⁻¹
    E[r z] = π ∇P (I − βP)⁻¹ r         what direct reinforcement learning averages, at any β
           = Σ_d β^d π ∇P P^d r        the same by delay: d steps from an act to its reward

z is the eligibility trace of equation (zupdate), with the term of the act that led to the state
whose reward it meets. E[r z] is Baxter and Bartlett's ∇_β η (2001, 'Infinite-horizon
policy-gradient estimation'; the paper cites its Theorems 3, 4 and 6). As β → 1 it goes to ∇η. In
it P may be less its limit 1π, since ∇P 1 = 0: so it is computed, without loss at β near 1.
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
"""Steps after which a chain is said not to mix at all; a periodic one never does."""


@dataclass(frozen=True, eq=False)
class Chain:
    """P(θ) at one θ, with what its parameters do to it; S states and K parameters.

    `transition` (S, S) is P. `slope` (K, S, S) is ∇P, one matrix for each parameter: the
    probability of a step times the mean of the score ∇μ/μ over the acts that make it.
    `square` (K, S, S) is the same with the mean of the score's square; only `noise` needs it.
    `reward` (S,) is r of the state a step leads to.

    Raises
    ------
    ValueError
        If no state is reached from every state: then π and η depend on where the chain starts.
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
        """E[r z] (K,) in the long run: the limit of GPOMDP, and of the rule's Δw/γ a step."""
        biased: Array = self._start @ self._resolvent(check_beta(beta)) @ self.reward
        return biased

    def gradient_by_delay(self, delays: int) -> Array:
        """π ∇P P^d r for d = 0, 1, … (delays, K): what rewards d steps after an act say of it."""
        terms, ahead = [], self.reward
        for _ in range(delays):
            terms.append(self._start @ ahead)
            ahead = self.transition @ ahead
        return np.array(terms).reshape(delays, len(self.slope))

    def noise(self, beta: float) -> Array:
        """The variance that r z adds a step, (K,): the mean of r z over T steps has noise/T.

        That is for T long against 1/(1 − β) and the mixing time. It is Σ_n Cov(r_t z_t,
        r_{t+n} z_{t+n}) over all n, from the moments of z in each state s,

            m = E[z; s] = β m P + π ∇P
            q = E[z²; s] = β² q P + 2β m ∇P + π ∇²          ∇² the `square`

        and the sums over n ≥ 0 of E[r_t z_t; s_{t+n}] and E[r_t z_t z_{t+n}; s_{t+n}], each less
        its limit: A = (m r − cπ) Z and B = (q r − c m + A ∇P)(I − βP)⁻¹, where c = E[r z].

        As β → 1 it grows like η² E[(∇μ/μ)²]/(1 − β)², and like 1/(1 − β) where η = 0.
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
        """How well the mean of r z over `steps` steps points along ∇η: m·g / (|g| √E|mean|²).

        m is E[r z], g is ∇η, both of the parameters `of`. E|mean|² is taken to be |m|² +
        Σ noise/steps, as it is for long averages, see `noise`; at any `steps` the formula weighs
        bias against noise. Many steps, which may be infinitely many, show the bias alone; few show
        the signal per noise, and the square then grows as `steps`. It is 0 where nothing is left
        of the mean. Raises ValueError where ∇η is zero: it has no direction.
        """
        if not steps > 0:
            raise ValueError(f"steps must be above 0, got {steps}")
        g, m = self.gradient[of], self.biased_gradient(beta)[of]
        if np.linalg.norm(g) == 0.0:
            raise ValueError("the gradient of these parameters is zero: it has no direction")
        return float(np.nan_to_num(expected_cosine(g, m, self.noise(beta)[of], steps)))

    def best_beta(self, *, steps: float, of: Index = ALL) -> float:
        """The β of the largest `expected_cosine`, to 10⁻⁴, by a grid made finer four times."""
        low, high = 0.0, 0.9999
        for _ in range(4):
            grid = np.linspace(low, high, 17)
            cosines = [self.expected_cosine(float(b), steps=steps, of=of) for b in grid]
            best = int(np.argmax(cosines))
            low, high = grid[max(0, best - 1)], grid[min(16, best + 1)]
        return float(grid[best])

    @cached_property
    def relaxation_time(self) -> float:
        """1/(1 − |λ₂|) steps, λ₂ the eigenvalue of P next in size to 1; infinite if |λ₂| = 1.

        The bound of Theorem 4 of Baxter and Bartlett (2001) on the bias of E[r z] is a multiple
        of (1 − β)/(1 − β|λ₂|): small where 1/(1 − β) is large against this time.
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
        """π ∇P, (K, S): how the parameters move the state one step ahead."""
        return np.ascontiguousarray(self.stationary @ self.slope)

    def _ahead(self, rows: Array, beta: float) -> Array:
        """Σ_d β^d rows P^d = rows (I − βP)⁻¹, (K, S).

        What the rows sum to is added up by itself, so that β near 1 costs no digits.
        """
        stays = beta / (1.0 - beta) * rows.sum(axis=1, keepdims=True) * self.stationary
        ahead: Array = rows @ self._resolvent(beta) + stays
        return ahead

    def _resolvent(self, beta: float) -> Array:
        """(I − β(P − 1π))⁻¹, (S, S); Z at β = 1."""
        p = self.transition - self.stationary
        return np.array(np.linalg.inv(np.eye(len(p)) - beta * p))


def _each(rows: Array, matrices: Array) -> Array:
    """Row k times matrix k: (K, S) and (K, S, S) to (K, S)."""
    product: Array = (rows[:, None, :] @ matrices)[:, 0]
    return product


def _apart(power: Array) -> float:
    """The largest total-variation distance between two rows."""
    return max(float(0.5 * np.abs(power - row).sum(axis=1).max()) for row in power)


def _has_one_class(transition: Array) -> bool:
    """Whether some state is reached from every state, by squaring 'in one step or none'."""
    reached = (transition > 0.0) | np.eye(len(transition), dtype=bool)
    for _ in range(len(transition).bit_length()):
        reached = reached.astype(np.float32) @ reached.astype(np.float32) > 0.0
    return bool(reached.all(axis=0).any())
