"""The random numbers: Philox as published, uniform, and independent in every direction."""

import math
from itertools import combinations

import numpy as np
import pytest
from numba import njit

from hebbviz.numerics.counter_rng import (
    FIRST_EPISODE,
    INITIAL_WEIGHTS,
    LARGEST_SEED,
    NEXT_EPISODE,
    SPIKES,
    WORLD,
    Draws,
    check_seed,
    philox,
    uniforms,
)

MANY = 1_000_000
HONEST = 1e-4
"""A fair generator fails a test with this probability; the seeds are fixed."""


called_philox = njit(philox.py_func, error_model="numpy")
"""`philox` itself can be called by compiled code only."""


@pytest.mark.parametrize(
    ("counter", "key", "words"),
    [
        ((0, 0, 0, 0), (0, 0), "5f6fb709 0d893f64 4f121f81 4f730a48"),
        ((2**32 - 1,) * 4, (2**32 - 1,) * 2, "5207ddc2 45165e59 4d8ee751 8c52f662"),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            "4dfccaba 190a87f0 c47362ba b6b5242a",
        ),
    ],
)
def test_philox_gives_the_known_answers(counter, key, words):
    """The vectors for philox4x32-7 of the Random123 distribution."""
    arguments = (np.uint32(n) for n in (*counter, *key))
    assert " ".join(f"{int(word):08x}" for word in called_philox(*arguments)) == words


def test_the_counter_is_block_step_and_purpose_and_the_key_seed_and_lane():
    step = 5 * 2**32 + 7
    words = called_philox(*(np.uint32(n) for n in (2, 7, 5, WORLD, 11, 13)))
    expected = [(int(word) + 0.5) / 2**32 for word in words]
    assert uniforms(12, seed=11, lane=13, purpose=WORLD, step=step)[8:].tolist() == expected


def streams():
    """A million numbers each, along every argument; neighbours differ by one in it."""
    return {
        "index": uniforms(MANY, seed=1, purpose=SPIKES),
        "step": _along(lambda k: uniforms(10, seed=1, purpose=SPIKES, step=k)),
        "lane": _along(lambda k: uniforms(10, seed=1, purpose=SPIKES, lane=k)),
        "seed": _along(lambda k: uniforms(10, seed=k, purpose=SPIKES)),
        "late step": _along(lambda k: uniforms(10, seed=1, purpose=WORLD, step=2**40 + k)),
    }


def _along(draw):
    return np.array([draw(k) for k in range(MANY // 10)])


@pytest.fixture(scope="module")
def numbers():
    return streams()


def test_draws_are_uniform(numbers):
    for name, u in numbers.items():
        flat = np.ravel(u)
        bins = np.histogram(flat, bins=1000, range=(0.0, 1.0))[0]
        assert chi_square(bins, flat.size / 1000) > HONEST, name
        assert kolmogorov(flat) > HONEST, name
        low_bits = np.histogram((flat * 2**16) % 1.0, bins=64, range=(0.0, 1.0))[0]
        assert chi_square(low_bits, flat.size / 64) > HONEST, name


def test_draws_are_independent_of_their_neighbours(numbers):
    """Along each argument, and between the neurons of a step."""
    for name, u in numbers.items():
        for lag in (1, 2, 3, 4, 8):
            assert independent(u[:-lag], u[lag:]), (name, lag)
        if u.ndim == 2:
            for i, j in combinations(range(5), 2):
                assert independent(u[:, i], u[:, j]), (name, i, j)


def test_purposes_steps_lanes_and_seeds_are_independent_streams():
    purposes = (SPIKES, WORLD, INITIAL_WEIGHTS, FIRST_EPISODE, NEXT_EPISODE)
    assert len(set(purposes)) == len(purposes)
    same = [{"seed": 3, "purpose": p} for p in purposes]
    same += [{"seed": 3, "purpose": SPIKES, "step": 2**k} for k in (0, 16, 32, 40)]
    same += [{"seed": 3, "purpose": SPIKES, "lane": k} for k in (1, 2, 63)]
    same += [{"seed": k, "purpose": SPIKES} for k in (0, 2, LARGEST_SEED)]
    drawn = [uniforms(200_000, **s) for s in same]
    for (a, u), (b, v) in combinations(zip(same, drawn, strict=True), 2):
        assert independent(u, v), (a, b)


def test_no_draw_is_zero_or_one(numbers):
    assert all(u.min() > 0.0 and u.max() < 1.0 for u in numbers.values())
    smallest, largest = 0.5 * 2.0**-32, (2**32 - 0.5) * 2.0**-32
    assert smallest > 0.0
    assert largest < 1.0


def test_first_draws_are_the_same_however_many_are_asked_for():
    draws = Draws(9, 2, 77)
    assert all(np.array_equal(draws(n), draws(50)[:n]) for n in range(50))
    assert np.array_equal(draws(5), uniforms(5, seed=9, lane=2, purpose=WORLD, step=77))


@pytest.mark.parametrize("seed", [-1, LARGEST_SEED + 1, 0.5, True, "1", None])
def test_a_seed_out_of_range_is_refused(seed):
    with pytest.raises(ValueError, match="seed must be"):
        check_seed(seed)


def test_seeds_in_range_are_kept():
    assert [check_seed(s) for s in (0, 7, np.int64(8), LARGEST_SEED)] == [0, 7, 8, LARGEST_SEED]


def test_the_statistics_can_fail():
    """Numbers a little off are told from fair ones."""
    u = uniforms(MANY, seed=1, purpose=SPIKES)
    bent = u**1.02
    assert chi_square(np.histogram(bent, bins=1000, range=(0.0, 1.0))[0], MANY / 1000) < HONEST
    assert kolmogorov(bent) < HONEST
    assert not independent(u, 0.99 * np.roll(u, 1) + 0.01 * u)


def chi_square(counts, expected):
    """Probability of counts so uneven, by Wilson and Hilferty's cube root."""
    free = len(counts) - 1
    statistic = float(np.sum((counts - expected) ** 2)) / expected
    z = ((statistic / free) ** (1 / 3) - (1 - 2 / (9 * free))) / math.sqrt(2 / (9 * free))
    return math.erfc(abs(z) / math.sqrt(2))


def kolmogorov(u):
    """Probability of a distribution function so far from uniform (Kolmogorov and Smirnov)."""
    n = u.size
    ordered = np.sort(u)
    ranks = np.arange(n + 1) / n
    far = max(np.max(ranks[1:] - ordered), np.max(ordered - ranks[:-1])) * math.sqrt(n)
    series = (2 * (-1) ** (k - 1) * math.exp(-2 * (k * far) ** 2) for k in range(1, 101))
    return min(1.0, max(0.0, sum(series)))


def independent(u, v):
    """No correlation, and all of 16 × 16 cells equally full."""
    u, v = np.ravel(u), np.ravel(v)
    correlation = float(np.corrcoef(u, v)[0, 1])
    cells = np.bincount((u * 16).astype(int) * 16 + (v * 16).astype(int), minlength=256)
    likely = math.erfc(abs(correlation) * math.sqrt(u.size / 2))
    return likely > HONEST / 10 and chi_square(cells, u.size / 256) > HONEST / 10
