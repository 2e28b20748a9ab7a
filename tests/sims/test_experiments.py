"""Many lanes at once: tiles, shares, interruptions and kills change nothing of what comes of it."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import hebbviz
from hebbviz.learner.learner import Learner
from hebbviz.rules.base import make_rule
from hebbviz.server.cli.main import main
from hebbviz.sims.experiments import Interrupted, Plan, open_workers, run, run_all, workers
from hebbviz.sims.experiments import store as store_module
from hebbviz.sims.experiments.plan import joined
from hebbviz.sims.experiments.run import TILE, _completed
from hebbviz.sims.experiments.store import Store
from hebbviz.sims.experiments.work_unit import ChangedTask, Tile, WrongVersion, bring_on
from hebbviz.sims.loading import make_task

ROOT = Path(__file__).parents[2]
LEVER = f"{ROOT / 'tests' / 'examples' / 'lever.py'}:Lever"
SONAR = Plan(task="sonar", hidden=(3,), seed=7, lanes=5, segments=6, segment_steps=3_001)
PATIENCE = 60.0
PULLS = Plan(task=LEVER, seed=2, lanes=3, segments=5, segment_steps=400)


def brought_on(plan, tile, seconds):
    return bring_on(plan, tile, seconds, hebbviz.__version__, plan.digest())


@pytest.fixture
def short_shares(monkeypatch):
    monkeypatch.setattr(workers, "SHARE_SECONDS", 0.01)


def same(a, b):
    return (
        a.steps == b.steps
        and all(
            np.array_equal(getattr(a, n), getattr(b, n))
            for n in ("end", "reward", "broadcast", "ended", "evaluated_at")
        )
        and a.figures.keys() == b.figures.keys()
        and all(np.array_equal(a.figures[n], b.figures[n]) for n in a.figures)
    )


def alone(plan):
    """Curves of a plan as one learner makes them, a lane at a time, with no machinery."""
    rows, figures = [], []
    for lane in range(plan.first_lane, plan.first_lane + plan.lanes):
        learner = Learner(make_task(plan.task), hidden=plan.hidden, seed=plan.seed, first_lane=lane)
        found, evaluated = [], []
        for k in range(plan.segments + 1):
            if plan.evaluate and k % plan.evaluate == 0:
                evaluated.append(learner.task.evaluate(learner))
            if k < plan.segments:
                before = learner.tally()
                learner.advance(plan.segment_steps)
                found.append(learner.tally() - before)
        rows.append(found)
        figures.append(evaluated)
    return rows, figures


@pytest.mark.parametrize("plan", [SONAR, PULLS], ids=["sonar", "lever"])
def test_curves_are_those_of_learners_alone(plan):
    with open_workers() as cores:
        curves = run(plan, cores)
    rows, _ = alone(plan)
    assert np.array_equal(curves.end, plan.segment_steps * np.arange(1, plan.segments + 1))
    assert curves.reward.shape == (plan.lanes, plan.segments)
    for name in ("reward", "broadcast", "ended"):
        expected = [[getattr(tally, name) for tally in lane] for lane in rows]
        assert np.array_equal(getattr(curves, name), expected), name
    scores = curves.scores(plan.make_task())[plan.make_task().measure.key]
    assert scores[1, 2] == plan.make_task().score(rows[1][2]).value
    assert curves.last(0.4)[2].reward == curves.reward[2, -2:].sum()


def test_lanes_that_touch_each_other_are_one_tile(tmp_path, short_shares):
    plan = replace(PULLS, options={"rule": "yoked"})
    with open_workers() as cores:
        curves = run(plan, cores, folder=tmp_path)
    learner = Learner(make_task(LEVER), rule=make_rule("yoked"), seed=2, lanes=3)
    totals = [learner.skip_tallied(plan.segment_steps) for _ in range(plan.segments)]
    assert np.array_equal(curves.reward.T, [[t.reward for t in lanes] for lanes in totals])
    assert np.array_equal(curves.broadcast.T, [[t.broadcast for t in lanes] for lanes in totals])
    assert [(t.first_lane, t.lanes) for t in Store(tmp_path, plan).read()] == [(0, 3)]


def test_frozen_copies_are_evaluated_lane_by_lane():
    plan = replace(SONAR, lanes=2, segments=4, evaluate=2)
    with open_workers() as cores:
        curves = run(plan, cores)
    _, expected = alone(plan)
    assert curves.evaluated_at.tolist() == [0, 6_002, 12_004]
    for name in ("training_error", "test_error"):
        assert np.array_equal(
            curves.figures[name], [[e[name][0] for e in lane] for lane in expected]
        )


def test_cut_and_shares_change_nothing(short_shares, monkeypatch):
    """One tile or five, one share or many; lane 3 is the same with others beside it or without."""
    with open_workers() as cores:
        many_shares = run(SONAR, cores)
        monkeypatch.setattr(workers._Cores, "count", lambda _: 5)
        five_tiles, third = run_all([SONAR, replace(SONAR, first_lane=3, lanes=1)], cores)
    one = brought_on(SONAR, Tile(0, SONAR.lanes), 1e9).curves(SONAR)
    assert same(many_shares, one)
    assert same(five_tiles, one)
    assert np.array_equal(third.reward[0], one.reward[3])


def test_tiles_hold_every_lane_once():
    for lanes in (1, 5, 64, 65, 100, 300):
        for pieces in (1, 2, 8):
            plan = replace(SONAR, first_lane=10, lanes=lanes)
            kept = _completed(plan, [], pieces)[1::2]
            tiles = _completed(plan, kept, pieces)
            held = [lane for t in tiles for lane in range(t.first_lane, t.first_lane + t.lanes)]
            assert held == list(range(10, 10 + lanes))
            assert max(t.lanes for t in tiles) <= TILE
            assert len(tiles) >= min(pieces, lanes)


@pytest.mark.parametrize("kept", [((0, 8), (0, 4), (4, 4)), ((0, 3), (2, 4), (5, 3)), ((6, 4),)])
def test_a_lane_that_was_kept_twice_is_run_once(kept, tmp_path, short_shares):
    """Tiles that overlap, or go beyond the plan: the curves have its lanes, and are the same."""
    plan = replace(SONAR, lanes=8, segments=2)
    for k, (first_lane, lanes) in enumerate(kept):
        tile = brought_on(plan, Tile(first_lane, lanes), 0.02 * k)
        Store(tmp_path, plan).write(tile)
    with open_workers() as cores:
        curves = run(plan, cores, folder=tmp_path)
        assert curves.reward.shape == (8, 2)
        assert same(curves, run(plan, cores))


def test_a_stopped_run_goes_on_and_nothing_is_done_twice(tmp_path, monkeypatch):
    monkeypatch.setattr(workers, "SHARE_SECONDS", 0.001)  # a hundredth of it, on a fast machine too
    stop, first, second = threading.Event(), [], []

    def stop_later(fraction):
        first.append(fraction)
        if fraction > 0.3:
            stop.set()

    with open_workers() as cores:
        with pytest.raises(Interrupted):
            run(SONAR, cores, folder=tmp_path, stop=stop, progress=stop_later)
        curves = run(SONAR, cores, folder=tmp_path, progress=second.append)
        again = run(SONAR, cores, folder=tmp_path, progress=(third := []).append)
        whole = run(SONAR, cores)
    assert first == sorted(first) and first[0] == 0.0
    assert 0.3 < first[-1] < 1.0
    assert second[0] == first[-1] and second[-1] == 1.0
    assert third == [1.0]
    assert same(curves, whole) and same(again, whole)


def test_a_run_that_is_killed_goes_on(tmp_path):
    """Killed with -9 in the midst of its shares: what was kept is whole, the end the same."""
    script = (
        "import json, sys\n"
        "from pathlib import Path\n"
        "from hebbviz.sims.experiments import Plan, open_workers, run, workers\n"
        "workers.SHARE_SECONDS = 0.0\n"
        "plan = Plan(**json.loads(sys.argv[1]))\n"
        "with open_workers() as cores:\n"
        "    run(plan, cores, folder=Path(sys.argv[2]), progress=lambda f: print(f, flush=True))\n"
    )
    command = [sys.executable, "-c", script, json.dumps(SONAR.to_json()), str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        fractions = [float(process.stdout.readline()) for _ in range(5)]
        process.kill()
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert 0.0 < fractions[-1] < 1.0
    with open_workers() as cores:
        resumed = run(SONAR, cores, folder=tmp_path, progress=(left := []).append)
        assert left[0] >= fractions[-1]
        assert same(resumed, run(SONAR, cores))


def test_curves_of_too_many_lanes_are_not_joined():
    plan = replace(SONAR, lanes=3, segments=1, segment_steps=1)
    curves = brought_on(plan, Tile(0, 3), 0.0).curves(plan)
    assert joined([curves, curves], 6).reward.shape == (6, 1)
    with pytest.raises(ValueError, match="the curves must have 5 lanes together, got 6"):
        joined([curves, curves], 5)


def test_plans_are_kept_apart(tmp_path, monkeypatch):
    own = tmp_path / "own.py"
    own.write_text(Path(LEVER.rpartition(":")[0]).read_text())
    plan = replace(PULLS, task=f"{own}:Lever")
    others = [
        replace(plan, **{name: value})
        for name, value in (("seed", 3), ("beta", 0.9), ("lanes", 4), ("hidden", (2,)))
    ]
    digests = {p.digest() for p in (plan, *others)}
    own.write_text(own.read_text() + "\n# edited\n")
    assert len(digests | {plan.digest()}) == len(others) + 2
    rule = tmp_path / "rule.py"
    rule.write_text("one")
    ruled = replace(plan, options={"rule": f"{rule}:Mine:time=5", "fall": 1e6})
    digests = {p.digest() for p in (plan, ruled, replace(ruled, options={"fall": 1e6}))}
    rule.write_text("two")
    assert len(digests | {ruled.digest()}) == 4
    monkeypatch.chdir(tmp_path)
    elsewhere = replace(ruled, options={"rule": "rule.py:Mine:time=5", "fall": 1e6})
    assert elsewhere.digest() == elsewhere.for_workers().digest() == ruled.digest()
    assert pickle.loads(pickle.dumps(plan)).digest() == plan.digest()
    assert Plan(**json.loads(json.dumps(plan.to_json()))).digest() == plan.digest()


def test_what_is_damaged_is_run_again(tmp_path, capsys):
    tile = brought_on(SONAR, Tile(0, 5), 0.0)
    store = Store(tmp_path, SONAR)
    store.write(tile)
    (file,) = store.folder.iterdir()
    (kept,) = store.read()
    assert kept.keyframe.digest() == tile.keyframe.digest()
    file.write_bytes(file.read_bytes()[:-40])
    with open_workers() as cores:
        again = run(SONAR, cores, folder=tmp_path)
        (line,) = capsys.readouterr().err.splitlines()
        assert str(file) in line and "damaged: it is put aside, and its lanes are run" in line
        assert same(again, run(SONAR, cores))
        run(SONAR, cores, folder=tmp_path)
    assert capsys.readouterr().err == "", "it is said once"


@pytest.mark.parametrize(("limit", "what"), [(500, "/lanes-"), (20_000, "learning-")])
def test_a_full_disk_is_told_and_the_same_command_goes_on(limit, what, tmp_path):
    """Where shares are kept, and where the figure is written; once there is room all is well."""
    script = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from hebbviz.server.cli.main import main\n"
        "words = sys.argv[2:]\n"
        "main([*words, '--out', 'warm'])  # compiles, and has that on disk\n"
        "hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), hard))\n"
        "codes = [main([*words, '--out', 'full'])]\n"
        "left = [p.suffix for p in Path('full').rglob('*') if p.is_file()]\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))\n"
        "print(*codes, main([*words, '--out', 'full']), *sorted(set(left)))\n"
    )
    argv = ["figure", "learning", "--task", "sonar", "--quick", "--lanes", "2", "--steps", "500"]
    done = subprocess.run(
        [sys.executable, "-c", script, str(limit), *argv], cwd=tmp_path, text=True, check=True,
        capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    (line,) = (x for x in done.stderr.splitlines() if x.startswith("hebbviz: "))
    assert line.startswith("hebbviz: cannot write full/learning-") and what in line
    assert line.endswith(": file too large; make room, the same command goes on")
    kept = "" if limit == 500 else ".npz"
    assert done.stdout.splitlines()[-1] == f"2 0 {kept}".strip(), "no part of a file is left"


def test_a_worker_of_another_version_is_refused():
    with pytest.raises(WrongVersion, match=r"0\.0\.0"):
        bring_on(SONAR, Tile(0, 1), 0.0, "0.0.0", SONAR.digest())


def test_a_task_that_is_edited_in_mid_run_is_refused(tmp_path, short_shares):
    """Nothing of the new text comes into the curves of the old one; put back, the run goes on."""
    own, edited = tmp_path / "own.py", tmp_path / "edited.py"
    own.write_text(text := Path(LEVER.rpartition(":")[0]).read_text())
    plan = replace(PULLS, task=f"{own}:Lever", segments=50)

    def edit(least, fraction):
        if least < fraction:
            edited.write_text(text.replace("return state[1]", "return 1.0 - state[1]"))
            edited.replace(own)

    with open_workers() as cores:
        whole = run(plan, cores)
        for least in (0.0, 0.999):  # in its midst, and once it is done but not yet told of
            with pytest.raises(
                ChangedTask, match=r"own.py:Lever: the file has changed since the run"
            ):
                run(plan, cores, folder=tmp_path / "kept", progress=partial(edit, least))
            own.write_text(text)
        assert same(run(plan, cores, folder=tmp_path / "kept", progress=(left := []).append), whole)
    assert left[0] > 0.0


RULE = Path(__file__).parents[1].joinpath("examples").joinpath("half.py").read_text()


def test_a_rule_of_ones_own_goes_from_process_to_process_and_may_not_be_edited(
    tmp_path, short_shares
):
    own, edited = tmp_path / "rule.py", tmp_path / "edited.py"
    own.write_text(RULE)
    plan = replace(PULLS, options={"rule": f"{own}:Half", "fall": 1e3}, segments=20)
    learner = Learner(make_task(LEVER), rule=plan.rule(), fall=1e3, seed=2, lanes=3)
    totals = [learner.skip_tallied(plan.segment_steps) for _ in range(plan.segments)]

    def edit(fraction):
        if fraction > 0.0:
            edited.write_text(RULE.replace("0.5", "0.25"))
            edited.replace(own)

    with open_workers() as cores, pytest.raises(ChangedTask, match=r"rule.py:Half: the file has"):
        run(plan, cores, folder=tmp_path / "kept", progress=edit)
    own.write_text(RULE)
    with open_workers() as cores:  # new processes, which have read nothing yet
        curves = run(plan, cores, folder=tmp_path / "kept", progress=(left := []).append)
    assert left[0] > 0.0
    assert np.array_equal(curves.reward.T, [[t.reward for t in lanes] for lanes in totals])
    assert np.array_equal(curves.broadcast.T, [[t.broadcast for t in lanes] for lanes in totals])
    assert np.array_equal(curves.broadcast, 0.5 * curves.reward)


def _die(*_):
    os.kill(os.getpid(), signal.SIGKILL)


def test_workers_that_die_or_are_others_are_not_blamed_on_the_task(tmp_path, capsys, monkeypatch):
    argv = ["figure", "learning", "--task", LEVER, "--quick", "--out", str(tmp_path)]
    kept = f"the same command continues from the results in {tmp_path}"
    with monkeypatch.context() as patch:
        patch.setattr(workers, "bring_on", _die)
        assert main(argv) == 1
    died = "hebbviz: a worker process died"
    assert capsys.readouterr().err.splitlines()[-1] == f"{died}; {kept}"
    with monkeypatch.context() as patch:
        patch.setattr(hebbviz, "__version__", "0.0.0")
        assert main(argv) == 1
    other = f"hebbviz: a worker runs hebbviz {hebbviz.__version__}, this is 0.0.0: install the same"
    assert capsys.readouterr().err.splitlines()[-1] == f"{other} version for all workers; {kept}"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_a_signal_to_all_processes_stops_them_as_one_to_the_first_does(number, tmp_path):
    script = (
        "import sys\n"
        "from hebbviz.server.cli.main import main\n"
        "from hebbviz.sims.experiments import workers\n"
        "workers.SHARE_SECONDS = 0.1\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    argv = ["figure", "learning", "--task", LEVER, "--out", str(tmp_path), "--steps", "10000000"]
    with subprocess.Popen(
        [sys.executable, "-c", script, *argv], cwd=ROOT, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            deadline = time.monotonic() + PATIENCE
            while not list(tmp_path.glob("*-unfinished-*/*/lanes-*.npz")):
                assert process.poll() is None and time.monotonic() < deadline
                time.sleep(0.02)
            os.killpg(process.pid, number)
            _, errors = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 128 + number
    assert errors.splitlines()[-1].startswith("hebbviz: stopped; the same command continues")


def test_what_the_learner_refuses_ends_the_run():
    with open_workers() as cores, pytest.raises(ValueError, match="beta must be in"):
        run(replace(SONAR, beta=2.0), cores)
    with pytest.raises(ValueError, match="lanes must be 1 or more, got 0"):
        replace(SONAR, lanes=0)


def unfit(header, arrays):
    """A share's header and arrays, changed so that they are not what the plan's run leaves."""
    first = {"first_lane": 1, "lanes": 4, "pending": 1, "figures": ["error"], "plan": "another"}
    for name, value in first.items():
        yield name, header | {name: value}, arrays
    for name in header:
        yield f"no {name}", {n: v for n, v in header.items() if n != name}, arrays
    for name, array in arrays.items():
        yield f"no {name}", header, {n: a for n, a in arrays.items() if n != name}
        for what, other in (
            ("longer", np.concatenate([array, array]) if array.ndim else np.array([array, array])),
            ("of texts", array.astype(str)), ("of float32", array.astype(np.float32)),
            ("another", -array - 1 if array.dtype != bool else ~array),
        ):  # fmt: skip
            if array.size or what == "of texts":
                yield f"{name} {what}", header, arrays | {name: other}


def resealed(header, arrays):
    """With a checksum that is right, as whoever changes it on purpose would leave it."""
    plain = {name: value for name, value in header.items() if name != "sum"}
    return plain | {"sum": store_module._checksum(plain, arrays)}


@pytest.mark.parametrize("on_purpose", [False, True])
def test_a_share_that_does_not_fit_is_run_again(on_purpose, tmp_path, capsys):
    store = Store(tmp_path, SONAR)
    store.write(brought_on(SONAR, Tile(0, 5), 0.0))
    (file,) = store.folder.iterdir()
    with np.load(file) as found:
        arrays = {name: found[name] for name in found.files}
    header = json.loads(str(arrays.pop("header")))
    tried = 0
    for what, changed, others in unfit(header, arrays):
        said = changed
        if on_purpose:
            if what.endswith(("another", "no sum")) or set(others) != set(arrays):
                continue  # other numbers, as the plan's run might have left them
            said = resealed(changed, others)
        np.savez(file, header=np.array(json.dumps(said)), **others)
        assert store.read() == [], what
        (line,) = capsys.readouterr().err.splitlines()
        assert "is put aside" in line, what
        tried += 1
    assert tried > 20
