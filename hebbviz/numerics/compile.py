"""How functions are compiled here: strict IEEE arithmetic, without the GIL, cached on disk.

No `fastmath` and no check for division by zero. What is cached is bound to all it was made of, see
`cache_key`: where any of that has changed, it is compiled anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import config, njit, types
from numba.core.ccallback import CFunc
from numba.extending import intrinsic

from hebbviz.limits import CompilerOff
from hebbviz.numerics.cache_key import stamp
from hebbviz.numerics.code_cache import cache_of

if getattr(config, "DISABLE_JIT", 0):
    raise CompilerOff(
        "NUMBA_DISABLE_JIT is set, and no network runs without the compiler: unset it"
    )

WIDTHS = (1, 16, 64)
"""Lanes of a tile, for each of which the engine is compiled; lanes that nobody asked for idle."""

INLINED: Any = {
    "forceinline": True, "error_model": "numpy",
    "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
}  # fmt: skip
inlined: Any = njit(**INLINED)
"""For a small function that only compiled functions call; cached as a part of them. What Python or
C would need to call it is left out: a third of the time to compile went into that.
"""


def compiled(function: Callable[..., Any]) -> Any:
    """For a function that Python calls, or one of a task that is too large to be `inlined`."""
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    dispatcher._cache = cache_of(function, stamp(function))  # noqa: SLF001
    return dispatcher


def called(signature: Any, *, allocates: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """For a function that compiled functions call by its address.

    Unless it `allocates` arrays, references to those it is given are not counted, which would
    cost more than a small world's step does.
    """
    options = {"error_model": "numpy"} | ({} if allocates else {"_nrt": False})

    def compile_now(function: Callable[..., Any]) -> Any:
        """What `numba.cfunc` does, which has no place to say what the cache is bound to."""
        callback: Any = CFunc(function, (signature.args, signature.return_type), {}, options)
        callback._cache = cache_of(function, stamp(function))  # noqa: SLF001
        callback.compile()
        return callback

    return compile_now


_WIDEST_VECTORS = '"prefer-vector-width"="512"'
"""Without it the compiler takes half of what a processor with AVX-512 offers: 64 lanes of sonar in
float32 took 1.6 times as long. The others take it for the widest they have.
"""

_intrinsic: Any = intrinsic  # numba gives it a type that knows little of how it is called


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
