"""Pieces: long calls are cut to a fraction of a second, for signals and progress reports.

Compiled code cannot be interrupted. A run does not depend on where it is cut, so Python takes over
between two pieces: Ctrl-C raises there, and callers receive the progress.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar

AIM_SECONDS = 0.25
"""A piece takes about as long as this, at most twice."""

Between = Callable[[int, int], object]
"""Receives the number of completed steps and that of all steps; an exception ends the call."""

_between: ContextVar[Between | None] = ContextVar("between", default=None)


class Stopped(BaseException):
    """The caller ended the call. Not an Exception: a task that catches those lets it pass."""


@contextlib.contextmanager
def between_pieces(call: Between) -> Iterator[None]:
    """Call `call` between the pieces of all learner runs in this context and thread."""
    token = _between.set(call)
    try:
        yield
    finally:
        _between.reset(token)


def stop_when(is_over: Callable[[], bool]) -> contextlib.AbstractContextManager[None]:
    """End runs in this context with Stopped, soon after `is_over` returns True."""

    def look(_: int, __: int) -> None:
        if is_over():
            raise Stopped

    return between_pieces(look)


def tell(made: int, steps: int) -> None:
    """Report that `made` of `steps` steps of a call are complete."""
    call = _between.get()
    if call is not None:
        call(made, steps)


class Pieces:
    """Chooses the size of each piece from the duration of the last; the first piece is one step."""

    def __init__(self) -> None:
        self._size = 1

    def of(self, steps: int) -> Iterator[slice]:
        """Yield slices of the steps; the caller runs each before it takes the next.

        Exceptions of a `between_pieces` callback are raised here.
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
