"""The run, its log, its way back, what is watched of it, and the thread that steps it."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_client import wait_until

from hebbviz.learner.learner import Learner, TaskError
from hebbviz.rules import base as rules
from hebbviz.rules.baseline import Baseline
from hebbviz.rules.paper import PAPER
from hebbviz.server.live import evaluation, session
from hebbviz.server.live.commands import (
    Choose,
    Command,
    Evaluate,
    Pause,
    Reset,
    SetSpeed,
    SetWatch,
    SetWatchSpeed,
    ShowReward,
    StartFork,
    StartRecording,
    StepOnce,
    StopRecording,
    Undo,
)
from hebbviz.server.live.excerpts import EXCERPT_SECONDS, LEAD, TAIL, Watch
from hebbviz.server.live.fork import NO_MEMORY
from hebbviz.server.live.session import RECORDINGS_A_MINUTE, Session
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.page.panels.learning_curve import evaluated
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.run.changes import (
    Change,
    Freeze,
    GiveReward,
    Logged,
    Press,
    SetBeta,
    SetGamma,
    SetRule,
    settled,
)
from hebbviz.server.run.history import CAPACITY, History, Totals
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Follower, Run
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.task.base import Input, Output, Tally, Task
from hebbviz.task.presets import Preset

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from hebbviz.learner.frames import Block
    from hebbviz.sims.loading import MakeTask


class Breaks(Task):
    """Raises at step 300, unless γ was set to 0 before: then its weights stand still."""

    name = "breaks"
    inputs = (Input("one"),)
    outputs = (Output("a", "fires", "is silent"),)
    presets = {"only": Preset(0.5, 0.1, "a test")}

    def restart(self, draws: Any) -> Any:
        return np.zeros(1)

    def transition(self, state: Any, action: Any, draws: Any) -> Any:
        if state[0] >= 300:
            raise KeyError("no more")
        return state + 1.0

    def observation(self, state: Any) -> Any:
        return np.ones(1)

    def reward(self, state: Any) -> float:
        return float(state[0] % 2)


def make(name: str, preset: str | None = None) -> Task:
    if name == "pendulum":
        preset = preset or "quick"  # the paper's plain rule
    return Breaks(preset) if name == "breaks" else make_task(name, preset)


def new_run(task: str = "pendulum", **options: Any) -> Run:
    return Run(Learner(make(task), **options), make)


class Steps(Follower):
    """When steps were made."""

    def __init__(self) -> None:
        self.at: list[float] = []

    def block(self, run: Run, block: Block) -> None:
        self.at.append(time.monotonic())

    def between(self, times: list[float]) -> list[int]:
        """How many stretches were made between each two times."""
        return [sum(a < t < b for t in self.at) for a, b in pairwise(times)]


def go_to(run: Run, step: int) -> None:
    while run.learner.step < step:
        run.advance(step - run.learner.step)


def assert_same(a: Learner, b: Learner) -> None:
    """Everything that is to come, and was, is the same, bit for bit."""
    assert (a.step, a.seed, a.frozen, a.gamma) == (b.step, b.seed, b.frozen, b.gamma)
    np.testing.assert_array_equal(a.network, b.network)
    np.testing.assert_array_equal(a.world, b.world)


def fresh(run: Run, step: int) -> Learner:
    """The learner at a step, made from nothing but the task, the seed and the log."""
    task = run.make_task(run.task_name, run.learner.task.preset_name)
    learner = Learner(task, topology=run.learner.topology, seed=run.learner.seed)
    for entry in run.log:
        if entry.step < step:
            learner.skip(entry.step - learner.step)
            entry.change.apply(learner)
    learner.skip(step - learner.step)
    return learner


CHANGES = [SetBeta(0.9), SetGamma(1e-3), GiveReward(2.0), Freeze(frozen=True), SetBeta(0.5),
           Freeze(frozen=False), GiveReward(-1.0)]  # fmt: skip


def eventful_run(task: str) -> tuple[Run, list[Moment]]:
    """A run with a change every so often, and moments of it, some between two changes."""
    run, moments = new_run(task, seed=11), []
    for k, change in enumerate(CHANGES):
        go_to(run, 137 * (k + 1))
        moments.append(run.moment())
        run.change(change)
        moments.append(run.moment())
    go_to(run, 1300)
    return run, moments


@pytest.mark.parametrize("task", ["pendulum", "sonar", "synapse"])
def test_seed_and_log_make_the_run_again(task: str) -> None:
    run, _ = eventful_run(task)
    assert_same(fresh(run, 1300), run.learner)


@pytest.mark.parametrize("task", ["pendulum", "sonar", "synapse"])
def test_a_replay_from_any_moment_is_the_run(task: str) -> None:
    run, moments = eventful_run(task)
    for moment in moments:
        replay = run.replay(moment)
        for end in (moment.step + 1, (moment.step + 1300) // 2, 1300):
            while replay.learner.step < end:
                assert len(replay.advance(end - replay.learner.step).fired) > 0
            assert_same(replay.learner, fresh(run, end))
        assert len(replay.advance(10).fired) == 0  # not beyond the run
        assert_same(replay.learner, run.learner)


def test_buttons_are_in_the_log() -> None:
    run = new_run("synapse")
    for step, name in enumerate(["Presynaptic spike", "Postsynaptic spike", "Play (a)-(l)"]):
        go_to(run, 3 * step)
        run.change(Press(name))
    go_to(run, 20)
    assert_same(fresh(run, 20), run.learner)


@pytest.mark.parametrize("change", CHANGES)
def test_undo_returns_to_the_moment_before(change: Any) -> None:
    run = new_run()
    go_to(run, 400)
    run.change(SetBeta(0.7))
    go_to(run, 500)
    before, log = run.learner.keyframe(), list(run.log)
    curve = run.history.curves().lane(0)
    run.change(change)
    go_to(run, 2000)
    assert run.undo() == str(change)
    assert run.log == log == [Logged(400, SetBeta(0.7))]
    assert_same(run.learner, fresh(run, 500))
    np.testing.assert_array_equal(run.learner.network, before.network)
    np.testing.assert_array_equal(run.learner.world, before.world)
    np.testing.assert_array_equal(run.history.curves().lane(0).end, curve.end)
    run.undo()
    assert (run.learner.step, run.log, run.undo()) == (400, [], None)


def test_all_points_to_go_back_to_share_one_log() -> None:
    """A copy for each would take longer with each change: the run would stop in a flood of them."""
    run = new_run()
    for k in range(100):
        go_to(run, 3 * k)
        run.change(SetBeta(k / 100))
        run.change(SetGamma(k / 100))
    assert all(point.log is run.log for point in run._undo)
    for back in range(1, 7):
        run.undo()
        assert len(run.log) == 200 - back
        assert all(point.log is run.log for point in run._undo)
    assert_same(fresh(run, run.learner.step), run.learner)
    run.change(GiveReward(1.0))
    run.undo()
    assert run.log[-1] == Logged(3 * 96, SetGamma(0.96))


def test_a_taken_over_run_can_be_undone_with_the_whole_log() -> None:
    run = new_run()
    go_to(run, 300)
    run.change(SetBeta(0.7))
    go_to(run, 600)
    run.change(SetBeta(0.8))
    log = list(run.log)
    replay = run.replay(Moment(new_run().learner.keyframe(), 0))
    replay.go_to(400)
    run.take_over(replay)
    assert run.log == log[:1]
    run.change(SetBeta(0.1))
    run.undo()
    run.undo()
    assert run.log == log and run.learner.step == 600
    run.undo()
    assert run.log == log[:1] and run.learner.step == 600


def test_recordings_begin_at_most_so_many_times_a_minute(tmp_path: Path) -> None:
    run, said = new_run("synapse"), []
    recordings = Recordings(run, Options(folder=tmp_path), on_notice=said.append)
    session = Session(run, on_notice=said.append, recordings=recordings)
    for k in range(RECORDINGS_A_MINUTE):
        StartRecording(f"{k}.rrd").apply(session)
        StopRecording().apply(session)
    with pytest.raises(ValueError, match="in a minute: try again in"):
        StartRecording("one more.rrd").apply(session)
    assert len(list(tmp_path.iterdir())) == RECORDINGS_A_MINUTE
    assert said == []


def test_commands_leave_the_run_most_of_the_time() -> None:
    """However many come, and however long each takes."""
    steps, made = Steps(), []

    class Slow(Session):
        def change(self, change: Change) -> None:
            made.append(time.monotonic())
            time.sleep(0.02)

    run = new_run("synapse")
    run.followers.append(steps)
    worker = Worker(Slow(run, on_notice=print))
    assert worker._for_commands.is_left(time.monotonic())
    worker._for_commands.spend(1.0)  # what was saved up
    worker._session.tempo.set_speed("max")
    for _ in range(15):
        worker.send(GiveReward(1.0))
    worker.start()
    wait_until(lambda: len(made) == 15, 30)
    worker.stop()
    worker.join()
    assert sum(n > 0 for n in steps.between(made)) > 7


def test_commands_that_come_together_act_at_one_step() -> None:
    run = new_run("synapse")
    worker = Worker(Session(run, on_notice=print))
    worker._session.tempo.set_speed("max")
    worker.send(Reset(seed=5))
    worker.send(GiveReward(1.0))
    worker.send(SetBeta(0.5))
    worker.start()
    wait_until(lambda: len(run.log) == 2, 30)
    worker.stop()
    worker.join()
    assert [logged.step for logged in run.log] == [0, 0]


@pytest.mark.parametrize(
    "begin",
    [
        lambda run: run.reset(),
        lambda run: run.reset(seed=5),
        lambda run: run.choose("sonar"),
        lambda run: run.choose("pendulum", "raw", (3,)),
    ],
)
def test_undo_of_another_run(begin: Callable[[Run], None]) -> None:
    run = new_run(seed=2)
    run.change(SetGamma(0.05))
    go_to(run, 1234)
    at = fresh(run, 1234)
    begin(run)
    assert (run.learner.step, run.log) == (0, [])
    go_to(run, 99)
    run.change(SetBeta(0.1))
    run.undo()
    run.undo()
    assert_same(run.learner, at)
    assert run.log == [Logged(0, SetGamma(0.05))]
    go_to(run, 1500)
    assert_same(run.learner, fresh(run, 1500))


def test_reset_keeps_what_is_set_and_leaves_a_ghost() -> None:
    run = new_run(seed=2)
    run.change(SetBeta(0.6))
    run.change(Freeze(frozen=True))
    go_to(run, 5000)
    run.reset()
    learner = run.learner
    assert (learner.step, learner.seed, learner.beta, learner.frozen) == (0, 2, 0.6, True)
    assert run.ghost is not None
    assert run.ghost.lane(0).steps.sum() == 5000
    run.reset(seed=9)
    assert run.learner.seed == 9


def test_a_change_that_fails_leaves_nothing_to_undo() -> None:
    run = new_run("synapse")
    with pytest.raises(ValueError, match="no control"):
        run.change(Press("Fly"))
    assert run.log == []
    assert run.undo_words is None


# History


@settings(deadline=None, max_examples=50)
@given(
    st.integers(1, 7),
    st.lists(st.integers(1, 900), min_size=1, max_size=40),
    st.integers(0, 2**32 - 1),
)
def test_windows_sum_to_the_totals(window: int, cuts: list[int], seed: int) -> None:
    """However the run is cut, no step is lost and none counted twice."""
    rewards = np.random.default_rng(seed).integers(-3, 4, sum(cuts)).astype(float)
    history, step = History(window, Totals(0, np.zeros((3, 1)))), 0

    def total(n: int) -> Tally:
        return Tally(n, rewards[:n].sum(), 2 * rewards[:n].sum(), float((rewards[:n] > 2).sum()))

    for cut in cuts:
        end = step + cut
        while step < end:
            step += min(end - step, history.until_edge(step))
            history.add(Totals.of_one(total(step)))
    curve = history.curves(Totals.of_one(total(step))).lane(0)
    assert len(curve.end) <= CAPACITY + 1
    assert curve.window % window == 0
    assert step - (curve.end[-1] if len(curve.end) else 0) <= curve.window / 2
    for tally, last in zip(curve.tallies(), curve.end, strict=True):
        assert tally == total(int(last)) - total(int(last) - tally.steps)
    assert all(s == curve.window for s in curve.steps[:-1])


# Watching


def drive(run: Run, watch: Watch, steps: int, stretch: int) -> None:
    """Step the run as the worker does, and tell the watch."""
    end = run.learner.step + steps
    while run.learner.step < end:
        moment = run.moment()
        watch.note(moment, run.advance(min(stretch, end - run.learner.step)))


@pytest.mark.parametrize(
    "stretch", [50, *(pytest.param(k, marks=pytest.mark.slow) for k in (3, 5000))]
)
def test_excerpts_are_long_and_true(stretch: int) -> None:
    """What is shown is what happened, also across a change, and it goes on for a while."""
    run, watch = new_run(seed=4), Watch()
    watch.on, watch.speed = True, 10.0
    drive(run, watch, 1000, stretch)
    run.change(SetBeta(0.5))
    seen: dict[int, int] = {}
    for _ in range(60):
        drive(run, watch, 15, stretch)
        played = watch.play(run, 0.5)
        assert played is not None
        replay, block = played
        excerpt = watch.excerpt()
        assert excerpt is not None
        assert excerpt.first <= excerpt.now <= excerpt.last
        assert excerpt.now == replay.learner.step <= run.learner.step
        seen[excerpt.first] = excerpt.now
        assert block is not None
        learner = fresh(run, block.start)
        for entry in run.log:
            if entry.step == block.start:
                entry.change.apply(learner)
        again = learner.advance(len(block.fired))
        np.testing.assert_array_equal(again.fired, block.fired)
        np.testing.assert_array_equal(again.broadcast, block.broadcast)
        assert_same(learner, replay.learner)
    played_through = list(seen.items())[:-1]
    assert played_through
    length = round(watch.speed * EXCERPT_SECONDS)
    assert all(last - first == length for first, last in played_through)


@pytest.mark.parametrize("stretch", [1, 7, 400])
def test_the_latest_reward_is_shown(stretch: int) -> None:
    run, watch = new_run(), Watch()
    assert not watch.show_reward(run)
    drive(run, watch, 700, stretch)
    run.change(GiveReward(1.0))
    drive(run, watch, 12, stretch)
    learner, rewarded = Learner(run.learner.task, seed=run.learner.seed), []
    for entry in run.log:
        rewarded.extend(np.flatnonzero(learner.advance(entry.step - learner.step).broadcast))
        entry.change.apply(learner)
    start = learner.step
    rewarded.extend(start + np.flatnonzero(learner.advance(712 - start).broadcast))
    latest = int(rewarded[-1])
    assert latest >= 700
    assert watch.show_reward(run)
    steps, shown = [], None
    for _ in range(200):
        played = watch.play(run, 0.1)
        if played is None:
            break
        replay, block = played
        shown = watch.excerpt()
        assert shown is not None
        if block is not None and len(block.fired):
            steps.extend(range(block.start, block.start + len(block.fired)))
            assert_same(replay.learner, fresh(run, replay.learner.step))
    assert shown is not None
    assert shown.is_reward
    assert shown.reward_step == latest
    assert steps == list(range(max(0, latest - LEAD), min(712, latest + TAIL)))


# The worker


class Bench:
    """A worker that runs, and its notices."""

    def __init__(self, run: Run) -> None:
        self.run, self.notices = run, list[str]()
        self.worker = Worker(Session(run, on_notice=self.notices.append))

    def send(self, *commands: Command) -> None:
        for command in commands:
            self.worker.send(command)

    def until(self, condition: Callable[[Snapshot], bool], seconds: float = 20.0) -> Snapshot:
        """The first new picture of which it is true; it must come."""
        end, number = time.monotonic() + seconds, 0
        if self.worker.latest is not None:
            number = self.worker.latest.number
        while time.monotonic() < end:
            snapshot = self.worker.wait_for(number, 0.1)
            if snapshot is not None:
                number = snapshot.number
                if condition(snapshot):
                    return snapshot
        raise AssertionError(f"not within {seconds} s; notices {self.notices}")

    def at_rest(self) -> Snapshot:
        self.send(Pause(paused=True))
        return self.until(lambda p: p.pacing.paused)


@contextlib.contextmanager
def bench(run: Run, *commands: Command) -> Iterator[Bench]:
    run.learner.twin().advance(2)  # compiled before the clock runs
    it = Bench(run)
    it.send(*commands)
    it.worker.start()
    try:
        it.until(lambda _: True)
        yield it
    finally:
        it.worker.stop()
        it.worker.join(20.0)
        assert not it.worker.is_alive()


FULL_SPEED = [SetSpeed("max"), SetSpeed(50.0), SetSpeed("realtime")]


@pytest.mark.parametrize("speed", FULL_SPEED)
def test_a_command_acts_soon_and_is_logged(speed: SetSpeed) -> None:
    with bench(new_run(), speed) as b:
        for command in (SetBeta(0.5), SetGamma(0.2), Freeze(frozen=True)):
            b.send(command)
            snapshot = b.until(lambda p, c=command: any(e.change == c for e in p.run.changes), 1.0)
        assert (snapshot.run.beta, snapshot.run.gamma, snapshot.run.frozen) == (0.5, 0.2, True)
        assert snapshot.run.undo_words == "learning frozen"
    assert b.notices == []
    assert_same(fresh(b.run, b.run.learner.step), b.run.learner)


def test_pause_stops_the_counter_and_step_steps_once() -> None:
    with bench(new_run()) as b:
        step = b.at_rest().run.live.step
        time.sleep(0.3)
        assert b.until(lambda _: True).run.live.step == step
        b.send(StepOnce())
        snapshot = b.until(lambda p: p.run.live.step != step)
        assert snapshot.run.live.step == step + 1
        assert snapshot.view.recent is not None
        assert snapshot.view.recent.start + len(snapshot.view.recent.fired) == step + 1
        b.send(StepOnce(), StepOnce(3))
        b.until(lambda p: p.run.live.step == step + 5)
        time.sleep(0.2)
        assert b.until(lambda _: True).run.live.step == step + 5
        b.send(Pause(paused=False))
        b.until(lambda p: p.run.live.step > step + 1000)


def test_undo_in_the_worker() -> None:
    with bench(new_run()) as b:
        step = b.at_rest().run.live.step
        b.send(SetBeta(0.5), Pause(paused=False))
        b.until(lambda p: p.run.live.step > step + 1000)
        b.send(Pause(paused=True), Undo())
        snapshot = b.until(lambda p: p.run.live.step == step)
        assert (snapshot.run.beta, snapshot.run.undo_words, list(snapshot.run.changes)) == (
            0.98,
            None,
            [],
        )
        assert_same(fresh(b.run, step), b.run.learner)
        b.send(Undo())
        b.until(lambda _: "there is nothing to undo" in b.notices)


def test_a_drag_is_one_undo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "SAME_GESTURE_SECONDS", 30.0)
    with bench(new_run()) as b:
        before = b.at_rest()
        for k in range(20):
            b.send(SetBeta(0.5 + k / 100))
            time.sleep(0.02)
        b.send(SetGamma(0.5))
        told = b.until(lambda p: p.run.gamma == 0.5).run.changes
        assert [str(c.change) for c in told] == ["β 0.69", "γ 0.5"], "where it settled"
        b.send(Undo())
        b.until(
            lambda p: (
                p.run.gamma == before.run.gamma
                and p.run.beta == 0.69
                and p.run.undo_words == "β 0.69"
            )
        )
        b.send(Undo())
        assert b.until(lambda p: p.run.beta == before.run.beta).run.undo_words is None


def test_of_a_drag_the_log_keeps_all_and_tells_where_it_settled() -> None:
    run = new_run()
    beta = run.learner.beta
    for k, value in enumerate((0.5, 0.6, 0.7)):
        run.change(SetBeta(value), goes_on=k > 0)
        run.advance(10)
    run.change(SetGamma(0.5))
    assert [str(c.change) for c in settled(run.log)] == ["β 0.7", "γ 0.5"]
    assert len(run.log) == 4, "all of it is needed to make the run again"
    assert (run.undo(), run.learner.beta) == ("γ 0.5", 0.7)
    assert (run.undo(), run.learner.beta) == ("β 0.7", beta)


def test_a_change_after_a_reset_is_its_own_undo() -> None:
    with bench(new_run(), Pause(paused=True)) as b:
        b.send(SetBeta(0.5), Reset(), SetBeta(0.6))
        b.until(lambda p: p.run.beta == 0.6)
        b.send(Undo())
        snapshot = b.until(lambda p: p.run.beta == 0.5)
        assert snapshot.run.undo_words == "reset"


def test_choose_and_reset_make_another_run() -> None:
    with bench(new_run()) as b:
        b.send(Choose("synapse", "script"))
        snapshot = b.until(lambda p: p.run.task_name == "synapse", 20.0)
        assert (snapshot.pacing.speed, snapshot.view.watching) == (1.5, False)
        b.send(Undo())
        snapshot = b.until(lambda p: p.run.task_name == "pendulum")
        assert (snapshot.pacing.speed, snapshot.view.watching) == ("max", True)
        b.until(lambda p: p.run.task_name == "pendulum" and p.run.live.step > 1000)
        b.send(Reset(seed=8))
        later = b.until(lambda p: p.run.seed == 8)
        assert later.run.ghost is not None
        assert later.run.number > snapshot.run.number


def made_late(gate: threading.Event, late: str) -> MakeTask:
    """Makes tasks, the one of this preset once the gate is open."""

    def make_in_time(name: str, preset: str | None = None) -> Task:
        assert preset != late or gate.wait(20.0)
        return make(name, preset)

    return make_in_time


def test_a_choice_that_takes_long_holds_up_nothing_but_the_run() -> None:
    gate = threading.Event()
    with bench(Run(Learner(make("pendulum")), made_late(gate, "script"))) as b:
        b.until(lambda p: p.run.live.step > 0)
        b.send(Choose("synapse", "script"), SetBeta(0.25), Pause(paused=True))
        snapshot = b.until(lambda p: p.pacing.preparing is not None and p.pacing.paused)
        assert "task synapse" in (snapshot.pacing.preparing or "")
        assert (snapshot.run.task_name, snapshot.run.beta) == ("pendulum", 0.98)
        later = b.until(lambda p: p.number > snapshot.number + 5)
        assert later.run.live.step == snapshot.run.live.step, "the run rests"
        gate.set()
        snapshot = b.until(lambda p: p.run.task_name == "synapse" and p.run.beta == 0.25)
        assert (snapshot.pacing.preparing, snapshot.pacing.paused) == (None, True)
        assert snapshot.run.undo_words == "β 0.25"


def test_so_does_a_switch() -> None:
    gate = threading.Event()
    with bench(Run(Learner(make("sonar")), made_late(gate, "quick:centred=yes"))) as b:
        b.send(Reset(switch=("centred", True)), SetBeta(0.25))
        snapshot = b.until(lambda p: p.pacing.preparing is not None)
        assert "for centred on" in (snapshot.pacing.preparing or "")
        assert (snapshot.run.task.settings["centred"], snapshot.run.beta) == (False, 0.5)
        gate.set()
        snapshot = b.until(lambda p: p.run.task.settings["centred"] and p.run.beta == 0.25)
        assert snapshot.pacing.preparing is None


def test_so_does_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()

    class Slow(Baseline):
        name = "slow"

        def compiled(self) -> tuple[Any, Any]:
            assert gate.wait(20.0)
            return super().compiled()

    monkeypatch.setitem(rules._own, "slow", Slow)
    with bench(new_run()) as b:
        b.send(SetRule("slow:time=500"), SetBeta(0.25))
        snapshot = b.until(lambda p: p.pacing.preparing is not None)
        assert "for rule slow:time=500" in (snapshot.pacing.preparing or "")
        assert snapshot.run.live.rule == PAPER
        gate.set()
        snapshot = b.until(lambda p: p.run.live.rule == Slow(500.0) and p.run.beta == 0.25, 20.0)
        assert (snapshot.pacing.preparing, snapshot.run.undo_words) == (None, "β 0.25")


def test_what_is_asked_wrongly_is_a_notice() -> None:
    with bench(new_run("sonar")) as b:
        b.send(SetSpeed("realtime"), Choose("chess"), Press("Fly"), ShowReward())
        b.until(lambda _: len(b.notices) >= 3)
        assert b.notices[0].startswith("task 'sonar' has no time step")
        assert b.notices[1].startswith("there is no task 'chess'")
        assert b.notices[2].startswith("task 'sonar' has no control 'Fly'")
        step = b.until(lambda _: True).run.live.step
        b.until(lambda p: p.run.live.step > step)


def test_speed_is_what_was_asked_for() -> None:
    with bench(new_run("synapse"), SetSpeed(50.0)) as b:
        first = b.until(lambda p: p.run.live.step > 0)
        last = b.until(lambda p: p.run.live.step > first.run.live.step + 200)
        made, seconds = last.run.live.step - first.run.live.step, last.made_at - first.made_at
        assert 40 < made / seconds < 60
        b.until(lambda p: 45 < p.pacing.steps_per_second < 55)
        b.send(SetSpeed(4.0))
        b.until(lambda p: 3 < p.pacing.steps_per_second < 5)
        assert b.at_rest().pacing.steps_per_second == 0.0


def test_a_task_that_raises_pauses_the_run_and_loses_nothing() -> None:
    with bench(new_run("breaks"), SetSpeed(2000.0), StepOnce(100)) as b:
        b.until(lambda p: p.run.live.step == 100)
        b.send(SetBeta(0.4), Pause(paused=False))
        snapshot = b.until(lambda p: p.pacing.error is not None)
        assert snapshot.pacing.paused
        assert "KeyError" in snapshot.pacing.error
        assert snapshot.run.live.step == 300
        assert len(b.notices) == 1
        b.send(Pause(paused=False))
        b.until(lambda p: len(b.notices) == 2 and p.pacing.error is not None and p.pacing.paused)
        assert b.run.learner.step == 300
        assert_same(b.run.learner, fresh(b.run, 300))
        b.send(Undo())
        snapshot = b.until(lambda p: p.run.live.step < 300)
        assert (snapshot.pacing.error, snapshot.run.beta) == (None, 0.5)
        b.send(StepOnce())
        step = snapshot.run.live.step
        assert b.until(lambda p: p.run.live.step > step).run.live.step == step + 1


def test_both_copies_of_a_fork_stop_at_the_same_step() -> None:
    with bench(new_run("breaks"), SetSpeed(2000.0), StepOnce(100)) as b:
        b.until(lambda p: p.run.live.step == 100)
        b.send(StartFork(NO_MEMORY), Pause(paused=False))
        snapshot = b.until(lambda p: p.pacing.error is not None)
        assert snapshot.view.other is not None
        assert snapshot.view.other.start == 100
        assert snapshot.view.other.frame.step == snapshot.run.live.step == 300


def test_an_evaluation_that_fails_is_a_notice() -> None:
    class Unjudged(Breaks):
        def evaluate(self, learner: Learner) -> Any:
            raise KeyError("no judge")

    with bench(Run(Learner(Unjudged()), lambda *_: Unjudged()), Pause(paused=True)) as b:
        b.send(Evaluate())
        b.until(lambda _: len(b.notices) == 1)
        assert "KeyError" in b.notices[0]
        b.send(Evaluate())
        b.until(lambda _: len(b.notices) == 2)


def test_a_long_evaluation_says_how_far_it_is_and_ends_with_its_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evaluation, "SHOWN_SECONDS", 0.0)

    class Patient(Pendulum):
        def evaluate(self, learner: Learner) -> Any:
            learner.frozen_copy().skip(10**9)

    with bench(Run(Learner(Patient()), lambda *_: Patient()), Pause(paused=True)) as b:
        b.send(Evaluate())
        snapshot = b.until(lambda p: p.findings.evaluating is not None)
        assert re.fullmatch(
            r"A frozen copy is being evaluated: step [\d,]+ of 1,000,000,000\.", evaluated(snapshot)
        )
        b.send(Reset())
        b.until(lambda p: p.findings.evaluating is None)
        assert not b.notices


def test_a_frozen_copy_says_how_often_it_fell_and_how_sure_that_is() -> None:
    """One that never falls in 2 000 s lasts over 2 000/2.996 s, not 2 000 s."""

    class Held(Pendulum):
        def transition(self, state: Any, action: Any, draws: Any) -> Any:
            return state

    for task, held in (Held(), True), (Pendulum(), False):
        run = Run(Learner(task, lanes=2), lambda *_, task=task: type(task)())
        with bench(run, Pause(paused=True)) as b:
            b.send(Evaluate())
            words = evaluated(b.until(lambda p: p.findings.evaluations, 60.0))
        if held:
            assert "time to fall **over 11.1 min (no fall, 95 %)**" in words
            assert "(median unknown, no fall in 2 of 2 lanes)" in words
        else:
            said = re.search(
                r"\*\*([\d.]+) s \(([\d,]+) falls; 95 %: ([\d.]+) s to ([\d.]+) s\)", words
            )
            assert said is not None, words
            value, falls, low, high = (float(x.replace(",", "")) for x in said.groups())
            assert value == pytest.approx(2000.0 / falls, rel=0.01)
            assert low < value < high < 1.1 * low


def test_undoing_a_switch_leaves_the_speed_that_was_chosen() -> None:
    with bench(new_run("sonar"), SetSpeed(100.0), SetWatch(on=False)) as b:
        b.send(Reset(switch=("centred", True)))
        b.until(lambda p: p.run.task.settings["centred"])
        b.send(Undo())
        snapshot = b.until(lambda p: not p.run.task.settings["centred"])
        assert (snapshot.pacing.speed, snapshot.view.watching) == (100.0, False)


def test_blocks_tell_every_step_that_is_shown() -> None:
    with bench(new_run(), SetWatch(on=False), SetSpeed(500.0)) as b:
        number, end, steps = b.worker.latest.number, time.monotonic() + 20.0, 0
        before: Snapshot | None = None
        while steps <= 200 and time.monotonic() < end:
            snapshot = b.worker.wait_for(number, 5.0)
            assert snapshot is not None
            if before is not None and snapshot.number == before.number + 1:
                moved = snapshot.view.frame.step - before.view.frame.step
                assert snapshot.view.recent is not None
                assert (
                    snapshot.view.recent.start + len(snapshot.view.recent.fired)
                    == snapshot.view.frame.step
                )
                assert snapshot.view.recent.start <= before.view.frame.step
                assert snapshot.run.live.since.steps == moved
                steps += moved
            before, number = snapshot, snapshot.number
        assert steps > 200


def test_watching_at_full_speed_shows_contiguous_excerpts() -> None:
    with bench(new_run(), SetWatchSpeed(100.0)) as b:
        b.until(lambda p: p.view.excerpt is not None)
        before = None
        for _ in range(40):
            snapshot = b.until(lambda _: True)
            if before is not None and snapshot.view.excerpt.first == before.view.excerpt.first:
                skipped = snapshot.number - before.number - 1
                moved = snapshot.view.frame.step - before.view.frame.step
                assert 0 <= moved <= 12 * (skipped + 1)
                assert snapshot.view.recent is not None
                assert (
                    snapshot.view.recent.start + len(snapshot.view.recent.fired)
                    == snapshot.view.frame.step
                )
            assert snapshot.view.frame.step == snapshot.view.excerpt.now
            before = snapshot
        assert before.run.live.step > 10 * before.view.frame.step or before.run.live.step > 10_000
        shown = before.view.frame
        at = shown.step
        again = fresh(b.run, at).frame()
        for name in ("weight", "trace", "activity", "potential", "draw", "world"):
            np.testing.assert_array_equal(getattr(again, name), getattr(shown, name))


def test_stop_ends_the_thread_soon_at_any_speed() -> None:
    for speed in FULL_SPEED:
        with bench(new_run(), speed):
            pass


def test_a_run_that_fails_at_once_raises_what_it_was() -> None:
    run = new_run("breaks")
    go_to(run, 300)
    with pytest.raises(TaskError, match="KeyError"):
        run.advance(5)
    assert run.learner.step == 300
