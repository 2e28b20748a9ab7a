"""A counter-based random number generator, Philox4x32-7 (Salmon et al. 2011, 'Random123').

Every number is a pure function of (seed, lane, purpose, step, index). A run therefore does not
depend on its division into blocks, on other lanes or on threads, and rewinding needs no generator
state. cuRAND, PyTorch and TensorFlow use this generator with ten rounds; seven is the smallest
number that its authors found to pass all of BigCrush. The tests contain the published test vectors
for seven rounds.

Other generators were tried and rejected (64 lanes of sonar with AVX-512, processor time relative
to this one). If random numbers cost nothing, a step would be 1.31 times as fast in float32 and 1.11
times in float64 (`tests/benchmarks/random_numbers.py`). Blocks shared by four steps, which leave
no word unused, made it 0.95 and 1.05 times as fast; xoshiro128++ in bursts of 16 steps, each
seeded by a block, 1.17 and 1.0 times, but 0.7 times with one lane.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from hebbviz.numerics.compile import INLINED, compiled, inlined

SPIKES, WORLD, INITIAL_WEIGHTS, FIRST_EPISODE, NEXT_EPISODE = 0, 1, 2, 3, 4
"""Purposes; each has an independent stream."""

LARGEST_SEED = 2**32 - 1

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_MASK, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)
_ROUNDS = 7
_UNIT = 2.0**-32
_8, _UNIT_32 = np.uint32(8), np.float32(2.0**-24)


# Each word is in the low half of 64 bits, as a vector multiply reads and writes it; the high half
# is ignored until the end.


@inlined
def _round(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]
    p0 = (c0 & _MASK) * _M0
    p1 = (c2 & _MASK) * _M1
    return (p1 >> _32) ^ c1 ^ k0, p1, (p0 >> _32) ^ c3 ^ k1, p0


@inlined
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]  # compiled: uint32 in and out
    """Return four random 32-bit words for a counter of four words and a key of two."""
    c0, c1, c2, c3 = np.uint64(c0), np.uint64(c1), np.uint64(c2), np.uint64(c3)
    k0, k1 = np.uint64(k0), np.uint64(k1)
    for _ in range(_ROUNDS):
        c0, c1, c2, c3 = _round(c0, c1, c2, c3, k0, k1)
        k0 += _W0
        k1 += _W1
    return np.uint32(c0), np.uint32(c1), np.uint32(c2), np.uint32(c3)


@inlined
def four_words(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Return draws 4·block to 4·block + 3 of a step, as 32-bit words."""
    low, high = np.uint64(step) & _MASK, np.uint64(step) >> _32
    return philox(block, low, high, purpose, seed, lane)


@inlined
def eight_words(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Return the words of a block and of the next one, four each.

    The two calls of `philox` are interleaved, so neither waits for the other.
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
    """Convert a word to (0, 1). The result is below σ(v) with probability σ(v) to within 2⁻³³."""
    return (word + 0.5) * _UNIT


@inlined
def unit32(word):  # type: ignore[no-untyped-def]
    """Convert the upper 24 bits of a word to [0, 1), exactly in float32.

    A neuron fires if this is below σ(v), so its probability is σ(v) rounded up to a multiple of
    2⁻²⁴: at most 6e-8 more than σ(v), and at least 2⁻²⁴, because 0 can be drawn.
    """
    return np.float32(np.int32(word >> _8)) * _UNIT_32


def unit(word: Any, like: Any) -> Any:
    """Convert a word to a number between 0 and 1 of the type of `like`."""
    raise NotImplementedError("unit is for compiled code")


@overload(unit, jit_options=INLINED)
def _unit_for(word, like):  # type: ignore[no-untyped-def]
    if like == types.float32:
        return lambda word, like: unit32(word)
    return lambda word, like: unit64(word)


@inlined
def four_uniforms(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Return draws 4·block to 4·block + 3 of a step, as numbers in (0, 1)."""
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
    """Return the first `count` draws of a step, (count,), each uniform in (0, 1)."""
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
    """Return the seed; raise ValueError unless it is a whole number from 0 to 2³² - 1."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
        raise ValueError(f"seed must be a whole number, got {seed!r}")
    if not 0 <= seed <= LARGEST_SEED:
        raise ValueError(f"seed must be from 0 to {LARGEST_SEED}, got {seed}")
    return int(seed)
