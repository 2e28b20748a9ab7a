"""Folders that appear only when complete; a failure leaves nothing behind."""

from __future__ import annotations

import contextlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and its parents; on exit remove those that are still empty."""
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
    """Yield a temporary folder; move its files into `folder` when all of them are written.

    A new `folder` appears with all files at once; in an existing one they replace older files of
    the same names. Raises OSError, which names `folder`, if a file cannot be written.
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
