"""Random numbers that need no state: Philox4x32-7 (Salmon et al. 2011, 'Random123').

Every number is a pure function of (seed, lane, purpose, step, index). So a run does not depend
on how it was cut into blocks, on other lanes or on threads, and going back needs no generator
state: the draws of step t are those of step t, whenever they are asked for. It is the generator
of cuRAND, PyTorch and TensorFlow, with the fewest rounds that its authors found to pass all of
BigCrush, seven, where those take ten. The published test vectors for seven rounds are in the tests.

Other generators were tried and not taken (64 lanes of sonar with AVX-512; processor time beside
this one's). If random numbers cost nothing, a step would be 1.31 times as fast in float32 and 1.11
times in float64 (`tests/benchmarks/random_numbers.py`). Blocks that four steps share, so that no
word is left over, made it 0.95 and 1.05 times as fast; xoshiro128++ in bursts of 16 steps, each
seeded by a block, 1.17 and 1.0 times, but one lane 0.7 times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from hebbviz.numerics.compile import INLINED, compiled, inlined

SPIKES, WORLD, INITIAL_WEIGHTS, FIRST_EPISODE, NEXT_EPISODE = 0, 1, 2, 3, 4
"""Purposes: one independent stream each."""

LARGEST_SEED = 2**32 - 1

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_MASK, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)
_ROUNDS = 7
_UNIT = 2.0**-32
_8, _UNIT_32 = np.uint32(8), np.float32(2.0**-24)


# Each word lives in the low half of 64 bits, which a vector multiply takes and gives; what is in
# the high half is nobody's business until the end.


@inlined
def _round(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    p0 = (c0 & _MASK) * _M0
    p1 = (c2 & _MASK) * _M1
    return (p1 >> _32) ^ c1 ^ k0, p1, (p0 >> _32) ^ c3 ^ k1, p0


@inlined
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]  # compiled: uint32 in and out
    """Four random 32-bit words from a counter of four words and a key of two."""
    c0, c1, c2, c3 = np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3)
    k0, k1 = np.uint64(k0), np.uint64(k1)
    for _ in range(_ROUNDS):
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, k0, k1)
        k0 += _W0
        k1 += _W1
    return np.uint32(c0), np.uint32(c1), np.uint32(c2), np.uint32(c3)


@inlined
def four_words(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Draws 4·block to 4·block + 3 of that step, as 32-bit words."""
    low, high = np.uint64(step) & _MASK, np.uint64(step) >> _32
    return philox(block, low, high, purpose, seed, lane)


@inlined
def eight_words(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Those of a block and of the one after it, four and four.

    Two calls of `philox` side by side: neither waits for the other.
    """
    low, high = np.uint64(step) & _MASK, np.uint64(step) >> _32
    k0, k1 = np.uint64(seed), np.uint64(lane)
    a0, a1, a2, a3 = np.uint64(block), low, high, np.uint64(purpose)
    b0, b1, b2, b3 = np.uint64(block + 1), low, high, np.uint64(purpose)
    for _ in range(_ROUNDS):
        a0, a1, a2, a3 = _round(a0, a1, a2, a3, k0, k1)
        b0, b1, b2, b3 = _round(b0, b1, b2, b3, k0, k1)
        k0 += _W0
        k1 += _W1
    return (
        (np.uint32(a0), np.uint32(a1), np.uint32(a2), np.uint32(a3)),
        (np.uint32(b0), np.uint32(b1), np.uint32(b2), np.uint32(b3)),
    )


@inlined
def unit64(word):  # type: ignore[no-untyped-def]
    """A word as a number in (0, 1). It is below σ(v) with that probability to within 2⁻³³."""
    return (word + 0.5) * _UNIT


@inlined
def unit32(word):  # type: ignore[no-untyped-def]
    """The upper 24 bits of a word as a number in [0, 1), which float32 holds exactly.

    A neuron fires if this is below σ(v), so with probability σ(v) rounded up to a multiple of 2⁻²⁴:
    with up to 6e-8 more than σ(v) at each step, and never with less than 2⁻²⁴, as 0 is drawn.
    """
    return np.float32(np.int32(word >> _8)) * _UNIT_32


def unit(word: Any, like: Any) -> Any:
    """A word as a number between 0 and 1 in the type of `like`."""
    raise NotImplementedError("unit is for compiled code")


@overload(unit, jit_options=INLINED)
def _unit_for(word, like):  # type: ignore[no-untyped-def]
    if like == types.float32:
        return lambda word, like: unit32(word)
    return lambda word, like: unit64(word)


@inlined
def four_uniforms(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Four numbers in (0, 1): draws 4·block to 4·block + 3 of that step."""
    a, b, c, d = four_words(seed, lane, purpose, step, block)
    return unit64(a), unit64(b), unit64(c), unit64(d)


@compiled
def _fill(out, seed, lane, purpose, step):  # type: ignore[no-untyped-def]
    for block in range((out.shape[0] + 3) // 4):
        four = four_uniforms(seed, lane, purpose, step, block)
        for k in range(min(4, out.shape[0] - 4 * block)):
            out[4 * block + k] = four[k]


def uniforms(
    count: int, *, seed: int, lane: int = 0, purpose: int, step: int = 0
) -> NDArray[np.float64]:
    """The first `count` draws of one step, shape (count,), each uniform in (0, 1)."""
    out = np.empty(count)
    _fill(out, np.uint32(seed), np.uint32(lane), np.uint32(purpose), np.int64(step))
    return out


class Draws:
    """The random numbers of one lane of a world at one step; `draws(n)` gives the first n."""

    __slots__ = ("lane", "purpose", "seed", "step")

    def __init__(self, seed: int, lane: int, step: int, purpose: int = WORLD) -> None:
        self.seed, self.lane, self.step, self.purpose = seed, lane, step, purpose

    def __call__(self, count: int) -> NDArray[np.float64]:
        return uniforms(count, seed=self.seed, lane=self.lane, purpose=self.purpose, step=self.step)


def check_seed(seed: int) -> int:
    """The seed itself; raises ValueError unless it is a whole number from 0 to 2³² - 1."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
        raise ValueError(f"seed must be a whole number, got {seed!r}")
    if not 0 <= seed <= LARGEST_SEED:
        raise ValueError(f"seed must be from 0 to {LARGEST_SEED}, got {seed}")
    return int(seed)
