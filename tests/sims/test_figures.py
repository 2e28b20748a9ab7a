"""The paper's figures: their files, the numbers in them, and that an interruption costs nothing."""

from __future__ import annotations

import csv
import io
import json
import re
import shlex
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import hebbviz
from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main, parse
from hebbviz.sims import TASKS
from hebbviz.sims.experiments import Curves, Plan, open_workers, run_all
from hebbviz.sims.experiments.work_unit import Tile, bring_on
from hebbviz.sims.figures import learning, pendulum
from hebbviz.sims.figures.curves import preset_note, set_measure_axis
from hebbviz.sims.figures.gradient import BETAS, STILL, Watched, Watching, angle_of_all
from hebbviz.sims.figures.log_time import (
    Course,
    course,
    evaluated,
    even_course,
    frozen_course,
    scales,
)
from hebbviz.sims.figures.request import KINDS, Order
from hebbviz.sims.figures.run_figure import progress_bar
from hebbviz.sims.figures.run_length import Time
from hebbviz.sims.figures.sheet import Origin, Sheet, apart, blank, look, save
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.lamps import Lamps, small_example
from hebbviz.sims.worlds.pendulum.physics import PLANT
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.sims.worlds.sonar import Sonar
from hebbviz.sims.worlds.synapse import SCRIPT
from hebbviz.task.base import Measure
from hebbviz.theory.exact_gradient import angle_between

ROOT = Path(__file__).parents[2]
LEVER = f"{ROOT / 'tests' / 'examples' / 'lever.py'}:Lever"
PATIENCE = 120.0
DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"

SMALL = {
    "synapse": "",
    "gradient": "--lanes 2",
    "sonar": "--lanes 2 --epochs 2",
    "pendulum": "--lanes 2 --hours 0.01",
    "learning": f"--task {LEVER} --lanes 2 --steps 2000",
}
"""What is added to --quick, for these tests to be quick."""


class Made:
    """A figure made by the command line: its folder, and what it printed."""

    def __init__(self, name, folder, options):
        self.name, self.folder = name, folder
        self.argv = ["figure", name, "--out", str(folder), "--quick", *shlex.split(options)]
        out = io.StringIO()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "stdout", out)
            assert main(self.argv) == 0
        (line,) = out.getvalue().splitlines()
        self.says = json.loads(line)

    def file(self, kind):
        (path,) = (Path(p) for p in self.says["files"] if p.endswith(f".{kind}"))
        return path

    @property
    def comments(self):
        lines = self.file("csv").read_text().splitlines()
        return dict(line[2:].split(": ", 1) for line in lines if line.startswith("# "))

    @property
    def columns(self):
        """Numbers where all of a column are."""
        lines = self.file("csv").read_text().splitlines()
        names, *rows = csv.reader(line for line in lines if not line.startswith("#"))
        return {
            n: _numbers(values) for n, values in zip(names, zip(*rows, strict=True), strict=True)
        }


def _numbers(values):
    try:
        return np.array(values, dtype=float)
    except ValueError:
        return np.array(values)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Each figure, made once."""
    found = {}

    def make(name):
        if name not in found:
            found[name] = Made(name, tmp_path_factory.mktemp(name), SMALL[name])
        return found[name]

    return make


def same_files(a, b):
    return all(a.file(k).read_bytes() == b.file(k).read_bytes() for k in ("png", "svg", "csv"))


@pytest.mark.parametrize(
    "name", [k if k == "synapse" else pytest.param(k, marks=pytest.mark.slow) for k in KINDS]
)
def test_three_files_are_written_and_say_by_what_they_were_made(made, name):
    figure = made(name)
    assert [Path(p).suffix for p in figure.says["files"]] == [".png", ".svg", ".csv"]
    assert {Path(p) for p in figure.says["files"]} == set(figure.folder.iterdir())
    told = {"command": figure.says["command"], "version": hebbviz.__version__, "seed": "0"}
    told["quick"] = figure.comments["quick"]
    assert figure.comments == told
    assert re.match(r"\d+ (short )?(run|estimate)s? |the same as without|preset ", told["quick"])
    with Image.open(figure.file("png")) as image:
        image.load()
        assert image.width > 1000
        assert {k: image.text[k.title()] for k in told} == told
    description = ET.parse(figure.file("svg")).find(f".//{DUBLIN_CORE}description")
    assert description is not None
    assert description.text == "; ".join(f"{k}: {v}" for k, v in told.items())
    assert figure.says["version"] == hebbviz.__version__
    assert figure.says["quick"] is True


@pytest.mark.parametrize(
    ("options", "file"),
    [
        ("sonar", "sonar"),
        ("sonar --scheduler tcp://here:1", "sonar"),
        ("sonar --preset best", "sonar-best"),
        ("sonar --preset best:centred=no,scaled=no", "sonar-best-centred=no-scaled=no"),
        ("sonar --quick", "sonar-quick"),
        ("sonar --preset quick", "sonar-quick-preset"),
        ("sonar --lanes 2 --epochs 30 --seed 3", "sonar-2-lanes-30-epochs-seed-3"),
        ("pendulum --preset best --hours 120", "pendulum-best-120.0-hours"),
        ("learning", "learning"),
        ("learning --task sonar --steps 2000", "learning-sonar-2000-steps"),
        ("learning --task ../a/lever.py:Lever", "learning-lever"),
        ("learning --task mine.py:Pole", "learning-mine-Pole"),
        ("learning --rule yoked --lanes 4", "learning-yoked-4-lanes"),
        ("learning --rule a/my.py:Own:time=5 --fall never", "learning-my-Own-time=5-fall-never"),
        (
            "learning --hidden none --beta 0.9 --gamma 1e-3",
            "learning-hidden-none-beta-0.9-gamma-0.001",
        ),
    ],
)
def test_files_are_called_by_what_was_asked(options, file):
    name, *more = options.split()
    assert Order.of(parse(["figure", name, "--out", "x", *more])).file == file


def test_a_figure_does_not_write_over_one_of_another_command(tmp_path, capsys):
    """Two commands can have one name for their files still, as two tasks have of two folders."""
    options = "--lanes 1 --steps 500"
    first = Made("learning", tmp_path, f"--task {LEVER} {options}")
    before = first.file("csv").read_bytes()
    other = tmp_path / "other" / "lever.py"
    other.parent.mkdir()
    other.write_text(Path(LEVER.rpartition(":")[0]).read_text())
    argv = ["figure", "learning", "--out", str(tmp_path), "--quick", *options.split()]
    assert main([*argv, "--task", f"{other}:Lever"]) == 2
    assert "is of another command and is not written over" in capsys.readouterr().err
    assert first.file("csv").read_bytes() == before
    assert main([*argv, "--task", LEVER]) == 0, "its own command makes it again"


@pytest.mark.parametrize(
    "name", ["synapse", *(pytest.param(k, marks=pytest.mark.slow) for k in ("sonar", "pendulum"))]
)
def test_the_command_that_a_figure_names_writes_the_same_bytes(made, name, tmp_path):
    first = made(name)
    program, *argv = shlex.split(first.says["command"])
    assert (program, *argv[:4]) == ("hebbviz", "figure", name, "--out", "FOLDER")
    again = Made(name, tmp_path, shlex.join(a for a in argv[4:] if a != "--quick"))
    assert same_files(first, again)


def test_synapse_shows_what_the_rule_does(made):
    """Equations (zupdate) and (update), from the spikes and rewards in the CSV."""
    figure = made("synapse")
    columns, preset = figure.columns, make_task("synapse", "script").preset
    assert [letter for letter in columns["letter"] if letter] == list("abcdefghijkl")
    assert len(columns["step"]) == len(SCRIPT)
    z, w, pre_before = 0.0, 0.5, 0.0
    for k in range(len(SCRIPT)):
        assert columns["weight_before"][k] == pytest.approx(w, abs=1e-12)
        fires = 1.0 / (1.0 + np.exp(-w * pre_before))
        z = preset.beta * z + (columns["postsynaptic"][k] - fires) * pre_before
        w += preset.gamma * columns["reward"][k] * z
        assert columns["trace"][k] == pytest.approx(z, abs=1e-12)
        assert columns["weight"][k] == pytest.approx(w, abs=1e-12)
        pre_before = columns["presynaptic"][k]
    change = columns["weight"] - columns["weight_before"]
    by_letter = dict(zip(columns["letter"], change, strict=True))
    for letter in "chl":
        assert figure.says[f"weight_change_{letter}"] == by_letter[letter]
    assert by_letter["h"] < 0.0 < by_letter["l"]
    assert abs(by_letter["c"]) < abs(by_letter["h"]) / 4


@pytest.mark.slow
def test_gradient_shows_the_angles_of_real_learners_and_of_the_exact_chain(made):
    figure = made("gradient")
    columns, steps = figure.columns, figure.says["steps"]
    network, weights = small_example()
    chain = network.at(weights)
    for k, beta in enumerate(BETAS):
        rows = columns["beta"] == beta
        last = np.array([columns[f"angle_{lane}"][rows][-1] for lane in range(2)])
        assert columns["steps"][rows][-1] == steps
        assert figure.says["angle"][k] == pytest.approx(last.mean(), rel=1e-12)
        assert columns["angle_mean"][rows][-1] == pytest.approx(last.mean(), rel=1e-12)
        assert figure.says["angle_of_all"][k] == columns["angle_of_all"][rows][-1]
        assert columns["angle_of_all"][rows][-1] == pytest.approx(last.mean(), abs=5.0)
        cosine = np.cos(np.radians(columns["angle_expected"][rows][-1]))
        assert cosine == pytest.approx(chain.expected_cosine(beta, steps=steps), abs=1e-9)
        bias = angle_between(chain.gradient, chain.biased_gradient(beta))
        assert figure.says["bias"][k] == pytest.approx(bias, abs=1e-9)
    learner = Learner(Lamps(), topology=network.topology, beta=0.8, gamma=STILL, first_lane=1)
    learner.set_weights(weights[:, None])
    learner.skip(steps)
    angle = angle_between(chain.gradient, learner.weights[:, 0] - weights)
    assert columns["angle_1"][columns["beta"] == 0.8][-1] == pytest.approx(angle, abs=1e-4)
    assert 0.0 < angle < 60.0


def test_an_estimate_is_at_a_right_angle_as_long_as_it_has_no_direction():
    learner = Learner(Watched(), lanes=3)
    assert learner.task.evaluate(learner)["angle"].tolist() == [90.0] * 3
    gradient = np.array(learner.task._gradient)
    toward = np.stack([gradient, -gradient, np.zeros_like(gradient)], axis=1)
    learner.set_weights(learner.weights + 1e-3 * toward)
    angle = learner.task.evaluate(learner)["angle"]
    np.testing.assert_allclose(angle, [0.0, 180.0, 90.0], atol=1e-4)


def test_the_angle_of_all_estimates_is_that_of_their_sums():
    """Of as many as can be it is what is expected; the mean of their angles is another thing."""
    estimates = np.random.default_rng(0).normal(0.3, 1.0, (5, 40))
    truth, length = np.arange(1.0, 6.0), np.linalg.norm(estimates, axis=0)
    cosine = (truth @ estimates).mean() / np.linalg.norm(truth) / np.sqrt((length**2).mean())
    found = angle_of_all(angle_between(truth, estimates), length)
    assert np.cos(np.radians(found)) == pytest.approx(cosine, rel=1e-12)
    assert angle_of_all(np.full(3, 90.0), np.zeros(3)) == 90.0

    lanes = 1024
    plan = Watching(beta=0.8, gamma=STILL, lanes=lanes, segments=1, segment_steps=20_000,
                    evaluate=1)  # fmt: skip
    tile = bring_on(plan, Tile(0, lanes), 1e9, hebbviz.__version__, plan.digest())
    angle, length = (tile.curves(plan).figures[name][:, 1] for name in ("angle", "length"))
    network, weights = small_example()
    expected = np.degrees(np.arccos(network.at(weights).expected_cosine(0.8, steps=20_000)))
    assert angle_of_all(angle, length) == pytest.approx(expected, abs=0.5)
    assert angle.mean() < expected - 1.0


@pytest.mark.slow
def test_sonar_shows_the_errors_of_frozen_copies(made):
    figure = made("sonar")
    columns, says = figure.columns, figure.says
    np.testing.assert_array_equal(columns["epoch"], [0, 1, 2])
    learner = Learner(Sonar("quick"), lanes=2, dtype="float32")
    for epoch in range(3):
        for name, errors in learner.task.evaluate(learner).items():
            shown = [columns[f"{name}_{lane}"][epoch] for lane in range(2)]
            np.testing.assert_allclose(shown, errors, rtol=0, atol=1e-12)
            assert columns[f"{name}_mean"][epoch] == pytest.approx(errors.mean(), rel=1e-12)
            assert columns[f"{name}_sd"][epoch] == pytest.approx(errors.std(ddof=1), abs=1e-12)
        if epoch < 2:
            learner.skip(Sonar.epoch)
    for name in ("training_error", "test_error"):
        assert says[name] == columns[f"{name}_mean"][-1]
        assert says[f"{name}_sd"] == columns[f"{name}_sd"][-1]
    assert (says["training_error_back_propagation"], says["test_error_back_propagation"]) == (
        0.003, 0.165,
    )  # fmt: skip


@pytest.mark.slow
def test_pendulum_shows_the_falls_of_every_run(made):
    """Blocks follow each other without a gap: their falls are all falls of the run."""
    figure = made("pendulum")
    columns, says = figure.columns, figure.says
    assert list(says["presets"]) == ["quick", "raw", "paper", "literal"]
    assert says["constant_thrust_s"] < says["random_thrust_s"] < 0.7
    assert "10⁷" in says["literal_says"]
    for preset in ("quick", "paper"):
        rows = columns["preset"] == preset
        learner = Learner(Pendulum(preset), first_lane=1)
        learner.skip(1440)
        before = learner.tally()
        learner.skip(360)
        blocks = np.diff(columns["simulated_s"][rows], prepend=0.0)
        assert columns["simulated_s"][rows][-1] == pytest.approx(1800 * PLANT.time_step)
        falls = columns["falls_1"][rows]
        assert falls.sum() == learner.tally().ended
        np.testing.assert_allclose(falls * columns["mean_time_to_fall_s_1"][rows], blocks)
        late = learner.task.score(learner.tally() - before).value
        assert says["presets"][preset]["mean_time_to_fall_s"][1] == pytest.approx(late, rel=1e-12)
        end = columns["mean_time_to_fall_s_median"][rows][-1]
        assert says["presets"][preset]["mean_time_to_fall_s_median_at_end"] == end


def test_a_point_of_the_pendulum_is_of_a_frozen_copy():
    """At the very steps at which the blocks of the running learner end, from one scale or another,
    and told as `Task.evaluate` has it.
    """
    points = {"first": 500, "per_decade": 4}
    plans = evaluated(scales(Plan(task="pendulum", preset="best", lanes=2, segments=50,
                                  segment_steps=100), first=1000), **points)  # fmt: skip
    with open_workers() as workers:
        curves = run_all(plans, workers)
    task = plans[-1].make_task()
    frozen, running = frozen_course(task, curves), course(task, curves, **points)
    assert len(frozen.steps) > 4
    np.testing.assert_array_equal(frozen.steps, running.steps)
    learner = Learner(task, lanes=2)
    for k, step in enumerate(frozen.steps):
        learner.skip(int(step) - learner.step)
        for key, values in task.evaluate(learner).items():
            np.testing.assert_array_equal(frozen.figures[key][:, k], values)
    np.testing.assert_allclose(frozen.values * frozen.figures["falls"], 2000.0)
    assert pendulum._FROZEN_SECONDS == 2000.0, "as in the paper"


def seconds_of(steps, values):
    """A course of time to fall (lanes, n), with some falls in all of it."""
    figures = dict.fromkeys(Pendulum.measure.keys, np.array(values, dtype=float))
    return Course(Pendulum.measure, steps, figures)


@pytest.mark.parametrize(("end", "is_flat"), [(0.7, True), (30.0, False)])
def test_literal_is_called_flat_only_where_it_is(end, is_flat):
    steps = np.array([500, 50_000, 5_000_000])
    plan = Plan(task="pendulum", preset="literal", lanes=1, segments=1, segment_steps=5_000_000)
    found = seconds_of(steps, [[0.5, 0.6, end]])
    ones = np.ones((1, 1))
    curves = Curves(steps[-1:], plan.steps, ones, ones, ones, steps[:0], {})
    curve = pendulum._Curve(plan, curves, found, learning=seconds_of(steps, [[0.5, 5.0, 500.0]]))
    assert pendulum._is_flat_literal(curve) is is_flat, "frozen copies are drawn"


@pytest.mark.parametrize(("highest", "top"), [(100.0, 3e4), (4e5, 6e5)])
def test_no_time_to_fall_is_cut_off(highest, top):
    values = np.array([[0.5, 2.0, 50.0], [0.5, 9.0, highest]])
    steps = np.array([500, 50_000, 5_000_000])
    plan = Plan(task="pendulum", preset="quick", lanes=2, segments=1, segment_steps=5_000_000)
    found = seconds_of(steps, values)
    ones = np.ones((2, 1))
    curves = Curves(steps[-1:], plan.steps, ones, ones, ones, steps[:0], {})
    with look():
        figure = pendulum._draw([pendulum._Curve(plan, curves, found, found)],
                                {"random_thrust_s": 0.6, "constant_thrust_s": 0.3})  # fmt: skip
    assert figure.axes[0].get_ylim() == (0.15, top)


def test_learning_shows_the_measure_of_a_users_task(made):
    figure = made("learning")
    columns, says = figure.columns, figure.says
    learner = Learner(make_task(LEVER), first_lane=1)
    for step, shown in zip(columns["step"], columns["average_reward_1"], strict=True):
        before = learner.tally()
        learner.skip(int(step) - learner.step)
        assert shown == pytest.approx((learner.tally() - before).average_reward, abs=1e-12)
    assert learner.step == says["steps"] == 2000
    assert says["average_reward_median_at_end"] == columns["average_reward_median"][-1]
    assert says["average_reward"][1] == pytest.approx(columns["average_reward_1"][-5:].mean())


OWN_RULE = """
from dataclasses import dataclass
from hebbviz.rules import Rule, parameter

@dataclass(frozen=True)
class Scaled(Rule):
    name = "scaled"
    by: float = parameter(1.0, least=0.0, most=10.0)

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        for lane in range(len(reward)):
            sent[lane] = constants[0] * reward[lane]
"""


def test_learning_takes_a_network_values_and_a_rule_of_ones_own(tmp_path):
    """Twice the reward with half of γ is the paper's rule, to the bit where both are exact."""
    own = tmp_path / "own.py"
    own.write_text(OWN_RULE)
    options = f"--task {LEVER} --lanes 2 --steps 2000 --hidden 2 --beta 0.25 --fall 1e4"
    paper = Made("learning", tmp_path / "a", f"{options} --rule paper --gamma 0.5")
    mine = Made("learning", tmp_path / "b", f"{options} --rule {own}:Scaled:by=2 --gamma 0.25")
    for name in ("network", "beta", "fall"):
        assert mine.says[name] == paper.says[name] == {
            "network": "1-2-1", "beta": 0.25, "fall": 1e4,
        }[name]  # fmt: skip
    assert (mine.says["rule"], mine.says["gamma"]) == ("scaled:by=2", 0.25)
    for name, values in paper.columns.items():
        np.testing.assert_array_equal(mine.columns[name], values)
    assert np.std(paper.columns["average_reward_0"]) > 0.0


def test_a_yoked_control_is_drawn_from_lanes_that_touch(tmp_path, capsys):
    argv = ["figure", "learning", "--task", LEVER, "--steps", "500", "--rule", "yoked"]
    assert main([*argv, "--lanes", "1", "--out", str(tmp_path / "one")]) == 2
    assert "rule yoked needs 2 lanes or more" in capsys.readouterr().err
    assert main([*argv, "--lanes", "3", "--out", str(tmp_path / "three")]) == 0
    assert json.loads(capsys.readouterr().out)["rule"] == "yoked"


def test_the_time_that_compiling_takes_is_not_counted_on(capsys, monkeypatch):
    """Half was done in the second after the first share: a second is left, not an hour."""
    monkeypatch.setattr("hebbviz.sims.figures.run_figure._LOG_SECONDS", 0.0)
    now = 1000.0
    monkeypatch.setattr("tqdm.std.time", lambda: now)
    with progress_bar("figure x") as progress:
        for now, fraction in ((1000.0, 0.0), (4600.0, 0.01), (4601.0, 0.5)):  # noqa: B007
            progress(fraction)
        (*_, line) = capsys.readouterr().err.split("\r")
        assert "50 %" in line
        assert line.strip().endswith("00:01 gone, 00:01 left")


SLOW_SHARES = """
import sys, time
from hebbviz.sims.experiments import workers

def slowly(*given, bring_on=workers.bring_on):
    time.sleep(0.1)
    return bring_on(*given)

workers.SHARE_SECONDS, workers.bring_on = 0.01, slowly
from hebbviz.server.cli.main import main
sys.exit(main())
"""


@pytest.mark.slow
def test_an_interrupted_figure_goes_on_and_comes_out_the_same(made, tmp_path):
    whole = made("sonar")
    argv = [a if a != str(whole.folder) else str(tmp_path) for a in whole.argv]
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW_SHARES, *argv], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        deadline = time.monotonic() + PATIENCE
        while not list(tmp_path.glob("sonar-unfinished-*/*/lanes-*.npz")):
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 130
    assert out == ""
    assert "the same command continues" in err.splitlines()[-1]
    assert not list(tmp_path.glob("sonar*.*"))
    resumed = Made("sonar", tmp_path, SMALL["sonar"])
    assert not list(tmp_path.glob("*unfinished*"))
    assert same_files(whole, resumed)
    timeless = {"seconds", "files"}
    assert {k: v for k, v in resumed.says.items() if k not in timeless} == {
        k: v for k, v in whole.says.items() if k not in timeless
    }


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("nothing --out {out}", "synapse"),
        ("sonar", "--out"),
        ("sonar --out {out} --hours 1", "takes no --hours"),
        ("pendulum --out {out} --epochs 3", "takes no --epochs"),
        ("synapse --out {out} --task sonar", "takes no --task"),
        ("sonar --out {out} --preset none", "quick, paper"),
        ("sonar --out {out} --preset best:bent=no", "no switch 'bent'; it has centred"),
        ("learning --out {out} --task {lever} --hours 1", "give --steps"),
        ("learning --out {out} --task {lever} --epochs 1", "no epochs"),
        ("learning --out {out} --task none", "no task 'none'"),
        ("learning --out {out} --epochs 1 --hours 1", "not allowed with"),
        ("pendulum --out {out} --hours 0", "hours"),
        ("pendulum --out {out} --hours 1e-9", "a run of 1e-09 is too short for a curve: ask for"),
        ("learning --out {out} --task {lever} --steps 4", "ask for 5 or more"),
        ("pendulum --out {out} --hours 1e308", "at most 1,000,000,000,000 steps, got inf"),
        ("pendulum --out {out} --hours 1e300", "at most 1,000,000,000,000 steps, got 1.8e+305"),
        ("learning --out {out} --hours 1e300", "at most 1,000,000,000,000 steps, got 1.8e+305"),
        ("sonar --out {out} --epochs 1000000000000", "steps, got 1.87e+17: ask for fewer"),
        ("sonar --out {out} --lanes 0", "lanes"),
        ("synapse --out {file}", "choose another"),
    ],
)
def test_what_cannot_be_drawn_is_said_in_one_line(options, said, tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("mine")
    argv = shlex.split(options.format(out=tmp_path / "out", file=file, lever=LEVER))
    assert main(["figure", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert said in err
    assert file.read_text() == "mine"
    assert not (tmp_path / "out").exists(), "an empty folder is left"


def test_a_task_that_breaks_is_told_with_the_place_as_train_tells_it(tmp_path, capsys):
    """Also where a process of its own ran it, of which no traceback comes."""
    own = tmp_path / "own.py"
    text = Path(LEVER.rpartition(":")[0]).read_text()
    own.write_text(broken := text.replace("return state[1]", "return {}['none']"))
    place = f"(own.py, line {1 + broken[: broken.index('return {}[')].count(chr(10))})"
    task = ["--task", f"{own}:Lever"]
    assert main(["train", *task, "--steps", "10"]) == 2
    trained = capsys.readouterr().err.partition(place)
    assert main(["figure", "learning", *task, "--quick", "--out", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == f"{trained[0]}{place}"
    assert not (tmp_path / "out").exists(), "an empty folder is left"


def test_a_task_may_be_written_in_another_encoding(tmp_path):
    own = tmp_path / "own.py"
    text = Path(LEVER.rpartition(":")[0]).read_text()
    own.write_bytes(b"# -*- coding: latin-1 -*-\n" + f"# défaut\n{text}".encode("latin-1"))
    made = Made("learning", tmp_path / "out", f"--task {own}:Lever --lanes 1 --steps 100")
    assert made.says["steps"] == 100


def test_a_caption_says_what_is_not_as_the_preset_has_it():
    """Its note tells the preset's own β, which is not in force then."""
    plan = Plan(task="pendulum", preset="quick", lanes=1, segments=1, segment_steps=1)
    note = make_task("pendulum", "quick").note
    assert preset_note(plan) == f"preset quick: {note}"
    given = replace(plan, beta=0.9, hidden=(3,), options={"rule": "baseline"})
    assert preset_note(given) == f"preset quick, but another network, β, rule; as it is: {note}"
    same = replace(plan, beta=0.98, hidden=(4,))
    assert preset_note(same) == preset_note(plan)


@pytest.mark.parametrize("preset", ["quick", "best", "best:centred=no"])
def test_the_foot_says_all_of_the_note_within_the_figure(preset, tmp_path):
    plan = Plan(task="sonar", preset=preset, segments=1, segment_steps=1)
    note = f"{'few of its runs ' * 12}\n{preset_note(plan)}"
    with look():
        figure = blank(2.0)
        axes = figure.add_subplot()
        axes.set_xlabel("steps")
    sheet = Sheet(figure, {"step": [1]}, {}, note, quick="short runs")
    save(sheet, tmp_path, "x", Origin("hebbviz figure x", 0))
    command, *said = (text.get_text() for text in figure.texts)
    assert command.startswith("hebbviz figure x")
    assert " ".join(reversed(said)).split() == f"quick: short runs {note}".split()
    boxes = [text.get_window_extent() for text in figure.texts]
    assert max(box.x1 for box in boxes) < figure.bbox.x1
    assert max(box.y1 for box in boxes) < axes.get_tightbbox().y0


def title_boxes(figure):
    """Of the titles of all axes that say something, in pixels."""
    figure.draw_without_rendering()
    titles = [axes.set_title(axes.get_title(loc), loc=loc) for axes in figure.axes
              for loc in ("left", "center", "right")]  # fmt: skip
    return [title.get_window_extent() for title in titles if title.get_text()]


def test_stretches_without_an_end_grow_along_the_curve(tmp_path):
    """A block as long as any other would be the ceiling of a time to fall, whatever is learnt."""
    columns = Made("learning", tmp_path, "--lanes 1 --steps 3000").columns
    lengths = np.diff(columns["step"], prepend=0)
    assert lengths[-1] > 10 * lengths[0]
    assert columns["step"][-1] == 3000


@pytest.mark.parametrize("places", [(1.0, 1.0, 1.1), (3.0, 1.0, 2.0), (0.0, 0.05, 0.9, 1.0, 5.0)])
def test_labels_stand_apart_in_the_order_of_what_they_name(places):
    found = apart(places, 0.2)
    assert np.array_equal(np.argsort(found, kind="stable"), np.argsort(places, kind="stable"))
    assert np.diff(np.sort(found)).min() > 0.2 - 1e-12
    assert found.mean() == pytest.approx(np.mean(places))
    far = [k for k, p in enumerate(places) if sum(abs(p - q) < 0.3 for q in places) == 1]
    assert all(found[k] == places[k] for k in far)


@pytest.mark.parametrize("value", [1e200, -3.0, 0.0])
def test_rounding_is_not_drawn_as_a_curve(value):
    with look():
        axes = blank(2.0).add_subplot()
        axes.plot([0, 1], [value, value * (1 + 1e-15)])
        set_measure_axis(axes, Measure("average reward", "average_reward"))
        bottom, top = axes.get_ylim()
    assert bottom < value < top
    assert top - bottom > 0.1 * abs(value)


@pytest.mark.parametrize("name", [*TASKS.names, LEVER, "a long summary"])
def test_the_title_of_a_learning_curve_is_legible(name):
    """It stays within the figure, and nothing is printed over it."""
    plan = Plan(task=LEVER if name == "a long summary" else name, segments=2, segment_steps=10)
    task, totals = plan.make_task(), np.ones((plan.lanes, 2))
    if name == "a long summary":
        task.summary = "Win More Games of Whist With a Memory of What Was Played " * 3
    curves = Curves(np.array([10, 20]), 10, totals, totals, totals, np.zeros(0, dtype=int), {})
    with look():
        figure = learning._draw(plan, task, Time("steps", "step", 1.0), even_course(task, curves))
        boxes = title_boxes(figure)
    assert boxes
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
