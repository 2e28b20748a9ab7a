"""What was recorded is what happened: round trips through real files, to the bit."""

from __future__ import annotations

import csv
import json
import math
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from hebbviz.conformance import same_learner
from hebbviz.learner.frames import Block, join
from hebbviz.learner.learner import Learner
from hebbviz.server.recording.export import export_steps, export_timelines
from hebbviz.server.recording.header import FORMAT, Header, change_from_json, change_to_json
from hebbviz.server.recording.inspect import describe, figures
from hebbviz.server.recording.reader import Recording, open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.tables import read_rows
from hebbviz.server.recording.targets import FileTarget
from hebbviz.server.run.changes import (
    Change,
    Freeze,
    GiveReward,
    Logged,
    Press,
    SetBeta,
    SetFall,
    SetGamma,
    SetRule,
)
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task

LEVER = f"{Path(__file__).parents[1] / 'examples' / 'lever.py'}:Lever"
TASKS = ("pendulum", "sonar", "synapse", LEVER)
GOLDEN = Path(__file__).parents[1] / "golden"


@dataclass
class Recorded:
    """A run that was recorded, and what its learner really did."""

    path: Path
    run: Run
    blocks: list[Block] = field(default_factory=list)
    weights: dict[int, np.ndarray] = field(default_factory=dict)
    moments: list[Moment] = field(default_factory=list)

    @property
    def all(self) -> Block:
        return join(self.blocks)

    def read(self) -> Recording:
        return open_recording(self.path)


CHANGES: dict[int, Change] = {
    300: SetBeta(0.9), 450: GiveReward(2.5), 451: Freeze(frozen=True), 700: Freeze(frozen=False),
    701: SetGamma(3e-3),
}  # fmt: skip


def record(
    path: Path,
    task: str = "pendulum",
    *,
    steps: int = 1500,
    changes: dict[int, Change] = CHANGES,
    learner: Learner | None = None,
    **options: object,
) -> Recorded:
    """Record a run with changes, a frame every 40 steps and a keyframe every 200."""
    run = Run(learner or Learner(make_task(task), seed=3), make_task, task)
    recorder = Recorder(FileTarget(path), run, on_notice=pytest.fail, **options)  # type: ignore[arg-type]
    run.followers.append(recorder)
    made = Recorded(path, run)
    while run.learner.step < steps:
        step = run.learner.step
        if step in changes:
            run.change(changes[step])
        edges = [s - step for s in (*changes, 40 * (step // 40 + 1), steps) if s > step]
        made.blocks.append(run.advance(min(edges)))
        made.weights[run.learner.step] = run.learner.weights[:, 0]
        if run.learner.step % 40 == 0:
            run.frame()
        if run.learner.step % 200 == 0:
            run.keep()
            made.moments.append(run.moment())
    recorder.close(run)
    run.followers.clear()
    return made


@pytest.fixture(scope="module", params=TASKS, ids=lambda t: t.rpartition(":")[2])
def recorded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return record(tmp_path_factory.mktemp("recorded") / "run.rrd", request.param)


def again(made: Recorded) -> Run:
    recording, name = made.read(), made.run.task_name
    return recording.run(make_task, make_task(name, recording.header.preset), name)


def test_a_recording_says_what_run_it_is(recorded: Recorded) -> None:
    recording, learner = recorded.read(), recorded.run.learner
    header = recording.header
    assert (header.task, header.seed, header.step) == (recorded.run.task_name, 3, 0)
    assert header.topology == learner.topology
    assert (header.beta, header.gamma) == (learner.task.preset.beta, learner.task.preset.gamma)
    assert recording.log == tuple(recorded.run.log)
    assert (recording.last_step, recording.is_cut) == (1500, False)
    assert recording.ending == "it was stopped"
    assert recording.notice is None
    assert Header.from_json(header.to_json()) == header


def test_the_run_is_back_to_the_bit(recorded: Recorded) -> None:
    run = again(recorded)
    assert same_learner(run.learner, recorded.run.learner)
    assert run.log == recorded.run.log
    assert run.history.edges() == recorded.run.history.edges()
    assert run.history.window == recorded.run.history.window


def test_one_of_many_lanes_is_recorded_with_its_rule_and_switches(tmp_path: Path) -> None:
    """As the run of its own that it is."""
    learner = Learner(make_task("sonar", "best:centred=no"), hidden=(4,), seed=3, lanes=3)
    learner.look_at(2)
    made = record(tmp_path / "run.rrd", "sonar", learner=learner, changes={500: SetFall(1e3)})
    run = again(made)
    assert str(run.learner.rule) == "baseline:time=200"
    assert run.learner.fall == 1e3
    assert run.learner.task.preset_name == "best:centred=no"
    assert np.array_equal(run.learner.weights[:, 0], learner.weights[:, 2])
    assert np.array_equal(run.learner.memory[:, 0], learner.memory[:, 2])


def test_every_keyframe_is_there_and_leads_to_the_next(recorded: Recorded) -> None:
    recording, run = recorded.read(), again(recorded)
    steps = [m.step for m in recording.moments]
    assert set(steps) >= {0, *(m.step for m in recorded.moments)}
    true = {m.step: m.keyframe.digest() for m in recorded.moments}
    for moment in recording.moments:
        assert true.get(moment.step, moment.keyframe.digest()) == moment.keyframe.digest()
    for start, end in zip(recording.moments, recording.moments[1:], strict=False):
        replay = run.replay(start, end)
        replay.go_to(end.step)
        assert replay.moment().keyframe.digest() == end.keyframe.digest()


def test_taking_over_with_nothing_changed_makes_the_same_rest(recorded: Recorded) -> None:
    run = again(recorded)
    moment = run.tape.before(800)
    assert moment is not None
    replay = run.replay(moment)
    replay.go_to(831)
    run.take_over(replay)
    assert run.learner.step == 831
    assert (
        run.history.edges() == tuple(t for t in recorded.run.history.edges() if t.steps <= 831)
        or run.history.edges() == recorded.run.history.until(831).edges()
    )
    while run.learner.step < 1500:
        run.advance(1500 - run.learner.step)
    assert same_learner(run.learner, recorded.run.learner)
    assert run.history.edges() == recorded.run.history.edges()


def test_taking_over_can_be_undone(recorded: Recorded) -> None:
    run = again(recorded)
    moment = run.tape.before(400)
    assert moment is not None
    run.take_over(run.replay(moment))
    run.change(SetBeta(0.5))
    run.advance(50)
    run.undo()
    run.undo()
    assert same_learner(run.learner, recorded.run.learner)
    assert run.log == recorded.run.log


# What is exported


def test_exported_timelines_are_what_the_learner_had(recorded: Recorded, tmp_path: Path) -> None:
    written = export_timelines(recorded.read(), tmp_path)
    assert written[0] == tmp_path / "timelines.npz"
    block, t = recorded.all, recorded.run.learner.topology
    with np.load(written[0], allow_pickle=False) as found:
        assert np.array_equal(found["steps_step"], np.arange(1, 1501))
        assert np.array_equal(found["steps_fired"], block.fired)
        assert np.array_equal(found["steps_reward"], block.reward)
        assert np.array_equal(found["steps_broadcast"], block.broadcast)
        assert np.array_equal(found["steps_potential"], block.potential.astype(np.float32))
        kept = found["weights_step"]
        assert len(kept) > 1
        for step, weights in zip(kept, found["weights_weights"], strict=True):
            if step in recorded.weights:
                assert np.array_equal(weights, recorded.weights[step].astype(np.float32))
        assert found["weights_traces"].shape == (len(kept), t.synapses)
        sums = found["sums_step"]
        assert found["sums_steps"].sum() == sums[-1]
        assert np.array_equal(found["sums_spikes"].sum(axis=0), block.fired[: sums[-1]].sum(axis=0))
        ended = 1 + np.flatnonzero(block.ended)
        assert np.array_equal(found.get("episodes_step", np.zeros(0, int)), ended)
        task = make_task(recorded.run.task_name)
        beginning = Learner(task, seed=3).world.T
        readings = task.read(np.concatenate([beginning, block.world])).astype(np.float32)
        for k, reading in enumerate(task.readings):
            name = f"world_{reading.name.replace(' ', '_')}"
            at = found[f"{name}_step"]
            assert np.array_equal(found[f"{name}_value"], readings[at, k])
            jumps = np.flatnonzero(np.diff(readings[:, k], prepend=np.nan))
            assert set(jumps) <= set(at), "no change of a reading is left out"


def test_exported_tables_hold_the_same(recorded: Recorded, tmp_path: Path) -> None:
    export_timelines(recorded.read(), tmp_path)
    with (tmp_path / "steps.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["reward"]) for line in lines] == recorded.all.reward.tolist()
    fired = [[int(v) for k, v in line.items() if k.startswith("fired")] for line in lines]
    assert np.array_equal(fired, recorded.all.fired)
    dt = recorded.run.learner.task.dt
    if dt:
        assert float(lines[99]["sim_time"]) == pytest.approx(100 * dt)
    else:
        assert "sim_time" not in lines[0]


def test_steps_made_again_are_those_that_were(recorded: Recorded, tmp_path: Path) -> None:
    task = make_task(recorded.run.task_name)
    npz, table, _ = export_steps(recorded.read(), tmp_path, 421, 733, task)
    want = recorded.all.part(420, 732)
    with np.load(npz, allow_pickle=False) as found:
        assert np.array_equal(found["step"], np.arange(421, 733))
        for name in ("fired", "reward", "broadcast", "ended", "potential", "world"):
            assert np.array_equal(found[name], getattr(want, name)), name
        for step in set(found["step"].tolist()) & set(recorded.weights):
            assert np.array_equal(found["weight"][step - 421], recorded.weights[step])
    assert len(table.read_text().splitlines()) == 1 + len(want.fired)


@pytest.mark.parametrize("learner", [None, "frozen, γ falls"])
def test_timelines_hold_beta_and_gamma_as_they_were_in_force(
    learner: str | None, tmp_path: Path
) -> None:
    begun = Learner(make_task("pendulum"), seed=3, fall=300.0 if learner else math.inf)
    begun.skip(100 if learner else 0)  # the recording begins later than the run
    begun.freeze(learner is not None)
    changes = CHANGES | {240: Freeze(frozen=False), 800: SetFall(700.0), 900: SetBeta(0.5)}
    made = record(tmp_path / "run.rrd", learner=begun, changes=changes).read()
    first = made.header.step + 1
    export_timelines(made, tmp_path)
    export_steps(made, tmp_path, first, 1501, make_task("pendulum"))
    with np.load(tmp_path / "every-step.npz") as want, np.load(tmp_path / "timelines.npz") as found:
        for name in ("beta", "gamma"):
            for group in ("steps", "weights"):
                steps = found[f"{group}_step"]
                made_in_it = steps >= first
                assert made_in_it.any()
                same = want[name][steps[made_in_it] - first, 0]
                assert np.array_equal(found[f"{group}_{name}"][made_in_it], same), (group, name)


def check_rule(d: dict[str, np.ndarray], *, rtol: float = 1e-11, atol: float = 1e-12) -> None:
    """Weights and traces of every step, computed from the step before by the paper's equations."""
    silent, firing = d["activity"]
    inputs, p = d["input"].shape[1], d["projection"]
    u = np.hstack([d["input"][1:], np.where(d["fired"][:-1], firing, silent)])
    score = d["fired"] - 1 / (1 + np.exp(-d["potential"]))
    for n in range(1, len(d["step"])):
        z = d["beta"][n, p] * d["trace"][n - 1] + score[n, d["post"] - inputs] * u[n - 1, d["pre"]]
        w = d["weight"][n - 1] + d["gamma"][n, p] * d["broadcast"][n] * z
        np.testing.assert_allclose(d["trace"][n], z, rtol=rtol, atol=atol)
        np.testing.assert_allclose(d["weight"][n], w, rtol=rtol, atol=atol)


def test_the_rule_can_be_checked_from_an_export_alone(recorded: Recorded, tmp_path: Path) -> None:
    task = make_task(recorded.run.task_name)
    export_steps(recorded.read(), tmp_path, 250, 750, task)  # all changes are in it
    with np.load(tmp_path / "every-step.npz", allow_pickle=False) as found:
        check_rule(dict(found))
    words = (tmp_path / "every-step.txt").read_text()
    assert all(f"{name} " in words or f"{name}, " in words for name in found.files[1:11])


def test_a_rule_and_a_gamma_that_falls_can_be_checked_from_the_tables(tmp_path: Path) -> None:
    changes = {20: SetFall(300.0), 30: SetRule("baseline:time=50"), 700: Freeze(frozen=True)}
    made = record(tmp_path / "run.rrd", steps=800, changes=changes)
    npz, table, _ = export_steps(made.read(), tmp_path, 240, 801, make_task("pendulum"))
    lines = list(csv.reader(table.read_text().splitlines()))
    columns = {name: k for k, name in enumerate(lines[0])}
    numbers = np.array(lines[1:], dtype=np.float64)
    with np.load(npz, allow_pickle=False) as found:
        arrays = dict(found)
    for name, values in arrays.items():
        which = [k for c, k in columns.items() if c == name or c.startswith(f"{name} ")]
        if which:
            arrays[name] = numbers[:, which] if values.ndim > 1 else numbers[:, which[0]]
            assert np.array_equal(arrays[name], values), name
    named = {"input rate y", "gamma input → hidden", "fired output 1", "weight rate y → hidden 1"}
    assert named <= columns.keys()
    check_rule({**arrays, "fired": arrays["fired"].astype(int)})
    gamma = arrays["gamma"][:, 0]
    assert len(set(gamma.tolist())) == 4, "it falls each 256 steps, and is 0 while frozen"
    assert gamma[-1] == 0.0


def test_an_episode_ends_in_the_state_that_ended_it(tmp_path: Path) -> None:
    made = record(tmp_path / "run.rrd", steps=300, changes={})
    task = make_task("pendulum")
    export_steps(made.read(), tmp_path, 1, 301, task)
    export_timelines(made.read(), tmp_path)
    with np.load(tmp_path / "every-step.npz") as found, np.load(tmp_path / "timelines.npz") as kept:
        ends, world = np.flatnonzero(found["ended"]), found["world"]
        assert len(ends) > 2
        assert all(task.ended(world[k]) and task.reward(world[k]) == -1.0 for k in ends)
        names = [r.name for r in task.readings]
        tilt = kept["world_tilt_value"][np.searchsorted(kept["world_tilt_step"], ends + 1)]
        assert np.array_equal(tilt, task.read(world[ends])[:, names.index("tilt")].astype("f4"))
        following = ends[ends < 299] + 1
        seen = np.array([task.observation(state) for state in world])
        assert not np.array_equal(found["input"][following], seen[following - 1])
        others = np.setdiff1d(np.arange(1, 300), following)
        assert np.array_equal(found["input"][others], seen[others - 1])


@pytest.mark.parametrize("steps", [(0, 5), (1400, 1502), (10, 10)])
def test_steps_that_are_not_there_are_refused(
    recorded: Recorded, tmp_path: Path, steps: tuple[int, int]
) -> None:
    with pytest.raises(ValueError, match="holds steps 1:1501"):
        export_steps(recorded.read(), tmp_path, *steps, make_task(recorded.run.task_name))


def test_figures_are_strict_json_and_can_be_read(recorded: Recorded) -> None:
    found = figures(recorded.read())
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["task"], found["seed"], found["steps"]) == (recorded.run.task_name, 3, 1500)
    assert (found["whole"], found["keyframes"]) == (True, len(recorded.read().moments))
    assert len(found["changes"]) == len(CHANGES)
    late = recorded.all.part(found["last_step"] - found["late_steps"], 1500)
    if found["last_step"] % recorded.run.history.window == 0:
        assert found["late_average_reward"] == pytest.approx(late.reward.mean(), abs=1e-12)
    said = describe(found)
    assert all(word in said for word in ("seed 3", "5 changes", "keyframes", "1,500"))


def test_what_is_seen_of_it_is_there_from_its_first_step_on(tmp_path: Path) -> None:
    """Colours of synapses and levels of inputs, weights; β and γ as curves, not as two points."""
    made = record(tmp_path / "run.rrd", steps=400, changes={100: SetGamma(1e-3)})
    rows = read_rows(made.path, ("/scene/network/**", "/weights/**", "/parameters/**"))
    for name in ("/scene/network/synapses", "/scene/network/inputs", "/weights/input-hidden"):
        assert rows[name].step[0] == 0, name
    for name in ("beta", "gamma", "log10_gamma"):
        assert set(rows[f"/parameters/{name}"].step) >= {0, *range(40, 401, 40)}, name
    gamma, logarithm = (rows[f"/parameters/{n}"].scalars for n in ("gamma", "log10_gamma"))
    assert np.array_equal(np.log10(gamma), logarithm)
    low, high = rows["/weights/input-hidden"].columns["Tensor:value_range"][0]
    largest = np.abs(rows["/weights/input-hidden"].columns["Tensor:data"][0]).max()
    assert -high == low == pytest.approx(1.8 * largest), "blue above zero, and not yet cyan"


# Thinning, details, leaps


def test_of_a_fast_run_windows_of_every_step_are_kept(tmp_path: Path) -> None:
    made = record(tmp_path / "fast.rrd", steps=40_000, changes={}, budget=400_000)
    export_timelines(made.read(), tmp_path / "out")
    with np.load(tmp_path / "out" / "timelines.npz") as found:
        step, fired = found["steps_step"], found["steps_fired"]
        kept = made.all.fired[step - 1]
        assert np.array_equal(fired, kept)
        assert 500 <= len(step) < 40_000, "some of it was thinned"
        _, counts = np.unique((step - 1) // 500, return_counts=True)
        assert (counts == 500).all(), "a window is kept whole or not at all"
        assert found["sums_steps"].sum() == 40_000
        assert np.array_equal(found["sums_spikes"].sum(axis=0), made.all.fired.sum(axis=0))
    assert same_learner(again(made).learner, made.run.learner)


def test_light_recordings_keep_sums_keyframes_and_changes(tmp_path: Path) -> None:
    made = record(tmp_path / "light.rrd", detail="light", steps=10_000)
    full = record(tmp_path / "full.rrd", steps=10_000)
    assert made.path.stat().st_size < full.path.stat().st_size / 3
    assert same_learner(again(made).learner, made.run.learner)
    assert made.read().log == tuple(made.run.log)
    names = {p.name for p in export_timelines(made.read(), tmp_path / "out")}
    assert {"sums.csv", "curve.csv", "events.csv"} <= names
    assert "steps.csv" not in names
    with np.load(tmp_path / "out" / "timelines.npz") as found:
        assert np.array_equal(found["sums_spikes"].sum(axis=0), made.all.fired.sum(axis=0))


def test_of_a_slow_run_each_weight_of_each_step_is_kept(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum"), seed=3), make_task)
    recorder = Recorder(FileTarget(tmp_path / "slow.rrd"), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    for _ in range(50):
        run.advance(1)
        time.sleep(0.02)
    recorder.close(run)
    export_timelines(open_recording(tmp_path / "slow.rrd"), tmp_path)
    with np.load(tmp_path / "timelines.npz") as found:
        assert set(range(6, 51)) <= set(found["weights_step"].tolist())
        steps = np.arange(6, 51)
        at = {g: np.searchsorted(found[f"{g}_step"], steps) for g in ("steps", "weights")}
        one = {n.partition("_")[2]: found[n] for n in found.files if n.startswith("synapses_")}
        one |= {n: found[f"steps_{n}"][at["steps"]] for n in ("fired", "potential", "broadcast")}
        names = {"weight": "weights", "trace": "traces", "input": "input"}
        one |= {n: found[f"weights_{kept}"][at["weights"]] for n, kept in names.items()}
        projections = len(run.learner.topology.projections)
        for n in ("beta", "gamma"):
            one[n] = np.tile(found[f"weights_{n}"][at["weights"], None], projections)
    check_rule({**one, "step": steps}, rtol=1e-5, atol=1e-6)  # they are kept in float32


def test_a_recording_may_begin_anywhere(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum"), seed=1), make_task)
    run.advance(300)
    run.change(SetBeta(0.7))
    run.advance(333)
    while run.learner.step < 777:
        run.advance(777 - run.learner.step)
    recorder = Recorder(FileTarget(tmp_path / "late"), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    while run.learner.step < 1200:
        run.advance(1200 - run.learner.step)
    recorder.close(run)
    recording = open_recording(tmp_path / "late.rrd")
    back = recording.run(make_task, make_task("pendulum"))
    assert (recording.header.step, recording.last_step) == (777, 1200)
    assert same_learner(back.learner, run.learner)
    assert back.log == run.log == [Logged(300, SetBeta(0.7))]
    assert back.history.edges() == run.history.edges()
    assert back.tape.first == 777


def test_a_leap_in_time_begins_another_file(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum"), seed=1), make_task)
    recorder = Recorder(FileTarget(tmp_path / "run.rrd"), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    run.advance(400)
    run.change(SetBeta(0.5))
    run.advance(50)
    run.undo()
    run.advance(20)
    run.reset()
    run.advance(10)
    recorder.close(run)
    first, second, third = (
        open_recording(tmp_path / name) for name in ("run.rrd", "run-2.rrd", "run-3.rrd")
    )
    assert (first.last_step, first.ending) == (450, "β 0.5 was undone")
    assert (second.header.step, second.last_step, second.log) == (400, 420, ())
    assert (third.header.step, third.last_step) == (0, 10)
    assert "reset" in str(second.ending)


@pytest.mark.parametrize(
    "change",
    [
        SetBeta(0.25),
        SetGamma(1e-3),
        Freeze(frozen=True),
        GiveReward(-2.0),
        Press("Stop playing"),
        SetRule("baseline:time=20"),
        SetFall(1e5),
        SetFall(math.inf),
    ],
)
def test_changes_are_written_down_and_read(change: Change) -> None:
    logged = Logged(12, change)
    assert change_from_json(json.loads(json.dumps(change_to_json(logged)))) == logged


@pytest.mark.parametrize(
    "said",
    [
        {"step": 1, "kind": "SetBeta", "beta": 1.5}, {"step": 1, "kind": "Reset"},
        {"step": -1, "kind": "Freeze", "frozen": True}, {"kind": "Freeze", "frozen": True}, [1, 2],
        {"step": 1, "kind": "SetGamma", "gamma": "0.1"}, {"step": 1, "kind": "SetBeta", "x": 1},
        {"step": 1.5, "kind": "SetBeta", "beta": 0.5}, {"step": 1, "kind": "Freeze", "frozen": 1},
        {"step": 1, "kind": "Press", "control": 5}, {"step": 1, "kind": "SetFall", "fall": 0},
        {"step": 1, "kind": "SetRule", "rule": "nothing"}, {"step": 1, "kind": "SetRule"},
    ],
)  # fmt: skip
def test_what_is_no_change_is_refused(said: object) -> None:
    with pytest.raises(ValueError, match=r"change|beta|gamma|frozen|control|step|rule"):
        change_from_json(said)


# Earlier formats


GOLDEN_CHANGES: dict[str, dict[int, Change]] = {
    "format-1.rrd": {100: SetBeta(0.9), 150: Freeze(frozen=True)},
    "format-2.rrd": {
        100: SetRule("baseline:time=50"), 120: SetFall(1e3), 150: Freeze(frozen=True),
    },
}  # fmt: skip
"""What was changed in each; when the format changes, they stay, and there is one more."""


@pytest.mark.parametrize("name", GOLDEN_CHANGES)
def test_a_recording_of_each_format_still_opens(name: str) -> None:
    """Golden files; whether their runs can be made again depends on the machine."""
    recording = open_recording(GOLDEN / name)
    assert recording.ending is not None
    assert recording.header.task == "synapse"
    run = recording.run(make_task, make_task("synapse", recording.header.preset))
    assert run.learner.step == recording.last_step == 250
    assert {c.step: c.change for c in run.log} == GOLDEN_CHANGES[name]


@pytest.mark.parametrize("name", GOLDEN_CHANGES)
def test_a_recording_of_each_format_is_replayed_and_exported(name: str, tmp_path: Path) -> None:
    """Its rewards come from a script and its neurons are clamped, so any machine replays it; the
    random numbers, which nobody heeds, are of an earlier generator.
    """
    recording = open_recording(GOLDEN / name)
    run = recording.run(make_task, make_task("synapse", recording.header.preset))
    replay = run.replay(recording.moments[0])
    replay.go_to(250)
    again, end = replay.learner, run.learner  # the latter is at the last keyframe
    assert (str(again.rule), again.fall, again.frozen) == (str(end.rule), end.fall, end.frozen)
    for name_of in ("weights", "traces", "potentials", "activities", "world", "totals", "memory"):
        assert np.allclose(getattr(again, name_of), getattr(end, name_of), rtol=1e-12), name_of
    export_timelines(recording, tmp_path)
    with (tmp_path / "events.csv").open(encoding="utf-8") as file:
        assert {int(row["step"]) for row in csv.DictReader(file)} >= set(GOLDEN_CHANGES[name])
    with np.load(tmp_path / "timelines.npz", allow_pickle=False) as arrays:
        assert np.array_equal(arrays["curve_step"], np.arange(1, 251))


def test_there_is_a_golden_file_of_each_format() -> None:
    wanted = {f"format-{number}.rrd" for number in range(1, FORMAT + 1)}
    assert {file.name for file in GOLDEN.glob("*.rrd")} == wanted == set(GOLDEN_CHANGES)


def make_golden() -> None:
    """The file of the newest format."""
    name = f"format-{FORMAT}.rrd"
    record(GOLDEN / name, "synapse", steps=250, changes=GOLDEN_CHANGES[name], detail="light")
