"""What is printed can be lost, and nothing else is lost with it.

A reader that has left, a full disk, a closed stream or a terminal that is gone make no write fail
in here. So a run ends and is saved as it would be otherwise, and only the exit code may tell.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast


class Stream:
    """A text stream, or none, whose writes do not fail; `lost` is the first error of one.

    That is told on stderr of a stream with a `name`, unless its reader has left.
    """

    def __init__(self, stream: TextIO | None, name: str | None = None) -> None:
        self._stream, self._name = stream, name
        self.lost: OSError | ValueError | None = None

    def write(self, text: str) -> int:
        """Print, or note that it was not."""
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
            with contextlib.suppress(OSError, ValueError):  # what it still holds must go somewhere
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
    """Take both streams while entered; returns stdout."""
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
    """A file opened later must not become the stdin, stdout or stderr that was closed."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest that is free
