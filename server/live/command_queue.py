"""The commands that have come in, given out one by one in the order in which they came.

One after which other code is needed waits until that is compiled, and those after it wait too, but
for pausing. Of settings with no other command between them the last of each kind wins.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator

from hebbviz.server.live.commands import Command, Pause, Probe, Seek, SetSpeed, SetWatchSpeed
from hebbviz.server.live.precompile import Preparation
from hebbviz.server.run.changes import Freeze, SetBeta, SetFall, SetGamma

MOST_WAITING = 256
"""Commands beyond these are lost: nobody waits for so many."""
SETTINGS: tuple[tuple[type, ...], ...] = (
    (SetBeta, SetGamma, SetFall, Freeze),
    (Seek, Probe, SetSpeed, SetWatchSpeed),
)
"""Of those that come one after the other in a group, each makes the one of its kind before vain."""


class Inbox:
    """`prepare` begins what a command must wait for, or says None if it can be carried out."""

    def __init__(self, prepare: Callable[[Command], Preparation | None]) -> None:
        self._prepare = prepare
        self._changed = threading.Condition()
        self._waiting: deque[Command] = deque()
        self._is_new = False
        self._lost = 0
        self.preparation: Preparation | None = None
        """What is being waited for."""

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, command: Command) -> None:
        """From any thread, never blocks."""
        with self._changed:
            self._forget_vain(type(command))
            if len(self._waiting) < MOST_WAITING:
                self._waiting.append(command)
            else:
                self._lost += 1
        self.wake()

    def wake(self) -> None:
        """End the waiting of `take`, from any thread."""
        with self._changed:
            self._is_new = True
            self._changed.notify()

    def take(self, seconds: float) -> Iterator[Command]:
        """Those to be carried out now, each before the next is asked for; waits for the first
        one so long.
        """
        self.wait(seconds)
        while (command := self._next()) is not None:
            yield command

    def wait(self, seconds: float) -> None:
        """Wait at most so long for a command, or while one waits, for another."""
        with self._changed:
            if self.preparation is not None or not self._waiting:
                self._changed.wait_for(lambda: self._is_new, seconds)
            self._is_new = False

    def count_lost(self) -> int:
        """How many commands were lost since this was asked before."""
        with self._changed:
            lost, self._lost = self._lost, 0
        return lost

    def _forget_vain(self, kind: type) -> None:
        """Drop the setting that a new one of its kind makes vain, such as while a slider moves."""
        group = next((group for group in SETTINGS if kind in group), ())
        for k in reversed(range(len(self._waiting))):
            if type(self._waiting[k]) is kind and group:
                del self._waiting[k]
                return
            if type(self._waiting[k]) not in group:
                return

    def _next(self) -> Command | None:
        """The next one that need not wait."""
        if self.preparation is not None:
            return self._next_meanwhile(self.preparation)
        with self._changed:
            if not self._waiting:
                return None
            command = self._waiting.popleft()
        self.preparation = self._prepare(command)
        return command if self.preparation is None else self._next()

    def _next_meanwhile(self, preparation: Preparation) -> Command | None:
        """Pausing; or, once all is compiled, the command that waited for it."""
        with self._changed:
            for command in self._waiting:
                if isinstance(command, Pause):
                    self._waiting.remove(command)
                    return command
        if preparation.is_alive():
            return None
        self.preparation = None
        return preparation.command
