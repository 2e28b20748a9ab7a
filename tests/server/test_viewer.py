"""A recording in rerun's viewer: it is shown whole, and no other machine has a part in it."""

from __future__ import annotations

import contextlib
import http.client
import io
import os
import re
import socket
import subprocess
import threading
import time
import tracemalloc
import webbrowser
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image
from playwright.sync_api import Browser, Page, Request, Response
from raw_client import answers, wait_until

from hebbviz.server.recording import rerun_program
from hebbviz.server.recording.rerun_program import NoViewer
from hebbviz.server.recording.viewer import Viewer
from hebbviz.server.web.access import Access

STRIPES = ((250, 40, 200), (30, 230, 110), (70, 20, 140))
"""Colours that the viewer's own parts do not have."""
GIGABYTE = 2**30


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A picture of stripes that fills the window, under a name with what HTML and shells mind."""
    path = tmp_path_factory.mktemp("recordings") / "<b>mine & 'yours'.rrd"
    recorder = rr.RecordingStream("hebbviz test", recording_id="stripes")
    view = rrb.Spatial2DView(origin="stripes", name="Stripes")
    blueprint = rrb.Blueprint(view, collapse_panels=True)
    recorder.set_sinks(rr.FileSink(str(path), write_footer=True), default_blueprint=blueprint)
    pixels = np.repeat(np.array(STRIPES, np.uint8), 8, axis=0)[:, None].repeat(24, axis=1)
    recorder.set_time("step", sequence=3)
    recorder.log("stripes", rr.Image(pixels))
    recorder.flush(timeout_sec=10.0)
    recorder.disconnect()
    return path


@pytest.fixture(scope="module")
def shown(recording: Path) -> Iterator[Viewer]:
    with contextlib.closing(Viewer(recording)) as one:
        yield one


# In a browser


@pytest.mark.slow
def test_the_page_shows_the_recording_and_asks_no_other_machine(
    shown: Viewer, recording: Path, browser: Browser
) -> None:
    asked: list[Request] = []
    answered: dict[str, Response] = {}
    broken: list[str] = []
    said: list[str] = []
    page = browser.new_page(viewport={"width": 500, "height": 400})
    page.on("request", lambda request: asked.append(request))  # noqa: PLW0108
    page.on("requestfailed", lambda request: broken.append(request.url))
    page.on("websocket", lambda channel: pytest.fail(f"opened a channel to {channel.url}"))
    page.on("response", lambda answer: answered.update({urlsplit(answer.url).path: answer}))
    page.on("console", lambda line: said.append(line.text))
    page.on("pageerror", lambda error: pytest.fail(str(error)))
    page.goto(shown.address)

    assert _shows_stripes(page), "the picture in the recording is not on the screen"
    assert page.title() == f"{recording.name} · hebbviz"
    assert answered["/recording.rrd"].status == 200
    size = int(answered["/recording.rrd"].headers["content-length"])
    assert size == recording.stat().st_size
    assert not broken, "what was asked for did not come whole"
    assert {urlsplit(request.url).netloc for request in asked} == {urlsplit(shown.address).netloc}
    assert not [line for line in said if "Content Security Policy" in line]
    page.close()


def test_the_policy_stops_what_the_page_lets_out(shown: Viewer, browser: Browser) -> None:
    """The second wall: what a browser would send if the viewer found another way to ask."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        page = browser.new_page()
        page.route("**/start.js", lambda route: route.fulfill(body=""))
        page.goto(shown.address)
        page.evaluate(
            """(where) => {
                fetch(where, { mode: "no-cors" }).catch(() => {});
                navigator.sendBeacon(where, "told");
                const image = new Image();
                image.src = where;
                new WebSocket(where.replace("http", "ws")).onerror = () => {};
            }""",
            f"http://127.0.0.1:{port}/",
        )
        other.settimeout(0.5)
        with pytest.raises(TimeoutError):
            other.accept()
        page.close()


def _shows_stripes(page: Page, seconds: float = 90.0) -> bool:
    """Whether each of the stripes comes to cover a part of the screen."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        page.wait_for_timeout(200)
        pixels = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), int)
        if all((abs(pixels - c).max(axis=-1) <= 3).mean() > 0.05 for c in STRIPES):
            return True
    return False


# What the server answers


def test_the_recording_is_served_byte_for_byte(shown: Viewer, recording: Path) -> None:
    for _ in range(2):
        status, headers, body = _ask(shown, "/recording.rrd")
        assert status == 200 and body == recording.read_bytes()
    status, headers, body = _ask(shown, "/recording.rrd", method="HEAD")
    assert status == 200 and body == b""
    assert int(headers["Content-Length"]) == recording.stat().st_size


@pytest.mark.parametrize("path", ["/", "/?renderer=webgl", "/start.js", "/re_viewer_bg.wasm"])
def test_head_gives_the_length_of_what_get_gives(shown: Viewer, path: str) -> None:
    assert int(_ask(shown, path, method="HEAD")[1]["Content-Length"]) == len(_ask(shown, path)[2])


@pytest.mark.parametrize(
    "path",
    ["/recordings", "/recording.rrd/", "/../recording.rrd", "/etc/passwd"]
    + ["/%2e%2e/", "/index.html", "/signed-in", "http://127.0.0.1/", "*"],
)
def test_there_is_nothing_else(shown: Viewer, path: str) -> None:
    status, _, body = _ask(shown, path)
    assert status == 404 and b"rrd" not in body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "CONNECT"])
def test_it_can_only_be_read(shown: Viewer, method: str) -> None:
    for path in ("/", "/recording.rrd"):
        assert _ask(shown, path, method=method)[0] in (405, 501)


@pytest.mark.parametrize("path", ["/", "/recording.rrd", "/nothing"])
@pytest.mark.parametrize(
    "hosts",
    [[], ["evil.example"], ["evil.example:{port}"], ["10.0.0.1"], [""]]
    + [["127.0.0.1:{port}.evil.example"], ["127.0.0.1:{port}", "evil.example"]],
)
def test_only_its_own_names_are_answered(shown: Viewer, hosts: list[str], path: str) -> None:
    named = [host.format(port=_port(shown)) for host in hosts]
    status, _, body = _ask(shown, path, hosts=named)
    assert status == 403 and b"hebbviz<" not in body and not body.startswith(b"RRF")


@pytest.mark.parametrize("path", ["/", "/recording.rrd"])
def test_other_pages_are_not_answered(shown: Viewer, path: str) -> None:
    own = f"http://127.0.0.1:{_port(shown)}"
    assert _ask(shown, path, Origin=own)[0] == 200
    assert _ask(shown, path, Origin="http://127.0.0.1:1")[0] == 403


def test_its_own_names_are_answered_with_any_port(shown: Viewer) -> None:
    """It may be forwarded."""
    for name in ("127.0.0.1", "localhost", "LocalHost", "localhost.:9000", "[::1]:9000"):
        assert _ask(shown, "/", hosts=[name])[0] == 200


def test_an_allowed_name_is_answered_and_needs_the_token(recording: Path) -> None:
    told: list[str] = []
    allowed = Access(("lab.example.org",))
    with contextlib.closing(Viewer(recording, access=allowed, on_turned_away=told.append)) as one:
        link = urlsplit(one.link)
        assert one.warning is None
        for path in ("/", "/recording.rrd", "/?token=wrong"):
            assert _ask(one, path, hosts=["lab.example.org"])[0] == 403
        status, headers, _ = _ask(one, f"/?{link.query}", hosts=["lab.example.org"])
        assert status == 200
        cookie = headers["Set-Cookie"].split(";")[0]
        body = _ask(one, "/recording.rrd", hosts=["lab.example.org"], Cookie=cookie)[2]
        assert body == recording.read_bytes()
        assert _ask(one, "/", hosts=["evil.example"], Cookie=cookie)[0] == 403
        assert _ask(one, "/", hosts=["evil.example"], Cookie=cookie)[0] == 403
    assert [line.partition("; ")[2] for line in told] == [
        "open the link that was printed as this one started",
        "if it is: --allow-host evil.example",
    ]


def test_it_says_what_no_token_opens(recording: Path) -> None:
    allowed = Access(("lab.example.org",), token=False)
    with contextlib.closing(Viewer(recording, access=allowed)) as one:
        assert one.warning is not None and "whoever reaches it can read" in one.warning
        assert _ask(one, "/recording.rrd", hosts=["lab.example.org"])[0] == 200


@pytest.mark.parametrize("path", ["/", "/recording.rrd", "/nothing"])
def test_every_answer_has_the_policy(shown: Viewer, path: str) -> None:
    _, headers, _ = _ask(shown, path)
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy
    assert not re.search(r"https?:|\*|'unsafe-inline'|'unsafe-eval'", policy)
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["X-Frame-Options"] == "DENY" and "frame-ancestors 'none'" in policy
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "Access-Control-Allow-Origin" not in headers
    assert "Python" not in headers["Server"]


def test_the_page_runs_no_name_of_a_file(shown: Viewer) -> None:
    body = _ask(shown, "/")[2].decode()
    assert "<b>" not in body and "&lt;b&gt;mine &amp; &#x27;yours" in body


def test_nobody_reaches_it_but_at_the_loopback_address(shown: Viewer) -> None:
    assert answers("127.0.0.1", _port(shown))
    # every 127.x.x.x is this machine, but only 127.0.0.1 is the address that is listened on
    assert not answers("127.0.0.2", _port(shown))
    assert not answers("::1", _port(shown))


def test_a_recording_that_has_grown_is_served_as_it_is_now(tmp_path: Path) -> None:
    path = tmp_path / "growing.rrd"
    path.write_bytes(b"RRF2")
    with contextlib.closing(Viewer(path)) as one:
        path.write_bytes(b"RRF2 and more")
        assert _ask(one, "/recording.rrd")[2] == b"RRF2 and more"
        path.unlink()
        assert _ask(one, "/recording.rrd")[0] == 404


@pytest.mark.slow
def test_a_large_recording_is_never_in_memory(tmp_path: Path) -> None:
    path = tmp_path / "large.rrd"
    path.write_bytes(b"RRF2")
    os.truncate(path, GIGABYTE)
    with contextlib.closing(Viewer(path)) as one, _connection(one) as connection:
        tracemalloc.start()
        try:
            connection.request("GET", "/recording.rrd")
            answer, size, room = connection.getresponse(), 0, bytearray(2**20)
            while (count := answer.readinto(room)) > 0:
                size += count
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert size == GIGABYTE
    assert peak < 2**24


# Start and end


def test_rerun_s_program_has_ended_when_it_is_shown(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = _watched_programs(monkeypatch)
    with contextlib.closing(Viewer(recording)):
        assert [child.poll() is not None for child in started] == [True]
    (child,) = started
    assert Path(child.args[0]).read_bytes()[:2] != b"#!"  # a script would leave the program behind
    assert child.args[child.args.index("--bind") + 1] == "127.0.0.1"


@pytest.mark.skipif(os.name != "posix", reason="the programs are shell scripts")
@pytest.mark.parametrize(
    "script",
    ["exit 3", "sleep 60", "echo http://127.0.0.1:9/ >&2; sleep 60", "echo no such option >&2"],
)
def test_a_program_that_hands_over_nothing_is_ended_and_told_of(
    script: str, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "rerun"
    program.write_text(f"#!/bin/sh\n{script.replace('sleep', 'exec sleep')}\n")
    program.chmod(0o755)
    monkeypatch.setattr(rerun_program, "_program", lambda: program)
    monkeypatch.setattr(rerun_program, "PATIENCE_SECONDS", 0.3)
    started = _watched_programs(monkeypatch)
    with pytest.raises(NoViewer, match=r"rerun.*install rerun-sdk again"):
        Viewer(recording)
    assert [child.poll() is not None for child in started] == [True]


def test_without_rerun_it_says_so(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_program.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(NoViewer, match="pip install rerun-sdk"):
        Viewer(recording)


def test_it_shows_until_it_is_stopped_and_leaves_nothing(
    recording: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stop, one = threading.Event(), Viewer(recording)
    running = threading.Thread(target=one.run, args=(stop,), kwargs={"open_browser": False})
    running.start()
    with _connection(one) as stalled, _connection(one) as silent:
        stalled.request("GET", "/re_viewer_bg.wasm")  # and reads no answer
        silent.connect()
        assert _ask(one, "/")[0] == 200
        stop.set()
        running.join(2.0)
        assert not running.is_alive()
        wait_until(lambda: not [t for t in threading.enumerate() if "process_request" in t.name])
    one.close()  # a second time does no harm
    with pytest.raises(ConnectionRefusedError):
        _ask(one, "/")
    assert capfd.readouterr() == ("", "")


def test_a_browser_that_breaks_off_leaves_no_traceback(
    shown: Viewer, capfd: pytest.CaptureFixture[str]
) -> None:
    with _connection(shown) as connection:
        connection.request("GET", "/re_viewer_bg.wasm")
        connection.sock.recv(1)
    with socket.create_connection(("127.0.0.1", _port(shown))) as garbled:
        garbled.sendall(b"\x16\x03\x01 garbage\r\n\r\n")
        garbled.recv(100)
    assert _ask(shown, "/")[0] == 200
    assert capfd.readouterr() == ("", "")


def test_a_browser_is_opened_if_asked_for(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr("hebbviz.server.web.browser_window.has_display", lambda: True)
    stop, one = threading.Event(), Viewer(recording)
    running = threading.Thread(target=one.run, args=(stop,), kwargs={"open_browser": True})
    running.start()
    wait_until(lambda: opened)
    stop.set()
    running.join(2.0)
    assert opened == [one.address]


def test_a_taken_port_is_told_of(shown: Viewer, recording: Path) -> None:
    with pytest.raises(OSError, match=r"127\.0\.0\.1:\d+: the port is taken; choose another port"):
        Viewer(recording, port=_port(shown))
    with pytest.raises(ValueError, match="port must be between 0 and 65535, got 65536"):
        Viewer(recording, port=65536)


@pytest.mark.parametrize("content", [b"", b"RR", b"PK\x03\x04", b"\x00RRF2"])
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.rrd"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"other\.rrd: it is no rerun recording; give"):
        Viewer(path)


def test_what_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"missing\.rrd: there is no such file; give"):
        Viewer(tmp_path / "missing.rrd")
    with pytest.raises(ValueError, match="it is not a file; give"):
        Viewer(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.rrd")
        with pytest.raises(ValueError, match="it is not a file; give"):
            Viewer(tmp_path / "pipe.rrd")


# Tools


def _port(shown: Viewer) -> int:
    return int(urlsplit(shown.address).port or 0)


@contextlib.contextmanager
def _connection(shown: Viewer) -> Iterator[http.client.HTTPConnection]:
    with contextlib.closing(
        http.client.HTTPConnection("127.0.0.1", _port(shown), timeout=10.0)
    ) as one:
        yield one


def _ask(
    shown: Viewer, path: str, *, method: str = "GET", hosts: list[str] | None = None, **more: str
) -> tuple[int, http.client.HTTPMessage, bytes]:
    """Status, headers and body of the answer; `hosts` are its Host headers, one if not given."""
    own = [f"127.0.0.1:{_port(shown)}"]
    with _connection(shown) as connection:
        connection.putrequest(method, path, skip_host=True)
        for host in own if hosts is None else hosts:
            connection.putheader("Host", host)
        for name, value in more.items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def _watched_programs(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """The programs that are started from here on."""
    started: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen[bytes]):
        def __init__(self, *args: object, **options: object) -> None:
            super().__init__(*args, **options)  # type: ignore[call-overload]
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Watched)
    return started
