"""Windows of a run summed up until enough events came, so that each sum tells their rate.

A window shorter than the mean time to an event mostly sees none, and the few that see one would
show the window's own length. The time until the k-th event, divided by k, is right on average.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.server.run.history import Curve

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

ENOUGH = 5
"""Events of a pool, at least."""


def pools(events: Array) -> Whole:
    """The pool that each window belongs to, (windows, lanes), from its number of events.

    Pools follow each other, and end with the window that brings their events to `ENOUGH`; what is
    left at the end of the run belongs to the last one.
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
    """In place of each value the sum over its pool, both (windows, lanes)."""
    sums, lanes = np.zeros(values.shape), np.arange(values.shape[1])
    np.add.at(sums, (found, lanes), values)
    together: Array = sums[found, lanes]
    return together


def pooled_curve(curve: Curve, events: Array) -> Curve:
    """The curve with a window for each pool; `events` (windows,) were seen in its own."""
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
    """How many of the windows at the end hold `ENOUGH` events: all of them if they never do."""
    seen = np.cumsum(events[::-1])
    return min(int(np.searchsorted(seen, ENOUGH)) + 1, len(events))
