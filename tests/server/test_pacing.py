"""The tempo of a run, in plain numbers: steps that are owed, stretches, single steps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hebbviz.server.live.pacing import (
    LONGEST_STRETCH,
    LONGEST_STRETCH_SECONDS,
    MAX,
    MOST_OWED_SECONDS,
    REALTIME,
    STRETCH_SECONDS,
    Tempo,
)


def go_on(tempo: Tempo, seconds: float, cost: float = 1e-9, copied: float = 0.0) -> int:
    """Make what is due now, on a machine that takes `cost` seconds a step; how many steps."""
    steps = tempo.next(seconds)
    if steps:
        tempo.made(steps, 0.0, steps * cost, copied)
    return steps


def all_due(tempo: Tempo, seconds: float) -> int:
    """Make all that is due after so much more time, stretch by stretch."""
    total = made = go_on(tempo, seconds)
    while made:
        total += (made := go_on(tempo, 0.0))
    return total


def at_speed(speed: float | str, dt: float | None = None) -> Tempo:
    tempo = Tempo(dt)
    tempo.set_speed(speed)
    return tempo


seconds_between = st.lists(st.floats(0.0, MOST_OWED_SECONDS / 2), max_size=60)


@given(rate=st.floats(10.0, 1e6), cuts=seconds_between)
def test_steps_are_those_of_the_time_however_it_is_cut(rate: float, cuts: list[float]) -> None:
    tempo = at_speed(rate)
    made = sum(all_due(tempo, seconds) for seconds in cuts)
    assert rate * sum(cuts) - 1.01 <= made <= rate * sum(cuts) * (1 + 1e-9) + 1e-6


def test_real_time_is_the_rate_of_the_steps_that_the_run_has_now() -> None:
    tempo = at_speed(REALTIME, dt=0.02)
    assert tempo.rate == 50.0
    tempo.begin(0.01)
    assert tempo.rate == 100.0
    assert at_speed(MAX, dt=0.02).rate is None


@given(rate=st.floats(0.01, 1e6), seconds=st.floats(MOST_OWED_SECONDS, 1e6))
def test_a_run_that_was_held_up_saves_up_little(rate: float, seconds: float) -> None:
    assert all_due(at_speed(rate), seconds) <= max(1.0, rate * MOST_OWED_SECONDS)


@given(counts=st.lists(st.integers(1, 500), max_size=5), speed=st.sampled_from([MAX, 1.0, 1e5]))
def test_paused_it_makes_the_single_steps_and_no_more(counts: list[int], speed: float) -> None:
    tempo = at_speed(speed)
    tempo.pause(paused=True)
    for steps in counts:
        tempo.step(steps)
    assert tempo.is_due() == bool(counts)
    assert all_due(tempo, 1.0) == sum(counts)
    assert not tempo.is_due()
    tempo.pause(paused=False)
    assert tempo.is_due() == (speed == MAX), "the pause owes nothing"


@given(cost=st.floats(1e-9, 1.0), copied=st.floats(0.0, 0.1))
def test_a_stretch_comes_to_last_as_long_as_it_may(cost: float, copied: float) -> None:
    tempo = Tempo()
    for _ in range(40):
        steps = go_on(tempo, 0.0, cost, copied)
    aim = min(max(STRETCH_SECONDS, 2 * copied), LONGEST_STRETCH_SECONDS)
    assert steps == 1 or steps * cost <= aim
    assert steps == LONGEST_STRETCH or 2.1 * steps * cost >= aim / 2


@pytest.mark.parametrize("rate", [0.5, 3.0, 40.0, 2000.0])
def test_the_speed_that_is_measured_is_that_of_the_steps(rate: float) -> None:
    tempo, each = Tempo(), max(1, round(rate / 80))
    assert tempo.measured(0.0) == 0.0
    for k in range(200):
        tempo.made(each, k * each / rate, 1e-3, 0.0)
    now = 200 * each / rate
    assert tempo.measured(now) == pytest.approx(rate)
    tempo.pause(paused=True)
    assert tempo.measured(now) == 0.0
