"""Exact Poisson intervals: tabulated ones, their defining tails, and how often they hold."""

import math

import pytest

from hebbviz.theory.poisson import NONE_SEEN, expected_events, time_to_event


@pytest.mark.parametrize(
    ("count", "low", "high"),
    [  # Garwood (1936), as half of the quantiles of χ² with 2k and 2k + 2 degrees of freedom
        (1, 0.0253178, 5.5716434),
        (2, 0.2422093, 7.2246877),
        (3, 0.6186721, 8.7672730),
        (6, 2.2018943, 13.0594740),
        (10, 4.7953890, 18.3903560),
        (100, 81.36399, 121.62679),
    ],
)
def test_intervals_are_those_of_the_tables(count, low, high):
    assert expected_events(count) == (pytest.approx(low, rel=1e-6), pytest.approx(high, rel=1e-6))


def test_without_an_event_the_interval_is_one_sided():
    assert expected_events(0) == (0.0, NONE_SEEN)
    assert math.exp(-NONE_SEEN) == pytest.approx(0.05)
    low, high = time_to_event(2000.0, 0)
    assert (low, high) == (pytest.approx(667.6, abs=0.1), math.inf)


@pytest.mark.parametrize("count", [1, 5, 40, 300])
def test_a_count_is_as_unlikely_at_either_end(count):
    """Summed from the definition, term by term."""
    low, high = expected_events(count)

    def chance(k, mean):
        return math.exp(k * math.log(mean) - mean - math.lgamma(k + 1))

    assert 1.0 - sum(chance(k, low) for k in range(count)) == pytest.approx(0.025, rel=1e-6)
    assert sum(chance(k, high) for k in range(count + 1)) == pytest.approx(0.025, rel=1e-6)


@pytest.mark.parametrize("count", [10**4, 10**6])
def test_large_counts_come_to_the_known_limit(count):
    """Wilson and Hilferty's cube, whose error falls with the count."""

    def cube(a, z):
        return a * (1.0 - 1.0 / (9.0 * a) + z / (3.0 * math.sqrt(a))) ** 3

    want = cube(count, -1.959964), cube(count + 1, 1.959964)
    assert expected_events(count) == (
        pytest.approx(want[0], rel=1e-6), pytest.approx(want[1], rel=1e-6),
    )  # fmt: skip


@pytest.mark.parametrize("mean", [0.03, 0.5, 2.9, 3.0, 5.5, 20.0])
def test_an_interval_holds_as_often_as_it_says(mean):
    """With an event in 95 % of all cases or more; at most 2.5 % come from the one-sided end."""
    held = seen = 0.0
    for count in range(200):
        chance = math.exp(count * math.log(mean) - mean - math.lgamma(count + 1))
        low, high = expected_events(count)
        seen += chance if low <= mean <= high else 0.0
        held += chance if count == 0 or low <= mean <= high else 0.0
    assert held > 0.95
    assert seen > 0.925


def test_the_time_to_an_event_is_within_its_interval():
    low, high = time_to_event(4000.0, 6)
    assert (low, high) == (pytest.approx(306.3, abs=0.1), pytest.approx(1816.6, abs=0.1))
    assert low < 4000.0 / 6 < high
