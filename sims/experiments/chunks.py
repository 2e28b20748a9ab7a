"""Chunks: a long run is cut into parts of about equal duration, whatever a step costs."""

from __future__ import annotations

import time
from collections.abc import Iterator


def stretches(steps: int, seconds: float) -> Iterator[int]:
    """Yield sizes that add up to `steps`; the caller runs each before it takes the next.

    The size starts at 1 and is doubled or halved until a chunk takes about `seconds`, at most twice
    that.
    """
    size = 1
    while steps > 0:
        size, began = min(size, steps), time.perf_counter()
        yield size
        steps -= size
        took = time.perf_counter() - began
        if took < seconds / 2:
            size *= 2
        elif took > 2 * seconds:
            size = max(1, size // 2)
