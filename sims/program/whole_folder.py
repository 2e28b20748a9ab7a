"""Folders that are complete once they are there: nothing that was begun is left where it failed."""

from __future__ import annotations

import contextlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it, and take away again those that stay empty."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with contextlib.suppress(OSError):  # it is not empty, as it should be
            for path in made:
                path.rmdir()


@contextlib.contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder to write into, whose files come into `folder` when all of them are written.

    Where there is no `folder` yet it appears with all of them; else they take the places of
    older ones of their names. Raises OSError that names `folder` if something cannot be written.
    """
    folder = folder.absolute()
    above = folder if folder.exists() else folder.parent
    part = above / f".{folder.name}.{uuid.uuid4().hex}.part"
    try:
        with made_folder(above), _removed(part):
            part.mkdir()
            yield part
            if above is folder:
                for path in part.iterdir():
                    path.replace(folder / path.name)
            else:
                part.rename(folder)
    except OSError as error:
        raise type(error)(error.errno, os.strerror(error.errno or 0), str(folder)) from error


@contextlib.contextmanager
def _removed(folder: Path) -> Iterator[None]:
    try:
        yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)
