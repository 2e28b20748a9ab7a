"""viser's buffer of messages to pages, without its race and without its walk; see docs/viser.md.

viser numbers messages from 0 for as long as the server runs, and keeps only the newest of each key.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import AsyncGenerator, Sequence
from functools import cached_property
from itertools import takewhile

import msgspec
import zstandard
from viser.infra import _infra as viser_infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._messages import Message
from websockets.asyncio.server import ServerConnection

ALL_WINDOWS_PER_SECOND = 600.0
"""Of all clients: where many look on, the frame rate of each is less."""
CLOCK_SECONDS = 1e-6
"""A timer of the loop may fire so early."""


def install() -> None:
    """Let every viser server of this process use this buffer."""
    vars(viser_infra).update(AsyncMessageBuffer=MessageBuffer, _message_producer=send_windows)


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


class Window(list[Message]):
    """Messages that are sent together."""

    @cached_property
    def packed(self) -> bytes:
        """As viser's page reads them: sizes, compressed msgpack, and arrays as they are.

        Packed once, however many clients it is sent to.
        """
        arrays: list[memoryview] = []
        messages = tuple(message.as_serializable_dict(arrays) for message in self)
        lengths = tuple(array.nbytes for array in arrays)
        content = {
            "messages": messages,
            "timestampSec": time.perf_counter(),
            "binaryBufferLengths": lengths,
        }
        encoded = msgspec.msgpack.encode(content)
        compressed = zstandard.compress(encoded, level=1)
        sizes = (len(encoded).to_bytes(8, "little"), len(compressed).to_bytes(8, "little"))
        parts: list[bytes | memoryview] = [*sizes, compressed]
        vars(viser_infra)["_append_aligned_buffers"](parts, arrays, sum(map(len, parts)))
        return b"".join(parts)


async def send_windows(
    connection: ServerConnection,
    buffer: MessageBuffer,
    client_id: int,
    backlog_done_message: Message | None = None,
) -> None:
    """Send a client its windows, until the buffer is done."""
    windows = buffer.window_generator(client_id, backlog_done_message)
    try:
        async for window in windows:
            assert isinstance(window, Window)
            await connection.send(window.packed)
    finally:
        await windows.aclose()


class MessageBuffer(AsyncMessageBuffer):
    """Wakes its loop only thread-safely, visits only messages that are still there, and gives
    clients that are equally far the same windows.

    Time is divided into rounds: in each a client is sent the messages up to the round's end, and
    then it rests until the next one.
    """

    def __init__(self, event_loop: asyncio.AbstractEventLoop, persistent_messages: bool) -> None:
        super().__init__(
            event_loop,
            persistent_messages,
            ThreadsafeEvent(event_loop),
            ThreadsafeEvent(event_loop),
        )
        self._last, self._next_round = -1, 0.0
        self._windows: dict[tuple[int, int], tuple[Window, int]] = {}

    @property
    def round_seconds(self) -> float:
        """How long a round is: the more clients, the longer."""
        together = len(self.generator_cursors) / ALL_WINDOWS_PER_SECOND
        return max(self.window_duration_sec, together)

    async def _window_loop(
        self, client_id: int, backlog_last_id: int, backlog_done_message: Message | None
    ) -> AsyncGenerator[Sequence[Message], None]:
        """Yield the messages for a client in windows; the marker follows the backlog directly."""
        cursor, marker = -1, backlog_done_message
        self.generator_cursors[client_id] = cursor
        try:
            while not self.done:
                backlog = None if marker is None else backlog_last_id
                window, cursor = self._window(client_id, cursor, backlog)
                self.generator_cursors[client_id] = cursor
                if marker is not None and cursor >= backlog_last_id:
                    window = Window([*window, marker])
                    marker = None
                if window:
                    yield window
                elif self.atomic_counter or cursor >= self.message_counter - 1:
                    await self.message_event.wait()
                    self.message_event.clear()
                if not window or cursor >= self._last:
                    await self._rest()
        finally:
            self.generator_cursors.pop(client_id, None)

    def _window(self, client_id: int, cursor: int, backlog: int | None) -> tuple[Window, int]:
        """The next messages of the backlog or of this round, and how far that is.

        While an atomic group is being pushed there are none, so that it is not sent in parts.
        """
        with self.buffer_lock:
            if self.atomic_counter:
                return Window(), cursor
            if self.event_loop.time() >= self._next_round - CLOCK_SECONDS:
                self._begin_round()
            place = cursor, self._last if backlog is None else backlog
            if place not in self._windows:
                self._windows[place] = self._gather(*place)
            window, reached = self._windows[place]
        if any(message.excluded_self_client == client_id for message in window):
            window = Window(m for m in window if m.excluded_self_client != client_id)
        return window, reached

    def _begin_round(self) -> None:
        self._last = self.message_counter - 1
        self._next_round = self.event_loop.time() + self.round_seconds
        self._windows.clear()

    def _gather(self, after: int, last: int) -> tuple[Window, int]:
        """The messages after a number that are there, at most a window of them, and the last."""
        newest_first = takewhile(lambda number: number > after, reversed(self.message_from_id))
        numbers = [number for number in newest_first if number <= last][::-1]
        taken = numbers[: self.max_window_size]
        reached = max(after, last) if taken == numbers else taken[-1]
        found = (self.message_from_id.get(number) for number in taken)
        if not self.persistent_messages:  # one client's own is sent only once
            found = (self.pop_message_locked(number) for number in taken)
        return Window(message for message in found if message is not None), reached

    async def _rest(self) -> None:
        """Wait for the next round, or for a flush."""
        now = self.event_loop.time()
        if now >= self._next_round - CLOCK_SECONDS:  # nothing was sent for a while
            self._next_round = now + self.round_seconds
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout_at(self._next_round):
                await self.flush_event.wait()
        if self.flush_event.is_set() and not self.done:
            self.flush_event.clear()
            self._next_round = 0.0
