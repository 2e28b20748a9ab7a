"""A relay before rerun's server that lets programs through, but no web page.

rerun's server answers whatever Host a request names, so a website that has its own name lead here
could read the stream, and it allows pages of this machine and of rerun.io. But browsers speak
HTTP/2 only over TLS: whatever begins with its preface in the clear is a program, such as rerun's
viewer. Everything else is refused. rerun's server itself listens at an address that no website can
find.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import socketserver
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
"""How HTTP/2 begins (RFC 9113, 3.4); no method, path or header of a browser's makes this."""
PREFACE_SECONDS = 10.0
LATENCY_SECONDS = 0.05
DRAIN_SECONDS = 0.5
PIECE = 2**16
REFUSED = (
    "refused a request to the stream: it comes from a web page; only programs may read it, such as "
    "rerun's viewer"
)


class Relay(socketserver.ThreadingTCPServer):
    """Listens at 127.0.0.1 and a port, 0 for any; raises OSError where it is taken.

    `behind` is the address for rerun's server; `on_refused` is called once.
    """

    daemon_threads = True
    request_queue_size = 64
    allow_reuse_address = os.name == "posix"

    def __init__(self, port: int, on_refused: Callable[[str], None]) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.port: int = self.socket.getsockname()[1]
        self.behind = hidden_address()
        self._on_refused, self._told = on_refused, False
        self._changed, self._passing = threading.Condition(), 0
        self._thread = threading.Thread(
            target=self.serve_forever, args=(LATENCY_SECONDS,), name="hebbviz relay", daemon=True
        )

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """Stop, once current viewers have received what rerun's server has sent."""
        if self._thread.is_alive():
            self.shutdown()
        self.server_close()
        with self._changed:
            self._changed.wait_for(lambda: not self._passing, DRAIN_SECONDS)

    @contextlib.contextmanager
    def passing(self) -> Iterator[None]:
        """While something is passed on to a viewer."""
        with self._changed:
            self._passing += 1
        try:
            yield
        finally:
            with self._changed:
                self._passing -= 1
                self._changed.notify_all()

    def refuse(self) -> None:
        if not self._told:
            self._told = True
            self._on_refused(REFUSED)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnect: no traceback."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(socketserver.BaseRequestHandler):
    server: Relay

    def handle(self) -> None:
        self.request.settimeout(PREFACE_SECONDS)
        if not self._begins_well():
            self.server.refuse()
            self.request.sendall(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\n\r\n")
            return
        self.request.settimeout(None)
        with socket.create_connection(self.server.behind) as inner:
            inner.sendall(PREFACE)
            asked = threading.Thread(target=_pass_on, args=(self.request, inner), daemon=True)
            asked.start()
            with self.server.passing():
                _pass_on(inner, self.request)
            asked.join()

    def _begins_well(self) -> bool:
        """Whether the preface comes; one wrong byte is enough to know."""
        begun = b""
        while len(begun) < len(PREFACE) and PREFACE.startswith(begun):
            piece = self.request.recv(len(PREFACE) - len(begun))
            if not piece:
                raise ConnectionAbortedError
            begun += piece
        return begun == PREFACE


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    """Pass on data from one socket to the other until the end. Data that cannot be passed on is
    read and dropped: closing a connection with unread data would also discard sent data.
    """
    with contextlib.suppress(OSError):
        while piece := source.recv(PIECE):
            with contextlib.suppress(OSError):
                sink.sendall(piece)
    with contextlib.suppress(OSError):
        sink.shutdown(socket.SHUT_WR)


def hidden_address() -> tuple[str, int]:
    """A free port on one of the 2²⁴ loopback addresses of Linux; elsewhere on the only one."""
    some = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
    for host in (some, "127.0.0.1"):
        with contextlib.suppress(OSError), socket.create_server((host, 0)) as probe:
            return host, probe.getsockname()[1]
    raise OSError("this machine has no free port")
