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

from numba import cfunc, njit, types
from numba.extending import intrinsic

_KERNELS = (
    "compiled.py", "chance.py", "squashing.py", "layout.py", "rule.py", "written.py", "engine.py",
)  # fmt: skip
_HERE = Path(__file__).parent
_STAMP = tuple(zlib.crc32((_HERE / name).read_bytes()) for name in _KERNELS)

INLINED: Any = {
    "forceinline": True, "error_model": "numpy",
    "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
}  # fmt: skip
inlined: Any = njit(**INLINED)
"""For a small function that only compiled functions call; cached as a part of them. What Python or
C would need to call it is left out: a third of the time to compile went into that.
"""


def compiled(function: Callable[..., Any]) -> Any:
    """For a function that Python calls."""
    dispatcher: Any = njit(cache=True, nogil=True, error_model="numpy")(function)
    dispatcher._cache._cache_file._source_stamp = _STAMP  # noqa: SLF001
    return dispatcher


def called(signature: Any) -> Any:
    """For a function of a task that compiled functions call by its address, and that allocates no
    array: references to those it is given are not counted, which would cost more than a small
    world's step does.
    """
    return _cfunc(signature, cache=True, _nrt=False)


_WIDEST_VECTORS = '"prefer-vector-width"="512"'
"""Without it the compiler takes half of what a processor with AVX-512 offers: 64 lanes of sonar in
float32 took 1.6 times as long. The others take it for the widest they have.
"""

_cfunc: Any = cfunc
_intrinsic: Any = intrinsic  # numba gives them types that know little of how they are called


@_intrinsic
def row(typing, state, index, width):  # type: ignore[no-untyped-def]
    """Row `index` of a state (rows, width), for compiled code: a view, shape (width,).

    Unchecked and uncounted. `width` is a constant where this is compiled; so the compiler sees
    which rows are neighbours, and how many lanes a loop over a row has. Whoever takes a row loops
    over lanes: that function is compiled for the widest vectors.
    """
    view = types.Array(state.dtype, 1, "C")

    def code(context, builder, signature, args):  # type: ignore[no-untyped-def]
        set.add(builder.function.attributes, _WIDEST_VECTORS)  # past llvmlite's list of known ones
        whole = context.make_array(signature.args[0])(context, builder, args[0])
        found = context.make_array(view)(context, builder)
        size = context.get_constant(
            types.intp, context.get_abi_sizeof(context.get_data_type(view.dtype))
        )
        first = builder.mul(args[1], args[2])
        context.populate_array(
            found, data=builder.gep(whole.data, [first], inbounds=True), shape=[args[2]],
            strides=[size], itemsize=size, meminfo=None,
        )  # fmt: skip
        return found._getvalue()  # noqa: SLF001

    return view(state, types.intp, types.intp), code


@_intrinsic
def fma(typing, a, b, c):  # type: ignore[no-untyped-def]
    """a·b + c, rounded once, for compiled code."""

    def code(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.fma(*args)

    return a(a, a, a), code
