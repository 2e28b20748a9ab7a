"""The past of a run, played back, and runs that go on from there in another way."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hebbviz.conformance import same_learner
from hebbviz.learner.frames import Keyframe, join
from hebbviz.learner.learner import Learner
from hebbviz.server.live.commands import (
    BackToNow,
    Choose,
    EndFork,
    Pause,
    Probe,
    Reset,
    Seek,
    SeekEvent,
    SetLoop,
    SetSpeed,
    SetWatch,
    ShowBeginning,
    ShowReward,
    StartFork,
    StartRecording,
    StepOnce,
    StopRecording,
    Undo,
    WatchLane,
)
from hebbviz.server.live.fork import (
    BETA,
    GAMMA,
    KINDS,
    NO_MEMORY,
    NO_REWARD,
    OTHER_REWARD,
    Difference,
    Fork,
)
from hebbviz.server.live.playback import Check, Player
from hebbviz.server.live.recent_frames import STEPS
from hebbviz.server.live.session import Session
from hebbviz.server.live.view_mode import NOTHING_TO_PLAY, Event
from hebbviz.server.live.worker import Worker
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.recording.targets import FileTarget
from hebbviz.server.run.changes import SetBeta, SetGamma
from hebbviz.server.run.history import History, Totals
from hebbviz.server.run.keyframes import Moment, Pace, Tape
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task

STEP = 1200
CHANGED = {300: SetBeta(0.9), 600: SetGamma(2e-3)}


def new_run(task: str = "pendulum", steps: int = STEP, tape: int = 250) -> Run:
    """A run with changes, and with moments on its tape, some at the very step of a change."""
    run = Run(Learner(make_task(task, "quick"), seed=2), make_task)
    while run.learner.step < steps:
        step = run.learner.step
        if step in CHANGED:
            run.keep()
            run.change(CHANGED[step])
        stops = [s for s in (*CHANGED, (step // tape + 1) * tape, steps) if s > step]
        run.advance(min(stops) - step)
        if run.learner.step % tape == 0:
            run.keep()
    return run


def straight(task: str, step: int) -> Learner:
    """The learner at a step, before the changes of that step."""
    learner = Learner(make_task(task, "quick"), seed=2)
    for at, change in CHANGED.items():
        if at < step:
            learner.skip(at - learner.step)
            change.apply(learner)
    learner.skip(step - learner.step)
    return learner


def check_fully(player: Player) -> Check:
    until = time.monotonic() + 20.0
    while player.check is Check.PENDING and time.monotonic() < until:
        player.play(0.03, 1.0)
    return player.check


@pytest.fixture(scope="module")
def pendulum() -> Run:
    return new_run()


@settings(max_examples=25, deadline=None)
@given(step=st.integers(-5, STEP + 5))
def test_any_step_is_shown_as_it_was(pendulum: Run, step: int) -> None:
    before = pendulum.learner.keyframe().digest()
    player = Player(pendulum)
    player.seek(step)
    want = straight("pendulum", min(max(step, 0), STEP))
    assert player.cursor == want.step
    assert same_learner(player.replay.learner, want)
    recent = player.trail.recent
    if want.step > 0:
        assert recent is not None
        assert (recent.start, recent.end) == (max(0, want.step - STEPS), want.step)
        copy = straight("pendulum", recent.start)
        fired = []
        while copy.step < want.step:
            if copy.step in CHANGED:
                CHANGED[copy.step].apply(copy)
            fired.append(copy.advance(1).fired[0])
        assert np.array_equal(recent.fired, fired)
        alone = player.play(0.03, None).since
        assert (alone.steps, alone.spikes.tolist()) == (1, recent.fired[-1].tolist())
        assert alone.tally.broadcast == recent.broadcast[-1]
    assert pendulum.learner.keyframe().digest() == before, "the run itself rests"


def test_playing_goes_on_and_ends_at_the_end(pendulum: Run) -> None:
    player = Player(pendulum)
    player.seek(STEP - 100)
    assert player.play(0.1, 100.0).step == STEP - 100, "it rests until it is told to play"
    player.playing = True
    steps = [player.play(0.1, 100.0).step for _ in range(12)]
    assert steps[:3] == [STEP - 90, STEP - 80, STEP - 70]
    assert steps[-1] == STEP
    assert not player.playing
    assert same_learner(player.replay.learner, straight("pendulum", STEP))
    player.loop, player.playing = True, True
    player.play(0.1, 100.0)
    assert (player.cursor, player.playing) == (0, True)


def test_single_steps(pendulum: Run) -> None:
    player = Player(pendulum)
    player.seek(298)
    player.step(5)
    assert same_learner(player.replay.learner, straight("pendulum", 303))


def test_events_are_found(pendulum: Run) -> None:
    player = Player(pendulum)
    player.seek(450)
    assert (player.next_change(1), player.next_change(-1)) == (600, 300)
    player.seek(STEP)
    assert player.next_change(1) is None
    player.seek(0)
    step = player.next_reward()
    assert step is not None
    assert straight("pendulum", step).tally().reward == -1.0
    assert straight("pendulum", step - 1).tally().reward == 0.0


# From files


def recorded(path: Path, tamper: Callable[[Keyframe], Keyframe] = lambda k: k) -> Run:
    """A run read back from a file; `tamper` may forge the keyframes on their way there."""
    record(path, "pendulum", tamper)
    return open_recording(path).run(make_task, make_task("pendulum"))


def record(path: Path, task: str, tamper: Callable[[Keyframe], Keyframe] = lambda k: k) -> None:
    run = Run(Learner(make_task(task), seed=2), make_task, task)
    recorder = Recorder(FileTarget(path), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    for step in (300, 500, 700, 1000):
        while run.learner.step < step:
            run.advance(step - run.learner.step)
        moment = run.moment()
        recorder.keyframe(run, Moment(tamper(moment.keyframe), moment.logged))
        if step == 500:
            run.change(SetBeta(0.9))
    recorder.close(run)


def test_a_recording_is_compared_with_its_keyframes(tmp_path: Path) -> None:
    player = Player(recorded(tmp_path / "run.rrd"))
    for step in (0, 299, 300, 499, 500, 501, 850, 1000):
        player.seek(step)
        assert check_fully(player) is Check.GOOD, step


def test_where_it_cannot_be_made_again_what_was_stored_is_shown(tmp_path: Path) -> None:
    def other_machine(keyframe: Keyframe) -> Keyframe:
        """As another type of machine might have rounded at step 700."""
        if keyframe.step != 700:
            return keyframe
        return replace(keyframe, network=np.nextafter(keyframe.network, np.inf))

    player = Player(recorded(tmp_path / "run.rrd", other_machine))
    player.seek(400)
    assert check_fully(player) is Check.GOOD
    player.seek(650)
    assert check_fully(player) is Check.DIFFERS
    assert player.cursor == 650
    truth = Learner(make_task("pendulum"), seed=2)
    truth.advance(500)
    truth.set_beta(0.9)
    block = join([truth.advance(100, closely=True), truth.advance(50, closely=True)])
    shown = player.play(0.0, None)
    assert shown.step == 650
    assert np.array_equal(shown.fired, block.fired[-1])
    assert np.array_equal(shown.potential, block.potential[-1].astype(np.float32))
    recent = player.trail.recent
    assert recent is not None
    assert recent.end == 650
    assert np.array_equal(recent.part(500, 650).fired, block.fired)
    assert np.array_equal(recent.part(500, 650).broadcast, block.broadcast)
    player.playing = True
    assert [player.play(0.1, 50.0).step for _ in range(3)] == [655, 660, 665]


def test_a_recording_of_an_older_world_says_so(tmp_path: Path) -> None:
    file, path = tmp_path / "lever.py", tmp_path / "run.rrd"
    old = (Path(__file__).parents[1] / "examples" / "lever.py").read_text()
    task = f"{file}:Lever"
    file.write_text(old)
    record(path, task)
    new = old.replace("return state[1]", "return 2.0 * state[1]")
    file.write_text(new.replace('name = "lever"', 'name = "lever"\n    version = 2'))
    player = Player(open_recording(path).run(make_task, make_task(task)))
    player.seek(400)
    assert check_fully(player) is Check.DIFFERS
    assert player.why == "it was recorded with version 1 of task lever, this is version 2"


def test_a_recording_from_before_tasks_had_versions_is_of_version_1(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd", "pendulum")
    header = open_recording(tmp_path / "run.rrd").header
    task = make_task("pendulum")
    assert "version" not in header.other_now(task)
    old = replace(header, versions={n: v for n, v in header.versions.items() if n != "task"})
    why = old.other_now(task)
    assert why == "it was recorded with version 1 of task pendulum, this is version 2"


# Tapes


def test_a_tape_stays_within_its_bytes_and_keeps_its_beginning() -> None:
    keyframe = Learner(make_task("pendulum")).keyframe()
    size = Moment(keyframe, 0).size
    tape = Tape([Moment(keyframe, 0)], most_bytes=20 * size)
    for step in range(1, 500):
        tape.add(Moment(replace(keyframe, step=step), 0))
        assert len(tape) <= 20
        assert tape.before(0) is not None
        latest = tape.before(10**9)
        assert latest is not None
        assert latest.step == step
    kept = {m.step for s in range(500) if (m := tape.before(s)) is not None}
    assert max(np.diff(sorted(kept))) <= 64, "those that are left are spread over the whole run"
    assert tape.until(100).before(10**9) == tape.before(100)


@pytest.mark.parametrize("task", ["synapse", "pendulum"])
def test_a_moments_size_is_what_it_takes(task: str) -> None:
    """A small network's moments are mostly objects, of which many would not count as much."""
    learner = Learner(make_task(task))
    learner.advance(10)
    learner.keyframe()
    tracemalloc.start()
    moments = [Moment(learner.keyframe(), 0) for _ in range(200)]
    taken = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert taken < 200 * moments[0].size < 1.25 * taken


def test_histories_of_former_runs_are_forgotten_before_they_take_all_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = new_run()
    monkeypatch.setattr("hebbviz.server.run.run.MOST_UNDO_BYTES", 4_000_000)
    for _ in range(12):
        edges = [Totals(k, np.zeros((3, 512))) for k in range(80)]  # as of so many lanes
        run.become(run.learner, history=History.of(1, edges), log=[], tape=None, words="so")
    undone = 0
    while run.undo() is not None:
        undone += 1
    assert undone == 4, "of 1 MB each, and the first had none"


def test_former_runs_are_forgotten_before_they_take_all_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = new_run()
    size = run.moment().size
    monkeypatch.setattr("hebbviz.server.run.run.MOST_UNDO_BYTES", 60 * size)
    for _ in range(12):
        for _ in range(20):
            run.advance(10)
            run.keep()
        run.reset()
    undone = 0
    while run.undo() is not None:
        undone += 1
    assert undone == 3, "of 21 moments each, and one of their own"


def test_a_recording_that_is_gone_on_with_stays_within_its_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hebbviz.server.recording.reader.MOST_BYTES", 20 * new_run().moment().size)
    run = recorded(tmp_path / "run.rrd")
    for _ in range(100):
        run.advance(10)
        run.keep()
    assert len(run.tape) <= 20


def test_moments_are_a_tenth_of_a_second_of_computing_apart() -> None:
    pace = Pace()
    due = [pace.is_due(0.01, 0.01, 2_000) for _ in range(100)]
    assert sum(due) in (9, 10)
    resting = [pace.is_due(0.0, 0.1, 2_000) for _ in range(200)]
    assert sum(resting) in (3, 4)
    large = [pace.is_due(0.01, 0.01, 150_000) for _ in range(1000)]
    assert sum(large) in (9, 10), "a large one no more often than its bytes allow"


# Forks


@pytest.mark.parametrize("kind", KINDS)
def test_a_fork_differs_in_one_thing_alone(kind: str) -> None:
    run = new_run()
    start = run.learner.keyframe()
    fork = Fork(run, Difference(kind, 0.5 if kind == BETA else 5e-4 if kind == GAMMA else None))
    for _ in range(10):
        run.advance(100)
        fork.follow(run.learner.step)
    other = run.learner.twin()
    other.restore(start)
    if kind in (BETA, NO_MEMORY):
        other.set_beta(0.5 if kind == BETA else 0.0)
    if kind == GAMMA:
        other.set_gamma(5e-4)
    if kind == NO_REWARD:
        other.advance(1000, reward=np.zeros(1000))
    elif kind == OTHER_REWARD:
        donor = Learner(make_task("pendulum", "quick"), seed=3)
        donor.restore(start)
        other.advance(1000, reward=donor.advance(1000).broadcast)
    else:
        other.advance(1000)
    assert same_learner(fork.learner, other)
    assert not np.array_equal(fork.learner.weights, run.learner.weights)
    assert fork.learner.step == run.learner.step
    assert [t.steps for t in fork.history.edges()] == [t.steps for t in run.history.edges()]


@pytest.mark.parametrize("kind", [BETA, GAMMA, NO_MEMORY])
def test_any_step_of_a_copy_that_is_kept_is_shown_as_it_was(kind: str) -> None:
    run = new_run()
    fork = Fork(run, Difference(kind, None if kind == NO_MEMORY else 0.02))
    copies = {}
    for step in range(STEP + 100, STEP + 600, 100):
        run.advance(100)
        fork.follow(step)
        copies[step] = fork.learner.keyframe().digest()
        if step % 200 == 0:
            fork.keep()
    run.become(fork.learner, history=fork.history, log=fork.log, tape=fork.tape, words="kept")
    player = Player(run)
    for step, digest in copies.items():
        player.seek(step)
        assert player.replay.learner.keyframe().digest() == digest
    player.seek(700)
    assert same_learner(player.replay.learner, straight("pendulum", 700))


def test_a_fork_that_differs_in_nothing_is_the_same_run() -> None:
    run = new_run()
    fork = Fork(run, Difference(BETA, run.learner.beta))
    run.advance(300)
    fork.follow(run.learner.step)
    assert same_learner(fork.learner, run.learner)


def test_changes_reach_both_copies_but_for_what_differs() -> None:
    run = new_run()
    fork = Fork(run, Difference(NO_MEMORY))
    for change in (SetBeta(0.7), SetGamma(5e-3)):
        run.change(change)
        fork.change(change)
    assert (run.learner.beta, fork.learner.beta) == (0.7, 0.0)
    assert run.learner.gamma == fork.learner.gamma == 5e-3


@pytest.mark.parametrize(
    ("kind", "value"), [("β", None), (BETA, None), (BETA, 1.0), (GAMMA, -1.0), (GAMMA, np.nan)]
)
def test_forks_that_make_no_sense_are_refused(kind: str, value: float | None) -> None:
    with pytest.raises(ValueError, match=r"fork|beta|gamma"):
        Difference(kind, value)


# With the worker


class Stage:
    """A worker on a paused run, and what it says."""

    def __init__(self, run: Run, folder: Path, *, in_the_past: bool = False) -> None:
        self.notices: list[str] = []
        self.run = run
        self.recordings = Recordings(run, Options(folder=folder), on_notice=self.notices.append)
        session = Session(
            run, on_notice=self.notices.append, recordings=self.recordings, in_the_past=in_the_past
        )
        self.worker = Worker(session)
        self.worker.send(Pause(paused=True))
        self.worker.start()

    def send(self, *commands: object) -> None:
        for command in commands:
            self.worker.send(command)  # type: ignore[arg-type]
        number = self.worker.latest.number if self.worker.latest else 0
        assert self.worker.wait_for(number + 2, timeout=20.0) is not None

    def wait(self, holds: Callable[[], bool], seconds: float = 20.0) -> None:
        until = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < until, self.worker.latest
            time.sleep(0.01)

    @property
    def snapshot(self):  # type: ignore[no-untyped-def]
        return self.worker.latest


@pytest.fixture
def stage(tmp_path: Path):  # type: ignore[no-untyped-def]
    stage = Stage(new_run(), tmp_path / "recordings")
    yield stage
    stage.worker.stop()
    stage.worker.join(5.0)
    stage.recordings.close()


def test_a_live_run_is_rewound_and_left(stage: Stage) -> None:
    stage.send(Seek(450))
    assert stage.snapshot.view.past is not None
    assert (stage.snapshot.view.past.cursor, stage.snapshot.view.frame.step) == (450, 450)
    assert stage.snapshot.view.past.check is Check.OWN
    assert stage.snapshot.run.live.step == STEP
    stage.send(SeekEvent(Event.NEXT_CHANGE))
    assert stage.snapshot.view.past.cursor == 600
    stage.send(StepOnce(7))
    assert stage.snapshot.view.past.cursor == 607
    stage.send(SetSpeed(200.0), SetLoop(loop=True), Pause(paused=False))
    stage.wait(lambda: stage.snapshot.view.past.cursor > 640)
    assert stage.snapshot.pacing.paused is False
    stage.send(BackToNow())
    assert stage.snapshot.view.past is None
    assert stage.run.learner.step == STEP, "the run has not moved"


def test_a_reward_that_is_looked_for_is_seen_at_its_step_as_long_as_it_is_shown(
    stage: Stage,
) -> None:
    stage.send(Seek(0))
    for _ in range(5):
        leaps = stage.snapshot.view.leaps
        stage.send(SeekEvent(Event.NEXT_REWARD))
        for _ in range(3):
            stage.send()
            shown = stage.snapshot.view.frame
            assert (shown.since.steps, shown.since.tally.broadcast) == (1, -1.0)
            change = shown.weight - straight("pendulum", shown.step - 1).weights[:, 0]
            np.testing.assert_allclose(shown.since.weight_change, change, atol=1e-15)
            assert stage.snapshot.view.leaps == leaps + 1


def test_of_another_lane_nothing_is_said_that_was_of_the_one_before(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum"), lanes=2), make_task)
    run.advance(500)
    stage = Stage(run, tmp_path)
    try:
        stage.send(StepOnce(1))
        stage.wait(lambda: stage.snapshot.view.frame.since.steps == 1)
        leaps = stage.snapshot.view.leaps
        stage.send(WatchLane(1))
        assert (stage.snapshot.view.leaps, stage.snapshot.view.frame.since.steps) == (leaps + 1, 0)
        stage.send(WatchLane(1))
        assert stage.snapshot.view.leaps == leaps + 1
    finally:
        stage.worker.stop()
        stage.worker.join(5.0)


def test_a_run_is_taken_over_from_its_past_and_brought_back(stage: Stage) -> None:
    digest = stage.run.learner.keyframe().digest()
    stage.send(SetSpeed(50.0), Seek(450), SetBeta(0.5))
    stage.wait(lambda: stage.snapshot.run.live.step > 455)
    assert (stage.snapshot.view.past, stage.snapshot.run.beta) == (None, 0.5)
    stage.send(Undo(), Pause(paused=True))
    stage.wait(lambda: stage.snapshot.run.live.step >= STEP)
    stage.worker.stop()
    stage.worker.join(5.0)
    if stage.run.learner.step == STEP:
        assert stage.run.learner.keyframe().digest() == digest


def test_what_is_undone_in_vain_or_refused_leaves_the_past_and_a_fork(stage: Stage) -> None:
    stage.send(Undo(), Undo())
    in_vain, refused = Undo(), Choose("pendulum", hidden=(0,))
    for begin in (Seek(200), StartFork(NO_MEMORY)):
        before = len(stage.notices)
        stage.send(BackToNow(), begin, in_vain, refused)
        stage.wait(lambda before=before: len(stage.notices) == before + 2)  # type: ignore[misc]
        assert "nothing to undo" in stage.notices[-2]
        assert "hidden" in stage.notices[-1]
        past, other = stage.snapshot.view.past, stage.snapshot.view.other
        assert (past.cursor == 200) if isinstance(begin, Seek) else (other is not None)


def test_no_excerpt_is_played_of_a_fork_or_the_past(stage: Stage) -> None:
    stage.send(SetWatch(on=True), Pause(paused=False))
    stage.wait(lambda: stage.snapshot.view.excerpt is not None)
    stage.send(StartFork(NO_MEMORY), ShowReward(), ShowBeginning())
    assert stage.snapshot.view.other is not None
    assert stage.snapshot.view.excerpt is None
    assert stage.notices == [NOTHING_TO_PLAY]
    stage.send(EndFork(), Seek(450), ShowReward())
    assert stage.snapshot.view.past is not None
    assert stage.snapshot.view.excerpt is None
    assert stage.notices == 2 * [NOTHING_TO_PLAY]


def test_what_a_tab_follows_it_follows_after_a_reset_too(stage: Stage) -> None:
    stage.send(Probe((3, 10**6)), Reset(), Pause(paused=False))
    stage.wait(lambda: stage.snapshot.run.live.since.probes == (3,))


def test_a_change_in_the_past_takes_over_there(stage: Stage) -> None:
    stage.send(SetSpeed(20.0), Seek(100), SetGamma(1e-4))
    assert stage.snapshot.view.past is None
    assert stage.snapshot.run.gamma == 1e-4
    assert stage.snapshot.run.live.step < 400


def test_a_fork_runs_beside_and_one_of_the_two_is_kept(stage: Stage) -> None:
    stage.send(Seek(500), StartFork(NO_MEMORY), Pause(paused=False))
    stage.wait(
        lambda: stage.snapshot.view.other is not None and stage.snapshot.run.live.step > 1000
    )
    snapshot = stage.snapshot
    assert (snapshot.view.other.words, snapshot.view.other.start) == (NO_MEMORY, 500)
    assert snapshot.view.other.frame.step == snapshot.run.live.step
    stage.send(Pause(paused=True), EndFork(keep_other=True))
    assert stage.snapshot.view.other is None
    assert stage.snapshot.run.beta == 0.0
    assert [str(c.change) for c in stage.snapshot.run.changes][-1] == "β 0"
    stage.send(Undo())
    assert stage.snapshot.run.beta == 0.9


def test_the_copy_that_is_kept_has_the_changes_that_were_made_in_it(stage: Stage) -> None:
    known = [str(c) for c in CHANGED.values()]
    stage.send(StartFork(BETA, 0.5), SetBeta(0.7), SetGamma(2e-3), EndFork(keep_other=True))
    assert (stage.snapshot.run.beta, stage.snapshot.run.gamma) == (0.5, 2e-3)
    assert [str(c.change) for c in stage.snapshot.run.changes] == [*known, "β 0.5", "γ 0.002"]


def test_recording_is_begun_and_ended_by_commands(stage: Stage) -> None:
    stage.send(StartRecording("a run"), Pause(paused=False))
    stage.wait(lambda: stage.snapshot.run.live.step > STEP + 2000)
    assert stage.snapshot.recording.is_on
    stage.send(StartRecording("another"))
    assert any("already running" in n for n in stage.notices)
    stage.send(StopRecording())
    assert not stage.snapshot.recording.is_on
    recording = open_recording(stage.recordings.folder / "a run.rrd")
    assert recording.header.step == STEP
    assert recording.ending is not None
    stage.send(StartRecording("a run"))
    assert any("already: choose another name" in n for n in stage.notices)


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "a" * 200, "x\n", "~"])
def test_names_that_could_leave_the_folder_are_refused(stage: Stage, name: str) -> None:
    stage.send(StartRecording(name))
    assert not stage.snapshot.recording.is_on
    assert any("a recording's name has" in n for n in stage.notices)


def test_a_recording_is_played_from_its_beginning(tmp_path: Path) -> None:
    stage = Stage(recorded(tmp_path / "run.rrd"), tmp_path, in_the_past=True)
    try:
        stage.wait(lambda: stage.snapshot is not None and stage.snapshot.view.past is not None)
        assert stage.snapshot.view.past.cursor == 0
        stage.wait(lambda: stage.snapshot.view.past.check is Check.GOOD)
        stage.send(Pause(paused=False))
        stage.wait(lambda: stage.snapshot.view.past.cursor > 5)
    finally:
        stage.worker.stop()
        stage.worker.join(5.0)
