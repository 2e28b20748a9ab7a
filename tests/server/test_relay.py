"""The stream for rerun's viewers: programs reach it, web pages do not."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest
from raw_client import wait_until

from hebbviz.server.recording import relay
from hebbviz.server.recording.relay import PREFACE, Relay
from hebbviz.server.recording.targets import StreamTarget


@contextlib.contextmanager
def relayed() -> Iterator[tuple[Relay, socket.socket, list[str]]]:
    """A relay, the server behind it, and what was told."""
    told: list[str] = []
    one = Relay(0, told.append)
    with socket.create_server(one.behind) as behind:
        behind.settimeout(5.0)
        one.start()
        try:
            yield one, behind, told
        finally:
            one.close()


def connect(one: Relay) -> socket.socket:
    return socket.create_connection(("127.0.0.1", one.port), timeout=5.0)


def test_what_speaks_http_2_is_passed_on_both_ways() -> None:
    with relayed() as (one, behind, told), connect(one) as viewer:
        for byte in PREFACE + b"asked":
            viewer.sendall(bytes([byte]))
        inner, _ = behind.accept()
        with inner:
            assert read(inner, len(PREFACE) + 5) == PREFACE + b"asked"
            answer = b"x" * 3_000_000
            sender = threading.Thread(target=inner.sendall, args=(answer,))
            sender.start()
            assert read(viewer, len(answer)) == answer
            sender.join()
            inner.sendall(b"last")
            inner.shutdown(socket.SHUT_WR)
            viewer.sendall(b"ping")  # what comes late takes nothing away
            assert read(viewer, 99) == b"last"
        assert told == []


@pytest.mark.parametrize(
    "begun",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"POST /rerun HTTP/1.1\r\nHost: evil.example\r\nOrigin: http://evil.example\r\n\r\n",
        b"OPTIONS / HTTP/1.1\r\n\r\n",
        b"PRI / HTTP/2.0\r\n\r\nSM\r\n\r\n",
        b"PRI * HTTP/1.1\r\n\r\nSM\r\n\r\n",
        b"PRI * HTTP/2.0\r\nHost: evil.example\r\n\r\n",
        b"pri * http/2.0\r\n\r\nsm\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01",
        b"\r\n" + PREFACE,
    ],
)
def test_nothing_else_is(begun: bytes) -> None:
    with relayed() as (one, behind, told):
        for _ in range(2):
            with connect(one) as page:
                page.sendall(begun)
                with contextlib.suppress(ConnectionResetError):
                    assert read(page, 99)[:12] in (b"HTTP/1.1 403", b"")
        behind.settimeout(0.05)
        with pytest.raises(TimeoutError):
            behind.accept()
        assert told == [relay.REFUSED]


def test_a_viewer_that_is_gone_is_told_on() -> None:
    with relayed() as (one, behind, _):
        viewer = connect(one)
        viewer.sendall(PREFACE)
        inner, _ = behind.accept()
        viewer.close()
        with inner:
            assert read(inner, 99) == PREFACE


def test_who_says_nothing_is_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "PREFACE_SECONDS", 0.05)
    with relayed() as (one, _, told), connect(one) as silent:
        assert silent.recv(9) == b""
        assert told == []


def test_it_closes_though_a_viewer_takes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relay, "DRAIN_SECONDS", 0.05)
    with relayed() as (one, behind, _), connect(one) as viewer:
        viewer.sendall(PREFACE)
        inner, _ = behind.accept()
        wait_until(lambda: one._passing == 1)
        one.close()
        with pytest.raises(ConnectionRefusedError):
            connect(one)
        inner.close()


ASKED = (
    "POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\n"
    "Host: {}\r\n{}Content-Type: application/grpc-web+proto\r\nContent-Length: 5\r\n\r\n"
).format


@pytest.mark.parametrize("origin", ["", "http://localhost:3000", "https://rerun.io"])
def test_rerun_s_server_gives_a_page_nothing(origin: str) -> None:
    """Behind the relay it still answers anybody: it is how this test knows what to fear."""
    told: list[str] = []
    target = StreamTarget(0, told.append)
    try:
        request = ASKED("evil.example", f"Origin: {origin}\r\n" if origin else "").encode()
        for where, answer in (
            (target._relay.behind, b"HTTP/1.1 200"),
            (("127.0.0.1", target._relay.port), b"HTTP/1.1 403"),
        ):
            with socket.create_connection(where, timeout=5.0) as page:
                page.sendall(request + bytes(5))
                assert page.recv(12) == answer
        assert told == [relay.REFUSED]
    finally:
        target.close()


def read(source: socket.socket, count: int) -> bytes:
    """So many bytes, or those until the end."""
    found = b""
    while len(found) < count and (piece := source.recv(count - len(found))):
        found += piece
    return found
