"""A safe reader of the npz files that hebbviz writes; it reads only the requested arrays.

Files are not trusted: an array takes no more memory than its bytes in the file, which `np.savez`
does not compress, and all arrays together no more than `MOST_BYTES`. numpy's own reader expands
compressed data and allocates whatever a header claims.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

MOST_BYTES = 2_000_000_000
MOST_TEXT = 16_000_000
_PIECE = 1 << 20


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading.

    Raises OSError if that fails, and for pipes and devices, whose data may never end.
    """
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(number).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(number, "rb")
    os.close(number)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "not a regular file", str(path))


class Npz:
    """An open npz. Damaged files raise ValueError and other exceptions."""

    def __init__(self, file: BinaryIO) -> None:
        self._zip = zipfile.ZipFile(file)
        self._left = MOST_BYTES

    def text(self, name: str) -> str:
        """Return a text that was saved as an array."""
        return str(self._read(name, MOST_TEXT, "U"))

    def array(self, name: str) -> NDArray[Any]:
        """Return a numeric array."""
        return self._read(name, self._left, "biuf")

    def _read(self, name: str, most: int, kinds: str) -> NDArray[Any]:
        info = self._zip.getinfo(f"{name}.npy")
        if info.compress_type != zipfile.ZIP_STORED or info.file_size > most:
            raise ValueError(f"{name} is compressed or too large")
        self._left -= info.file_size
        with self._zip.open(info) as file:
            shape, order, dtype = _header(file)
            size = dtype.itemsize * math.prod(shape)
            if dtype.kind not in kinds or file.tell() + size != info.file_size:
                raise ValueError(f"{name} does not match its header")
            room = bytearray(size)
            for start in range(0, size, _PIECE):  # reading the last piece checks the checksum
                room[start : start + _PIECE] = file.read(min(_PIECE, size - start))
        array: NDArray[Any] = np.ndarray(shape, dtype, room, order="F" if order else "C")
        return array


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Npz]:
    """Open an npz file. Raises OSError, and zipfile's errors."""
    with open_regular(path) as file:
        yield Npz(file)


def _header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, whether the first index runs fastest, and dtype."""
    version = npy.read_magic(file)
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
    shape, order, dtype = read(file, max_header_size=10_000)
    return shape, order, dtype
