"""A client that speaks viser's websocket protocol without a browser, to test and to load a server.

Several clients share one event loop in one thread, and of each frame only the messages about the
GUI are decoded, so that many of them cost little.
"""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec
import viser
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Origin, Subprotocol

T = TypeVar("T")

CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [3.0, 3.0, 3.0],
    "fov": 1.3,
    "near": 0.01,
    "far": 1000,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}


class _Frame(msgspec.Struct):
    messages: list[msgspec.Raw]  # left encoded until someone cares


@dataclass
class Widget:
    """A widget or a command, as the server described it to the page."""

    kind: str
    uuid: str
    value: Any = None
    props: dict[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str | None:
        return self.props.get("label")

    @property
    def is_command(self) -> bool:
        """Whether it is one of the palette; a button may have the same label."""
        return self.kind == "RegisterCommandMessage"


class RawClient:
    """A connection to a viser server, like one of its page's; use it in a `with` statement.

    Args:
        port: Port of the server on `host`.
        origin: Origin header: the server's own page by default, None for none.
        name: Host header, where it is not to be the address.
        path: What is asked for, with its query.
        cookie: Cookie header, None for none.
        camera: Send the camera at once as a page does; viser calls no callbacks before.
        decode: Follow the GUI messages; without, frames and bytes are counted and no more.
    """

    def __init__(
        self,
        port: int,
        *,
        host: str = "127.0.0.1",
        origin: str | None = "own",
        name: str | None = None,
        path: str = "/",
        cookie: str | None = None,
        camera: bool = True,
        decode: bool = True,
    ) -> None:
        self.decode = decode
        self.frames = self.messages = self.bytes = 0  # received so far
        self.widgets: dict[str, Widget] = {}  # by uuid
        self.notices: list[str] = []
        self.close_code: int | None = None
        self._frame_decoder = msgspec.msgpack.Decoder(_Frame)
        self._decompressor = zstandard.ZstdDecompressor()
        address = f"{host}:{port}"
        origin = f"http://{address}" if origin == "own" else origin
        where = f"ws://{name or address}{path}"
        self._connection = _run(_connect(host, port, where, origin, cookie))
        self._receiver = asyncio.run_coroutine_threadsafe(self._receive(), _loop())
        if camera:
            self.send(CAMERA)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection as a page does that is left."""
        _run(self._connection.close())
        self._receiver.result(10)

    @property
    def closed(self) -> bool:
        return self._receiver.done()

    def find(self, label: str, *, command: bool = False, timeout: float = 5.0) -> Widget:
        """The widget or the command with this label, once the server has told of it."""

        def named() -> list[Widget]:
            widgets = list(self.widgets.values())
            return [w for w in widgets if w.label == label and w.is_command == command]

        return self.wait(named, timeout)[-1]

    def wait(self, condition: Callable[[], T], timeout: float = 5.0) -> T:
        """What `condition` returns, once it is true."""
        return wait_until(condition, timeout)

    def send(self, message: dict[str, Any]) -> None:
        """Send a message with viser's `type` and fields."""
        self.send_bytes(msgspec.msgpack.encode(message))

    def send_bytes(self, frame: bytes | str) -> None:
        """Send a frame as it is, well formed or not."""
        _run(self._connection.send(frame))

    def send_value(self, widget: Widget | str, value: object) -> None:
        """Set the value of a widget (or of the one with this label), as a user does."""
        self.send_updates(widget, {"value": value})

    def send_updates(self, widget: Widget | str, updates: dict[str, Any]) -> None:
        """Ask for any change of a widget's properties."""
        target = self.find(widget) if isinstance(widget, str) else widget
        self.send({"type": "GuiUpdateMessage", "uuid": target.uuid, "updates": updates})

    def press(self, button: Widget | str) -> None:
        """Press a button, as a user does."""
        self.send_value(button, True)

    def trigger(self, command: Widget | str) -> None:
        """Run a command of the palette, or its hotkey."""
        target = self.find(command, command=True) if isinstance(command, str) else command
        self.send({"type": "CommandTriggerMessage", "uuid": target.uuid})

    async def _receive(self) -> None:
        try:
            async for frame in self._connection:
                self.frames += 1
                self.bytes += len(frame)
                if self.decode and isinstance(frame, bytes):
                    self._read(frame)
        except ConnectionClosed:
            pass
        self.close_code = self._connection.close_code

    def _read(self, frame: bytes) -> None:
        """A frame: two sizes, compressed msgpack, and then the arrays, which are skipped."""
        size = int.from_bytes(frame[:8], "little")
        packed = int.from_bytes(frame[8:16], "little")
        inner = self._decompressor.decompress(frame[16 : 16 + packed], max_output_size=size)
        for raw in self._frame_decoder.decode(inner).messages:
            self.messages += 1
            if any(part in (encoded := bytes(raw)) for part in (b"Gui", b"Command", b"Notif")):
                self._apply(msgspec.msgpack.decode(encoded))

    def _apply(self, message: dict[str, Any]) -> None:
        kind, uuid = message["type"], message.get("uuid", "")
        if kind == "NotificationShowMessage":
            self.notices.append(message["props"]["body"])
        elif kind in ("GuiUpdateMessage", "CommandUpdateMessage"):
            if (widget := self.widgets.get(uuid)) is not None:
                updates = dict(message["updates"])
                widget.value = updates.pop("value", widget.value)
                widget.props.update(updates)
        elif kind in ("GuiRemoveMessage", "RemoveCommandMessage"):
            self.widgets.pop(uuid, None)
        elif isinstance(message.get("props"), dict) and uuid:
            self.widgets[uuid] = Widget(kind, uuid, message.get("value"), message["props"])


def wait_until(condition: Callable[[], T], timeout: float = 5.0) -> T:
    """What `condition` returns, once it is true."""
    end = time.monotonic() + timeout
    while not (result := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"waited {timeout} s in vain")
        time.sleep(0.005)
    return result


def answers(host: str, port: int) -> bool:
    """Whether a connection can be made there; why not is said in other words by each machine."""
    try:
        socket.create_connection((host, port), timeout=2.0).close()
    except OSError:
        return False
    return True


async def _connect(
    host: str, port: int, where: str, origin: str | None, cookie: str | None
) -> ClientConnection:
    return await connect(
        where,
        host=host,
        port=port,
        origin=None if origin is None else Origin(origin),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        compression=None,
        max_size=None,
        proxy=None,
        additional_headers={} if cookie is None else {"Cookie": cookie},
    )


_loops: list[asyncio.AbstractEventLoop] = []
_loops_lock = threading.Lock()


def _loop() -> asyncio.AbstractEventLoop:
    """The event loop that all clients of this process share."""
    with _loops_lock:
        if not _loops:
            _loops.append(asyncio.new_event_loop())
            threading.Thread(target=_loops[0].run_forever, daemon=True).start()
        return _loops[0]


def _run(job: Coroutine[Any, Any, T]) -> T:
    return asyncio.run_coroutine_threadsafe(job, _loop()).result(15)
