"""Messages of the command line: one-line errors, exit codes, and whose fault an error is."""

# ruff: noqa: PLC0415  # heavy modules are imported when needed: --help must be quick

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
    """An error in the user's input; the message says what, why and what to do."""


class WorkersFailed(Exception):
    """The workers are gone or unsuitable; the user's input is not at fault."""


@contextlib.contextmanager
def user_can_mend(args: argparse.Namespace) -> Iterator[None]:
    """Turn exceptions in this context into InputError, as caused by the user's input."""
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
    """Raise InputError unless an existing folder is writable; call it before the work."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"cannot save in {folder}: {reason(error)}; choose another folder"
        ) from error


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn OSError in this context into InputError about `path`; completed work is kept."""
    try:
        yield
    except OSError as error:
        remedy = "make room" if error.errno in _NO_ROOM else "fix that"
        raise InputError(
            f"cannot write {path}: {reason(error)}; {remedy}, the same command goes on"
        ) from error


def reason(error: OSError) -> str:
    """Return the reason of an OSError in lower case."""
    return (error.strerror or str(error)).lower()


def place(args: argparse.Namespace, error: BaseException) -> str:
    """Return the place of an error in the user's files, as ' (my.py, line 12)', or ''."""
    for file in _own(args).values():
        found = place_in(file, error)
        if found:
            return f" {found}"
    return ""


def place_in(file: Path, error: BaseException) -> str:
    """Return the place of an error in a file, as '(my.py, line 12)', or ''.

    A traceback does not survive the way out of another process. That process adds the place as a
    note to the error, and this function finds the note.
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
    """Return the user's own files by their specs."""
    from hebbviz.sims.user_file import own_files

    return own_files(getattr(args, "task", None), getattr(args, "rule", None))


def finite(value: Any) -> float | None:
    """Return a number for strict JSON, which has no infinity and no NaN: None for both."""
    number = float(value)
    return number if math.isfinite(number) else None


def fail(code: int, message: str) -> int:
    """Print an error message and return the exit code."""
    tell(message)
    return code


def tell(message: str) -> None:
    """Print a message as one line on stderr."""
    line = " ".join(message.split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    sys.stderr.write(f"hebbviz: {line[:LONGEST_LINE]}\n")
    sys.stderr.flush()


def prints_aside() -> contextlib.redirect_stdout[TextIO]:
    """Send prints of a user's task or rule to stderr; stdout is for results."""
    return contextlib.redirect_stdout(sys.stderr)


def say(line: str) -> None:
    """Print one line on stdout."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def leave(code: int) -> NoReturn:
    """End the process now, even while a compiler runs in another thread."""
    sys.stdout.flush()
    os._exit(code)
