"""The cache key of a compiled function: never reuse code compiled from other sources.

numba notices a change in the file of a cached function, but not in the functions that it calls and
the numbers that it names in other files. The cache key covers them all.
"""

from __future__ import annotations

import inspect
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher


def _checksum(file: str) -> int | None:
    """Return the checksum of a file; None if there is no such file."""
    path = Path(file)
    return zlib.crc32(path.read_bytes()) if path.is_file() else None


_KERNELS = {
    str(path): _checksum(str(path))
    for path in map(Path(__file__).parents[1].joinpath, (
        "numerics/compile.py", "numerics/counter_rng.py", "numerics/logistic.py",
        "engine/layout.py", "engine/kernel.py", "engine/unrolled.py", "engine/loop.py",
    ))
}  # fmt: skip
"""Checksums of all kernel files: not all calls between them are visible in their functions."""

_NUMBERS = (int, float, complex, str, tuple, np.generic)


def stamp(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Return the cache key of a function: checksums of its source files, and its numbers.

    The files are the kernel files, the function's own file and those of all compiled functions
    that it calls, directly or not; the numbers are those that these functions read from modules.
    """
    files, numbers = dict(_KERNELS), set()
    seen, waiting = set(), [function]
    while waiting:
        found = waiting.pop()
        file = found.__code__.co_filename
        if found in seen or file in _KERNELS:
            continue
        seen.add(found)
        files[file] = _checksum(file)
        for name, value in _used(found):
            if isinstance(value, Dispatcher):
                waiting.append(value.py_func)
            elif isinstance(value, np.ndarray):
                content = value.dtype, value.shape, zlib.crc32(value.tobytes())
                numbers.add(f"{file} {name} {content}")
            elif isinstance(value, _NUMBERS):
                numbers.add(f"{file} {name} {value!r}")
    return tuple(sorted(files.items())), tuple(sorted(numbers))


def _used(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Yield the global names that a function uses, with their values, and those in its modules.

    Numbers of an enclosing function are left out: numba already compiles separately for each.
    """
    found = inspect.getclosurevars(function)
    yield from ((n, v) for n, v in found.nonlocals.items() if isinstance(v, Dispatcher))
    for name, value in found.globals.items():
        yield name, value
        if isinstance(value, ModuleType):
            inside = vars(value)
            yield from ((n, inside[n]) for n in function.__code__.co_names if n in inside)
