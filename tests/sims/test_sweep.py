"""Maps of β against γ: what they refuse, that they are what learners alone do, and resume."""

from __future__ import annotations

import csv
import json
import shlex
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raw_client import wait_until

from hebbviz import __version__
from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main, parse
from hebbviz.sims.experiments import workers
from hebbviz.sims.figures.sheet import Origin, _made_by
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.learner_from_arguments import make_learner
from hebbviz.sims.sweep import heat_map
from hebbviz.sims.sweep.grid import Sweep, parse_betas, parse_gammas
from hebbviz.sims.sweep.outcome import Outcome
from hebbviz.sims.sweep.run_sweep import make
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.task.base import Measure, Tally

ROOT = Path(__file__).parents[2]
SWEEP = Sweep(
    task="sonar", preset="quick", hidden=(3,), betas=(0.0, 0.5), gammas=(1e-4, 0.01, 0.1), lanes=3,
    steps=30_000, seed=4,
)  # fmt: skip


def test_lists_and_ranges():
    assert parse_betas("0.9,0.5,0.9") == (0.5, 0.9)
    assert parse_gammas("1e-4:1e-1:4,0") == (0.0, 1e-4, 1e-3, 1e-2, 1e-1)
    assert parse_betas("0:0.999:4") == (0.0, 0.9, 0.99, 0.999), "time constants 1, 10, 100, 1000"
    for value in parse_gammas("1e-4:1e-1:6"):
        assert float(f"{value:.6g}") == value


def test_a_range_of_beta_goes_as_near_to_1_as_it_was_asked_to():
    assert parse_betas("0.9:0.9999999:3") == (0.9, 0.9999, 0.9999999)
    ends = parse_betas("0:0.999999999999:5")
    assert ends == (0.0, 0.999, 0.999999, 0.999999999, 0.999999999999)
    for value in parse_betas("0:0.9999:200"):
        assert float(f"{value:.6g}") == value, "six digits where they tell enough"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--beta 1", "beta must be in [0, 1)"),
        ("--beta 0.5,", "values must be numbers"),
        ("--gamma 0:1:3", "must lie above 0"),
        ("--gamma 1e-3:1:1", "from 2 to 1000 values"),
        ("--gamma 1:2:3:4", "FIRST:LAST:HOW_MANY"),
        ("--gamma nan", "gamma (the step size) must be from 0"),
        ("--beta 0.1:0.9:100 --gamma 0.1:0.9:100", "at most 1000 points"),
        ("--hours 1", "has no time but its steps"),
        ("--epochs 1000000000000", "at most 1,000,000,000,000 steps, got 1.87e+17"),
        ("--task pendulum --hours 1e300", "at most 1,000,000,000,000 steps, got 1.8e+305"),
        ("--task pendulum --hours 1e308", "at most 1,000,000,000,000 steps, got inf"),
        ("--epochs 0", "epochs must be a whole number from 1"),
        ("--task nothing", "there is no task 'nothing'"),
        ("--hidden 0", "hidden"),
        ("--lanes 0", "lanes must be a whole number"),
        ("--scheduler nowhere", "no Dask scheduler answers at nowhere"),
    ],
)
def test_what_it_refuses(options, said, tmp_path, capsys, monkeypatch):
    if "--scheduler" in options:
        monkeypatch.setattr(workers, "CONNECT_SECONDS", 0.5)
    task = [] if "--task" in options else ["--task", "sonar"]
    code = main(["sweep", *task, "--out", str(tmp_path / "out"), *options.split()])
    err = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hebbviz: ")]
    assert code == 2
    assert said in err[-1]
    assert not (tmp_path / "out").exists(), "an empty folder is left"


def test_asked_for_nothing_it_maps_the_default_task_into_a_folder_of_its_own(
    tmp_path, capsys, monkeypatch
):
    """As the help says: the pendulum at its first preset, one point."""
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "--lanes", "1", "--steps", "50"]) == 0
    says = json.loads(capsys.readouterr().out)
    assert (says["task"], says["preset"], len(says["points"])) == ("pendulum", "baseline", 1)
    assert says["files"] == [
        str(Path("sweep", f"sweep-pendulum.{kind}")) for kind in ("png", "svg", "csv")
    ]
    assert all((tmp_path / file).is_file() for file in says["files"])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("sweep")
    return out, make(SWEEP, out, threading.Event())


def test_a_point_is_what_learners_alone_do(made):
    _, says = made
    assert [(p["beta"], p["gamma"]) for p in says["points"]] == [
        (b, g) for b in SWEEP.betas for g in SWEEP.gammas
    ]
    late = []
    for gamma in (0.01, 0.0):
        for lane in range(SWEEP.lanes):
            learner = Learner(
                make_task("sonar"), hidden=(3,), beta=0.5, gamma=gamma, seed=4, first_lane=lane
            )
            learner.skip(24_000)
            before = learner.tally()
            learner.skip(6_000)
            late.append((learner.tally() - before).average_reward)
    point, (trained, untrained) = says["points"][4], np.split(np.array(late), 2)
    assert point["median"] == pytest.approx(100.0 * (1.0 - np.median(trained)), rel=1e-12)
    assert point["average_reward"] == np.median(trained)
    assert point["failing"] == np.mean(trained <= untrained.max())
    assert says["untrained_median"] == pytest.approx(100.0 * (1.0 - np.median(untrained)))
    rewards = [p["average_reward"] for p in says["points"]]
    best = says["points"][int(np.argmax(rewards))]
    assert says["best"] == {n: best[n] for n in ("beta", "gamma", "median")}


def test_a_point_can_be_opened(made):
    """The median lane as it was at the end, and the run from its start."""
    _, says = made
    point = next(p for p in says["points"] if p["lane"] > 0)  # which a seed alone does not open
    end, start = (make_learner(parse(shlex.split(point[o])[1:])) for o in ("open", "open_start"))
    alone = Learner(
        make_task("sonar"), hidden=(3,), beta=point["beta"], gamma=point["gamma"], seed=4,
        first_lane=point["lane"],
    )  # fmt: skip
    for learner in (start, end):
        assert learner.first_lane == point["lane"]
        alone.skip(learner.step - alone.step)
        assert learner.keyframe().digest() == alone.keyframe().digest()
    assert (start.step, end.step) == (0, 30_000)
    assert Sweep.of(parse(shlex.split(says["command"])[1:])) == SWEEP


def test_its_files_tell_the_same(made):
    out, says = made
    assert [Path(f).name for f in says["files"]] == [
        f"sweep-sonar.{kind}" for kind in ("png", "svg", "csv")
    ]
    lines = (out / "sweep-sonar.csv").read_text().splitlines()
    assert lines[0] == f"# command: {says['command']}"
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert len(rows) == len(says["points"])
    for row, point in zip(rows, says["points"], strict=True):
        for name in ("beta", "gamma", "median", "failing", "average_reward"):
            assert float(row[name]) == point[name]
        assert row["open"] == point["open"]
        lanes = [float(row[f"error_{k}"]) for k in range(SWEEP.lanes)]
        assert np.median(lanes) == point["median"]
    assert (out / "sweep-sonar.png").read_bytes().startswith(b"\x89PNG")
    assert says["command"] in (out / "sweep-sonar.svg").read_text()
    json.dumps(says, allow_nan=False)


def test_more_values_go_on_from_what_is_there(made, monkeypatch):
    out, says = made
    done, submit = [], workers._Cores.submit

    def note(self, plan, *share):
        done.append(plan)
        return submit(self, plan, *share)

    monkeypatch.setattr(workers._Cores, "submit", note)
    more = make(Sweep(**{**vars(SWEEP), "betas": (0.0, 0.5, 0.8)}), out, threading.Event())
    assert {p.beta for p in done} == {0.8}
    for before, now in zip(says["points"], more["points"][:6], strict=True):
        assert {n: v for n, v in now.items() if "open" not in n} == {
            n: v for n, v in before.items() if "open" not in n
        }


def test_no_map_is_written_over_by_another_command(tmp_path, capsys, monkeypatch):
    """In the folder that all go to unless told; its learners stay too, and its own command makes
    the same files again.
    """
    monkeypatch.chdir(tmp_path)
    sonar = ["sweep", "--task", "sonar", "--lanes", "1"]
    others = ("--gamma 0.1", "--gamma 0.1,0.2", "--gamma 0.1 --hidden 3", "--gamma 0.1 --seed 1")
    written = {}
    for options in (*others, *others):
        assert main([*sonar, "--steps", "50", *options.split()]) == 0
        says = json.loads(capsys.readouterr().out)
        opened = [shlex.split(p[o])[2] for p in says["points"] for o in ("open", "open_start")]
        made = {file: Path(file).read_bytes() for file in (*says["files"], *opened)}
        assert written.setdefault(options, made) == made
    names = [file for made in written.values() for file in made]
    assert len(set(names)) == len(names)
    assert Path("sweep/sweep-sonar-4.csv").exists()
    for made in written.values():
        assert {file: Path(file).read_bytes() for file in made} == made


def test_where_nothing_learns_none_is_best_and_it_is_said_before(tmp_path, capsys):
    argv = ["sweep", "--task", "gradient", "--beta", "0,0.9", "--steps", "100", "--lanes", "2"]
    assert main([*argv, "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["best"] is None
    assert "γ = 1e-10 moves no weight in 100 steps, so that nothing is learnt: name larger" in err
    assert main([*argv, "--out", str(tmp_path), "--gamma", "0.1"]) == 0
    assert "moves no weight" not in capsys.readouterr().err


def points_of(*rewards):
    measure = Measure("m", "m")
    return [Outcome(SWEEP.untrained, measure, {"m": np.array([r])}, np.array([r])) for r in rewards]


def test_all_that_are_rewarded_most_are_framed_and_none_that_fails():
    (untrained,) = points_of(0.5)
    for rewards, best in (((0.5, 0.5), []), ((0.2, 0.9), [1]), ((0.9, 0.4, 0.9), [0, 2])):
        assert heat_map._best(points_of(*rewards), untrained) == best


@pytest.mark.parametrize(
    ("values", "written"),
    [
        ((0.59, 0.6, 0.628), ["0.590", "0.600", "0.628"]),
        ((9.53, 53.21, 0.0), ["9.5", "53.2", "0.0"]),
        ((120.0, 3.0), ["120", "3"]),
    ],
)
def test_cells_of_a_map_have_the_same_decimals(values, written):
    points = points_of(*values)
    for measure, expected in (
        (Measure("m", "m"), written),
        (
            Measure("m", "m", span=(0.1, 10.0), logarithmic=True),
            [f"{v:#.3g}".rstrip(".") for v in values],
        ),
    ):
        assert [heat_map._digits(measure, points)(v) for v in values] == expected


def test_a_cell_tells_no_fall_in_half_of_the_lanes_from_one():
    """Of lanes of 4 000 s each: what the median is over is no median."""
    task, cells = Pendulum(), []
    for falls in ((1, 1, 6), (0, 0, 6), (0, 6, 6)):
        scores = [task.measure.figures(task.score(Tally(200_000, -k, -k, k))) for k in falls]
        figures = {key: np.array([s[key] for s in scores]) for key in task.measure.keys}
        cells.append(Outcome(SWEEP.untrained, task.measure, figures, -np.array(falls)))
    write = heat_map._digits(task.measure, cells)
    assert [heat_map._written(c, write) for c in cells] == ["4.00e+03", "> 1.34e+03", "667"]
    told = [heat_map.about(c, cells[-1]) for c in cells]
    assert [t["median"] for t in told] == [4000.0, None, pytest.approx(666.7, abs=0.1)]
    assert [t["upper_quartile"] for t in told] == [4000.0, None, None]
    assert [t["lanes_without_fall"] for t in told] == [0, 2, 1]


def test_the_whole_command_is_in_the_picture():
    sweep = replace(SWEEP, gammas=parse_gammas("1e-4:1:60"))
    rows = _made_by(Origin(sweep.command, 4))
    assert " ".join(rows).replace(", ", ",") == f"{sweep.command} · hebbviz {__version__} · seed 4"
    longest = _made_by(Origin(replace(SWEEP, gammas=parse_gammas("1e-4:1:500")).command, 4))
    assert longest[-1] == f"… (all of it is inside this file) · hebbviz {__version__} · seed 4"
    assert max(map(len, [*rows, *longest])) <= 150


def test_a_rule_of_ones_own_is_mapped_and_its_points_can_be_opened(tmp_path, capsys):
    own = tmp_path / "own.py"
    own.write_text((ROOT / "tests/examples/half.py").read_text())
    argv = ["sweep", "--task", "sonar", "--hidden", "3", "--lanes", "2", "--steps", "5000",
            "--gamma", "0.01", "--fall", "1e4", "--out", str(tmp_path)]  # fmt: skip
    assert main([*argv, "--rule", f"{own}:Half"]) == 0
    says = json.loads(capsys.readouterr().out)
    assert Sweep.of(parse(shlex.split(says["command"])[1:])).rule == f"{own}:Half"
    (point,) = says["points"]
    learner = make_learner(parse(shlex.split(point["open"])[1:]))
    assert (str(learner.rule), learner.fall, learner.step) == ("half", 1e4, 5000)
    assert main([*argv, "--rule", "paper", "--gamma", "0.005"]) == 0
    (paper,) = json.loads(capsys.readouterr().out)["points"]
    assert point["median"] == pytest.approx(paper["median"], abs=1.0)
    assert main([*argv, "--rule", "yoked"]) == 0, "lanes that touch each other are opened together"
    (point,) = json.loads(capsys.readouterr().out)["points"]
    assert make_learner(parse(shlex.split(point["open_start"])[1:])).lanes == 2


@pytest.mark.slow
def test_ctrl_c_and_the_same_command_again(tmp_path):
    """Stopped in its midst it says so; gone on with, it comes to what one go comes to."""
    own = tmp_path / "own.py"
    own.write_text(
        "from hebbviz.sims.worlds.sonar import Sonar\n\n\nclass Own(Sonar):\n    name = 'own'\n"
    )
    out, task = tmp_path / "stopped", f"{own}:Own"
    words = ["sweep", "--task", task, "--gamma", "0.001,0.1", "--lanes", "2", "--steps", "6000"]
    one_step_a_share = (
        "import sys\n"
        "from hebbviz.server.cli.main import main\n"
        "from hebbviz.sims.experiments import workers\n"
        "workers.SHARE_SECONDS = 0.0\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", one_step_a_share, *words, "--out", str(out)],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip

        def has_kept() -> bool:
            assert process.poll() is None, process.communicate()
            return bool(list(out.glob("runs/*/lanes-*.npz")))

        try:
            wait_until(has_kept, 60.0)
            process.send_signal(signal.SIGINT)
            said, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert said == ""
    assert f"stopped; the same command continues from the results in {out}" in errors
    sweep = Sweep.of(parse([*words, "--out", str(out)]))
    stop = threading.Event()
    points = [make(sweep, folder, stop)["points"] for folder in (out, tmp_path / "whole")]
    for point in (*points[0], *points[1]):
        assert all(f"--task {task}" in point.pop(o) for o in ("open", "open_start"))
    assert points[0] == points[1]
