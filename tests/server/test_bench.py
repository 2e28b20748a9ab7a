"""Benchmarks: what they time is the right thing, and their figures hold together. Not how fast."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hebbviz.server.cli.main import main
from hebbviz.server.cli.speeds import Contestant, Ratio, race

if TYPE_CHECKING:
    from types import ModuleType


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def limit() -> ModuleType:
    sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
    import limit

    return limit


@pytest.fixture(scope="module")
def speed(limit: ModuleType) -> ModuleType:
    import speed

    return speed


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_c_kernel_is_the_learner(limit: ModuleType, dtype: type, tmp_path: Path) -> None:
    """The same spikes in all lanes at every step, a change of the pattern among them."""
    try:
        tile = limit.Tile(dtype, tmp_path, seed=3)
    except limit.NoCompiler as error:
        pytest.skip(str(error))
    spikes, weights = limit.departure(tile, 1_100)
    assert spikes == 0
    assert weights < (1e-12 if dtype is np.float64 else 1e-4)
    assert tile.activities.std() > 0.5  # they do fire, and not all


def test_a_rival_whose_spikes_are_others_does_not_race(
    speed: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    departs = {"steps": 9, "spikes": 99, "largest_difference_of_a_weight": 0.5}
    monkeypatch.setattr(speed, "Tile", lambda *_: None)
    monkeypatch.setattr(speed, "departure", lambda *_: (3, 0.5))
    monkeypatch.setattr(speed, "ask_brian", lambda *_: departs | {"spikes_that_differ": 1})
    assert [*speed.limits(tmp_path), *speed.brian(tmp_path)] == []
    said = capsys.readouterr().err.splitlines()
    assert ["left out" in line for line in said] == [True, True, True]
    assert ["3 spikes differ" in line for line in said] == [True, True, False]
    assert "1 spikes differ" in said[2]


def test_bench_prints_figures_that_hold_together(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--json", "--seconds", "0.1"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {"reference", "one_lane", "lanes_float64", "pymunk"} <= told["speeds"].keys()
    for speed in told["speeds"].values():
        steps, updates = (
            speed[f"{what}_per_second"] for what in ("network_steps", "synaptic_updates")
        )
        assert steps > 0
        assert updates == pytest.approx(steps * speed["synapses"])
    assert told["speeds"]["one_lane"]["synapses"] == 60 * 8 + 8
    assert told["speeds"]["lanes_float64"]["networks"] == 64
    one, slow = (told["speeds"][k]["network_steps_per_second"] for k in ("one_lane", "reference"))
    assert told["ratios"]["one_lane_to_reference"] == pytest.approx(one / slow)


def test_bench_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--seconds", "0.1"]) == 0
    said = capsys.readouterr().out
    assert "NumPy reference" in said
    assert "one lane / NumPy reference" in said


def test_bench_refuses_no_time(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--seconds", "-1"]) == 2
    assert "seconds must be a number above 0, got '-1'" in capsys.readouterr().err


def test_the_best_turn_of_each_counts() -> None:
    class Clockwork(Contestant):
        """Says that a step takes 1 ms, or 2 ms every other time."""

        turns = 0

        def seconds(self, steps: int) -> float:
            self.turns += 1
            return steps * self.synapses * (1e-3 if self.turns % 2 else 2e-3)

    quick, slow = (Clockwork(k, k, 10, n, lambda _: None) for k, n in (("quick", 1), ("slow", 4)))
    speeds = race([quick, slow], 1e-9)
    assert speeds["quick"].network_steps_per_second == pytest.approx(10_000)
    assert speeds["slow"].nanoseconds == pytest.approx(4e5)
    assert Ratio("", "", "quick", "slow").of(speeds) == pytest.approx(4.0)
