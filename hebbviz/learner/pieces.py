"""Long calls cut into pieces of a fraction of a second, for signals to act and progress to show.

Compiled code cannot be interrupted. A run does not depend on where it is cut, so between two pieces
Python may look around: Ctrl-C raises there, and whoever waits can be told how far it is.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar

AIM_SECONDS = 0.25
"""A piece takes about as long as this, at most twice."""

Between = Callable[[int, int], object]
"""Told how many steps of a call are made, and of how many. What it raises ends the call."""

_between: ContextVar[Between | None] = ContextVar("between", default=None)


class Stopped(BaseException):
    """A call was no longer wanted. No error: a task that forgives all of its own lets it pass."""


@contextlib.contextmanager
def between_pieces(call: Between) -> Iterator[None]:
    """Have `call` called between the pieces of all runs of learners in here, in this thread."""
    token = _between.set(call)
    try:
        yield
    finally:
        _between.reset(token)


def stop_when(is_over: Callable[[], bool]) -> contextlib.AbstractContextManager[None]:
    """End what runs in here, by Stopped, soon after `is_over` says so."""

    def look(_: int, __: int) -> None:
        if is_over():
            raise Stopped

    return between_pieces(look)


def tell(made: int, steps: int) -> None:
    """So many steps of a call are made, of so many."""
    call = _between.get()
    if call is not None:
        call(made, steps)


class Pieces:
    """Cuts calls by how long the piece before took; the very first piece is one step."""

    def __init__(self) -> None:
        self._size = 1

    def of(self, steps: int) -> Iterator[slice]:
        """Which of the steps come next, for a caller that runs each piece before it takes the next;
        what a `between_pieces` raises is raised here.
        """
        made = 0
        while made < steps:
            size, began = min(self._size, steps - made), time.perf_counter()
            yield slice(made, made + size)
            self._adapt(size, time.perf_counter() - began)
            made += size
            tell(made, steps)

    def _adapt(self, size: int, seconds: float) -> None:
        if size == self._size and seconds < AIM_SECONDS / 2:
            self._size *= 2
        elif seconds > 2 * AIM_SECONDS:
            self._size = max(1, int(size * AIM_SECONDS / seconds))
