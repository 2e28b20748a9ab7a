"""Opens the page's server, and stands between it and whatever connects.

viser trusts whatever connects: it answers any website's script, takes any value for any widget
and opens a tunnel to an outside relay when a client asks for one. Here a request must pass
the `access`, and a message `admission`.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import threading
import types
from collections.abc import Awaitable, Callable, Iterable, Iterator
from http import HTTPStatus
from typing import Any

import rich
import viser
import websockets
import websockets.asyncio.server
from viser import _gui_handles as gui
from viser.infra import _infra as viser_infra
from websockets.asyncio.server import ServerConnection
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from hebbviz.server.web import admission, listening, read_only
from hebbviz.server.web.access import Access, Entrance, headers
from hebbviz.server.web.connection import MAX_MESSAGE_BYTES, Admitted, Connection
from hebbviz.server.web.connection_limits import Crowd, tell_shortages
from hebbviz.server.web.message_buffer import MessageBuffer, install
from hebbviz.server.web.refusal import Refused

SETTLE_SECONDS = 1.0  # between the refusal of a value and showing the true one, see `Gate._refuse`
FAREWELL_SECONDS = 0.3  # for connections to be closed politely when the server stops

POLICY = {
    "script-src": "'unsafe-inline' 'wasm-unsafe-eval'",
    "style-src": "'unsafe-inline'",
    "img-src": "'self' data: blob:",
    "worker-src": "blob:",
    "connect-src": "'self' data:",  # it fetches WebAssembly and a picture out of itself
}
"""Content that viser's page loads: it is an inline script that unpacks WebAssembly."""


# Where viser's GUI keeps the things that messages are about.
REGISTRIES: dict[type, str] = {
    admission.GuiUpdateMessage: "_gui_input_handle_from_uuid",
    admission.GuiButtonHoldMessage: "_gui_input_handle_from_uuid",
    admission.GuiFormSubmitMessage: "_container_handle_from_uuid",
    admission.GuiFormDirtyMessage: "_container_handle_from_uuid",
    admission.CommandTriggerMessage: "_command_handle_from_uuid",
}

OnRefusal = Callable[[str], None]
"""Takes one line for what was refused; called in the server's event loop, so it must be quick."""
Handler = Callable[[ServerConnection], Awaitable[None]]
RequestHook = Callable[[ServerConnection, Request], Response | None]

_viser_lock = threading.RLock()  # one server starts or stops at a time
_logger = logging.getLogger("hebbviz.websockets")
# A client that breaks off or garbles its request is no fault of ours, and worth no traceback.
_logger.addFilter(lambda record: record.getMessage() != "opening handshake failed")
_logger.setLevel(logging.INFO)  # in more detail it would tell tokens


def open_server(
    host: str = "127.0.0.1",
    port: int | None = None,
    *,
    default_port: int = 8080,
    access: Access = Access(),  # noqa: B008
    on_refusal: OnRefusal,
    on_turned_away: OnRefusal | None = None,
) -> GuardedServer:
    """Start a viser server that only its own page can talk to, and only as a page does.

    Args:
        host: Address to bind, and no other.
        port: Port to bind (0: any free one), or else `PortTaken` is raised. None: `default_port`
            or the next free one above it; `get_port()` of the server tells which.
        default_port: See `port`.
        access: Who may come in.
        on_refusal: Told of messages. A widget is reported at most once a second, others once.
        on_turned_away: Told of requests, once of each kind, with the remedy; by default
            `on_refusal`.
    """
    listener = listening.listener(host, port, default_port)
    gate = Gate(Entrance(host, access), access.frame_from, on_refusal, on_turned_away)
    called: list[bool] = []

    def serve(handler: Handler, _host: str, _port: int, **options: Any) -> Any:
        called.append(True)
        return gate.serve(handler, sock=listener, **options)

    install()
    with _viser_silenced(), _viser_serves_with(serve):
        server = GuardedServer(host=host, port=listener.getsockname()[1], verbose=False)
    if not called:  # never run without the gate
        server.stop()
        listener.close()
        raise RuntimeError(f"viser {viser.__version__} starts its server in an unknown way")
    server.gui.configure_theme(show_share_button=False)
    server.gate = gate
    server.on_client_connect(server.welcome_reader)
    gate.server = server
    return server


class Gate:
    """Judges requests and messages for one server; runs in that server's event loop."""

    def __init__(
        self,
        entrance: Entrance,
        frame_from: Iterable[str],
        on_refusal: OnRefusal,
        on_turned_away: OnRefusal | None = None,
    ) -> None:
        self.entrance, self.on_refusal = entrance, on_refusal
        self._on_turned_away = on_turned_away or on_refusal
        self._headers = headers(POLICY, frame_from)
        self.server: viser.ViserServer | None = None
        self.crowd = Crowd()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._reported: set[str] = set()
        self._unsettled: set[str] = set()

    def serve(self, handler: Handler, *, process_request: RequestHook, **options: Any) -> Any:
        """`websockets.asyncio.server.serve` as viser calls it, with the gate in its hooks."""

        async def checked_request(conn: Connection, request: Request) -> Response | None:
            try:
                conn.let_in(self.entrance.check(request.path, request.headers.get_all))
            except Refused as refused:
                self._report_once(refused, self._on_turned_away)
                return conn.respond(HTTPStatus.FORBIDDEN, f"{refused.line}\n")
            try:
                await self.crowd.wait_in_line(conn, as_page="Upgrade" in request.headers)
            except Refused as refused:
                self._report_once(refused, self._on_turned_away)
                return conn.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{refused.line}\n")
            while self.server is None:  # viser answers a moment before it is complete
                await asyncio.sleep(0.01)
            try:
                return process_request(conn, request)
            except (OSError, ValueError):  # a path that no file can have
                return conn.respond(HTTPStatus.NOT_FOUND, "there is no such file\n")

        def with_headers(conn: Connection, _: Request, response: Response) -> None:
            response.headers.update(self._headers)
            if conn.passage.cookie is not None:
                response.headers["Set-Cookie"] = conn.passage.cookie

        async def checked_handler(connection: ServerConnection) -> None:
            if connection.subprotocol == f"viser-v{viser.__version__}":
                await handler(connection)
            else:  # viser would print what the client calls itself
                reason = f"This page is not of viser {viser.__version__}: reload it"
                await connection.close(CloseCode.PROTOCOL_ERROR, reason)

        self._loop = asyncio.get_running_loop()
        tell_shortages(self._loop, self.report)
        options |= {
            "process_request": checked_request,
            "process_response": with_headers,
            "server_header": None,
            "max_size": MAX_MESSAGE_BYTES,
            "create_connection": functools.partial(
                Connection, crowd=self.crowd, admit=self.admit, report=self.report
            ),
            "logger": _logger,
        }
        return websockets.asyncio.server.serve(checked_handler, **options)

    def hang_up_soon(self) -> None:
        """Cut all connections in a moment. A stopping server waits many seconds for a browser that
        opened a connection in advance and says nothing, or for a tab that stalls.
        """
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(
                    self._loop.call_later, FAREWELL_SECONDS, self.crowd.hang_up
                )

    def admit(self, raw: str | bytes, connection: Connection) -> Admitted | None:
        """The message as viser may have it, or None.

        It is encoded again from the checked values, so that viser cannot read the same bytes (with
        a duplicate key, for example) differently from the check.
        """
        try:
            message = admission.decode(raw if isinstance(raw, bytes) else b"")  # viser sends bytes
            target, own = self._target(message, connection)
            if connection.reader is not None:
                read_only.check(message, target, own=own)
            admission.check(message, target)
        except Refused as refused:
            self._refuse(refused, connection)
            return None
        return Admitted(admission.key(message, target), admission.encode(message))

    def report(self, refused: Refused) -> None:
        """Say of a message that it was refused."""
        self._report_once(refused, self.on_refusal)

    def _report_once(self, refused: Refused, tell: OnRefusal) -> None:
        """Say it once per kind: a hostile client must not be able to flood the log."""
        if refused.kind not in self._reported:
            self._reported.add(refused.kind)
            tell(refused.line)

    def _target(
        self, message: admission.FromPage, connection: ServerConnection
    ) -> tuple[Any, bool]:
        """Find the target of a message, in the shared GUI or in the client's own; and whether it is
        the client's own.
        """
        registry = REGISTRIES.get(type(message))
        if registry is None:
            return None, False
        assert self.server is not None  # requests wait for it
        uuid: str = message.uuid  # type: ignore[attr-defined]
        if uuid in (shared := getattr(self.server.gui, registry)):
            return shared[uuid], False
        client = self.server.client_of(connection)
        if client is not None and uuid in (own := getattr(client.gui, registry)):
            return own[uuid], True
        raise Refused("target", "refused a message from a page: it is about no known widget")

    def _refuse(self, refused: Refused, connection: Connection) -> None:
        """Report now; show the true value a little later, at most once a second per widget.

        Later, because a user who types 25 into a box for 10 to 99 passes through 2, and must not
        have the box rewritten before the 5.
        """
        widget = refused.widget
        if connection.reader is not None:
            assert self.server is not None
            if (client := self.server.client_of(connection)) is not None:
                connection.reader.refuse(refused, client)
        elif widget is None:
            self.report(refused)
        elif widget._impl.uuid not in self._unsettled:
            self._unsettled.add(widget._impl.uuid)
            asyncio.get_running_loop().call_later(SETTLE_SECONDS, self._settle, widget)
            self.on_refusal(refused.line)

    def _settle(self, widget: Any) -> None:
        self._unsettled.discard(widget._impl.uuid)
        if isinstance(widget, gui.GuiInputHandle) and not widget._impl.removed:
            widget._queue_update("value", widget.value)


class GuardedServer(viser.ViserServer):
    """A viser server that stops in silence, and lets in only what passes its gate."""

    gate: Gate | None = None

    @property
    def entrance(self) -> Entrance:
        assert self.gate is not None  # `open_server` sets it
        return self.gate.entrance

    def client_of(self, connection: ServerConnection) -> viser.ClientHandle | None:
        """The client behind a connection, once it has sent its camera."""
        live = self._websock_server._live_connections
        found = (number for number, other in list(live.items()) if other is connection)
        return self.get_clients().get(next(found, -1))

    def is_reader(self, client: viser.ClientHandle) -> bool:
        """Whether a client came in to look, and changes nothing."""
        connection = self._websock_server._live_connections.get(client.client_id)
        return isinstance(connection, Connection) and connection.reader is not None

    def welcome_reader(self, client: viser.ClientHandle) -> None:
        if self.is_reader(client):
            read_only.welcome(client)

    @property
    def frame_seconds(self) -> float:
        """How long the pages are sent nothing more after a frame; the more pages, the longer."""
        buffer = self._websock_server.get_message_buffer()
        return buffer.round_seconds if isinstance(buffer, MessageBuffer) else 0.0

    def stop(self) -> None:
        with _viser_silenced():
            if self.gate is not None:
                self.gate.hang_up_soon()
            super().stop()


@contextlib.contextmanager
def _viser_silenced() -> Iterator[None]:
    """viser prints a banner and a farewell with rich even when it is not verbose."""
    console = rich.get_console()
    with _viser_lock:
        quiet, console.quiet = console.quiet, True
        try:
            yield
        finally:
            console.quiet = quiet


@contextlib.contextmanager
def _viser_serves_with(serve: Callable[..., Any]) -> Iterator[None]:
    """While a server starts, viser's server module sees our `serve` in place of websockets'.

    viser has no hook for requests or raw messages, and calls `websockets.asyncio.server.serve`
    by its full name. So the name `websockets` in that one module stands for a view of the package
    with our `serve`, and for the package again once the server listens.
    """
    view = types.SimpleNamespace(**vars(websockets))
    view.asyncio = types.SimpleNamespace(server=types.SimpleNamespace(serve=serve))
    names = vars(viser_infra)
    with _viser_lock:
        original, names["websockets"] = names["websockets"], view
        try:
            yield
        finally:
            names["websockets"] = original
