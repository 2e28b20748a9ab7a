"""The exact gradient of a small network in a finite world, to compare estimates with.

    ∇η        the exact gradient of the average reward
    E[r z]    the limit of the mean of r z at this β: the rule's gradient, including its bias
    noise/T   the variance of that mean over T steps, for T ≫ 1/(1 − β) and the mixing time

The angle between ∇η and the mean over T steps therefore falls like 1/√T, down to the bias angle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GradientTruth:
    """The exact gradient at given weights and β; arrays (synapses,) in the topology's order.

    `gradient` is ∇η, `biased` E[r z] and `noise` its variance times T. `average_reward` is η;
    `best_reward` is the largest η of a network of this topology, None if it is not known.
    """

    gradient: Array
    biased: Array
    noise: Array
    average_reward: float
    best_reward: float | None = None

    def angle(self, estimate: Array) -> float:
        """Return the angle in degrees between ∇η and an estimate; NaN if either is zero."""
        return float(angle_between(self.gradient, estimate))

    @property
    def bias_angle(self) -> float:
        """The angle in degrees between ∇η and E[r z], which more steps do not reduce."""
        return self.angle(self.biased)

    def expected_angles(self, steps: Array) -> Array:
        """Return the expected angle in degrees of the mean of r z over `steps` steps.

        The result has the shape of `steps`.
        """
        return degrees_of(expected_cosine(self.gradient, self.biased, self.noise, steps))


def expected_cosine(g: Array, m: Array, noise: Array, steps: Array | float) -> Array:
    """Return m·g / (|g| √(|m|² + Σ noise/T)) for each T of `steps`, with m = E[r z] and g = ∇η.

    The root is √E|mean|² over T steps, for T ≫ 1/(1 − β) and the mixing time. The result is NaN
    where the root or g is zero.
    """
    spread = np.maximum(m @ m + noise.sum() / steps, 0.0)  # rounding may make zero noise negative
    return np.array(m @ g / _or_nan(np.linalg.norm(g) * np.sqrt(spread)))


def angle_between(a: Array, b: Array) -> Array:
    """Return the angle in degrees between a (K,) and b, (K,) or (K, n); NaN where one is zero."""
    lengths = np.linalg.norm(a) * np.linalg.norm(b, axis=0)
    return degrees_of(a @ b / _or_nan(lengths))


def _or_nan(lengths: Array) -> Array:
    return np.where(lengths > 0.0, lengths, np.nan)


def degrees_of(cosine: Array) -> Array:
    """Return the angle in degrees of a cosine; values beyond ±1, due to rounding, are clipped."""
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
