"""Compilation of functions: strict IEEE arithmetic, without the GIL, cached on disk.

Neither `fastmath` nor a check for division by zero is used. Cached code is bound to a key of all
its sources, see `cache_key`, and compiled again when any of them changes.
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
        "NUMBA_DISABLE_JIT is set, but no network runs without the compiler: unset it"
    )

WIDTHS = (1, 16, 64)
"""Numbers of lanes in a tile; the engine is compiled once for each. Surplus lanes idle."""

INLINED: Any = {
    "forceinline": True, "error_model": "numpy",
    "no_cpython_wrapper": True, "no_cfunc_wrapper": True,
}  # fmt: skip
inlined: Any = njit(**INLINED)
"""Decorator for a small function that only compiled functions call; cached as a part of them. It
makes no entry points for Python and C, which took a third of the compile time.
"""


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function that Python calls, or a function of a task too large to be `inlined`."""
    dispatcher: Any = njit(nogil=True, error_model="numpy")(function)
    dispatcher._cache = cache_of(function, stamp(function))  # noqa: SLF001
    return dispatcher


def called(signature: Any, *, allocates: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function for calls by address from compiled code.

    Unless it `allocates` arrays, references to its arguments are not counted; counting would cost
    more than the step of a small world.
    """
    options = {"error_model": "numpy"} | ({} if allocates else {"_nrt": False})

    def compile_now(function: Callable[..., Any]) -> Any:
        """Do the same as `numba.cfunc`, which does not accept a cache key."""
        callback: Any = CFunc(function, (signature.args, signature.return_type), {}, options)
        callback._cache = cache_of(function, stamp(function))  # noqa: SLF001
        callback.compile()
        return callback

    return compile_now


_WIDEST_VECTORS = '"prefer-vector-width"="512"'
"""Without this attribute the compiler uses half the vector width of AVX-512, and 64 lanes of sonar
in float32 took 1.6 times as long. Other processors use their widest vectors.
"""

_intrinsic: Any = intrinsic  # numba's type for it does not describe how it is called


@_intrinsic
def row(typing, state, index, width):  # type: ignore[no-untyped-def]
    """Return a view (width,) of row `index` of a state (rows, width), in compiled code.

    The index is not checked, and the reference is not counted. `width` is a compile-time constant,
    so the compiler knows which rows are adjacent and how many lanes a loop over a row has. The
    calling function loops over lanes, so it is compiled for the widest vectors.
    """
    view = types.Array(state.dtype, 1, "C")

    def code(context, builder, signature, args):  # type: ignore[no-untyped-def]
        set.add(builder.function.attributes, _WIDEST_VECTORS)  # bypasses llvmlite's list
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
    """Return a·b + c, rounded once, in compiled code."""

    def code(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.fma(*args)

    return a(a, a, a), code
