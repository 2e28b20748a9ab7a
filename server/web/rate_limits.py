"""Limits a page's messages to manual speed: the last of each value wins, and presses are counted.

Nothing here knows of clocks or sockets. All times are in seconds, of any clock.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable

SHORTEST_PAUSE = 0.03
"""Who has to wait waits at least so long, and then goes on with several at once."""
MESSAGES_PER_SECOND, ALL_MESSAGES_PER_SECOND = 150.0, 600.0
"""Handed on from one page, and from all of them."""
READS_PER_SECOND, ALL_READS_PER_SECOND = 4000.0, 8000.0
"""Read and checked from one connection, and from all of them; the rest waits with its sender."""
PRESSES_PER_SECOND = 30.0
"""Of a page's buttons, keys and clicks; as fast as a key that is held down repeats."""
MOST_PRESSES = 30
"""Presses that wait; more are lost."""


class Allowance:
    """Allows `most` uses in `seconds`; up to `most` unused ones accumulate."""

    def __init__(self, most: float, seconds: float = 1.0) -> None:
        self._most = self._left = most
        self._rate, self._at = most / seconds, 0.0

    def wait(self, now: float, *, share: float = 1.0) -> float:
        """Take one and return 0, or return how long to wait; `share` is what part is allowed."""
        rate = self._rate * share
        saved = self._left + (now - self._at) * rate
        self._left, self._at = min(max(1.0, self._most * share), saved), now
        if self._left < 1.0:
            return max(SHORTEST_PAUSE, (1.0 - self._left) / rate)
        self._left -= 1.0
        return 0.0


class TimeShare:
    """Allows a share of the time, of which up to `seconds` accumulate; a debt lasts at most 1 s."""

    def __init__(self, share: float, seconds: float) -> None:
        self._share, self._most = share, seconds
        self._left, self._at = seconds, 0.0

    def is_left(self, now: float, *, spent: float = 0.0) -> bool:
        """Whether there is more than what is spent already."""
        self._left = min(self._most, self._left + (now - self._at) * self._share)
        self._at = now
        return self._left > spent

    def spend(self, seconds: float) -> None:
        self._left = max(-self._share, self._left - seconds)


class Inflow:
    """The messages of one page that are still to be handed on, in their order.

    Of those with one key, such as the values of one slider, only the last is kept. Those without a
    key are presses.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, bytes] = {}
        self._numbers = itertools.count()
        self._messages = Allowance(MESSAGES_PER_SECOND)
        self._pressed = Allowance(PRESSES_PER_SECOND)
        self._presses = 0

    def put(self, key: Hashable | None, message: bytes) -> bool:
        """Returns False if it is lost, for there were too many."""
        if key is None:
            if self._presses >= MOST_PRESSES:
                return False
            self._presses += 1
            key = _Press(next(self._numbers))
        self._waiting.pop(key, None)
        self._waiting[key] = message
        return True

    def take(self, now: float, *, share: float = 1.0) -> bytes | float | None:
        """The next message; or how long to wait for it, or None where there is none."""
        if not self._waiting:
            return None
        key = next(iter(self._waiting))
        wait = self._pressed.wait(now) if isinstance(key, _Press) else 0.0
        wait = wait or self._messages.wait(now, share=share)
        if wait:
            return wait
        self._presses -= isinstance(key, _Press)
        return self._waiting.pop(key)

    def __len__(self) -> int:
        return len(self._waiting)


class _Press(int):
    """The number of a press."""
