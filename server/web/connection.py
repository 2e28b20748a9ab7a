"""A client's websocket: how fast it is read, and that nobody can make it fill a log."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.protocol import SEND_EOF

from hebbviz.server.web.access import Passage, Role
from hebbviz.server.web.connection_limits import Crowd
from hebbviz.server.web.rate_limits import (
    ALL_MESSAGES_PER_SECOND,
    ALL_READS_PER_SECOND,
    MESSAGES_PER_SECOND,
    PRESSES_PER_SECOND,
    READS_PER_SECOND,
    Allowance,
    Inflow,
)
from hebbviz.server.web.read_only import Reader
from hebbviz.server.web.refusal import Refused

MAX_MESSAGE_BYTES = 2**20
LONG_SECONDS = 0.001  # for taking apart what came at once over a connection
NO_PASSAGE = Passage(Role.NOBODY)
"""Of a request that was not let in."""

Admit = Callable[[Any, "Connection"], "Admitted | None"]
"""Takes a raw message, and gives what may pass."""
Report = Callable[[Refused], None]


class Admitted(NamedTuple):
    """A message that may pass, and what it is about; see `admission.key`."""

    key: str | None
    message: bytes


class Connection(ServerConnection):
    """A client's connection, which passes on only messages that `admit` lets through."""

    def __init__(
        self, *args: Any, crowd: Crowd, admit: Admit, report: Report, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self._crowd, self._admit, self._report = crowd, admit, report
        self.passage = NO_PASSAGE
        self.reader: Reader | None = None

    def let_in(self, passage: Passage) -> None:
        self.passage = passage
        self.reader = Reader() if passage.role is Role.READER else None

        self._inflow, self._reads = Inflow(), Allowance(READS_PER_SECOND)
        self._reader: asyncio.Task[None] | None = None
        self._news = asyncio.Event()
        self._end: Exception | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._crowd.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._crowd.leave(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take apart what came, such as a flood of pings, for a fifth of the time at most."""
        began = time.perf_counter()
        super().data_received(data)
        spent = time.perf_counter() - began
        if spent > LONG_SECONDS:
            self.transport.pause_reading()
            self.loop.call_later(4.0 * spent, self._read_on)

    def _read_on(self) -> None:
        if not self.recv_messages.paused:  # else it reads on once its messages are taken
            self.transport.resume_reading()

    def send_data(self) -> None:
        """Send all pending data in one piece, unless the connection is closing.

        asyncio prints a line for each piece sent to a closed connection, such as the answers to a
        flood of pings.
        """
        pieces = self.protocol.data_to_send()
        if not self.transport.is_closing():
            data, is_end = b"".join(pieces), pieces[-1:] == [SEND_EOF]
            self.protocol.writes = [data] * bool(data) + [SEND_EOF] * is_end
            super().send_data()

    async def recv(self, decode: bool | None = None) -> Any:
        """The next message, at the pace of the `Inflow`."""
        if self._reader is None:
            self._reader = asyncio.create_task(self._read(decode))
        while True:
            self._news.clear()
            share = self._crowd.share(MESSAGES_PER_SECOND, ALL_MESSAGES_PER_SECOND)
            found = self._inflow.take(self.loop.time(), share=share)
            if isinstance(found, bytes):
                return found
            if found is None and self._end is not None:
                raise self._end
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(found):
                    await self._news.wait()

    async def _read(self, decode: bool | None) -> None:
        """Take in what comes, until the connection is closed."""
        try:
            while True:
                raw = await super().recv(decode)
                self._take_in(self._admit(raw, self))
                await self._rest()
        except ConnectionClosed as closed:
            if closed.sent is not None and closed.sent.code == CloseCode.MESSAGE_TOO_BIG:
                line = f"refused a message from a page: over {MAX_MESSAGE_BYTES} bytes"
                self._report(Refused("oversized", line))
            self._end = closed
        except Exception as error:  # `recv` is to end by it
            self._end = error
        finally:
            self._news.set()

    def _take_in(self, admitted: Admitted | None) -> None:
        if admitted is None:
            return
        if not self._inflow.put(admitted.key, admitted.message):
            line = f"refused clicks from a page: over {PRESSES_PER_SECOND:.0f} a second"
            self._report(Refused("presses", line))
        self._news.set()

    async def _rest(self) -> None:
        """Read no more than is allowed; the rest waits with whoever sends it."""
        share = self._crowd.share(READS_PER_SECOND, ALL_READS_PER_SECOND)
        while wait := self._reads.wait(self.loop.time(), share=share):
            await asyncio.sleep(wait)
