"""What the command line says: errors of one line, exit codes, and whose fault an error is."""

# ruff: noqa: PLC0415  # what is heavy is imported once it is needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
import errno
import math
import os
import sys
import tempfile
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn, TextIO

FINE, FAILED, BAD_INPUT = 0, 1, 2
LONGEST_LINE = 600
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class InputError(Exception):
    """Something that the user gave and can mend; the message says what, why and what to do."""


class WorkersFailed(Exception):
    """Those who do the work are gone or not fit for it: nothing that the user gave is to blame."""


@contextlib.contextmanager
def user_can_mend(args: argparse.Namespace) -> Iterator[None]:
    """What goes wrong in here does so for what the user gave."""
    from hebbviz.learner.learner import TaskError

    try:
        yield
    except (InputError, WorkersFailed, MemoryError):
        raise
    except FileExistsError as error:
        what = f"{error.filename} exists already and is not written over: name another file"
        raise InputError(what) from error
    except OSError as error:
        known = error.filename is not None
        verb = "write" if error.errno in _NO_ROOM else "open"
        what = f"cannot {verb} {error.filename}: {reason(error)}" if known else str(error)
        raise InputError(what) from error
    except (ValueError, TaskError) as error:
        raise InputError(f"{error}{place(args, error)}") from error
    except (Exception, SystemExit) as error:
        own = _own(args)
        if not own:
            raise
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{' or '.join(own)}: {what}{place(args, error)}") from error


def check_writable(folder: Path) -> None:
    """Find out before the work whether its result can be written into an existing folder."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"cannot save in {folder}: {reason(error)}; choose another folder"
        ) from error


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """What cannot be written in here is said as such; what was done before is kept."""
    try:
        yield
    except OSError as error:
        remedy = "make room" if error.errno in _NO_ROOM else "mend that"
        raise InputError(
            f"cannot write {path}: {reason(error)}; {remedy}, the same command goes on"
        ) from error


def reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


def place(args: argparse.Namespace, error: BaseException) -> str:
    """Where in the user's own file an error came from, as ' (my.py, line 12)', or nothing."""
    for file in _own(args).values():
        found = place_in(file, error)
        if found:
            return f" {found}"
    return ""


def place_in(file: Path, error: BaseException) -> str:
    """Where in a file an error came from, as '(my.py, line 12)', or nothing.

    A traceback does not come out of another process. There this is to be a note on the error, and
    is found again here.
    """
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    for cause in reversed(causes):
        frames = traceback.extract_tb(cause.__traceback__)
        lines = [f.lineno for f in frames if Path(f.filename).resolve() == file]
        if lines:
            return f"({file.name}, line {lines[-1]})"
    notes = (n for cause in causes for n in getattr(cause, "__notes__", ()))
    return next((n for n in notes if n.startswith(f"({file.name}, line ")), "")


def _own(args: argparse.Namespace) -> dict[str, Path]:
    """The user's own files, by what they were given as."""
    from hebbviz.sims.user_file import own_files

    return own_files(getattr(args, "task", None), getattr(args, "rule", None))


def finite(value: Any) -> float | None:
    """A number as strict JSON can say it, which knows no infinity: that is None."""
    number = float(value)
    return number if math.isfinite(number) else None


def fail(code: int, message: str) -> int:
    tell(message)
    return code


def tell(message: str) -> None:
    """One line on stderr, whatever is in the message."""
    line = " ".join(message.split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    sys.stderr.write(f"hebbviz: {line[:LONGEST_LINE]}\n")
    sys.stderr.flush()


def prints_aside() -> contextlib.redirect_stdout[TextIO]:
    """What a user's task or rule prints in here goes to stderr: stdout is for the figures."""
    return contextlib.redirect_stdout(sys.stderr)


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def leave(code: int) -> NoReturn:
    """End the process now, even if a compiler is still at work in another thread."""
    sys.stdout.flush()
    os._exit(code)
