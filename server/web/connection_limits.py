"""Limits of simultaneous connections, and of new ones per second."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State

from hebbviz.server.web.rate_limits import Allowance
from hebbviz.server.web.refusal import Refused

MOST_CONNECTIONS = 128
"""Of pages, of browsers that load one, and of those that say nothing."""
MOST_PAGES = 64
REQUESTS_PER_SECOND, PAGES_PER_SECOND = 40.0, 10.0
"""More wait. A page asks for a file or two, and then for the websocket that makes it a page."""


class Crowd:
    """The connections of a server."""

    def __init__(self, most: int | None = None) -> None:
        self.most = most or _most_connections()
        self._all: dict[ServerConnection, None] = {}
        self._requests = Allowance(REQUESTS_PER_SECOND)
        self._newcomers = Allowance(PAGES_PER_SECOND)

    def __len__(self) -> int:
        return len(self._all)

    @property
    def pages(self) -> int:
        return sum(connection.state is State.OPEN for connection in self._all)

    def share(self, each: float, together: float) -> float:
        """Fraction of `each` at which all connections stay within `together`."""
        return min(1.0, together / each / max(1, len(self._all)))

    def enter(self, connection: ServerConnection) -> None:
        """One too many ends the oldest that is no page yet, or itself."""
        self._all[connection] = None
        if len(self._all) > self.most:
            idle = (other for other in self._all if other.state is State.CONNECTING)
            leaving = next(idle, connection)
            self.leave(leaving)
            leaving.transport.abort()

    def leave(self, connection: ServerConnection) -> None:
        self._all.pop(connection, None)

    async def wait_in_line(self, connection: ServerConnection, *, as_page: bool) -> None:
        """Wait until a request may be answered; raises Refused where no page is to be added."""
        loop = asyncio.get_running_loop()
        line = self._newcomers if as_page else self._requests
        while wait := line.wait(loop.time()):
            await asyncio.sleep(wait)
            if connection.transport.is_closing():
                break
        most = min(MOST_PAGES, self.most - 2)
        if self.pages >= most:
            raise Refused("crowd", f"refused a page: {most} are open already; close one of them")

    def hang_up(self) -> None:
        for connection in list(self._all):
            connection.transport.abort()


def _most_connections() -> int:
    """Half of the files that may still be opened, for others are needed too."""
    try:
        import resource  # noqa: PLC0415  # not on Windows

        limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        is_open = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    except (ImportError, OSError):
        return MOST_CONNECTIONS
    return max(4, min(MOST_CONNECTIONS, (limit - is_open) // 2))


def tell_shortages(loop: asyncio.AbstractEventLoop, tell: Callable[[Refused], None]) -> None:
    """Say in a line that no connection can be accepted, where asyncio says it in a traceback each
    time, and tries a hundred times on end.
    """

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            advice = "close other connections, or allow more files with ulimit -n"
            tell(Refused("files", f"cannot accept a page: too many files are open; {advice}"))
        else:
            loop.default_exception_handler(context)

    loop.set_exception_handler(handle)
