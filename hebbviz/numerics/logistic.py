"""σ(v) = 1/(1 + e^{−v}), compiled for float64 and float32 from basic arithmetic.

It has its own exponential, which gives the same bits for any number of lanes, and with or without
a vector math library on the machine.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from hebbviz.numerics.compile import INLINED, fma, inlined

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5·2⁵²: adding it rounds to a whole number in the low bits
_ROUND_BITS = np.int64(0x4338000000000000)

_F_LOG2_E = np.float32(_LOG2_E)
_F_MINUS_LN2_HIGH, _F_MINUS_LN2_LOW = np.float32(-0.693359375), np.float32(2.12194440e-4)
_F_ROUND = np.float32(12582912.0)  # 1.5·2²³; its lowest bits are 0
_F_FARTHEST, _F_ONE = np.float32(86.0), np.float32(1.0)
_F2, _F3, _F4, _F5 = (np.float32(c) for c in (0.49999171, 0.16667153, 0.04189894, 0.00831158))
"""1 + x + x² (F2 + F3 x + F4 x² + F5 x³) is e^x for |x| ≤ ln 2 / 2, to 1.2e-7 of it."""
_MANTISSA = np.int32(23)


@inlined
def _exp64(a):  # type: ignore[no-untyped-def]  # compiled: float64 to float64
    """Return e^a for a ≤ 0, to 1 unit in the last place; below −700 it is e^−700."""
    a = max(a, -700.0)
    shifted = a * _LOG2_E + _ROUND
    n = shifted - _ROUND
    x = (a - n * _LN2_HIGH) - n * _LN2_LOW
    x2 = x * x
    x4 = x2 * x2
    low = (1.0 + x) + x2 * (1 / 2 + x * (1 / 6))
    mid = (1 / 24 + x * (1 / 120)) + x2 * (1 / 720 + x * (1 / 5040))
    high = (1 / 40320 + x * (1 / 362880)) + x2 * (1 / 3628800 + x * (1 / 39916800))
    top = 1 / 479001600 + x * (1 / 6227020800)
    series = low + x4 * (mid + x4 * (high + x4 * top))
    exponent = np.float64(shifted).view(np.int64) - _ROUND_BITS
    return series * np.int64((exponent + 1023) << 52).view(np.float64)


@inlined
def _exp32(a):  # type: ignore[no-untyped-def]  # compiled: float32 to float32
    """Return e^a in float32, to 2 units in the last place; beyond ±86 it is e^±86."""
    a = min(max(a, -_F_FARTHEST), _F_FARTHEST)
    shifted = fma(a, _F_LOG2_E, _F_ROUND)
    n = shifted - _F_ROUND
    x = fma(n, _F_MINUS_LN2_LOW, fma(n, _F_MINUS_LN2_HIGH, a))
    x2 = x * x
    curve = fma(x2, fma(x, _F5, _F4), fma(x, _F3, _F2))
    series = np.float32(fma(x2, curve, _F_ONE + x))
    power = np.int32(np.float32(shifted).view(np.int32) << _MANTISSA)
    return np.int32(series.view(np.int32) + power).view(np.float32)


@inlined
def _sigmoid64(v):  # type: ignore[no-untyped-def]
    e = _exp64(-abs(v))
    return (1.0 if v >= 0.0 else e) / (1.0 + e)


@inlined
def _sigmoid32(v):  # type: ignore[no-untyped-def]
    return _F_ONE / (_F_ONE + _exp32(-v))


def sigmoid(v: Any) -> Any:
    """Return σ(v), equation (neuron), in the type of v."""
    raise NotImplementedError("sigmoid is for compiled code")


@overload(sigmoid, jit_options=INLINED)
def _sigmoid_for(v):  # type: ignore[no-untyped-def]
    if v == types.float32:
        return lambda v: _sigmoid32(v)  # noqa: PLW0108  # numba compares the arguments' names
    return lambda v: _sigmoid64(v)  # noqa: PLW0108
