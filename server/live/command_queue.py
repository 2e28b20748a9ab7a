"""The queue of commands, which are handed out one by one in order of arrival.

A command that needs newly compiled code waits for it, and later commands wait too, except pausing.
Among consecutive settings the last of each kind wins.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator

from hebbviz.server.live.commands import Command, Pause, Probe, Seek, SetSpeed, SetWatchSpeed
from hebbviz.server.live.precompile import Preparation
from hebbviz.server.run.changes import Freeze, SetBeta, SetFall, SetGamma

MOST_WAITING = 256
"""Commands beyond this number are lost."""
SETTINGS: tuple[tuple[type, ...], ...] = (
    (SetBeta, SetGamma, SetFall, Freeze),
    (Seek, Probe, SetSpeed, SetWatchSpeed),
)
"""Settings: a new one replaces a waiting one of its kind, if no other command is between them."""


class Inbox:
    """`prepare` starts what a command must wait for, or returns None if it can be carried out."""

    def __init__(self, prepare: Callable[[Command], Preparation | None]) -> None:
        self._prepare = prepare
        self._changed = threading.Condition()
        self._waiting: deque[Command] = deque()
        self._is_new = False
        self._lost = 0
        self.preparation: Preparation | None = None
        """The preparation that a command waits for."""

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, command: Command) -> None:
        """Add a command; from any thread, never blocks."""
        with self._changed:
            self._forget_vain(type(command))
            if len(self._waiting) < MOST_WAITING:
                self._waiting.append(command)
            else:
                self._lost += 1
        self.wake()

    def wake(self) -> None:
        """Wake a waiting `take`, from any thread."""
        with self._changed:
            self._is_new = True
            self._changed.notify()

    def take(self, seconds: float) -> Iterator[Command]:
        """The commands to carry out now, each before the next is taken; waits at most `seconds` for
        the first.
        """
        self.wait(seconds)
        while (command := self._next()) is not None:
            yield command

    def wait(self, seconds: float) -> None:
        """Wait at most `seconds` for a command, or for another one while one waits."""
        with self._changed:
            if self.preparation is not None or not self._waiting:
                self._changed.wait_for(lambda: self._is_new, seconds)
            self._is_new = False

    def count_lost(self) -> int:
        """Number of commands lost since the last call."""
        with self._changed:
            lost, self._lost = self._lost, 0
        return lost

    def _forget_vain(self, kind: type) -> None:
        """Drop the setting that a new one of its kind replaces, as while a slider moves."""
        group = next((group for group in SETTINGS if kind in group), ())
        for k in reversed(range(len(self._waiting))):
            if type(self._waiting[k]) is kind and group:
                del self._waiting[k]
                return
            if type(self._waiting[k]) not in group:
                return

    def _next(self) -> Command | None:
        """The next command that need not wait."""
        if self.preparation is not None:
            return self._next_meanwhile(self.preparation)
        with self._changed:
            if not self._waiting:
                return None
            command = self._waiting.popleft()
        self.preparation = self._prepare(command)
        return command if self.preparation is None else self._next()

    def _next_meanwhile(self, preparation: Preparation) -> Command | None:
        """A pause command; or, once compiling is done, the command that waited for it."""
        with self._changed:
            for command in self._waiting:
                if isinstance(command, Pause):
                    self._waiting.remove(command)
                    return command
        if preparation.is_alive():
            return None
        self.preparation = None
        return preparation.command
