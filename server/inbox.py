"""The commands that have come in, given out one by one in the order in which they came.

One after which other code is needed waits until that is compiled, and those after it wait too, but
for pausing.
"""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Iterator

from server.commands import Command, Pause, Seek
from server.preparing import Preparation


class Inbox:
    """`prepare` begins what a command must wait for, or says None if it can be carried out."""

    def __init__(self, prepare: Callable[[Command], Preparation | None]) -> None:
        self._prepare = prepare
        self._new: queue.SimpleQueue[Command | None] = queue.SimpleQueue()
        self._waiting: deque[Command] = deque()
        self.preparation: Preparation | None = None
        """What is being waited for."""

    def put(self, command: Command) -> None:
        """From any thread, never blocks."""
        self._new.put(command)

    def wake(self) -> None:
        """End the waiting of `take`, from any thread."""
        self._new.put(None)

    def take(self, seconds: float) -> Iterator[Command]:
        """Those to be carried out now, each before the next is asked for; waits for the first
        one so long.
        """
        self._receive(seconds)
        while (command := self._next()) is not None:
            yield command

    def _receive(self, seconds: float) -> None:
        """Fetch all that is new; a seek that another follows at once is not worth its work."""
        try:
            command = self._new.get(timeout=seconds) if seconds else self._new.get_nowait()
            while command is not None:
                last = self._waiting[-1] if self._waiting else None
                if isinstance(command, Seek) and isinstance(last, Seek):
                    self._waiting.pop()
                self._waiting.append(command)
                command = self._new.get_nowait()
        except queue.Empty:
            pass

    def _next(self) -> Command | None:
        """The next one that need not wait."""
        if self.preparation is not None:
            return self._next_meanwhile(self.preparation)
        if not self._waiting:
            return None
        command = self._waiting.popleft()
        self.preparation = self._prepare(command)
        return command if self.preparation is None else self._next()

    def _next_meanwhile(self, preparation: Preparation) -> Command | None:
        """Pausing; or, once all is compiled, the command that waited for it."""
        for command in self._waiting:
            if isinstance(command, Pause):
                self._waiting.remove(command)
                return command
        if preparation.is_alive():
            return None
        self.preparation = None
        return preparation.command
