"""The files of rerun's web viewer, which are inside rerun's program and nowhere else.

The program is started to hand over script and WebAssembly, and ended at once.
"""

from __future__ import annotations

import contextlib
import http.client
import importlib.util
import os
import re
import subprocess
import threading
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

HOST = "127.0.0.1"
RECORDING = "/recording.rrd"
PATIENCE_SECONDS = 60.0
"""How long rerun's program may take to hand over the viewer; it takes half a second, or on a slow
disk as long as it takes to read a program of 300 MB."""
RERUNS_OWN = {
    "/re_viewer.js": "text/javascript; charset=utf-8",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
"""Path and type of the files that rerun's program hands over."""


class NoViewer(OSError):
    """rerun's program is missing, or hands over no viewer."""


class File(NamedTuple):
    kind: str
    """The media type."""
    content: bytes


def viewer_files() -> dict[str, File]:
    """The files of rerun's viewer. Raises NoViewer."""
    program = _program()
    try:
        with _serving(program) as port:
            return {path: File(kind, _fetch(port, path)) for path, kind in RERUNS_OWN.items()}
    except (OSError, http.client.HTTPException) as error:
        raise NoViewer(
            f"cannot take the web viewer out of {program}: {error}; install rerun-sdk again"
        ) from error


def _program() -> Path:
    """rerun's program itself: the command `rerun` is a script, and ending it does not end this."""
    spec = importlib.util.find_spec("rerun_cli")
    folders = spec.submodule_search_locations if spec is not None else None
    for folder in folders or ():
        for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun"):
            if (program := Path(folder, name)).is_file():
                return program
    raise NoViewer("rerun's web viewer is not installed: pip install rerun-sdk")


@contextlib.contextmanager
def _serving(program: Path) -> Iterator[int]:
    """While entered, rerun's program serves its viewer on this machine, at the port given.

    It is given the address of a recording, so that it opens no port of its own to receive one.
    """
    elsewhere = f"http://{HOST}:1{RECORDING}"
    command = [str(program), "--serve-web", "--bind", HOST, "--web-viewer-port", "0", elsewhere]
    silent = subprocess.DEVNULL
    with subprocess.Popen(
        command, stdin=silent, stdout=silent, stderr=subprocess.PIPE, env=_environment()
    ) as child:
        alarm = threading.Timer(PATIENCE_SECONDS, child.kill)
        alarm.start()
        try:
            yield _announced_port(child.stderr or ())
        finally:
            alarm.cancel()
            child.kill()


def _environment() -> dict[str, str]:
    """Little of ours, so that no setting of the user's changes what rerun says or sends.

    rerun takes CI for a reason to collect no figures of its use, and to write no settings.
    """
    kept = ("LD_LIBRARY_PATH", "PATH", "SYSTEMROOT")
    ours = {name: os.environ[name] for name in kept if name in os.environ}
    return ours | {"CI": "1", "NO_COLOR": "1", "RUST_LOG": "info"}


def _announced_port(lines: Iterable[bytes]) -> int:
    """Where rerun's program says that it serves its viewer."""
    for line in lines:
        found = re.search(rf"http://{re.escape(HOST)}:(\d+)".encode(), line)
        if found is not None:
            return int(found[1])
    raise NoViewer("it ended before it served it")


def _fetch(port: int, path: str) -> bytes:
    connection = http.client.HTTPConnection(HOST, port)
    with contextlib.closing(connection):
        connection.request("GET", path)
        answer = connection.getresponse()
        if answer.status != HTTPStatus.OK:
            raise NoViewer(f"it has no {path}")
        return answer.read()
