"""A client that floods a server with one kind of thing, in a process of its own.

    python tests/support/attacker.py PORT KIND SECONDS

It sends as fast as it is let, or so many messages a second, and never reads more than it must.
"""

from __future__ import annotations

import asyncio
import itertools
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
from raw_client import CAMERA, RawClient, Widget, _connect
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, WebSocketException

Message = dict[str, Any]
Messages = Iterator[Message]
BATCHES = 50
"""Messages are sent so many times a second, many at a time."""


@dataclass(frozen=True)
class Flood:
    """Messages a second, and what they are, made from the widgets of the page by their labels."""

    rate: int
    messages: Callable[[dict[str, Widget]], Messages]


def setting(widget: Widget, value: object) -> Message:
    """A value for a widget; a command has none and is run."""
    if widget.is_command:
        return {"type": "CommandTriggerMessage", "uuid": widget.uuid}
    return {"type": "GuiUpdateMessage", "uuid": widget.uuid, "updates": {"value": value}}


def sliders(widgets: dict[str, Widget]) -> Messages:
    """β and γ in turn, another value each time; the last two are known."""
    for k in itertools.count():
        yield setting(widgets["β by memory"], 1.0 + k % 100 / 100)
        yield setting(widgets["γ, step size"], -3.0 + k % 100 / 100)


def cameras(_: dict[str, Widget]) -> Messages:
    for k in itertools.count():
        yield CAMERA | {"position": [3.0, 3.0, k % 7]}


def clicks(_: dict[str, Widget]) -> Messages:
    ray = {"ray_origin": [0, 0, 0], "ray_direction": [0, 0, 1.0], "screen_pos": [0.5, 0.5]}
    for k in itertools.count():
        name = {"name": "/this 0/network/units", "instance_index": k % 4, "modifier": None}
        yield {"type": "SceneNodeClickMessage"} | ray | name


def pressing(label: str, *values: object) -> Callable[[dict[str, Widget]], Messages]:
    def messages(widgets: dict[str, Widget]) -> Messages:
        for value in itertools.cycle(values):
            yield setting(widgets[label], value)

    return messages


def garbage(_: dict[str, Widget]) -> Messages:
    return itertools.repeat({"type": "NoSuchMessage"})


FLOODS = {
    "sliders": Flood(2000, sliders),
    "cameras": Flood(10_000, cameras),
    "clicks": Flood(2000, clicks),
    "rewards": Flood(2000, pressing("reward", "+ reward", "− punishment")),
    "resets": Flood(500, pressing("Reset", True)),
    "seeds": Flood(500, pressing("New seed", True)),
    "undos": Flood(500, pressing("Undo", True)),
    "tasks": Flood(500, pressing("task", "synapse", "pendulum")),
    "recordings": Flood(100, pressing("Record", True)),
    "garbage": Flood(10_000, garbage),
}


async def send(flood: Flood, connection: ClientConnection, widgets: dict[str, Widget],
               until: float) -> None:  # fmt: skip
    """Send batches at the flood's rate, as far as the server takes them."""
    messages, batch = flood.messages(widgets), max(1, flood.rate // BATCHES)
    due = time.monotonic()
    while time.monotonic() < until:
        for message in itertools.islice(messages, batch):
            await connection.send(msgspec.msgpack.encode(message))
        due += batch / flood.rate
        await asyncio.sleep(max(0.0, due - time.monotonic()))


async def page(port: int) -> ClientConnection:
    """A connection as a page has one."""
    address = f"127.0.0.1:{port}"
    return await _connect("127.0.0.1", port, f"ws://{address}/", f"http://{address}", None)


async def sit(port: int, until: float, *, sockets: int = 200) -> None:
    """Open connections as pages do, and read nothing from them."""
    opened = []
    for _ in range(sockets):
        try:
            async with asyncio.timeout(5):
                connection = await page(port)
                connection.transport.pause_reading()
                await connection.send(msgspec.msgpack.encode(CAMERA))
                opened.append(connection)
        except (OSError, WebSocketException, TimeoutError):
            await asyncio.sleep(0.05)
    await asyncio.sleep(max(0.0, until - time.monotonic()))
    for connection in opened:
        connection.transport.abort()


async def dumb(port: int, until: float, *, sockets: int = 200) -> None:
    """Open connections and say nothing, time and again."""
    while time.monotonic() < until:
        opened = []
        for _ in range(sockets):
            try:
                opened.append(await asyncio.open_connection("127.0.0.1", port))
            except OSError:
                await asyncio.sleep(0.05)
        await asyncio.sleep(0.5)
        for _, writer in opened:
            writer.transport.abort()


async def visit(port: int, until: float) -> None:
    """Come and go, without a rest."""
    while time.monotonic() < until:
        try:
            async with asyncio.timeout(5):
                connection = await page(port)
                await connection.send(msgspec.msgpack.encode(CAMERA))
                await connection.recv()
            connection.transport.abort()
        except (OSError, WebSocketException, TimeoutError):
            await asyncio.sleep(0.01)


async def ping(port: int, until: float) -> None:
    """Pings, as many as are taken; their answers are not read."""
    connection = await page(port)
    connection.transport.pause_reading()
    frames = b"\x89\x80\0\0\0\0" * 10_000
    while time.monotonic() < until and not connection.transport.is_closing():
        connection.transport.write(frames)
        await connection.drain()


CROWDS: dict[str, Callable[[int, float], Awaitable[None]]] = {
    "sockets": sit, "dumb": dumb, "visits": visit, "pings": ping,
}  # fmt: skip


def main(port: int, kind: str, seconds: float) -> None:
    if kind in CROWDS:
        sys.stdout.write("flooding\n")
        sys.stdout.flush()
        asyncio.run(_run(CROWDS[kind](port, time.monotonic() + seconds)))
        return
    with RawClient(port) as client:
        client.find("Record", timeout=30)  # the last that is told of
        commands_first = sorted(client.widgets.values(), key=lambda w: not w.is_command)
        widgets = {w.label: w for w in commands_first if w.label}  # a button's label may change
        sys.stdout.write("flooding\n")
        sys.stdout.flush()
        client.decode = False
        job = send(FLOODS[kind], client._connection, widgets, time.monotonic() + seconds)
        try:
            asyncio.run_coroutine_threadsafe(job, client._connection.loop).result()
        except ConnectionClosed as closed:
            sys.stdout.write(f"closed: {closed}\n")


async def _run(job: Awaitable[None]) -> None:
    await job


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], float(sys.argv[3]))
