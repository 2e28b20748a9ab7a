"""Targets of a recording: a new file, or viewers that connect to this machine."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import rerun as rr

from hebbviz.server.recording.relay import Relay
from hebbviz.server.recording.streams import Stream
from hebbviz.sims.program.terminal import reason

DEFAULT_STREAM_PORT = 9876
RESERVE = 4_000_000
"""Bytes left free on a disk, so that a recording can be finished."""
RESERVE_SHARE = 0.02


class FileTarget:
    """One file for each run: NAME.rrd, then NAME-2.rrd, NAME-3.rrd … after a discontinuity.

    An existing file is never overwritten: `open` raises FileExistsError.
    """

    live = False
    silence = "the disk does not answer"
    """The message when nothing gets through."""

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        self._first = path if path.suffix == ".rrd" else path.with_name(f"{path.name}.rrd")
        self.path = self._first

    def open(self, number: int) -> Stream:
        """The stream of the `number`-th run, from 1 on."""
        stem = self._first.stem + (f"-{number}" if number > 1 else "")
        path = self._first.with_name(f"{stem}.rrd")
        path.open("xb").close()
        self.path = path
        try:
            self._check_room()
            stream = Stream()
            # a footer would be an index of all chunks, kept in memory: 24 MB more each minute
            stream.set_sinks(rr.FileSink(path, write_footer=False))
            self._inode, self._size = path.stat().st_ino, 0
        except BaseException as error:
            path.unlink(missing_ok=True)
            if isinstance(error, RuntimeError):  # rerun's, for whatever the disk says
                raise OSError(errno.EIO, str(error).splitlines()[0], str(path)) from error
            raise
        return stream

    def _check_room(self) -> None:
        """Raise OSError if there is no room to begin."""
        if shutil.disk_usage(self.path.parent).free < RESERVE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))

    @property
    def words(self) -> str:
        return str(self.path)

    def size(self) -> int | None:
        """Bytes written so far, None if unknown."""
        with contextlib.suppress(OSError):
            size = self.path.stat().st_size
            self._size = max(self._size, size)
            return size
        return 0

    def trouble(self, pending: int) -> str | None:
        """The reason why nothing more can be written, or None."""
        try:
            if self.path.stat().st_ino != self._inode:
                return "another file has taken the place of its own"
            free = shutil.disk_usage(self.path.parent).free
            written = self.path.stat().st_size
        except OSError as error:
            return f"its file is gone ({reason(error)})"
        if written < self._size:
            return "another program has truncated its file"
        if free < RESERVE + RESERVE_SHARE * written + pending:
            return f"the disk is full: only {free / 1e6:.1f} MB left"
        return None

    def close(self) -> None:
        pass


class StreamTarget:
    """A server on 127.0.0.1 that rerun's viewers connect to, through the relay; it waits for none
    of them.
    """

    live = True
    silence = "a viewer does not read its data"
    words = "the stream"

    def __init__(
        self, port: int = DEFAULT_STREAM_PORT, on_refused: Callable[[str], None] = lambda _: None
    ) -> None:
        self._relay = _relay(port, on_refused)
        self.url = f"rerun+http://127.0.0.1:{self._relay.port}/proxy"
        host, hidden = self._relay.behind
        self._own_url = f"rerun+http://{host}:{hidden}/proxy"
        self._hub = Stream()
        self._hub.set_sinks(
            rr.GrpcServerSink(
                bind_ip=host, port=hidden, server_memory_limit="256MiB", newest_first=False
            )
        )
        self._relay.start()

    def open(self, number: int) -> Stream:
        """A new stream for each run, through the one server.

        The server's own stream serves the first run; otherwise viewers would also show an empty
        one.
        """
        stream = Stream(self._hub.identity if number == 1 else None)
        stream.set_sinks(rr.GrpcSink(self._own_url))
        return stream

    def size(self) -> int | None:
        return None

    def trouble(self, pending: int) -> str | None:
        return None

    def close(self) -> None:
        self._hub.let_go()
        self._relay.close()


Target = FileTarget | StreamTarget


def _relay(port: int, on_refused: Callable[[str], None]) -> Relay:
    """The relay at the port; raises OSError if it is taken, which rerun would not report."""
    try:
        return Relay(port, on_refused)
    except OSError as error:
        raise OSError(
            f"cannot stream on port {port}: {reason(error)}; "
            "give --stream another port, or 0 for any"
        ) from error
