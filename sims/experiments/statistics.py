"""Statistics over the last axis, the lanes, for values that may be infinite."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def deviation_of(values: Array, axis: int = -1) -> Array:
    """Return the sample standard deviation, with n − 1; NaN for a single value."""
    if values.shape[axis] > 1:
        spread: Array = np.std(values, axis=axis, ddof=1)
        return spread
    return np.full_like(values.mean(axis=axis), np.nan)


def quantiles(values: Array, shares: Sequence[float]) -> Array:
    """Return quantiles over the last axis, from (..., lanes) to (shares, ...).

    They equal NumPy's default quantiles, and also handle infinite values.
    """
    ranked = np.sort(values, axis=-1)
    place = np.asarray(shares) * (values.shape[-1] - 1)
    below, above = np.floor(place).astype(int), np.ceil(place).astype(int)
    low, high = np.moveaxis(ranked[..., below], -1, 0), np.moveaxis(ranked[..., above], -1, 0)
    with np.errstate(invalid="ignore"):
        steps = (high - low) * (place - below).reshape(-1, *[1] * (low.ndim - 1))
    return np.where(low == high, low, low + steps)


def median(values: Array) -> Array:
    """Return the median over the last axis; values may be infinite."""
    middle: Array = quantiles(values, (0.5,))[0]
    return middle
