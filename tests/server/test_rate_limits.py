"""What a page sends too much of: the last value wins, presses are counted, crowds wait outside."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st
from raw_client import CAMERA, RawClient, wait_until
from websockets.exceptions import InvalidStatus

from hebbviz.server.web import connection_limits, guard, rate_limits
from hebbviz.server.web.guard import GuardedServer
from hebbviz.server.web.rate_limits import (
    MESSAGES_PER_SECOND,
    MOST_PRESSES,
    Allowance,
    Inflow,
    TimeShare,
)

ROOT = Path(__file__).parents[2]
some = st.lists(st.tuples(st.sampled_from(["camera", "β", None]), st.binary(max_size=3)))


def drained(flow: Inflow, now: float) -> list[bytes]:
    """All that can be taken, with as much time as it needs."""
    taken = []
    while (found := flow.take(now)) is not None:
        if isinstance(found, bytes):
            taken.append(found)
        else:
            now += found
    return taken


@given(some)
def test_the_last_of_each_key_wins_and_each_press_counts(sent: list[tuple[Any, bytes]]) -> None:
    flow = Inflow()
    for key, message in sent[: MOST_PRESSES - 1]:
        flow.put(key, message)
    last = {key or -number: number for number, (key, _) in enumerate(sent[: MOST_PRESSES - 1], 1)}
    assert drained(flow, 0.0) == [sent[k - 1][1] for k in sorted(last.values())]


def test_a_flood_of_values_leaves_one_of_each() -> None:
    flow = Inflow()
    for k in range(100_000):
        assert flow.put(f"slider {k % 2}", b"%d" % k)
    assert len(flow) == 2
    assert drained(flow, 0.0) == [b"99998", b"99999"]


def test_presses_are_bounded_and_what_is_lost_is_known() -> None:
    flow = Inflow()
    put = [flow.put(None, b"%d" % k) for k in range(100)]
    assert put == [True] * MOST_PRESSES + [False] * (100 - MOST_PRESSES)
    assert drained(flow, 0.0) == [b"%d" % k for k in range(MOST_PRESSES)]
    assert flow.put(None, b"again")


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_an_allowance_is_kept_over_any_time(share: float) -> None:
    allowance, now, taken = Allowance(50.0), 1000.0, 0
    while now < 1010.0:
        wait = allowance.wait(now, share=share)
        taken, now = (taken, now + wait) if wait else (taken + 1, now)
    assert 0.97 * 500 * share <= taken <= 500 * share + 50


def test_no_more_is_handed_on_than_is_allowed() -> None:
    flow, taken, now = Inflow(), 0, 0.0
    while now < 10.0:
        flow.put("camera", b"")
        found = flow.take(now)
        taken += isinstance(found, bytes)
        now += found if isinstance(found, float) else 1e-4
    assert 9 * MESSAGES_PER_SECOND < taken <= 11 * MESSAGES_PER_SECOND + 1


@pytest.mark.parametrize("each", [1e-4, 0.02, 0.2])
def test_what_always_wants_more_gets_its_share_of_the_time(each: float) -> None:
    share, now, spent = TimeShare(0.25, 1.0), 1000.0, 0.0
    while now < 1100.0:
        if share.is_left(now):
            share.spend(each)
            spent += each
            now += each
        else:
            now += 0.01
    assert 24.0 < spent < 26.5


def test_who_owes_time_waits_for_a_second_at_most() -> None:
    share = TimeShare(0.25, 1.0)
    assert share.is_left(1000.0)
    share.spend(60.0)
    assert not share.is_left(1060.0 - 59.5)
    assert share.is_left(1061.1)


# At a server.


@contextlib.contextmanager
def opened(refusals: list[str]) -> Iterator[GuardedServer]:
    server = guard.open_server(port=0, on_refusal=refusals.append)
    try:
        yield server
    finally:
        server.stop()


def test_a_page_that_floods_is_heard_last_and_loses_only_presses() -> None:
    refusals: list[str] = []
    with opened(refusals) as server:
        slider = server.gui.add_slider("slider", 0.0, 1.0, 1e-6, 0.0)
        pressed, moved = [], []
        server.gui.add_button("button").on_click(lambda _: pressed.append(1))
        slider.on_update(lambda _: moved.append(slider.value))
        with RawClient(server.get_port()) as client:
            page, button = client.find("slider"), client.find("button")
            for k in range(1, 401):
                client.send_value(page, k / 400)
                client.send(CAMERA | {"position": [float(k), 0.0, 0.0]})
                client.press(button)
            tabs = server.get_clients
            client.wait(lambda: slider.value == 1.0, 30)
            client.wait(lambda: [t.camera.position[0] for t in tabs().values()] == [400.0], 30)
        assert len(moved) < 400 and len(pressed) < 400
        assert [line for line in refusals if "clicks" in line] == refusals


def status(server: GuardedServer, path: str = "/") -> tuple[int, str]:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{server.get_port()}{path}") as answer:
            return answer.status, answer.read().decode(errors="replace")
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_only_so_many_pages_are_open_and_one_more_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection_limits, "MOST_PAGES", 3)
    refusals: list[str] = []
    with opened(refusals) as server, contextlib.ExitStack() as pages:
        for _ in range(3):
            pages.enter_context(RawClient(server.get_port(), decode=False))
        with pytest.raises(InvalidStatus):
            RawClient(server.get_port())
        assert status(server) == (503, "refused a page: 3 are open already; close one of them\n")
        assert refusals == ["refused a page: 3 are open already; close one of them"]
        pages.close()
        wait_until(lambda: not server.gate or server.gate.crowd.pages == 0)
        with RawClient(server.get_port()) as client:
            client.wait(server.get_clients)


def test_connections_that_say_nothing_make_room() -> None:
    with opened([]) as server, contextlib.ExitStack() as idle:
        assert server.gate is not None
        server.gate.crowd.most = 8
        page = idle.enter_context(RawClient(server.get_port()))
        for _ in range(30):
            idle.enter_context(socket.create_connection(("127.0.0.1", server.get_port())))
        wait_until(lambda: server.gate is not None and len(server.gate.crowd) == 8)
        assert status(server)[0] == 200
        assert not page.closed


@pytest.mark.parametrize("path", ["/" + "a" * 5000, "/" + "%61" * 400, "/%00", "/" + "a/" * 2500])
def test_a_path_that_no_file_can_have_is_not_found(path: str) -> None:
    with opened([]) as server:
        assert status(server, path)[0] == 404


def test_each_request_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    class Counted(rate_limits.Allowance):
        def wait(self, now: float, *, share: float = 1.0) -> float:
            asked.append(wait := super().wait(now, share=share))
            return wait

    monkeypatch.setattr(connection_limits, "Allowance", Counted)
    with opened([]) as server:
        for _ in range(8):
            assert status(server, "/none")[0] == 404
    assert asked.count(0.0) == 8


def upgraded(port: int) -> socket.socket:
    """A websocket, to be written to by hand."""
    wire = socket.create_connection(("127.0.0.1", port))
    request = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket"]
    request += ["Connection: Upgrade", "Sec-WebSocket-Version: 13"]
    request += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]
    request += [f"Sec-WebSocket-Protocol: viser-v{viser.__version__}", "", ""]
    wire.sendall("\r\n".join(request).encode())
    assert wire.recv(12) == b"HTTP/1.1 101"
    return wire


def test_a_client_that_leaves_amid_its_pings_is_not_complained_of(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with opened([]) as server:
        for _ in range(3):
            with upgraded(server.get_port()) as wire:
                wire.settimeout(0.2)
                with contextlib.suppress(TimeoutError):
                    wire.sendall(b"\x89\x80\0\0\0\0" * 20_000)
                wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        wait_until(lambda: server.gate is not None and not server.gate.crowd, 30)
    assert [r.getMessage() for r in caplog.records if r.name == "asyncio"] == []


FEW_FILES = """
import resource, sys
from hebbviz.server.web import connection_limits as crowd, guard
crowd.MOST_CONNECTIONS, limit = int(sys.argv[1]), (50, 50)
crowd_of_limit = sys.argv[1] == "128"
if crowd_of_limit:
    resource.setrlimit(resource.RLIMIT_NOFILE, limit)
server = guard.open_server(port=0, on_refusal=lambda line: print(line, flush=True))
if not crowd_of_limit:
    resource.setrlimit(resource.RLIMIT_NOFILE, limit)
print(server.get_port(), flush=True)
sys.stdin.read()
server.stop()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it has no such limit")
@pytest.mark.parametrize("most", [128, 1000])
def test_a_shortage_of_files_is_one_line_and_no_end(most: int) -> None:
    """However few: fewer connections are let in. What is short all the same is told once."""
    program = [sys.executable, "-c", FEW_FILES, str(most)]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(program, **pipes, stderr=subprocess.STDOUT, text=True, cwd=ROOT) as short:
        assert short.stdout is not None
        port = int(short.stdout.readline())
        with contextlib.ExitStack() as crowded:
            for _ in range(100):
                wire = socket.create_connection(("127.0.0.1", port))
                crowded.enter_context(wire)
            if most > 128:
                assert "too many files are open" in short.stdout.readline()
        wait_until(lambda: fetched(port), 30)
        said, _ = short.communicate("")
    assert "Traceback" not in said and said.count("\n") <= 1
    assert short.returncode == 0


def fetched(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=5) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False
