"""Arrays out of an npz of ours, and none but those that are asked for.

What a file says is not believed: an array takes no more memory than it has bytes in the file, which
`np.savez` does not pack, and all of them no more than `MOST_BYTES`. numpy's own reader unpacks what
was packed, and makes room for what a header claims.
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
    """A file to be read; raises OSError, for a pipe or a device too, which might never end."""
    number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    mode = os.fstat(number).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(number, "rb")
    os.close(number)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise OSError(errno.EINVAL, "not a regular file", str(path))


class Npz:
    """An npz that is open. Raises ValueError and more where it is damaged."""

    def __init__(self, file: BinaryIO) -> None:
        self._zip = zipfile.ZipFile(file)
        self._left = MOST_BYTES

    def text(self, name: str) -> str:
        """A text that was saved as an array of its own."""
        return str(self._read(name, MOST_TEXT, "U"))

    def array(self, name: str) -> NDArray[Any]:
        """Numbers."""
        return self._read(name, self._left, "biuf")

    def _read(self, name: str, most: int, kinds: str) -> NDArray[Any]:
        info = self._zip.getinfo(f"{name}.npy")
        if info.compress_type != zipfile.ZIP_STORED or info.file_size > most:
            raise ValueError(f"{name} is packed, or too large")
        self._left -= info.file_size
        with self._zip.open(info) as file:
            shape, order, dtype = _header(file)
            size = dtype.itemsize * math.prod(shape)
            if dtype.kind not in kinds or file.tell() + size != info.file_size:
                raise ValueError(f"{name} is not what its header says")
            room = bytearray(size)
            for start in range(0, size, _PIECE):  # with the last one its checksum is looked at
                room[start : start + _PIECE] = file.read(min(_PIECE, size - start))
        array: NDArray[Any] = np.ndarray(shape, dtype, room, order="F" if order else "C")
        return array


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Npz]:
    """The npz in a file. Raises OSError, and zipfile's errors."""
    with open_regular(path) as file:
        yield Npz(file)


def _header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether the first index runs fastest, dtype."""
    version = npy.read_magic(file)
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
    shape, order, dtype = read(file, max_header_size=10_000)
    return shape, order, dtype
