"""What a compiled function is made of, so that none is taken from a cache that is made of else.

numba notices a change in the file of a cached function, but not in what it takes from others: a
function that it calls, a number that it names. Here are all of them.
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
    """Of a text; None of what is no file."""
    path = Path(file)
    return zlib.crc32(path.read_bytes()) if path.is_file() else None


_KERNELS = {
    str(path): _checksum(str(path))
    for path in map(Path(__file__).parents[1].joinpath, (
        "numerics/compile.py", "numerics/counter_rng.py", "numerics/logistic.py",
        "engine/layout.py", "engine/kernel.py", "engine/unrolled.py", "engine/loop.py",
    ))
}  # fmt: skip
"""They go together: how they call each other cannot always be seen from their functions."""

_NUMBERS = (int, float, complex, str, tuple, np.generic)


def stamp(function: Callable[..., Any]) -> tuple[Any, ...]:
    """Equal for equal texts and numbers: the texts of all kernel files, of the function's own file
    and of those of the compiled functions that it calls, and theirs; the numbers that all of these
    take from their modules.
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
    """What a function names that is not its own; of a module, what it may name in it.

    Numbers of a function around it are left to numba, which keeps apart what it compiles for each.
    """
    found = inspect.getclosurevars(function)
    yield from ((n, v) for n, v in found.nonlocals.items() if isinstance(v, Dispatcher))
    for name, value in found.globals.items():
        yield name, value
        if isinstance(value, ModuleType):
            inside = vars(value)
            yield from ((n, inside[n]) for n in function.__code__.co_names if n in inside)
