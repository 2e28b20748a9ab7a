"""What is known exactly of a small network in a finite world, to hold an estimate against.

    ∇η        the true gradient of the average reward
    E[r z]    what the mean of r z goes to at this β: the rule's gradient, bias and all
    noise/T   the variance of that mean over T steps, T long against 1/(1 − β) and the mixing

So the angle between ∇η and the mean over T steps falls like 1/√T, down to the angle of the bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GradientTruth:
    """Of one network at its weights and β; arrays (synapses,) in the topology's order.

    `average_reward` is η; `best_reward` the most that a network of this topology can earn, None
    if that is not known.
    """

    gradient: Array
    biased: Array
    noise: Array
    average_reward: float
    best_reward: float | None = None

    def angle(self, estimate: Array) -> float:
        """Degrees between ∇η and an estimate of it; NaN where either has no direction."""
        return float(angle_between(self.gradient, estimate))

    @property
    def bias_angle(self) -> float:
        """Degrees between ∇η and E[r z]: what no number of steps takes away."""
        return self.angle(self.biased)

    def expected_angles(self, steps: Array) -> Array:
        """Degrees to be expected of the mean of r z over so many steps, as `steps` in shape."""
        return degrees_of(expected_cosine(self.gradient, self.biased, self.noise, steps))


def expected_cosine(g: Array, m: Array, noise: Array, steps: Array | float) -> Array:
    """cos = m·g / (|g| √(|m|² + Σ noise/T)) for each T of `steps`, m being E[r z], g being ∇η.

    The root is that of E|mean|² over T steps, T long against 1/(1 − β) and the mixing. NaN where
    it or g is zero.
    """
    spread = np.maximum(m @ m + noise.sum() / steps, 0.0)  # no noise may be less by rounding
    return np.array(m @ g / _or_nan(np.linalg.norm(g) * np.sqrt(spread)))


def angle_between(a: Array, b: Array) -> Array:
    """Degrees from one vector (K,) to another, or to each of (K, n); NaN where one is zero."""
    lengths = np.linalg.norm(a) * np.linalg.norm(b, axis=0)
    return degrees_of(a @ b / _or_nan(lengths))


def _or_nan(lengths: Array) -> Array:
    return np.where(lengths > 0.0, lengths, np.nan)


def degrees_of(cosine: Array) -> Array:
    """The angle of a cosine, which rounding may have put beyond ±1."""
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
