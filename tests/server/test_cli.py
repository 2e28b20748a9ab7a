"""The command line: what it refuses and how, what it reports, and that it ends cleanly."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from raw_client import RawClient, wait_until

from hebbviz.learner import saves
from hebbviz.learner.learner import Learner
from hebbviz.server import app, serve
from hebbviz.server.cli.main import main
from hebbviz.server.web import host_names
from hebbviz.sims.loading import make_task
from hebbviz.theory.poisson import time_to_event

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
HEBBVIZ = [sys.executable, "-m", "hebbviz"]
PATIENCE = 60.0
"""Seconds for a server to be up; most of it is for compiling on a machine that never did."""
HEAVY = {
    "distributed", "llvmlite", "matplotlib", "numba", "pyarrow", "pymunk", "rerun", "trimesh",
    "viser",
}  # fmt: skip
"""What takes long to import."""

POLE = '''
import numpy as np
from hebbviz.task import Input, Output, Preset, Task


class Pole(Task):
    """The input says which of the two is wanted; reward for doing it."""

    name = "pole"
    inputs = (Input("wanted"),)
    outputs = (Output("done", "right", "left"),)
    presets = {"easy": Preset(0.5, 0.01, "a test"), "hard": Preset(0.9, 0.01, "a test")}

    def restart(self, draws):
        return np.array([1.0, 0.0])

    def transition(self, state, action, draws):
        return np.array([1.0 if draws(1)[0] < 0.5 else -1.0, float(action[0] == state[0])])

    def observation(self, state):
        return state[:1].copy()

    def reward(self, state):
        return float(state[1])


class Breaks(Pole):
    name = "breaks"

    def restart(self, draws):
        return np.zeros(2)

    def transition(self, state, action, draws):
        if state[1] >= 100:
            raise KeyError("no\\nmore")
        return state + 1.0

    def reward(self, state):
        return 0.0


class NotFinite(Breaks):
    def transition(self, state, action, draws):
        return state + 1.0

    def reward(self, state):
        return float("nan") if state[1] > 50 else 0.0


class WrongShape(Pole):
    def observation(self, state):
        return np.zeros(3)


class NoOutputs(Pole):
    outputs = ()


class StrangePresets(Pole):
    presets = ["easy"]


class Prints(Pole):
    def results(self, learner, late):
        return {"luck": float("inf"), "seed": 99.0}
'''


RULES = """
from dataclasses import dataclass
from hebbviz.rules import Rule
from hebbviz.task import Reading


@dataclass(frozen=True)
class Typo(Rule):
    name = "typo"

    @staticmethod
    def modulat(memory, constants, reward, ended, sent):
        sent[:] = reward


class Beyond(Typo):
    name = "beyond"

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        sent[5] = 1.0


class Late(Typo):
    name = "late"
    memory = (Reading("steps"),)

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        for lane in range(len(reward)):
            memory[0, lane] += 1.0
            sent[lane] = 1.0 / (50.0 - memory[0, lane])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """User's files, saved learners, and files that are none."""
    path = tmp_path_factory.mktemp("cli")
    (path / "mine.py").write_text(POLE)
    (path / "lone.py").write_text(POLE[: POLE.index("class Breaks")])
    (path / "rules.py").write_text(RULES)
    (path / "broken.py").write_text("def f(:\n")
    (path / "raises.py").write_text("x = 1\n\n1 / 0\n")
    (path / "exits.py").write_text("import sys\nsys.exit(0)\n")
    saves.save(Learner(make_task("pendulum", "raw"), seed=3), path / "pole.npz")
    own = f"{path}/mine.py:Pole"
    saves.save(Learner(make_task(own)), path / "own", task_name=own)
    whole = (path / "pole.npz").read_bytes()
    (path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (path / "flipped.npz").write_bytes(whole[:700] + bytes([whole[700] ^ 255]) + whole[701:])
    (path / "text.npz").write_text("no learner")
    np.savez(path / "other.npz", weights=np.zeros(3))
    header = {"program": saves.PROGRAM, "format": saves.FORMAT + 1}
    np.savez(path / "newer.npz", header=np.array(json.dumps(header)))
    (path / "a_folder.npz").mkdir()
    return path


def run(*args: object, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main([str(a) for a in args])
    out, err = capsys.readouterr()
    return code, out, err


BAD: dict[str, str] = {
    # arguments: a part of the line that says why
    "sing": "'sing'",
    "--task nope": "there is no task 'nope'; choose from pendulum, filtering, gradient",
    "--preset nope": "no preset 'nope'; choose from baseline, quick, raw, paper, literal",
    "--preset quick:gains=no": "has no switch 'gains'; it has none",
    "--task sonar --preset best:mean=no": "has no switch 'mean'; it has centred",
    "--task sonar --preset best:centred=2": "centred, which must be yes or no, got '2'",
    "--task sonar --preset worst:centred=no": "no preset 'worst'; choose from quick, paper, best",
    "--beta 1": "beta must be in [0, 1), got 1.0",
    "--beta -0.1": "beta must be in [0, 1), got -0.1",
    "--beta nan": "beta must be a finite number, got 'nan'",
    "--gamma -1e-3": "gamma (the step size) must be from 0",
    "--gamma -inf": "gamma must be a finite number, got '-inf'",
    "--rule nope": "there is no rule 'nope'; choose from paper, baseline, yoked",
    "--rule baseline:time=0": "rule baseline: time must be from 1 to 1e+12, got 0.0",
    "--rule baseline:tau=9": "rule baseline has no parameter 'tau'; it has time",
    "--rule nowhere.py:Mine": "rule nowhere.py:Mine: there is no file nowhere.py",
    "--rule {0}/rules.py:Typo": "rule typo: the class has no method 'modulate'",
    "--rule {0}/rules.py:Beyond": "out of bounds for axis 0 with size 1 (rules.py, line 21)",
    "train --steps 99 --rule {0}/rules.py:Late": "rule late sent what is not a finite number",
    "--rule yoked --lanes 1": "rule yoked needs 2 lanes or more, this learner has 1",
    "train --steps 9 --load {0}/pole --rule yoked": "rule yoked needs 2 lanes or more",
    "--fall 0": "fall (the steps over which gamma falls) must be from 1",
    "--fall soon": "fall must be a number of steps or never, got 'soon'",
    "train --steps 5 --task sonar --rule yoked --record {}/yoked.rrd": "a recording holds one lane",
    "--seed -1": "seed must be a whole number from 0 to 4294967295, got '-1'",
    "--seed 4294967296": "seed must be",
    "--seed 1.5": "seed must be",
    "--lanes 0": "lanes must be a whole number from 1 to 256, got '0'",
    "--lanes -1": "lanes must be",
    "--lanes 1e3": "lanes must be a whole number from 1 to 256, got '1e3'",
    "--lanes 257": "lanes must be",
    "--hidden 8x": "hidden must be sizes such as 16 or 8,8",
    "--hidden 100000000": "must have 1 to 4096 units, got 100000000",
    "--hidden 1,2,3,4,5,6,7,8,9": "(at most 8, from 1 to 4096 each)",
    "--hidden 0": "must have 1 to 4096 units, got 0",
    "--hidden 4096,4096": "at most 4000000 synapses",
    "--speed fast": "speed must be steps per second above 0, realtime or max, got 'fast'",
    "--speed 0": "speed must be",
    "--speed 1e10": "speed must be above 0 and at most 1e+09",
    "--speed realtime --task sonar": "needs a task with a time step",
    "--port 65536": "port must be a whole number from 0 to 65535",
    "--port http": "port must be",
    "--recordings=": "a path must have a name, got ''; see hebbviz serve --help",
    "--load=": "a path must have a name",
    "--task=": "there is no task ''",
    "inspect ": "a path must have a name",
    "export run.rrd --out=": "a path must have a name",
    "figure sonar --out=": "a path must have a name",
    "figure sonar --out={0}/out --rules R": "arguments: --rules R; see hebbviz figure --help",
    "figure sonar --out={0}/out --rule R": "figure sonar takes no --rule: leave it out",
    "train --steps 9 --record=": "a path must have a name",
    "train --steps 9 --save=": "--save must name a file, got ''",
    "--host 192.0.2.1 --port 0": "can't listen on 192.0.2.1:0",
    "--host no.such.host.invalid": "can't listen on no.such.host.invalid",
    "--host=": "host must be a name or an address",
    "--no-such-option": "unrecognized arguments",
    "train": "required: --steps",
    "train --steps -1": "steps must be a whole number from 0",
    "train --steps 1e999999999": "steps must be a whole number",
    "train --steps 1e13": "steps must be a whole number",
    "train --steps 1,000,000": "got '1,000,000'; leave the commas out",
    "train --steps 1,5e6": "got '1,5e6'; use a point: 1.5e6",
    "train --steps 9 --beta 0,95": "beta must be a finite number, got '0,95'; use a point: 0.95",
    "--fall 1,5e6": "or never, got '1,5e6'; use a point: 1.5e6",
    "--speed 0,5": "or max, got '0,5'; use a point: 0.5",
    "--rule baseline:time=0,5": "it has time; use a point in numbers",
    "sweep --beta 0,95 --out {0}/out": "in [0, 1), got 95.0; use a point: 0.95",
    "figure pendulum --hours 0,5 --out {0}/out": "got '0,5'; use a point: 0.5",
    "train --steps 9 --budget 1,5MB": "got '1,5MB'; use a point",
    "--task {0}/mine.py": "class must be named too, such as {0}/mine.py:Pole or {0}/mine.py:Breaks",
    "--task {0}/lone.py": "task {0}/lone.py: the class must be named too, such as {0}/lone.py:Pole",
    "--task none.py": "there is no file none.py; give it as path.py:Name",
    "--rule {0}/mine.py": "the class must be named too, and it has none made from Rule",
    "train --steps 1.5": "steps must be a whole number",
    "train --steps 9 --speed 3": "unrecognized arguments: --speed",
    "train --steps 9 --lanes 3": "unrecognized arguments: --lanes",
    "train --steps 9 --task nope": "there is no task 'nope'",
    "train --steps 9 --save {0}/nowhere/x": "no such file or directory; choose another folder",
    "train --steps 9 --save {0}/a_folder": "--save must name a file",
    "train --steps 9 --save {0}/pole": "pole.npz exists already and is not overwritten",
    "train --steps 9 --load {0}/own --save {0}/pole": "is not overwritten: name another file for",
    "train --steps 9 --budget 1MB": "--budget needs a recording: name its file with --record",
    "train --steps 9 --detail light": "--detail needs a recording",
    "train --steps 9 --load {0}/absent": "cannot open {0}/absent: no such file",
    "train --steps 9 --load {0}": "is a directory",
    "train --steps 9 --load {0}/text.npz": "is not a learner saved by hebbviz",
    "train --steps 9 --load {0}/other.npz": "is not a learner saved by hebbviz",
    "train --steps 9 --load {0}/cut.npz": "damaged",
    "train --steps 9 --load {0}/flipped.npz": "damaged",
    "--load {0}/newer.npz": "newer than this hebbviz knows",
    "--load {0}/pole --task sonar": "--task sonar does not go with --load",
    "--load {0}/pole --preset quick": "--preset quick does not go with --load",
    "--load {0}/pole --seed 4": "--seed 4 does not go with --load",
    "--load {0}/pole --lanes 4": "--lanes 4 does not go with --load",
    "--load {0}/pole --hidden 5": "--hidden 5 does not go with --load",
    "--load {0}/pole --beta 2": "beta must be in [0, 1)",
    "--load {0}/own": "name its file again, with --task path.py:Name",
    "--load {0}/own --task pendulum": "does not go with --load",
    "--load {0}/own --task {0}/mine.py:Breaks": "does not go with --load",
    "--task {0}/none.py:Pole": "there is no file",
    "--task {0}/mine.py:Missing": "has no class Missing",
    "--task {0}/mine.py:np": "has no class np",
    "--task {0}/mine.py:NoOutputs": "must set 'outputs'",
    "--task {0}/mine.py:StrangePresets": "StrangePresets",
    "--task {0}/mine.py:WrongShape": "observation",
    "--task {0}/broken.py:X": "SyntaxError",
    "--task {0}/raises.py:X": "ZeroDivisionError: division by zero (raises.py, line 3)",
    "--task {0}/exits.py:X": "SystemExit",
    "train --steps 500 --task {0}/mine.py:Breaks": "(mine.py, line 35), at step 100",
    "train --steps 500 --task {0}/mine.py:NotFinite": "not a finite number, at step 50",
}


@pytest.mark.parametrize("arguments", BAD)
def test_bad_input_is_one_line_and_exit_2(
    arguments: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    began = time.monotonic()
    code, out, err = run(*arguments.format(folder).split(" "), capsys=capsys)
    assert code == 2
    assert not out or out.startswith("compiling")
    assert err.startswith("hebbviz: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert "Traceback" not in err
    assert BAD[arguments].format(folder) in err
    assert time.monotonic() - began < 5 * PATIENCE  # some are found out about once compiled


def test_signals_are_as_before_after_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    before = [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)]
    assert run("train", "--steps", 5, "--json", capsys=capsys)[0] == 0
    assert [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)] == before


def test_bad_input_to_a_process() -> None:
    done = subprocess.run(
        [*HEBBVIZ, "--beta", "1.5"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "hebbviz: beta must be in [0, 1), got 1.5\n"


@pytest.mark.parametrize("arguments", [["--help"], ["serve", "--help"], ["train", "-h"]])
def test_help_is_quick_and_tells_every_option(arguments: list[str]) -> None:
    """It imports nothing that takes long."""
    python, *program = HEBBVIZ
    done = subprocess.run(
        [python, "-X", "importtime", *program, *arguments],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=PATIENCE,
    )  # fmt: skip
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "hebbviz.server.cli.arguments" in imported
    assert not imported & HEAVY
    assert done.stdout.startswith("usage: hebbviz")
    wanted = {
        "--help": ["serve", "train", "--version"],
        "serve": [
            "--task",
            "--preset",
            "--beta",
            "--gamma",
            "--rule",
            "--fall",
            "--seed",
            "--hidden",
            "--speed",
            "--host",
            "--port",
            "--load",
            "--no-browser",
        ],
        "train": [
            "--task",
            "--preset",
            "--steps",
            "--seed",
            "--beta",
            "--gamma",
            "--hidden",
            "--json",
            "--save",
            "--load",
        ],
    }[arguments[0]]
    assert [w for w in wanted if w not in done.stdout] == []


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version", capsys=capsys)[:2] == (0, "hebbviz 0.1.0\n")


def test_python_m_hebbviz_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hebbviz", "--version"],
        cwd=ROOT, capture_output=True, text=True, check=True, timeout=PATIENCE,
    )  # fmt: skip
    assert done.stdout == "hebbviz 0.1.0\n"


# Training


def test_steps_may_be_written_with_an_exponent(capsys: pytest.CaptureFixture[str]) -> None:
    assert trained(capsys, "--task", "synapse", "--steps", "1.2e2")["steps"] == 120


def trained(capsys: pytest.CaptureFixture[str], *args: object) -> dict[str, Any]:
    code, out, err = run("train", "--json", *args, capsys=capsys)
    assert (code, err) == (0, "")

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    figures: dict[str, Any] = json.loads(out.splitlines()[-1], parse_constant=refuse)
    return figures


OWN_FIGURES = {
    "pendulum": {"mean_time_to_fall_s"},
    "sonar": {"training_error", "test_error"},
    "synapse": set(),
    "gradient": {"average_reward"},
    "prediction": {"right", "baseline", "best", "same_as_now", "most_frequent"},
    "filtering": {"right", "baseline", "best"},
}


@pytest.mark.parametrize("task", OWN_FIGURES)
def test_train_tells_its_figures(task: str, capsys: pytest.CaptureFixture[str]) -> None:
    figures = trained(capsys, "--task", task, "--steps", 2000, "--seed", 7)
    again = trained(capsys, "--task", task, "--steps", 2000, "--seed", 7)
    other = trained(capsys, "--task", task, "--steps", 2000, "--seed", 8)
    timed = {"seconds", "steps_per_second"}
    assert {k: v for k, v in figures.items() if k not in timed} == {
        k: v for k, v in again.items() if k not in timed
    }
    assert other["seed"] == 8
    assert figures["task"] == task
    assert figures["preset"] == next(iter(make_task(task).presets))
    assert (figures["seed"], figures["steps"], figures["late_steps"]) == (7, 2000, 400)
    assert figures["seconds"] > 0
    assert figures["steps_per_second"] == pytest.approx(2000 / figures["seconds"])
    assert isinstance(figures["average_reward"], float)
    assert OWN_FIGURES[task] <= figures.keys()
    assert all(isinstance(figures[name], float) for name in OWN_FIGURES[task])


def test_time_to_fall_and_reward_agree(capsys: pytest.CaptureFixture[str]) -> None:
    figures = trained(capsys, "--steps", 5000)
    dt = make_task("pendulum").dt
    assert dt is not None
    assert figures["mean_time_to_fall_s"] == pytest.approx(-dt / figures["average_reward"])
    late = figures["late_steps"] * dt
    assert figures["mean_time_to_fall_s"] == pytest.approx(late / figures["falls"])
    ends = figures["mean_time_to_fall_s_low"], figures["mean_time_to_fall_s_high"]
    assert ends == pytest.approx(time_to_event(late, figures["falls"]))


@pytest.mark.parametrize("steps", [0, 1, 4])
def test_few_steps(steps: int, capsys: pytest.CaptureFixture[str]) -> None:
    figures = trained(capsys, "--steps", steps)
    assert (figures["steps"], figures["total_steps"]) == (steps, steps)
    assert figures["late_steps"] == (1 if steps else 0)
    assert (figures["average_reward"] is None) == (steps == 0)
    assert figures["mean_time_to_fall_s"] is None, "nothing fell"
    assert figures["falls"] == (0 if steps else None)
    assert figures["mean_time_to_fall_s_high"] is None
    low = figures["mean_time_to_fall_s_low"]
    assert low == (pytest.approx(0.02 / 2.9957, rel=1e-4) if steps else None)


def test_no_fall_and_one_are_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
    """The step of the first fall is the last of five that count, or comes after them."""
    learner = Learner(make_task("pendulum"), seed=7)
    falls = np.flatnonzero(learner.advance(500).ended)
    told = []
    for steps in (falls[0], falls[0] + 1):
        assert main(["train", "--task", "pendulum", "--seed", "7", "--steps", str(steps)]) == 0
        told.append(capsys.readouterr().out.splitlines()[-1])
    assert re.fullmatch(r"mean time to fall s: over 0\.\d+ \(no fall, 95 %\)", told[0])
    assert re.fullmatch(
        r"mean time to fall s: 0\.\d+ \(1 fall; 95 %: 0\.\d+ to \d+\.\d+\)", told[1]
    )


def test_train_for_the_eye(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(
        *("train", "--preset", "quick", "--steps", 1000, "--hidden", "3,2"),
        *("--save", tmp_path / "x"),
        capsys=capsys,
    )
    assert (code, err) == (0, "")
    assert out.startswith("pendulum quick, 8-3-2-2, seed 0, β 0.98, γ 0.01\n1,000 steps in ")
    assert "mean time to fall s: " in out
    assert out.endswith(f"saved in {tmp_path / 'x.npz'}\n")


def test_a_rule_gets_the_lanes_that_it_needs_and_they_are_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = "--task", "sonar", "--rule", "yoked", "--steps", 10
    assert trained(capsys, *given)["lanes"] == 2
    code, out, _ = run("train", *given, capsys=capsys)
    assert code == 0
    assert out.startswith("sonar quick, 60-8-1, seed 0, the first of 2 lanes, ")


@pytest.mark.parametrize("task", ["pendulum", "sonar", "own"])
def test_a_saved_learner_goes_on_as_one_long_run(
    task: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = f"{folder}/mine.py:Pole" if task == "own" else task
    named = ["--task", task] if ":" in task else []
    one, two, long = (tmp_path / n for n in ("one", "two", "long.npz"))
    beta = ["--beta", 0.7, "--gamma", 0.02, "--hidden", "6"]
    trained(capsys, "--task", task, *beta, "--seed", 5, "--steps", 1500, "--save", one)
    figures = trained(capsys, "--load", one, *named, "--steps", 501, "--save", two)
    trained(capsys, "--task", task, *beta, "--seed", 5, "--steps", 2001, "--save", long)
    assert (figures["seed"], figures["beta"], figures["gamma"]) == (5, 0.7, 0.02)
    assert (figures["steps"], figures["total_steps"]) == (501, 2001)

    def whole(path: Path) -> Learner:
        return saves.load(path, lambda _, preset: make_task(task, preset))

    a, b = whole(Path(f"{two}.npz")), whole(long)
    assert a.step == b.step == 2001
    np.testing.assert_array_equal(a.network, b.network)
    np.testing.assert_array_equal(a.world, b.world)
    assert np.ptp(a.weights) > 0


def test_a_learner_that_was_loaded_is_saved_in_the_same_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "my.npz"
    trained(capsys, "--task", "sonar", "--steps", 50, "--save", saved)
    for name in (saved, tmp_path / "my"):
        trained(capsys, "--load", name, "--steps", 50, "--save", saved)
    assert saves.load(saved, make_task).step == 150


def test_load_takes_new_parameters_and_repeated_ones(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = trained(
        capsys, "--load", folder / "pole", "--steps", 10, "--beta", 0.25, "--gamma", 0,
        "--task", "pendulum", "--preset", "raw", "--seed", 3, "--hidden", 4,
    )  # fmt: skip
    assert (figures["beta"], figures["gamma"], figures["preset"]) == (0.25, 0.0, "raw")


def test_the_rule_goes_on_and_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Loaded with its rule as it was, with another where that is asked for."""
    saved = tmp_path / "based.npz"
    given = "--task", "sonar", "--rule", "baseline:time=50", "--fall", 2000
    whole = trained(capsys, *given, "--steps", 700)
    half = trained(capsys, *given, "--steps", 400, "--save", saved)
    rest = trained(capsys, "--load", saved, "--rule", "baseline", "--steps", 300)
    for figures in (whole, half, rest):
        assert (figures["rule"], figures["fall"]) == ("baseline:time=50", 2000.0)
    told = ("total_steps", "gamma_in_force", "test_error", "training_error")
    assert [rest[name] for name in told] == [whole[name] for name in told]
    other = trained(capsys, "--load", saved, "--rule", "paper", "--fall", "never", "--steps", 9)
    assert (other["rule"], other["fall"]) == ("paper", None)
    assert other["gamma_in_force"] == other["gamma"]


def test_results_of_a_users_task_are_strict_json(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = trained(capsys, "--task", f"{folder}/mine.py:Prints", "--steps", 50)
    assert figures["luck"] is None
    assert figures["seed"] == 0


def test_a_task_that_breaks_in_training_loses_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = f"{folder}/mine.py:Breaks"
    code, out, err = run(
        "train", "--steps", 500, "--task", task, "--save", tmp_path / "x", capsys=capsys
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.endswith(f"at step 100; saved in {tmp_path / 'x.npz'}\n")
    saved = saves.load(tmp_path / "x.npz", lambda _, preset: make_task(task, preset))
    assert saved.step == 100


@pytest.mark.parametrize(
    "command", ["train --steps 50 --json", "figure learning --steps 50 --lanes 2 --out {}/out"]
)
def test_what_a_users_task_prints_is_not_among_the_figures(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nor what it prints in the processes that do the work of a figure."""
    prints = "        print('state', state)\n"
    head, at, tail = POLE.partition("    def reward(self, state):\n")
    (tmp_path / "talks.py").write_text(f"print('here')\n{head}{at}{prints}{tail}")
    task = f"{tmp_path}/talks.py:Pole"
    assert main([*command.format(tmp_path).split(), "--task", task]) == 0
    out, err = capfd.readouterr()
    assert out.count("\n") == 1
    assert json.loads(out)["preset"] == "easy"
    assert "here\n" in err
    assert "state [" in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_training_is_saved(number: signal.Signals, tmp_path: Path) -> None:
    path, mark = tmp_path / "x.npz", tmp_path / "mark"
    head, at, tail = POLE.partition("    def reward(self, state):\n")
    touch = (
        "        self.rewards = getattr(self, 'rewards', 0) + 1\n"
        "        if self.rewards == 100:  # some steps are made before the training, to compile\n"
        f"            __import__('pathlib').Path({str(mark)!r}).touch()\n"
    )
    (tmp_path / "marks.py").write_text(head + at + touch + tail)
    task = f"{tmp_path}/marks.py:Pole"
    with started("train", "--task", task, "--steps", 10**11, "--save", path) as process:
        wait_until(mark.exists, PATIENCE)
        began = time.monotonic()
        process.send_signal(number)
        out, err = process.communicate(timeout=10)
    assert time.monotonic() - began < 5.0
    assert (process.returncode, out) == (128 + number, "")
    step = int(err.partition("at step ")[2].partition(";")[0].replace(",", ""))
    assert err == f"hebbviz: stopped at step {step:,}; saved in {path}\n"
    assert saves.load(path, lambda *_: make_task(task)).step == step


# Serving


@contextlib.contextmanager
def started(*args: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    command = [*HEBBVIZ, *map(str, args)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=ROOT, **pipes, **options) as process:
        try:
            yield process
        finally:
            process.kill()


def address_of(process: subprocess.Popen[str]) -> tuple[str, list[str]]:
    """Read on until the address is told; returns it, as host:port, and the lines before it."""
    lines: list[str] = []
    watchdog = threading.Timer(PATIENCE, process.kill)
    watchdog.start()
    assert process.stdout is not None
    for line in process.stdout:
        if "hebbviz is at http://" in line:
            watchdog.cancel()
            return line.split("http://")[1].split(" ")[0], lines
        lines.append(line)
    raise AssertionError(f"no address; {lines}, {process.communicate()}")


def ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_serve_answers_and_ends_cleanly(number: signal.Signals) -> None:
    """In the background of a script, where Ctrl-C is ignored unless a program asks for it."""
    with started(
        "--port", 0, "--no-browser", "--speed", "max", preexec_fn=ignore_ctrl_c
    ) as process:
        address, _ = address_of(process)
        with contextlib.closing(http.client.HTTPConnection(address, timeout=10)) as connection:
            connection.request("GET", "/")
            response = connection.getresponse()
            assert response.status == 200
            assert b"<html" in response.read().lower()
        host, port = address.split(":")
        assert host == "127.0.0.1"
        # A browser opens connections in advance, on which it says nothing.
        with RawClient(int(port)), socket.create_connection((host, int(port))):
            time.sleep(1.0)
            process.send_signal(number)
            out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert err == ""
    assert out.splitlines()[-1].startswith("stopped at step ")
    assert out.count("\n") == 1


def test_a_taken_port_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        code, out, err = run("--port", port, capsys=capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"can't listen on 127.0.0.1:{port}: the port is taken" in err


def test_serve_from_python_takes_the_next_port_and_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        monkeypatch.setattr(app, "DEFAULT_PORT", port)
        learner = Learner(make_task("synapse"))

        def stop_soon() -> None:
            try:
                wait_until(lambda: learner.step > 10, PATIENCE)
            finally:
                stop.set()

        stopper = threading.Thread(target=stop_soon)
        stopper.start()
        serve(learner, speed=50, stop=stop)
        stopper.join()
    said = capsys.readouterr().out.splitlines()
    moved = [line.startswith(f"port {port} is taken, using ") for line in said]
    told = [line.startswith("hebbviz is at http://127.0.0.1:") for line in said]
    assert (sum(moved), sum(told)) == (1, 1)
    assert moved.index(True) < told.index(True)
    assert said[-1] == f"stopped at step {learner.step}"
    assert learner.step > 10


@pytest.mark.parametrize(
    ("options", "said", "in_link"),
    [
        (["--host", "0.0.0.0"], "read-only link: http://localhost:", "/?token="),
        pytest.param(
            ["--host", "0.0.0.0", "--no-token"], "whoever reaches it can change the run and record",
            "localhost:", marks=pytest.mark.slow,
        ),
        pytest.param(
            ["--allow-host", "lab.example.org"],
            "read-only link",
            "/?token=",
            marks=pytest.mark.slow,
        ),
        pytest.param(["--token"], "read-only link", "/?token=", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_says_who_may_come_in(options: list[str], said: str, in_link: str) -> None:
    with started(*options, "--port", 0, "--no-browser") as process:
        link, before = address_of(process)
        address, _, path = link.partition("/")
        port = int(address.rpartition(":")[2])
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as asked:
            asked.request("GET", f"/{path}")
            assert asked.getresponse().status == 200
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as asked:
            asked.request("GET", "/", headers={"Host": "evil.example"})
            assert asked.getresponse().status == 403
        process.terminate()
        _, err = process.communicate(timeout=PATIENCE)
    assert in_link in link
    assert any(said in line for line in before)
    assert err.count("\n") == 1 and "--allow-host evil.example" in err
    assert process.returncode == 0


def test_a_name_that_cannot_be_allowed_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run("--allow-host", "*.example.org", capsys=capsys)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "must be NAME or NAME:PORT, such as lab.example.org, got '*.example.org'" in err


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.3.2.1"])
def test_loopback_is_known(host: str) -> None:
    assert host_names.is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "::", "no.such.host.invalid"])
def test_all_else_is_not_loopback(host: str) -> None:
    assert not host_names.is_loopback(host)


def test_the_terminal_tells_why_a_task_stopped_under_the_page(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stop, learner = threading.Event(), Learner(make_task(f"{folder}/mine.py:Breaks"))

    def stop_late() -> None:
        try:
            wait_until(lambda: learner.step == 100, PATIENCE)
            time.sleep(1.0)
        finally:
            stop.set()

    stopper = threading.Thread(target=stop_late)
    stopper.start()
    serve(learner, port=0, speed="max", stop=stop)
    stopper.join()
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith("stopped at step 100: task 'breaks' failed: KeyError: ")


def test_serve_checks_what_it_is_given() -> None:
    with pytest.raises(ValueError, match="time step"):
        serve(Learner(make_task("sonar")), speed="realtime")
    with pytest.raises(ValueError, match="speed must be"):
        serve(Learner(make_task("sonar")), speed=-1.0)
