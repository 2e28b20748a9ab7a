"""A recording in rerun's own web viewer, on this machine alone.

The viewer is a page, a script and 43 MB of WebAssembly, all inside rerun's program and nowhere
else. That program could serve them itself, but its page loads fonts from outside, asks GitHub for
updates and reports what is done in it. So it is started only to hand over script and WebAssembly,
and ended at once; they are then served from memory with a page of our own, which lets nothing out,
and with a policy by which the browser lets nothing out either.
"""

from __future__ import annotations

import contextlib
import errno
import html
import os
import socket
import socketserver
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hebbviz.server.recording.rerun_program import (
    HOST,
    RECORDING,
    File,
    viewer_files,
)
from hebbviz.server.web.access import Access, Entrance, Passage, Role, headers
from hebbviz.server.web.browser_window import open_window
from hebbviz.server.web.refusal import Refused
from hebbviz.sims.program.terminal import reason

if TYPE_CHECKING:
    from collections.abc import Callable

LATENCY_SECONDS = 0.05  # until the server sees that it is to end
MAGIC = b"RRF"  # how every rerun recording begins
HEADERS = headers(
    {
        "script-src": "'self' 'wasm-unsafe-eval'",
        "connect-src": "'self'",
        "img-src": "'self' data: blob:",
        "media-src": "data: blob:",
        "style-src": "'self'",
    }
)
"""Sent with every answer."""

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<link rel="icon" href="favicon.ico">
<link rel="stylesheet" href="page.css">
<p id="words">Loading rerun's viewer…</p>
<canvas id="canvas" hidden></canvas>
<script src="re_viewer.js"></script>
<script src="start.js"></script>
</html>
"""

STYLE = """:root { color-scheme: light dark; }
html, body { margin: 0; height: 100%; overflow: hidden; touch-action: manipulation; }
#words { margin: 4em auto; max-width: 40em; padding: 0 1em; font: 16px sans-serif; }
#words { white-space: pre-wrap; }
#canvas { position: absolute; inset: 0; width: 100%; height: 100%; }
#canvas[hidden] { display: none; }
"""

# There is no switch for the viewer's reports, but it bears it in silence when they fail.
# `?renderer=` is its own name for how it draws, which can be chosen in its menu.
START = """"use strict";
const PANIC_CHECK_MS = 1000;
const canvas = document.getElementById("canvas");
const words = document.getElementById("words");
const chosen = new URLSearchParams(location.search).get("renderer");

function fail(why) {
  console.error(why);
  canvas.remove();
  const other = chosen === "webgl" ? "webgpu" : "webgl";
  words.textContent = `rerun's viewer has stopped: ${why}\\n\\nReload the page to try again, or `
    + `draw in another way: ${location.origin}/?renderer=${other}`;
}

function watch(viewer) {
  if (viewer.has_panicked()) fail(viewer.panic_message());
  else setTimeout(watch, PANIC_CHECK_MS, viewer);
}

const ask = window.fetch.bind(window);
window.fetch = (what, how) => {
  const to = new URL(what instanceof Request ? what.url : what, location.href);
  if (to.origin === location.origin) return ask(what, how);
  return Promise.resolve(Response.error());  // as if the machine had no network
};

async function show() {
  await wasm_bindgen({ module_or_path: "re_viewer_bg.wasm" });
  const viewer = new wasm_bindgen.WebHandle({
    url: [`${location.origin}/recording.rrd`],
    render_backend: chosen,
    hide_welcome_screen: true,
    check_for_updates_on_startup: false,
    enable_history: false,
    persist: false,
  });
  watch(viewer);
  canvas.hidden = false;
  await viewer.start(canvas);
}

show().catch(fail);
"""


class Viewer:
    """Shows one recording to the browsers of this machine; it listens from here on.

    `port` 0 is any free one. `access` says who may connect; `on_turned_away` receives one line,
    with the remedy, for the first refused request of each kind.

    Raises ValueError if `path` is no recording or `port` no port, and OSError if the port cannot be
    listened on or rerun's viewer cannot be had (`NoViewer`).
    """

    def __init__(
        self,
        path: str | Path,
        *,
        port: int = 0,
        access: Access = Access(),  # noqa: B008
        on_turned_away: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.path = check_recording(path)
        self._server = _listen(port)
        self._server.entrance = Entrance(HOST, access)
        self._server.on_turned_away = on_turned_away
        try:
            self._server.files = _page(self.path.name) | viewer_files()
        except BaseException:
            self._server.server_close()
            raise
        self._server.recording = self.path
        self._thread = threading.Thread(
            target=self._server.serve_forever,
            args=(LATENCY_SECONDS,),
            name="hebbviz viewer",
            daemon=True,
        )
        self._thread.start()

    @property
    def address(self) -> str:
        """Where it is on this machine."""
        return f"http://{HOST}:{self._server.server_port}/"

    @property
    def link(self) -> str:
        """Address to open in a browser."""
        return self._server.entrance.link(self.address)

    @property
    def warning(self) -> str | None:
        """A warning about who can reach it, if any is due."""
        return self._server.entrance.warning("read the recording")

    def run(self, stop: threading.Event, *, open_browser: bool) -> None:
        """Show it until `stop` is set; then close."""
        try:
            if open_browser:
                open_window(self._server.entrance.link_for_once(self.address))
            while not stop.wait(1.0):  # where a wait has no end, Windows heeds no Ctrl-C
                pass
        finally:
            self.close()

    def close(self) -> None:
        """Listen no longer, and cut off who still reads. May be called again."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def check_recording(path: str | Path) -> Path:
    """The path of a recording, absolute; raises ValueError if there is none that can be read."""
    path = Path(path).absolute()
    advice = "give a file that was recorded, such as run.rrd"
    if not path.exists():
        raise ValueError(f"cannot show {path}: there is no such file; {advice}")
    if not path.is_file():  # to open a pipe could take for ever
        raise ValueError(f"cannot show {path}: it is not a file; {advice}")
    try:
        with path.open("rb") as file:
            beginning = file.read(len(MAGIC))
    except OSError as error:
        raise ValueError(f"cannot show {path}: {reason(error)}; {advice}") from error
    if beginning != MAGIC:
        raise ValueError(f"cannot show {path}: it is no rerun recording; {advice}")
    return path


# Our server


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 64
    allow_reuse_address = os.name == "posix"  # there it only skips the wait after a restart

    def __init__(self, port: int) -> None:
        self.files: dict[str, File] = {}
        self.recording = Path()
        self.entrance = Entrance(HOST)
        self.on_turned_away: Callable[[str], None] = lambda _: None
        self.told: set[str] = set()
        self._connections: set[Any] = set()
        super().__init__((HOST, port), _Handler)

    def server_bind(self) -> None:
        """As HTTPServer does it, but without looking up the name of this machine in a network."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, self.socket.getsockname()[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        self._connections.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._connections.discard(request)
        super().shutdown_request(request)

    def server_close(self) -> None:
        """Also end the threads that wait for a browser which says nothing, or stalls."""
        super().server_close()
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that breaks off is no fault of ours, and worth no traceback."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """One request. There is no time limit: a tab in the background reads slowly, and what is cut
    short would be shown as a shorter recording.
    """

    server: _Server
    server_version, sys_version = "hebbviz", ""
    passage = Passage(Role.NOBODY)

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if not self._is_let_in():
            return
        if path == RECORDING:
            self._send_recording()
        elif path in self.server.files:
            kind, content = self.server.files[path]
            self._begin(kind, len(content))
            if self.command == "GET":
                self.wfile.write(content)
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    do_HEAD = do_GET  # noqa: N815

    def end_headers(self) -> None:
        for name, value in HEADERS.items():
            self.send_header(name, value)
        if self.passage.cookie is not None:
            self.send_header("Set-Cookie", self.passage.cookie)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Say nothing: the terminal is the user's."""

    def _is_let_in(self) -> bool:
        """Whether the request passes the entrance; one that does not is answered here."""
        try:
            self.passage = self.server.entrance.check(
                self.path, lambda name: self.headers.get_all(name, [])
            )
        except Refused as refused:
            if refused.kind not in self.server.told:
                self.server.told.add(refused.kind)
                self.server.on_turned_away(refused.line)
            self.send_error(HTTPStatus.FORBIDDEN, "Refused", refused.line)
            return False
        return True

    def _send_recording(self) -> None:
        """As much of it as is there now: it may still be written to."""
        try:
            file = self.server.recording.open("rb")
        except OSError:
            self.send_error(HTTPStatus.NOT_FOUND, "The recording is no longer there")
            return
        with file:
            size = os.fstat(file.fileno()).st_size
            self._begin("application/octet-stream", size)
            if self.command == "GET" and size:
                self.connection.sendfile(file, count=size)

    def _begin(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.end_headers()


def _listen(port: int) -> _Server:
    if not 0 <= port <= 65535:
        raise ValueError(f"port must be between 0 and 65535, got {port}")
    try:
        return _Server(port)
    except OSError as error:
        taken = error.errno == errno.EADDRINUSE
        why = "the port is taken" if taken else reason(error)
        advice = "choose another port, or 0 for any free one"
        raise OSError(f"can't listen on {HOST}:{port}: {why}; {advice}") from error


def _page(name: str) -> dict[str, File]:
    """Our part of the page. `name` is the file's, which may be in any encoding."""
    title = html.escape(f"{os.fsencode(name).decode(errors='replace')} · hebbviz")
    return {
        "/": File("text/html; charset=utf-8", PAGE.format(title=title).encode()),
        "/page.css": File("text/css; charset=utf-8", STYLE.encode()),
        "/start.js": File("text/javascript; charset=utf-8", START.encode()),
    }


# rerun's program
