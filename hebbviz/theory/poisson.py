"""Exact 95 % confidence intervals of Poisson counts, and of mean times to an event."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95
NONE_SEEN = -math.log(1.0 - CONFIDENCE)
"""2.996: if no event was seen, fewer than this were expected, with 95 % confidence."""

_HALVINGS = 48
_TERMS = 9.0
"""Terms of a tail, in square roots of the count; further terms are below double precision."""


@lru_cache(maxsize=65_536)
def expected_events(count: int) -> tuple[float, float]:
    """Return the 95 % interval (low, high) of a Poisson variable's mean, given one `count`.

    For at least one event it is two-sided (Garwood 1936): at either end, the count or a more
    extreme one has a probability of 2.5 %. Without an event it is one-sided, from 0 to −ln 0.05,
    because no lower end can be known. Used together, the two kinds cover at least 92.5 %.
    """
    if count == 0:
        return 0.0, NONE_SEEN
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = 0.0, float(count)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (low, middle) if _or_more(count, middle) > tail else (middle, high)
    first = low
    low, high = float(count), count + 4.0 * math.sqrt(count) + 4.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if _or_fewer(count, middle) > tail else (low, middle)
    return first, high


def time_to_event(time: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of the mean time to an event, after `count` events in `time`.

    It assumes independent events at a constant rate. Without an event the interval is from
    time/2.996 to infinity. Both ends have the unit of `time`.
    """
    low, high = expected_events(count)
    return time / high, time / low if low else math.inf


def _or_more(count: int, mean: float) -> float:
    """Return P(X ≥ count) for a mean below the count."""
    return _likelihood(count, mean) * _series(mean / (count + np.arange(1.0, _terms(count))))


def _or_fewer(count: int, mean: float) -> float:
    """Return P(X ≤ count) for a mean above the count."""
    down = np.maximum(count - np.arange(_terms(count)), 0.0)
    return _likelihood(count, mean) * _series(down / mean)


def _series(ratios: NDArray[np.float64]) -> float:
    """Return 1 + r₁ + r₁r₂ + …"""
    return 1.0 + float(np.cumprod(ratios).sum())


def _terms(count: int) -> int:
    return 20 + math.ceil(_TERMS * math.sqrt(count))


def _likelihood(count: int, mean: float) -> float:
    return math.exp(count * math.log(mean) - mean - math.lgamma(count + 1.0))
