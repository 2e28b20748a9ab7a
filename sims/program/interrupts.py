"""Ctrl-C, SIGTERM and SIGHUP: at a good moment while things run, and at once while they are
prepared.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""The last, of a terminal that is closed, is unknown to Windows."""

T = TypeVar("T")


class Stopped(KeyboardInterrupt):
    """A signal of this number came."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextlib.contextmanager
def raising() -> Iterator[None]:
    """Each signal raises `Stopped` in here, so that what was begun is undone and nothing is left of
    it; for commands that do one thing in the main thread.
    """

    def stop(number: int, _: FrameType | None) -> None:
        raise Stopped(number)

    before = _taken(stop)
    try:
        yield
    finally:
        _put_back(before)


class Interrupts:
    """Takes the signals while entered, also where a shell had the program ignore Ctrl-C; but not a
    SIGHUP that is ignored, as `nohup` has it.

    The first signal sets `stop`, and `number` is its number; a second one raises
    KeyboardInterrupt, except SIGHUP: a closed terminal sends it more than once, nobody's
    impatience. In a thread other than the main one signals cannot be taken, and only `stop` is
    left.
    """

    def __init__(self, stop: threading.Event | None = None) -> None:
        self.stop = threading.Event() if stop is None else stop
        self.number: int | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        self._before = _taken(self._take)
        return self

    def __exit__(self, *_: object) -> None:
        _put_back(self._before)

    def prepare(self, make: Callable[[], T], *, grace: float = 0.0) -> T:
        """What `make` returns, or KeyboardInterrupt as soon as `stop` is set.

        It is called in a thread of its own: a compiler cannot be interrupted for many seconds,
        and swallows what is raised in it. Once `stop` is set it may have a `grace` of so many
        seconds to end by itself. Whoever leaves it behind ends the program by `os._exit`.
        """
        made: list[T] = []
        failures: list[BaseException] = []

        def work() -> None:
            try:
                made.append(make())
            except BaseException as error:
                failures.append(error)

        thread = threading.Thread(target=work, name="hebbviz preparation", daemon=True)
        thread.start()
        while thread.is_alive():
            thread.join(0.05)
            if self.stop.is_set():
                thread.join(grace)
                if thread.is_alive() or not grace:
                    raise KeyboardInterrupt
        if failures:
            raise failures[0]
        return made[0]

    def _take(self, number: int, _: FrameType | None) -> None:
        if self.number is not None:
            if signal.Signals(number).name == "SIGHUP":
                return
            raise KeyboardInterrupt
        self.number = number
        self.stop.set()


def _taken(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Have the signals handled, and give what was there before; in a thread none are."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {s: signal.signal(s, handler) for s in SIGNALS if not _is_ignored(s)}


def _put_back(handlers: dict[signal.Signals, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _is_ignored(number: signal.Signals) -> bool:
    return number.name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN
