"""Pools of a run's windows, each with enough events to estimate their rate.

A window shorter than the mean time to an event mostly has none, and the few that have one would
show the window's own length. The time until the k-th event, divided by k, is right on average.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.server.run.history import Curve

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

ENOUGH = 5
"""Least number of events in a pool."""


def pools(events: Array) -> Whole:
    """The pool that each window belongs to, (windows, lanes), from its number of events.

    Pools follow each other, and end with the window that brings their events to `ENOUGH`; the
    remaining windows at the end of the run belong to the last one.
    """
    found = np.zeros(events.shape, dtype=np.int64)
    number, seen = np.zeros(events.shape[1], dtype=np.int64), np.zeros(events.shape[1])
    for window, count in enumerate(events):
        found[window] = number
        seen += count
        is_full = seen >= ENOUGH
        number += is_full
        seen[is_full] = 0.0
    return np.minimum(found, np.maximum(number - 1, 0))


def pooled(values: Array, found: Whole) -> Array:
    """Each value replaced by the sum over its pool, (windows, lanes)."""
    sums, lanes = np.zeros(values.shape), np.arange(values.shape[1])
    np.add.at(sums, (found, lanes), values)
    together: Array = sums[found, lanes]
    return together


def pooled_curve(curve: Curve, events: Array) -> Curve:
    """The curve with a window for each pool; `events` (windows,) are those of its own windows."""
    if len(events) == 0:
        return curve
    _, first = np.unique(pools(events[:, None])[:, 0], return_index=True)
    last = np.append(first[1:], len(events)) - 1
    steps, reward, broadcast, ended = (
        np.add.reduceat(column, first)
        for column in (curve.steps, curve.reward, curve.broadcast, curve.ended)
    )
    return Curve(curve.window, curve.end[last], steps, reward, broadcast, ended)


def latest(events: Array) -> int:
    """The number of last windows that hold `ENOUGH` events: all windows if there are too few
    events.
    """
    seen = np.cumsum(events[::-1])
    return min(int(np.searchsorted(seen, ENOUGH)) + 1, len(events))
