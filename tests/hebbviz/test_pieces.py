"""Long calls are cut into pieces: the run stays the same, and between two it can be ended."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raw_client import wait_until

import hebbviz
from hebbviz.learner import pieces, saves
from hebbviz.learner.learner import Learner
from hebbviz.learner.pieces import Stopped, between_pieces, stop_when
from hebbviz.sims.experiments import Plan
from hebbviz.sims.experiments.work_unit import Tile, bring_on
from hebbviz.sims.loading import make_task

ROOT = Path(__file__).parents[2]
PATIENCE = 120.0
ENDS = 10.0
"""Seconds within which a program must end; it takes one or two, on a machine that is not busy."""


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Cut into pieces of 1, 2, 3, 1, ... steps; returns them."""
    sizes: list[int] = []

    def adapt(self: Any, size: int, _: float) -> None:
        sizes.append(size)
        self._size = 1 + len(sizes) % 3

    monkeypatch.setattr(pieces.Pieces, "_adapt", adapt)
    return sizes


def run_of(*, written_out: bool) -> list[Any]:
    """All that a run shows: with notes and without, with changes and a reward of another run."""
    learner = Learner(
        make_task("sonar"), hidden=(3,), seed=4, lanes=3, written_out=written_out, fall=100.0
    )
    learner.look_at(1)
    learner.probe((0, 5))
    closely = learner.advance(130, closely=True)
    learner.give_reward(0.5)
    replaced = learner.advance(40, reward=np.linspace(-1.0, 1.0, 40))
    frame = learner.frame()
    learner.skip(700)
    return [
        closely.fired, closely.potential, closely.world, replaced.broadcast, frame.since.spikes,
        frame.since.probe_range, learner.network, learner.world, learner.totals,
    ]  # fmt: skip


@pytest.mark.parametrize("written_out", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_run_does_not_depend_on_where_it_is_cut(
    written_out: bool, small_pieces: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    cut = run_of(written_out=written_out)
    assert len(small_pieces) > 400
    monkeypatch.undo()
    for a, b in zip(cut, run_of(written_out=written_out), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("task", ["sonar", "pendulum"])
def test_progress_is_told_and_a_call_that_is_stopped_leaves_a_good_learner(
    task: str, small_pieces: list[int]
) -> None:
    learner, told = Learner(make_task(task)), []
    with between_pieces(lambda made, steps: told.append((made, steps))):
        learner.skip(20)
    assert told[-1] == (20, 20)
    assert len(told) > 9
    with pytest.raises(Stopped), stop_when(lambda: True):
        learner.skip(20)
    other = Learner(make_task(task))
    other.skip(learner.step)
    np.testing.assert_array_equal(learner.network, other.network)
    np.testing.assert_array_equal(learner.world, other.world)


def test_pieces_take_about_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that only they move: however many steps there are in one, it is cut to the aim."""
    now, made = 0.0, []
    monkeypatch.setattr(pieces.time, "perf_counter", lambda: now)
    cut = pieces.Pieces()
    for steps, a_step in ((3_000, 1e-3), (200, 0.1), (100_000, 1e-5)):
        for piece in cut.of(steps):
            made.append((piece.stop - piece.start) * a_step)
            now += made[-1]
        assert sum(made) == pytest.approx(steps * a_step)
        assert max(made[1:]) <= 2 * pieces.AIM_SECONDS  # the first is as long as it was before
        assert len(made) < 15 + 2 * steps * a_step / pieces.AIM_SECONDS
        made.clear()


def test_a_share_that_is_stopped_in_an_evaluation_goes_on_with_it() -> None:
    plan = Plan(task="sonar", lanes=2, segments=3, segment_steps=70, evaluate=1, hidden=(2,))
    stop, version, digest = threading.Event(), hebbviz.__version__, plan.digest()
    stop.set()
    tile, shares = Tile(0, 2), 0
    while not tile.is_done(plan):
        stopped = bring_on(plan, tile, 1e9, version, digest, stop)
        assert len(stopped.figures.get("test_error", ())) == len(tile.figures.get("test_error", ()))
        tile = bring_on(plan, stopped, 0.0, version, digest)
        shares += 1
    assert shares > 3
    whole = bring_on(plan, Tile(0, 2), 1e9, version, digest)
    np.testing.assert_array_equal(tile.totals, whole.totals)
    assert len(whole.figures["test_error"]) == 4
    for name, values in whole.figures.items():
        np.testing.assert_array_equal(tile.figures[name], values)


# Processes


LARGE = "--task sonar --hidden 1000,1000"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_evaluation_of_a_large_network_which_is_saved(
    number: signal.Signals, tmp_path: Path
) -> None:
    saved = tmp_path / "x.npz"
    with started(f"train {LARGE} --steps 20 --save {saved}") as process:
        wait_until(saved.exists, PATIENCE)
        time.sleep(0.5)  # it is well in the evaluation, which takes minutes
        _, err = ended(process, number)
    assert process.returncode == 128 + number
    said = f"stopped at step 20, before a frozen copy was evaluated; saved in {saved}"
    assert err == f"hebbviz: {said}\n"
    assert saves.load(saved, make_task).step == 20


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        f"figure learning {LARGE} --lanes 1 --epochs 1 --out {{}}/out",
        "sweep --task sonar --hidden 1000,1000 --lanes 1 --epochs 1 --gamma 1e-3 --out {}/out",
        "bench --seconds 100",
    ],
)
def test_a_signal_ends_experiments_in_the_midst_of_compiled_calls(
    command: str, tmp_path: Path
) -> None:
    with started(command.format(tmp_path)) as process:
        time.sleep(6.0)  # in whatever it is then, the compiler too
        assert process.poll() is None
        _, err = ended(process, signal.SIGTERM)
    assert process.returncode == 128 + signal.SIGTERM
    assert "stopped" in err.splitlines()[-1]


@pytest.mark.slow
def test_a_signal_ends_a_page_that_evaluates_a_large_network(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with started(f"serve {LARGE} --port 0 --no-browser --record {path}") as process:
        assert process.stdout is not None
        while "hebbviz is at" not in process.stdout.readline():
            assert process.poll() is None
        time.sleep(4.0)  # it evaluates by itself
        out, err = ended(process, signal.SIGTERM)
    assert (process.returncode, err) == (0, "")
    assert "recorded" in out


@contextlib.contextmanager
def started(command: str) -> Any:
    with subprocess.Popen(
        [sys.executable, "-m", "hebbviz", *command.split()], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


def ended(process: subprocess.Popen[str], number: signal.Signals) -> tuple[str, str]:
    began = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - began < ENDS
    return out, err
