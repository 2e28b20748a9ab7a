"""The commands for recordings: train and record, inspect, export, replay, view."""

from __future__ import annotations

import http.client
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from raw_client import wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main
from hebbviz.server.recording import header
from hebbviz.sims.loading import make_task

HEBBVIZ = [sys.executable, "-m", "hebbviz"]
ROOT = Path(__file__).parents[2]
LEVER = f"{ROOT / 'tests' / 'examples' / 'lever.py'}:Lever"
PATIENCE = 60.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings: of the pendulum, and of a task of the user's own."""
    path = tmp_path_factory.mktemp("recordings")
    record(path / "pole.rrd", "--task", "pendulum", "--seed", "5")
    record(path / "lever.rrd", "--task", LEVER)
    return path


def record(path: Path, *options: str) -> None:
    assert main(["train", "--steps", "3000", "--record", str(path), *options]) == 0


def test_training_and_recording_is_the_same_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = []
    for extra in ([], ["--record", str(tmp_path / "run.rrd")]):
        assert main(["train", "--task", "sonar", "--steps", "20000", "--json", *extra]) == 0
        found = json.loads(capsys.readouterr().out)
        results.append({k: v for k, v in found.items() if k not in ("seconds", "steps_per_second")})
    assert results[0] == results[1]


def test_inspect_says_it_in_words_and_as_json(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(folder / "pole.rrd"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["task"], found["seed"], found["last_step"]) == ("pendulum", 5, 3000)
    assert found["whole"] is True
    assert main(["inspect", str(folder / "pole.rrd")]) == 0
    said = capsys.readouterr().out
    words = ("pendulum baseline", "seed 5", "3,000", "60.00 s", "complete")
    assert all(word in said for word in words)


def test_export_writes_what_it_says(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    assert main(["export", str(folder / "pole.rrd"), "--out", out]) == 0
    written = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert all(path.stat().st_size for path in written)
    assert tmp_path / "out" / "timelines.npz" in written
    assert main(["export", str(folder / "pole.rrd"), "--out", out, "--every-step", "10:40"]) == 0
    learner = Learner(make_task("pendulum"), seed=5)
    block = learner.advance(40)
    with np.load(tmp_path / "out" / "every-step.npz") as found:
        assert np.array_equal(found["fired"], block.fired[9:39])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_export_that_is_stopped_leaves_nothing(
    folder: Path, tmp_path: Path, number: signal.Signals
) -> None:
    arguments = ("export", str(folder / "pole.rrd"), "--out", str(tmp_path / "out"))
    every = (*HEBBVIZ, *arguments, "--every-step", "1:3000")
    with subprocess.Popen(every, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: list(tmp_path.iterdir()), PATIENCE)  # it has begun to write
        process.send_signal(number)
        assert process.wait(PATIENCE) == 128 + number
        assert process.stderr is not None
        assert process.stderr.read() == "hebbviz: stopped at once\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["replay", "export"])
def test_a_task_of_the_users_own_is_run_only_if_it_is_named(
    folder: Path, tmp_path: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--out", str(tmp_path), "--every-step", "1:5"] if command == "export" else []
    assert main([command, str(folder / "lever.rrd"), *options]) == 2
    assert "with --task path.py:Name" in capsys.readouterr().err
    if command == "export":
        assert main([command, str(folder / "lever.rrd"), *options, "--task", LEVER]) == 0
    assert main([command, str(folder / "lever.rrd"), *options, "--task", "sonar"]) == 2
    assert main([command, str(folder / "pole.rrd"), *options, "--task", "sonar"]) == 2


def test_a_difference_from_the_recording_program_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The task's file where nothing else is: it was edited after the recording."""
    text = Path(LEVER.rpartition(":")[0]).read_text()
    (tmp_path / "mine.py").write_text(text)
    task = ["--task", f"{tmp_path / 'mine.py'}:Lever"]
    record(tmp_path / "run.rrd", *task)
    command = ["export", str(tmp_path / "run.rrd"), *task, "--out", str(tmp_path / "out")]
    command += ["--every-step", "1:5"]
    assert main(command) == 0
    (tmp_path / "mine.py").write_text(text.replace("return state[1]", "return 2 * state[1]"))
    capsys.readouterr()
    for name, value, told in (
        (None, None, "the file of its task or rule has probably changed"),
        ("versions", dict, "it was recorded with hebbviz "),
        ("machine", lambda: "Plan9 vax", "this machine is Plan9 vax"),
    ):
        if name is not None:
            monkeypatch.setattr(header, name, value)
        assert main(command) == 2
        said = capsys.readouterr().err
        assert told in said and said.count("\n") == 1


@pytest.mark.parametrize(
    "options",
    [
        ["--budget", "lots"], ["--budget", "1kB"], ["--budget", "-5MB"], ["--detail", "some"],
        ["--record", "/nonexistent/run.rrd"],
    ],
)  # fmt: skip
def test_what_cannot_be_recorded_is_said_in_one_line(
    options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--steps", "10", "--task", "synapse", *options]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("steps", ["5", "9:3", "a:b", "-1:4", "1:1"])
def test_steps_to_export_are_from_and_to(
    folder: Path, tmp_path: Path, steps: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = str(folder / "pole.rrd"), str(tmp_path)
    assert main(["export", file, "--out", out, f"--every-step={steps}"]) == 2
    assert "FROM:TO" in capsys.readouterr().err


@contextmanager
def program(*options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A program that serves a page, and the address that it says, as host:port."""
    process = subprocess.Popen(
        [*HEBBVIZ, *options, "--no-browser", "--port", "0"], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    watchdog = threading.Timer(PATIENCE, process.kill)
    watchdog.start()
    said: list[str] = []
    try:
        assert process.stdout is not None
        for line in process.stdout:
            said.append(line)
            if "http://" in line:
                break
        else:
            raise AssertionError(f"it ended, or told no address for {PATIENCE} s: {said}")
        watchdog.cancel()
        yield process, said[-1].split("http://")[1].split()[0].rstrip("/")
    finally:
        watchdog.cancel()
        process.kill()
        process.communicate(timeout=10.0)


@pytest.mark.parametrize("command", ["replay", "view"])
def test_pages_of_recordings_are_served_until_they_are_stopped(folder: Path, command: str) -> None:
    with program(command, str(folder / "pole.rrd")) as (process, address):
        with closing(http.client.HTTPConnection(address, timeout=20.0)) as connection:
            connection.request("GET", "/")
            answer = connection.getresponse()
            assert answer.status == 200
            assert b"<html" in answer.read().lower()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def test_help_tells_of_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    for command in ("serve", "train", "replay", "view", "inspect", "export"):
        assert command in said
        assert main([command, "--help"]) == 0
