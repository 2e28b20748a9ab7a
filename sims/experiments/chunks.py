"""A long run cut into stretches of about the same time, whatever a step costs."""

from __future__ import annotations

import time
from collections.abc import Iterator


def stretches(steps: int, seconds: float) -> Iterator[int]:
    """Sizes that add up to `steps`, for a caller that runs each one before it takes the next.

    They begin at 1 and are doubled or halved until one takes about `seconds`, at most twice that.
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
