"""How functions are compiled here: cached on disk, strict IEEE arithmetic, without the GIL.

No `fastmath` and no check for division by zero. numba notices a change in the file of a cached
function, but not in the files of the functions it calls; so the cache of every function here is
bound to the text of all kernel files together.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

_KERNELS = ("compiled.py", "chance.py", "layout.py", "rule.py", "engine.py")
_HERE = Path(__file__).parent
_STAMP = tuple(zlib.crc32((_HERE / name).read_bytes()) for name in _KERNELS)

inlined = njit(forceinline=True, error_model="numpy")
"""For a small function that only compiled functions call; cached as a part of them."""


def compiled(function: Callable[..., Any]) -> Any:
    """For a function that Python calls."""
    dispatcher: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    dispatcher._cache._cache_file._source_stamp = _STAMP  # noqa: SLF001
    return dispatcher
