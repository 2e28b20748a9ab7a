"""viser's buffer of messages to pages, without its race and without its walk; see docs/viser.md.

viser numbers messages from 0 for as long as the server runs, and keeps only the newest of each key.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile

from viser.infra import _infra as viser_infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._messages import Message

ALL_WINDOWS_PER_SECOND = 250.0
"""Of all clients: each window is packed for each of them, so where many look on the frame rate of
each is less.
"""


def install() -> None:
    """Let every viser server of this process use this buffer."""
    vars(viser_infra)["AsyncMessageBuffer"] = MessageBuffer


class ThreadsafeEvent(asyncio.Event):
    """An event that any thread may set: its waiters are touched in their loop alone."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._of, self._asked, self._lock = loop, False, threading.Lock()

    def set(self) -> None:
        """Set it soon; asked many times before the loop comes to it, it is set once."""
        with self._lock:
            asked, self._asked = self._asked, True
        if not asked:
            try:
                self._of.call_soon_threadsafe(self._set)
            except RuntimeError:  # the loop has ended, and nobody waits
                self._asked = False

    def _set(self) -> None:
        with self._lock:
            self._asked = False
        super().set()


@dataclass
class _Place:
    """How far a client is: all up to the `cursor` is dealt with, `pending` comes next."""

    cursor: int = -1
    pending: deque[int] = field(default_factory=deque)


class MessageBuffer(AsyncMessageBuffer):
    """Wakes its loop only thread-safely, and visits only messages that are still there."""

    def __init__(self, event_loop: asyncio.AbstractEventLoop, persistent_messages: bool) -> None:
        super().__init__(
            event_loop,
            persistent_messages,
            ThreadsafeEvent(event_loop),
            ThreadsafeEvent(event_loop),
        )

    async def _window_loop(
        self, client_id: int, backlog_last_id: int, backlog_done_message: Message | None
    ) -> AsyncGenerator[Sequence[Message], None]:
        """What a client is to be sent, in windows; the marker comes right after the backlog."""
        place, marker = _Place(), backlog_done_message
        self.generator_cursors[client_id] = place.cursor
        try:
            while not self.done:
                window = self._window(client_id, place, None if marker is None else backlog_last_id)
                self.generator_cursors[client_id] = place.cursor
                if marker is not None and place.cursor >= backlog_last_id:
                    window.append(marker)
                    marker = None
                if window:
                    yield window
                elif self.atomic_counter or self._is_all(place):
                    await self.message_event.wait()
                    self.message_event.clear()
                if not window or self._is_all(place):
                    await self._rest()
        finally:
            self.generator_cursors.pop(client_id, None)

    def _is_all(self, place: _Place) -> bool:
        return place.cursor >= self.message_counter - 1

    def _window(self, client_id: int, place: _Place, last: int | None) -> list[Message]:
        """The next messages, at most a window of them, and none after the `last`.

        While an atomic group is being pushed there are none, so that it is not sent in parts.
        """
        window: list[Message] = []
        with self.buffer_lock:
            if self.atomic_counter:
                return window
            while len(window) < self.max_window_size and self._goes_on(place, last):
                message = self._message(place.cursor)
                if message is not None and message.excluded_self_client != client_id:
                    window.append(message)
        return window

    def _goes_on(self, place: _Place, last: int | None) -> bool:
        """Go to the next message; False, and at the end, where there is none."""
        if not place.pending:
            end = self.message_counter - 1 if last is None else last
            place.pending.extend(self._numbers(place.cursor, end))
            if not place.pending:
                place.cursor = max(place.cursor, end)
                return False
        place.cursor = place.pending.popleft()
        return True

    def _numbers(self, after: int, last: int) -> list[int]:
        """The numbers of the messages that are there, which a dict keeps in their order."""
        newest_first = takewhile(lambda number: number > after, reversed(self.message_from_id))
        return [number for number in newest_first if number <= last][::-1]

    def _message(self, number: int) -> Message | None:
        """The message, unless a newer one has replaced it; one client's own is sent only once."""
        if self.persistent_messages:
            return self.message_from_id.get(number)
        return self.pop_message_locked(number)

    async def _rest(self) -> None:
        """Wait for the messages of one window, or for a flush."""
        try:
            together = len(self.generator_cursors) / ALL_WINDOWS_PER_SECOND
            async with asyncio.timeout(max(self.window_duration_sec, together)):
                await self.flush_event.wait()
        except TimeoutError:
            return
        if not self.done:
            self.flush_event.clear()
