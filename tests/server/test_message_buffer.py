"""The buffer of messages to pages: safe from any thread, and quick however many there were."""

from __future__ import annotations

import asyncio
import itertools
import math
import threading
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec
import numpy as np
import pytest
import viser
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from raw_client import RawClient, wait_until
from viser import _messages as messages
from viser.infra import _infra as viser_infra
from viser.infra._async_message_buffer import AsyncMessageBuffer
from viser.infra._messages import Message

from hebbviz.server.web import guard, message_buffer
from hebbviz.server.web.message_buffer import MessageBuffer, Window, send_windows

VISERS_PRODUCER = viser_infra._message_producer

Windows = AsyncGenerator[Sequence[Message], None]
MARKER = messages.GuiFormSubmitMessage("the backlog is over")


def setting(key: str, value: object) -> Message:
    """A message of which only the latest with this key is worth sending."""
    return messages.GuiUpdateMessage(key, {"value": value})


def run(job: Callable[[], Awaitable[None]]) -> None:
    """In a thread of its own: a browser test before this one may leave a loop in this thread."""

    async def bounded() -> None:
        async with asyncio.timeout(20):
            await job()

    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(bounded())).result()


def new(*, persistent: bool = True) -> MessageBuffer:
    buffer = MessageBuffer(asyncio.get_running_loop(), persistent_messages=persistent)
    buffer.window_duration_sec = 0.0
    return buffer


async def until(windows: Windows, message: Message) -> list[Message]:
    """All that comes up to a message."""
    sent: list[Message] = []
    while message not in sent:
        sent.extend(await anext(windows))
    return sent


def in_a_thread(job: Callable[[], None]) -> None:
    thread = threading.Thread(target=job)
    thread.start()
    thread.join()


def test_a_push_from_a_thread_leaves_waking_to_the_loop() -> None:
    async def job() -> None:
        buffer = new()
        windows = buffer.window_generator(0)
        waiting = asyncio.ensure_future(anext(windows))
        await asyncio.sleep(0)
        waiters = tuple(buffer.message_event._waiters)  # type: ignore[attr-defined]
        assert len(waiters) == 1
        in_a_thread(lambda: buffer.push(MARKER))
        assert not waiters[0].done()  # this thread is the loop's, and has not come to it
        assert list(await waiting) == [MARKER]
        await windows.aclose()

    run(job)


class Counted(dict[int, Message]):
    """Counts the numbers that are looked up."""

    asked = 0

    def get(self, *number: Any) -> Any:
        self.asked += 1
        return super().get(*number)


def test_a_new_client_visits_only_messages_that_are_there() -> None:
    async def job() -> None:
        buffer = new()
        buffer.message_from_id = counted = Counted()
        for value in range(30_000):
            buffer.push(setting(f"key {value % 3}", value))
        windows = buffer.window_generator(0, MARKER)
        sent = await until(windows, MARKER)
        assert sent == [setting(f"key {k % 3}", k) for k in range(29_997, 30_000)] + [MARKER]
        assert counted.asked <= 2 * len(counted)
        await windows.aclose()

    run(job)


def test_a_client_that_stalled_visits_only_messages_that_are_there() -> None:
    async def job() -> None:
        buffer = new()
        buffer.message_from_id = counted = Counted()
        windows = buffer.window_generator(0)
        buffer.push(MARKER)
        assert list(await anext(windows)) == [MARKER]
        for value in range(30_000):
            buffer.push(setting("key", value))
        assert list(await anext(windows)) == [setting("key", 29_999)]
        assert counted.asked < 10
        await windows.aclose()

    run(job)


def test_what_comes_while_the_backlog_is_sent_comes_after_the_marker() -> None:
    async def job() -> None:
        buffer = new()
        buffer.max_window_size = 2
        for value in range(5):
            buffer.push(setting(f"old {value}", value))
        windows = buffer.window_generator(0, MARKER)
        buffer.push(setting("new", 0))
        first = await anext(windows)
        buffer.push(setting("old 3", 9))  # replaces one that was still to be sent
        sent = [*first, *await until(windows, setting("old 3", 9))]
        old = [setting(f"old {k}", k) for k in (0, 1, 2, 4)]
        assert sent == [*old, MARKER, setting("new", 0), setting("old 3", 9)]
        await windows.aclose()

    run(job)


def test_all_that_was_pending_may_be_replaced_while_a_client_stalls() -> None:
    """Another client has cleared the event meanwhile: nobody calls this one again."""

    async def job() -> None:
        buffer = new()
        buffer.max_window_size = 1
        buffer.push(setting("a", 0))
        buffer.push(setting("b", 0))
        stalled = buffer.window_generator(0)
        assert list(await anext(stalled)) == [setting("a", 0)]
        buffer.push(setting("b", 1))
        buffer.message_event.clear()
        assert list(await anext(stalled)) == [setting("b", 1)]
        await stalled.aclose()

    run(job)


def test_an_atomic_group_is_sent_when_it_is_whole() -> None:
    async def job() -> None:
        buffer = new()
        windows = buffer.window_generator(0)
        waiting = asyncio.ensure_future(anext(windows))
        buffer.atomic_start()
        for value in range(3):
            in_a_thread(lambda value=value: buffer.push(setting(str(value), value)))  # type: ignore[misc]
            for _ in range(5):
                await asyncio.sleep(0.001)
            assert not waiting.done()
        buffer.atomic_end()
        assert len(await waiting) == 3
        await windows.aclose()

    run(job)


def test_the_message_of_one_client_is_sent_to_no_other_and_to_it_once() -> None:
    async def job() -> None:
        shared, own = new(), new(persistent=False)
        message = setting("a", 1)
        message.excluded_self_client = 0
        shared.push(message)
        shared.push(MARKER)
        for client, wanted in ((0, [MARKER]), (1, [message, MARKER])):
            windows = shared.window_generator(client)
            assert list(await anext(windows)) == wanted
            await windows.aclose()
        own.push(MARKER)
        windows = own.window_generator(0)
        assert list(await anext(windows)) == [MARKER]
        assert own.message_from_id == {}
        assert shared.generator_cursors == {}
        await windows.aclose()

    run(job)


def test_a_buffer_that_is_done_ends_those_who_wait() -> None:
    async def job() -> None:
        buffer = new()
        windows = buffer.window_generator(0)
        waiting = asyncio.ensure_future(anext(windows))
        await asyncio.sleep(0)
        in_a_thread(buffer.set_done)
        with pytest.raises(StopAsyncIteration):
            await waiting
        assert buffer.generator_cursors == {}

    run(job)


steps = st.lists(
    st.one_of(
        st.tuples(st.just("push"), st.sampled_from("abc")),
        st.just(("remove", "a")),
        st.just(("take", "a")),
    ),
    max_size=30,
)


@given(steps)
def test_it_sends_what_visers_own_buffer_sends(steps: list[tuple[str, Any]]) -> None:
    """Where rounds take no time; else what is replaced within one is skipped."""

    async def sent_by(kind: type[AsyncMessageBuffer]) -> list[Message]:
        buffer = kind(asyncio.get_running_loop(), persistent_messages=True)
        buffer.window_duration_sec, buffer.max_window_size = 0.0, 2
        windows, values, sent = buffer.window_generator(0, MARKER), itertools.count(), []
        for what, how in steps:
            removes = what == "remove"
            push = messages.GuiRemoveMessage(how) if removes else setting(how, next(values))
            buffer.push(push)
            if what == "take":  # there is something
                sent.extend(await anext(windows))
        buffer.push(end := setting("end", None))
        sent.extend(await until(windows, end))
        await windows.aclose()
        return sent

    async def job() -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(message_buffer, "ALL_WINDOWS_PER_SECOND", math.inf)
            own = await sent_by(MessageBuffer)
        assert own == await sent_by(AsyncMessageBuffer)

    run(job)


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    server = guard.open_server(port=0, on_refusal=print)
    yield server
    server.stop()


def test_the_server_and_its_clients_have_this_buffer(server: viser.ViserServer) -> None:
    with RawClient(server.get_port()):
        wait_until(server.get_clients)
        client = next(iter(server.get_clients().values()))
        for sender in (server._websock_server, client._websock_connection):
            assert type(sender.get_message_buffer()) is MessageBuffer


@pytest.mark.slow
def test_a_million_pushes_while_clients_come_and_go(server: viser.ViserServer) -> None:
    """viser's own buffer raises 'deque mutated during iteration' a few times in these."""
    errors: list[BaseException] = []
    done = threading.Event()

    def push(thread: int) -> None:
        try:
            for value in range(500_000):
                server._websock_server.queue_message(setting(f"{thread} {value % 50}", value))
        except BaseException as error:
            errors.append(error)

    def come_and_go() -> None:
        while not done.is_set():
            with RawClient(server.get_port(), decode=False) as client:
                client.wait(lambda: client.frames > 3 or done.is_set(), 60)

    visitors = [threading.Thread(target=come_and_go) for _ in range(3)]
    pushers = [threading.Thread(target=push, args=(k,)) for k in range(2)]
    for thread in (*visitors, *pushers):
        thread.start()
    for thread in pushers:
        thread.join()
    done.set()
    for thread in visitors:
        thread.join()
    assert errors == []


def test_many_clients_have_fewer_windows_each() -> None:
    async def job() -> None:
        buffer = MessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        seconds = []
        for clients in (1, 8, 64):
            buffer.generator_cursors = dict.fromkeys(range(clients), 0)
            seconds.append(buffer.round_seconds)
        assert seconds[0] < 1 / 30 and seconds[1] < 1 / 30 and seconds[2] > 1 / 10

    run(job)


def test_clients_that_are_equally_far_share_their_windows_packed() -> None:
    """Whenever they came; one that is itself the sender of a message gets a window of its own."""

    async def take(windows: Windows, into: list[Window]) -> None:
        async for window in windows:
            assert isinstance(window, Window)
            into.append(window)

    async def job() -> None:
        buffer = MessageBuffer(asyncio.get_running_loop(), persistent_messages=True)
        sent: list[list[Window]] = [[] for _ in range(8)]
        tasks = []
        for client, into in enumerate(sent):
            tasks.append(asyncio.create_task(take(buffer.window_generator(client), into)))
            buffer.push(setting("key", client))
            await asyncio.sleep(0.007)
        start = [len(into) for into in sent]
        for value in range(100):
            buffer.push(setting(f"key {value}", value))
            await asyncio.sleep(0.003)
        message = setting("of one", 1)
        message.excluded_self_client = 0
        buffer.push(message)
        buffer.push(MARKER)
        while MARKER not in sent[0][-1] or MARKER not in sent[7][-1]:
            await asyncio.sleep(0.01)
        buffer.set_done()
        await asyncio.gather(*tasks)
        later = [into[first + 1 : -1] for first, into in zip(start, sent, strict=True)]
        assert len(later[0]) > 3
        for others in later[1:]:
            assert all(a is b for a, b in zip(later[0], others, strict=True))
        assert later[0][0].packed is later[7][0].packed
        assert message in sent[7][-1] and message not in sent[0][-1]

    run(job)


def test_a_window_is_packed_as_visers_own_are() -> None:
    """A page can read it: sizes, compressed messages, and arrays at multiples of eight bytes."""

    class Socket:
        def __init__(self) -> None:
            self.sent: list[bytes] = []

        async def send(self, data: bytes) -> None:
            self.sent.append(data)

    async def packed_by(kind: type[AsyncMessageBuffer], send: Any) -> bytes:
        buffer = kind(asyncio.get_running_loop(), persistent_messages=True)
        buffer.push(setting("a", 1))
        buffer.push(setting("b", np.arange(5, dtype=np.float32)))
        buffer.push(setting("c", np.arange(3, dtype=np.uint8)))
        socket = Socket()
        sending = asyncio.create_task(send(socket, buffer, 0, MARKER))
        while not socket.sent:
            await asyncio.sleep(0.001)
        sending.cancel()
        return socket.sent[0]

    async def job() -> None:
        (own, own_arrays), (visers, visers_arrays) = (
            unpack(await packed_by(MessageBuffer, send_windows)),
            unpack(await packed_by(AsyncMessageBuffer, VISERS_PRODUCER)),
        )
        assert VISERS_PRODUCER is not send_windows
        own.pop("timestampSec"), visers.pop("timestampSec")
        assert own == visers and own_arrays == visers_arrays and len(own["messages"]) == 4

    run(job)


def unpack(frame: bytes) -> tuple[dict[str, Any], bytes]:
    """What a frame holds besides its arrays, and these."""
    whole, size = int.from_bytes(frame[:8], "little"), int.from_bytes(frame[8:16], "little")
    content = zstandard.decompress(frame[16 : 16 + size])
    assert len(content) == whole
    start = 16 + size + -size % 8
    assert not any(frame[16 + size : start])
    return msgspec.msgpack.decode(content), frame[start:]
