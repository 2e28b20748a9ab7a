"""Output streams whose failure does not stop a run.

Writes do not fail if the reader has closed the pipe, the disk is full, or the stream or terminal is
closed. The run ends and is saved as usual; only the exit code may differ.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class Stream:
    """A text stream, or None, whose writes do not fail; `lost` is the first error.

    For a stream with a `name` the error is reported on stderr, unless the reader closed the pipe.
    """

    def __init__(self, stream: TextIO | None, name: str | None = None) -> None:
        self._stream, self._name = stream, name
        self.lost: OSError | ValueError | None = None

    def write(self, text: str) -> int:
        """Write the text, or record the error."""
        try:
            if self._stream is None:
                raise OSError(errno.EBADF, "it is closed")
            return self._stream.write(text)
        except (OSError, ValueError) as error:
            self._lose(error)
            return len(text)

    def flush(self) -> None:
        try:
            if self._stream is not None:
                self._stream.flush()
        except (OSError, ValueError) as error:
            self._lose(error)

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _lose(self, error: OSError | ValueError) -> None:
        if self.lost is not None:
            return
        self.lost = error
        if self._stream is not None:
            with contextlib.suppress(OSError, ValueError):  # its buffer must go somewhere
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        if self._name is not None and not isinstance(error, BrokenPipeError):
            why = (getattr(error, "strerror", None) or str(error)).lower()
            sys.stderr.write(
                f"hebbviz: cannot print to {self._name}: {why}; all else is done and saved as "
                "usual\n"
            )
            sys.stderr.flush()


@contextlib.contextmanager
def spared() -> Iterator[Stream]:
    """Replace stdout and stderr while entered; yields stdout."""
    _occupy()
    before = sys.stdout, sys.stderr
    out, err = Stream(sys.stdout, "stdout"), Stream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before


def _occupy() -> None:
    """Open /dev/null as closed standard streams, so that no file gets their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest that is free
