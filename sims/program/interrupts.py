"""Ctrl-C, SIGTERM and SIGHUP: they end a run at a safe point, and preparation immediately."""

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
"""Signals that end a program. Windows has no SIGHUP, which a closing terminal sends."""

T = TypeVar("T")


class Stopped(KeyboardInterrupt):
    """The signal with this number was received."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextlib.contextmanager
def raising() -> Iterator[None]:
    """Raise `Stopped` on each signal in this context, so that cleanup runs and leaves no files.

    For commands that do one thing in the main thread.
    """

    def stop(number: int, _: FrameType | None) -> None:
        raise Stopped(number)

    before = _taken(stop)
    try:
        yield
    finally:
        _put_back(before)


class Interrupts:
    """Handles the signals while entered, even if a shell made the program ignore Ctrl-C; but not a
    SIGHUP that `nohup` ignores.

    The first signal sets `stop` and its `number`. A second one raises KeyboardInterrupt, except
    SIGHUP, which a closing terminal sends more than once. Outside the main thread signals cannot
    be handled; only `stop` works there.
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
        """Return the result of `make`; raise KeyboardInterrupt as soon as `stop` is set.

        `make` runs in its own thread, because a compiler cannot be interrupted for many seconds
        and swallows exceptions. Once `stop` is set, `make` has `grace` seconds to end by itself.
        If it is still running then, the caller must end the program with `os._exit`.
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
    """Install the handler and return the previous ones; outside the main thread do nothing."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    return {s: signal.signal(s, handler) for s in SIGNALS if not _is_ignored(s)}


def _put_back(handlers: dict[signal.Signals, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, signal.SIG_DFL if handler is None else handler)


def _is_ignored(number: signal.Signals) -> bool:
    return number.name == "SIGHUP" and signal.getsignal(number) == signal.SIG_IGN
