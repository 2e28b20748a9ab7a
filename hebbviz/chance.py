"""Random numbers that need no state: Philox4x32-10 (Salmon et al. 2011, 'Random123').

Every number is a pure function of (seed, lane, purpose, step, index). So a run does not depend
on how it was cut into blocks, on other lanes or on threads, and going back needs no generator
state: the draws of step t are those of step t, whenever they are asked for. It is the generator
of cuRAND, PyTorch and TensorFlow; its published test vectors are in the tests.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hebbviz.compiled import compiled, inlined

SPIKES, WORLD, INITIAL_WEIGHTS, FIRST_EPISODE, NEXT_EPISODE = 0, 1, 2, 3, 4
"""Purposes: one independent stream each."""

LARGEST_SEED = 2**32 - 1

_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint32(0x9E3779B9), np.uint32(0xBB67AE85)
_MASK, _32 = np.uint64(0xFFFFFFFF), np.uint64(32)
_ROUNDS = 10
_UNIT = 2.0**-32


@inlined
def philox(c0, c1, c2, c3, k0, k1):  # type: ignore[no-untyped-def]  # compiled: uint32 in and out
    """Four random 32-bit words from a counter of four words and a key of two."""
    c0, c1, c2, c3 = np.uint32(c0), np.uint32(c1), np.uint32(c2), np.uint32(c3)
    k0, k1 = np.uint32(k0), np.uint32(k1)
    for _ in range(_ROUNDS):
        p0 = np.uint64(c0) * _M0
        p1 = np.uint64(c2) * _M1
        c0 = np.uint32(p1 >> _32) ^ c1 ^ k0
        c2 = np.uint32(p0 >> _32) ^ c3 ^ k1
        c1 = np.uint32(p1 & _MASK)
        c3 = np.uint32(p0 & _MASK)
        k0 = np.uint32(k0 + _W0)
        k1 = np.uint32(k1 + _W1)
    return c0, c1, c2, c3


@inlined
def four_uniforms(seed, lane, purpose, step, block):  # type: ignore[no-untyped-def]
    """Four numbers in (0, 1): draws 4·block to 4·block + 3 of that step."""
    low = np.uint32(np.uint64(step) & _MASK)
    high = np.uint32(np.uint64(step) >> _32)
    a, b, c, d = philox(block, low, high, purpose, seed, lane)
    return (a + 0.5) * _UNIT, (b + 0.5) * _UNIT, (c + 0.5) * _UNIT, (d + 0.5) * _UNIT


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
