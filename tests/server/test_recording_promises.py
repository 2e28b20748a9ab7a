"""What recordings promise when programs are killed, disks are full, files damaged, viewers stuck.

Programs are real ones that are really killed, disks are small file systems that really are full.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, settings
from hypothesis import strategies as st
from raw_client import answers, wait_until

from hebbviz.learner.frames import Keyframe
from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main
from hebbviz.server.recording import header, segment
from hebbviz.server.recording.reader import BadRecording, Recording, open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.recording.streams import Stream
from hebbviz.server.recording.targets import FileTarget, StreamTarget
from hebbviz.server.run import thinning
from hebbviz.server.run.changes import SetBeta
from hebbviz.server.run.run import Run
from hebbviz.server.run.thinning import Plan, Thinning, parse_budget
from hebbviz.sims.loading import make_task

ROOT = Path(__file__).parents[2]
HEBBVIZ = [sys.executable, "-m", "hebbviz"]
PATIENCE = 60.0
"""Seconds for a program to be up; most of it is for compiling on a machine that never did."""
ENDS = 5.0
"""Seconds within which a program ends, whatever holds up its disk or its viewers."""
MEGABYTE = 1_000_000

CLOCKED = '''
import time
from pathlib import Path

import numpy as np

from hebbviz.task import Input, Output, Preset, Task

TIMES = np.memmap(Path(__file__).with_name("times"), np.float64, "r+")


class Clocked(Task):
    """Notes when it first made each step, where it is found even if its program is killed."""

    name = "clocked"
    inputs = (Input("lamp"),)
    outputs = (Output("lever", "pulled", "let go"),)
    presets = {"easy": Preset(0.5, 0.01, "a test")}

    def restart(self, draws):
        return np.zeros(2)

    def transition(self, state, action, draws):
        step = int(state[0]) + 1
        if not TIMES[step]:
            TIMES[step] = time.monotonic()
        return np.array([step, float(action[0] == (draws(1)[0] < 0.5))])

    def observation(self, state):
        return state[1:].copy()

    def reward(self, state):
        return float(state[1])
'''


class Program:
    """hebbviz in a process of its own; its stderr goes to a file, so that no pipe fills."""

    def __init__(self, folder: Path, *args: object) -> None:
        self.said, self.told = folder / "stdout", folder / "stderr"
        with self.said.open("w") as out, self.told.open("w") as err:
            command = [*HEBBVIZ, *map(str, args)]
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=out, stderr=err)

    def out(self) -> str:
        return self.said.read_text()

    def err(self) -> str:
        return self.told.read_text()

    def wait_for(self, condition: Callable[[], Any], seconds: float = PATIENCE) -> Any:
        """What `condition` returns once it is true; fails if the program ends before."""

        def met() -> Any:
            assert self.process.poll() is None, self.out() + self.err()
            return condition()

        return wait_until(met, seconds)

    def end(self, number: int = signal.SIGINT) -> float:
        """End it with a signal; returns the seconds that it took."""
        began = time.monotonic()
        self.process.send_signal(number)
        self.process.wait(timeout=60)
        return time.monotonic() - began


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Program]]:
    """Starts programs, and kills those that are left."""
    with contextlib.ExitStack() as stack:

        def start_one(*args: object) -> Program:
            folder = tmp_path / f"program-{time.monotonic_ns()}"
            folder.mkdir()
            program = Program(folder, *args)
            stack.callback(program.process.wait)
            stack.callback(program.process.kill)
            return program

        yield start_one


def serve(*args: object) -> list[object]:
    return ["serve", "--no-browser", "--port", 0, *args]


def train(*args: object) -> list[object]:
    return ["train", "--steps", 10**11, *args]


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def rests(path: Path) -> bool:
    """Whether a file does not grow for a second."""
    before = size(path)
    time.sleep(1.0)
    return size(path) == before


def made_again(recording: Recording, task_name: str | None = None) -> bool:
    """Whether the run, made again from its first keyframe, goes through all its others."""
    task = make_task(task_name or recording.header.task, recording.header.preset)
    run = recording.run(lambda *_: task, task)
    assert run.learner.step == recording.last_step
    replay = run.replay(recording.moments[0])
    for moment in recording.moments[1:]:
        replay.go_to(moment.step)
        if replay.moment().keyframe.digest() != moment.keyframe.digest():
            return False
    replay.go_to(recording.last_step)
    return replay.moment().keyframe.digest() == run.learner.keyframe().digest()


# Killed


@pytest.mark.slow
@pytest.mark.parametrize("command", [train(), serve("--speed", 50)], ids=["train", "serve"])
def test_a_program_that_is_killed_loses_a_second_at_most(
    command: list[object], tmp_path: Path, start: Callable[..., Program]
) -> None:
    (tmp_path / "clocked.py").write_text(CLOCKED)
    (tmp_path / "times").touch()
    os.truncate(tmp_path / "times", 8 * 10**8)
    times = np.memmap(tmp_path / "times", np.float64, "r")
    task, path = f"{tmp_path}/clocked.py:Clocked", tmp_path / "run.rrd"
    program = start(*command, "--task", task, "--record", path)
    program.wait_for(lambda: times[10] > 0)
    time.sleep(2.2)
    killed = time.monotonic()
    program.end(signal.SIGKILL)
    recording = open_recording(path)
    lost = killed - times[recording.last_step]
    assert lost < 1.0
    assert times[recording.last_step + 1] > 0 or recording.last_step > 100_000_000
    assert recording.ending is None
    assert recording.notice
    assert str(path) in recording.notice
    assert made_again(recording, task)


TRAIN, SERVE = train(), serve("--speed", "max")


@pytest.mark.parametrize(
    ("command", "number"),
    [
        pytest.param(TRAIN, signal.SIGTERM, id="train-15"),
        pytest.param(SERVE, signal.SIGINT, id="serve-2", marks=pytest.mark.slow),
        pytest.param(TRAIN, signal.SIGINT, id="train-2", marks=pytest.mark.slow),
        pytest.param(SERVE, signal.SIGTERM, id="serve-15", marks=pytest.mark.slow),
    ],
)
def test_a_program_that_is_stopped_loses_nothing(
    command: list[object],
    number: signal.Signals,
    tmp_path: Path,
    start: Callable[..., Program],
) -> None:
    path = tmp_path / "run.rrd"
    program = start(*command, "--record", path)
    program.wait_for(lambda: size(path) > MEGABYTE)
    assert program.end(number) < ENDS
    stopped = re.search(r"stopped at step ([\d,]+)", program.out() + program.err())
    assert stopped
    recording = open_recording(path)
    assert recording.last_step == int(stopped[1].replace(",", ""))
    assert recording.moments[-1].step == recording.last_step
    assert (recording.ending, recording.is_cut) == ("it was stopped", False)
    assert recording.notice is None
    assert program.err().count("\n") == (1 if command[0] == "train" else 0)


# Damaged


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording of some seconds, with changes."""
    path = tmp_path_factory.mktemp("whole") / "run.rrd"
    return record(path)


def record(path: Path) -> Recording:
    run = Run(Learner(make_task("pendulum"), seed=3), make_task)
    notices: list[str] = []
    recordings = Recordings(run, Options(file=path), on_notice=notices.append)
    for k in range(4):
        advance(run, 400)
        run.change(SetBeta(0.9 + k / 100))
        advance(run, 200)
        run.keep()
        time.sleep(segment.FLUSH_SECONDS)
    recordings.close()
    assert not notices
    return open_recording(path)


def advance(run: Run, steps: int) -> None:
    end = run.learner.step + steps
    while run.learner.step < end:
        run.advance(min(100, end - run.learner.step))
    run.frame()


def is_a_beginning_of(part: Recording, all_of: Recording) -> bool:
    """Whether all that the one holds is what the other holds up to there, to the bit."""

    def digests(r: Recording) -> list[tuple[str, int]]:
        return [(m.keyframe.digest(), m.logged) for m in r.moments]

    changes = len([c for c in all_of.log if c.step < part.last_step])
    return (
        part.header == all_of.header
        and digests(part) == digests(all_of)[: len(part.moments)]
        and part.log == all_of.log[: len(part.log)]
        and part.edges == all_of.edges[: len(part.edges)]
        and changes <= len(part.log)
        and part.last_step <= all_of.last_step
    )


def read_or_why_not(path: Path, content: bytes) -> Recording | str:
    """What can be read of a file with this content, or the line that says why it cannot be."""
    path.write_bytes(content)
    try:
        return open_recording(path)
    except BadRecording as error:
        return str(error)


def test_a_file_that_is_cut_is_read_up_to_its_last_whole_piece(
    whole: Recording, tmp_path: Path
) -> None:
    content, rng = whole.path.read_bytes(), np.random.default_rng(0)
    ends = sorted([*rng.integers(0, len(content), 60).tolist(), len(content) - 100])
    found = [read_or_why_not(tmp_path / "cut.rrd", content[:end]) for end in ends]
    opened = [part for part in found if isinstance(part, Recording)]
    assert len(opened) > 40
    assert found[-len(opened) :] == opened, "of a longer piece less can be read"
    for why in found[: -len(opened)]:
        assert re.search("truncated before its header|before its first keyframe", str(why))
    for end, part in zip(ends[-len(opened) :], opened, strict=True):
        assert part.notice
        assert is_a_beginning_of(part, whole), end
    last = [part.last_step for part in opened]
    assert last == sorted(last)
    assert last[-1] == whole.last_step
    assert made_again(opened[-1])


@pytest.mark.parametrize(
    ("anywhere", "early"), [(60, 40), pytest.param(200, 100, marks=pytest.mark.slow)]
)
def test_a_wrong_byte_changes_no_keyframe_and_no_change(
    whole: Recording, tmp_path: Path, anywhere: int, early: int
) -> None:
    """Curves have no checksum; what a run is made again from has one."""
    content, rng = np.frombuffer(whole.path.read_bytes(), np.uint8), np.random.default_rng(1)
    places = np.concatenate(
        (rng.integers(0, len(content), anywhere), rng.integers(0, 30_000, early))
    )
    told = 0
    for place in places.tolist():
        changed = content.copy()
        changed[place] ^= rng.integers(1, 256, dtype=np.uint8)
        found = read_or_why_not(tmp_path / "flipped.rrd", changed.tobytes())
        if isinstance(found, str):
            told += 1
            assert "\n" not in found
        else:
            assert is_a_beginning_of(found, whole), place
    assert told


def other_program(path: Path) -> None:
    stream = rr.RecordingStream("another program", recording_id="a")
    stream.set_sinks(rr.FileSink(path, write_footer=True))
    stream.set_time("step", sequence=3)
    stream.log("a/b", rr.Scalars(1.0))
    stream.disconnect()


def tampered(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        true = Keyframe.digest
        patch.setattr(Keyframe, "digest", lambda k: true(k) if k.step < 600 else true(k)[::-1])
        write(path)


def newer(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(header, "FORMAT", header.FORMAT + 1)
        write(path)


def write(path: Path) -> None:
    run = Run(Learner(make_task("pendulum")), make_task)
    recordings = Recordings(run, Options(file=path), on_notice=lambda _: None)
    advance(run, 700)
    recordings.close()


NO_RECORDINGS = {
    "empty": "it is empty",
    "garbage": "it is no rerun file",
    "text": "it is no rerun file",
    "learner": "it is no rerun file",
    "beginning": "it was truncated before its header",
    "folder": "is a directory",
    "missing": "no such file",
    "other": "it is a recording of another program, not of hebbviz",
    "tampered": "its keyframe at step 700 was changed: its checksum is wrong",
    "newer": "newer than this hebbviz can read",
    "flipped": "it is damaged",
}


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory, whole: Recording) -> Path:
    """Files of which none is a recording that can be read."""
    folder = tmp_path_factory.mktemp("bad")
    content = whole.path.read_bytes()
    (folder / "empty.rrd").touch()
    (folder / "garbage.rrd").write_bytes(np.random.default_rng(0).bytes(10_000))
    (folder / "text.rrd").write_text("a,b\n1,2\n" * 100)
    np.savez(folder / "learner.npz", weights=np.zeros(3))
    (folder / "learner.npz").rename(folder / "learner.rrd")
    (folder / "beginning.rrd").write_bytes(content[:12])
    (folder / "folder.rrd").mkdir()
    other_program(folder / "other.rrd")
    with pytest.MonkeyPatch.context() as patch:
        tampered(folder / "tampered.rrd", patch)
        newer(folder / "newer.rrd", patch)
    (folder / "flipped.rrd").write_bytes(content[:100_000] + b"\xff" * 2000 + content[102_000:])
    return folder


@pytest.mark.parametrize("command", ["inspect", "replay --no-browser --port 0", "export --out {}"])
@pytest.mark.parametrize("kind", NO_RECORDINGS)
def test_what_is_no_recording_is_one_line_and_exit_2(
    kind: str, command: str, bad: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    began = time.monotonic()
    code = main([*command.format(tmp_path / "out").split(), str(bad / f"{kind}.rrd")])
    out, err = capfd.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert err.startswith("hebbviz: cannot ")
    assert NO_RECORDINGS[kind] in err
    assert f"{kind}.rrd" in err
    assert not (tmp_path / "out").exists()
    assert time.monotonic() - began < 10.0


@pytest.mark.slow
def test_what_is_damaged_is_said_by_a_program_in_one_line(bad: Path, whole: Recording) -> None:
    """In a process of its own, where rerun's own log and warnings would be seen."""
    (bad / "cut.rrd").write_bytes(whole.path.read_bytes()[:-1000])
    for kind, code, lines in (("flipped", 2, 1), ("tampered", 2, 1), ("cut", 0, 0)):
        done = subprocess.run(
            [*HEBBVIZ, "inspect", str(bad / f"{kind}.rrd")],
            cwd=ROOT, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr.count("\n")) == (code, lines), done.stderr
    assert ", truncated" in done.stdout


# Full disks


@contextlib.contextmanager
def disk(folder: Path, megabytes: int, *, options: str = "") -> Iterator[Path]:
    """A file system of its own."""
    mount, umount = shutil.which("mount"), shutil.which("umount")
    if not mount or not umount or os.geteuid() != 0:
        pytest.skip("only root can mount a small file system")
    path = folder / "disk"
    path.mkdir()
    command = [mount, "-t", "tmpfs", "-o", f"size={megabytes}m{options}", "tmpfs", str(path)]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("mounting is not permitted here")
    try:
        yield path
    finally:
        subprocess.run([umount, "-l", str(path)], check=True)


def fill(folder: Path) -> None:
    """Leave not a byte free."""
    with (folder / "filling").open("wb", buffering=0) as file:
        for piece in (b"x" * 65536, b"x"):
            with contextlib.suppress(OSError):
                while True:
                    file.write(piece)


BIG = ("--budget", "10GB")


@pytest.mark.slow
def test_a_training_on_a_full_disk_ends_with_its_figures(
    tmp_path: Path, start: Callable[..., Program]
) -> None:
    with disk(tmp_path, 8) as folder:
        path = folder / "run.rrd"
        program = start("train", "--steps", 60_000, "--record", path, *BIG)
        assert program.process.wait(timeout=PATIENCE) == 0
        assert "now at step 60,000" in program.out()
        told = program.err()
        assert told.count("\n") == 1
        assert f"recording into {path} has stopped, the run continues: the disk is full" in told
        recording = open_recording(path)
        assert 0 < recording.last_step < 60_000
        assert (recording.is_cut, recording.notice) == (False, None)
        assert str(recording.ending).startswith("the disk is full")
        assert made_again(recording)


@pytest.mark.slow
@pytest.mark.parametrize("command", [train(), serve("--speed", "max")], ids=["train", "serve"])
@pytest.mark.parametrize("by_others", [False, True], ids=["by us", "by others"])
def test_a_run_goes_on_when_the_disk_is_full_and_still_ends(
    command: list[object], by_others: bool, tmp_path: Path, start: Callable[..., Program]
) -> None:
    with disk(tmp_path, 64 if by_others else 16) as folder:
        path = folder / "run.rrd"
        program = start(*command, "--record", path, *BIG)
        if by_others:
            program.wait_for(lambda: size(path) > 3 * MEGABYTE)
            fill(folder)
        program.wait_for(lambda: "has stopped" in program.err())
        recorded = open_recording(path).last_step
        time.sleep(0.5)
        assert program.end() < ENDS
        assert program.process.returncode == (130 if command[0] == "train" else 0)
        stopped = re.search(r"stopped at step ([\d,]+)", program.out() + program.err())
        assert stopped
        assert int(stopped[1].replace(",", "")) > recorded + 1000
        assert program.err().count("\n") == (2 if command[0] == "train" else 1), program.err()
        assert open_recording(path).last_step >= recorded > 0


@pytest.mark.slow
def test_a_file_that_is_deleted_is_said_and_the_run_goes_on(
    tmp_path: Path, start: Callable[..., Program]
) -> None:
    path = tmp_path / "run.rrd"
    program = start(*serve("--speed", "max", "--record", path))
    program.wait_for(lambda: size(path) > MEGABYTE)
    path.unlink()
    program.wait_for(lambda: "its file is gone" in program.err(), 15.0)
    assert program.err().count("\n") == 1
    assert program.end() < ENDS
    assert program.process.returncode == 0
    assert not path.exists()


RECORDS = pytest.mark.parametrize("command", ["train --steps 10", "serve --no-browser --port 0"])


@RECORDS
def test_what_cannot_be_written_is_said_at_once(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there.rrd"
    there.write_text("precious")
    for path, words in (
        (there, "exists already and is not written over: name another file"),
        (there.with_suffix(""), "exists already"),
        (tmp_path / "nowhere" / "run.rrd", "no such file or directory"),
        (there / "run.rrd", "not a directory"),
    ):
        is_refused(command, path, words, capfd)
    assert there.read_text() == "precious"


@RECORDS
def test_a_disk_that_can_only_be_read_is_said_at_once(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with disk(tmp_path, 1, options=",ro") as read_only:
        is_refused(command, read_only / "run.rrd", "read-only file system", capfd)


@RECORDS
def test_a_disk_that_is_full_is_said_at_once(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for megabytes, name in ((1, "small"), (6, "filled")):
        (tmp_path / name).mkdir()
        with disk(tmp_path / name, megabytes) as folder:
            if name == "filled":
                fill(folder)
            is_refused(command, folder / "run.rrd", "run.rrd: no space left on device", capfd)
            assert not (folder / "run.rrd").exists()


@pytest.mark.slow
def test_a_file_that_another_program_cuts_is_said_and_the_run_goes_on(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum")), make_task)
    notices: list[str] = []
    recordings = Recordings(run, Options(file=tmp_path / "run.rrd"), on_notice=notices.append)
    advance(run, 500)
    wait_until(lambda: size(tmp_path / "run.rrd") > 50_000, PATIENCE)
    wait_until(lambda: rests(tmp_path / "run.rrd"), PATIENCE)
    os.truncate(tmp_path / "run.rrd", 20_000)
    wait_until(lambda: notices, PATIENCE)
    assert notices == [
        f"recording into {tmp_path / 'run.rrd'} has stopped, the run continues: another program "
        "has truncated its file"
    ]
    advance(run, 500)
    assert run.learner.step == 1000
    assert not recordings.close()


def test_closing_does_not_count_what_its_beginning_took(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a machine at work elsewhere rerun alone takes longer to be imported."""
    monkeypatch.setattr(segment, "CLOSE_SECONDS", 0.0)
    begin, writer = threading.Event(), segment.Take._writer
    monkeypatch.setattr(
        segment.Take, "_writer", lambda self: writer(self) if begin.wait(PATIENCE) else None
    )
    run = Run(Learner(make_task("pendulum")), make_task)
    notices: list[str] = []
    recorder = Recorder(FileTarget(tmp_path / "run.rrd"), run, on_notice=notices.append)
    run.followers.append(recorder)
    run.advance(50)
    threading.Timer(0.5, begin.set).start()
    recorder.close(run, seconds=0.4)
    assert begin.is_set()
    wait_until(lambda: not recorder.is_stuck, PATIENCE)
    assert open_recording(tmp_path / "run.rrd").last_step == 50


def is_refused(command: str, path: Path, words: str, capfd: pytest.CaptureFixture[str]) -> None:
    code = main([*command.split(), "--record", str(path)])
    out, err = capfd.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert words in err


# A disk that does not answer


class Blocked:
    """A target whose stream takes nothing until `free` is set; it holds what came then."""

    live, words, silence = False, "a slow disk", FileTarget.silence

    def __init__(self, path: Path) -> None:
        self._path, self.free = path, threading.Event()

    def open(self, number: int) -> Stream:
        stream = Stream("slow")
        stream.set_sinks(rr.FileSink(self._path, write_footer=True))
        flush = stream.flush

        def blocked(**options: Any) -> None:
            self.free.wait(PATIENCE)
            flush(**options)

        stream.flush = blocked
        return stream

    def size(self) -> int | None:
        return size(self._path)

    def trouble(self, pending: int) -> str | None:
        return None

    def close(self) -> None:
        pass


def test_a_slow_disk_drops_steps_but_no_change_and_holds_up_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segment, "MOST_QUEUED", 2_000_000)
    target = Blocked(tmp_path / "slow.rrd")
    run = Run(Learner(make_task("pendulum")), make_task)
    notices: list[str] = []
    recorder = Recorder(target, run, budget=10**10, on_notice=notices.append)  # type: ignore[arg-type]
    run.followers.append(recorder)
    run.advance(100)  # what is compiled or opened first is not waiting for a disk
    longest, waiting, began = 0.0, 0, time.monotonic()
    while not (waiting > 2_000_000 and time.monotonic() - began > 1.5):
        before = time.monotonic()
        run.advance(100)
        longest = max(longest, time.monotonic() - before)
        if run.learner.step % 2000 == 0:
            run.change(SetBeta(0.9 + run.learner.step % 7 / 100))
            run.keep()
        waiting = recorder._takes[-1]._told - recorder._takes[-1]._written
        assert waiting < 3_000_000
        assert time.monotonic() - began < 30.0
    assert longest < 5.0, "it waited for the disk, which answers after PATIENCE"
    assert recorder.status.dropped > 0
    assert "steps dropped: the disk is too slow" in recorder.status.thinned
    target.free.set()
    recorder.close(run)
    recording = open_recording(tmp_path / "slow.rrd")
    assert not notices
    assert recording.log == tuple(run.log)
    assert recording.last_step == run.learner.step
    assert recording.ending == "it was stopped"
    assert made_again(recording)


@pytest.mark.slow
def test_a_disk_that_never_answers_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(segment, "MOST_QUEUED", 20_000)
    monkeypatch.setattr(segment, "MOST_KEPT", 60_000)
    target = Blocked(tmp_path / "slow.rrd")
    run = Run(Learner(make_task("pendulum")), make_task)
    notices: list[str] = []
    recorder = Recorder(target, run, on_notice=notices.append)  # type: ignore[arg-type]
    run.followers.append(recorder)
    for _ in range(300):
        run.advance(100)
        run.keep()
        time.sleep(0.005)
    assert notices == [
        "recording into a slow disk has stopped, the run continues: the disk does not answer"
    ]
    began = time.monotonic()
    recorder.close(run, seconds=0.2)
    assert time.monotonic() - began < 1.0
    assert recorder.is_stuck
    target.free.set()
    wait_until(lambda: not recorder.is_stuck, 20.0)


# Leaps


def test_a_leap_ends_one_file_whole_and_begins_another(tmp_path: Path) -> None:
    run = Run(Learner(make_task("pendulum"), seed=2), make_task)
    notices: list[str] = []
    recordings = Recordings(run, Options(file=tmp_path / "run"), on_notice=notices.append)
    expected = []

    def leap(by: Callable[[], object], ending: str) -> None:
        expected.append((run.learner.seed, run.learner.step, ending))
        by()
        advance(run, 300)

    advance(run, 500)
    run.change(SetBeta(0.5))
    advance(run, 500)
    leap(run.undo, "β 0.5 was undone")
    leap(lambda: run.reset(seed=7), "the run was reset")
    replay = run.replay(run.tape.before(0))  # type: ignore[arg-type]
    replay.go_to(100)
    leap(lambda: run.take_over(replay), "the run continues from step 100")
    expected.append((run.learner.seed, run.learner.step, "it was stopped"))
    recordings.close()
    assert not notices
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "run-2.rrd", "run-3.rrd", "run-4.rrd", "run.rrd",
    ]  # fmt: skip
    for name, (seed, step, ending) in zip(("", "-2", "-3", "-4"), expected, strict=True):
        one = open_recording(tmp_path / f"run{name}.rrd")
        assert (one.header.seed, one.last_step, one.notice) == (seed, step, None)
        assert str(one.ending).split(" (")[0] == ending
        assert made_again(one)


def test_a_name_that_is_taken_after_a_leap_ends_the_recording_alone(tmp_path: Path) -> None:
    (tmp_path / "run-2.rrd").write_text("precious")
    run = Run(Learner(make_task("pendulum")), make_task)
    notices: list[str] = []
    recordings = Recordings(run, Options(file=tmp_path / "run.rrd"), on_notice=notices.append)
    advance(run, 500)
    run.reset()
    for _ in range(3):
        advance(run, 200)
        run.change(SetBeta(0.7))
        run.keep()
        run.undo()
    assert notices == [
        f"recording has stopped, the run continues: {tmp_path}/run-2.rrd exists already and is not "
        "overwritten"
    ]
    assert not recordings.is_on
    assert recordings.status is not None
    assert recordings.status.error
    assert (tmp_path / "run-2.rrd").read_text() == "precious"
    recordings.start(tmp_path / "another.rrd")
    advance(run, 200)
    assert recordings.is_on
    assert len(run.followers) == 1
    assert not recordings.close()
    assert len(notices) == 1
    assert open_recording(tmp_path / "run.rrd").last_step == 500
    assert open_recording(tmp_path / "another.rrd").last_step == run.learner.step


# Live viewers


@contextlib.contextmanager
def viewer(url: str, path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """rerun's own program, which receives what is streamed into a file."""
    from hebbviz.server.recording.rerun_program import _environment, _program

    command = [str(_program()), url, "--save", str(path), "--bind", "127.0.0.1", "--port", "0"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, env=_environment(), stdout=quiet, stderr=quiet) as process:
        try:
            yield process
        finally:
            process.kill()


def address_of_stream(program: Program) -> tuple[str, int]:
    found = program.wait_for(
        lambda: re.search(r"rerun (rerun\+http://127\.0\.0\.1:(\d+)/proxy)\n", program.out())
    )
    return found[1], int(found[2])


@pytest.mark.slow
def test_a_viewer_gets_what_is_recorded(tmp_path: Path, start: Callable[..., Program]) -> None:
    program = start(*serve("--speed", 200, "--stream", 0, "--record", tmp_path / "file.rrd"))
    url, port = address_of_stream(program)
    program.wait_for(lambda: "hebbviz is at" in program.out())
    assert not answers("127.0.0.2", port)
    assert not answers("::1", port)
    with viewer(url, tmp_path / "live.rrd"):
        wait_until(lambda: size(tmp_path / "live.rrd") > MEGABYTE // 2, PATIENCE)
        time.sleep(2.0)
        assert program.end() < ENDS
        wait_until(lambda: rests(tmp_path / "live.rrd"), 30.0)
    live, file = open_recording(tmp_path / "live.rrd"), open_recording(tmp_path / "file.rrd")
    assert (live.header.seed, live.header.step) == (file.header.seed, 0)
    assert 0 < live.last_step <= file.last_step
    assert file.last_step - live.last_step < 200 * 1.5
    assert made_again(live)
    kept = {m.step: m.keyframe.digest() for m in file.moments}
    again = {m.step: m.keyframe.digest() for m in live.moments if m.step in kept}
    assert len(again) > 1
    assert again == {step: kept[step] for step in again}
    assert program.err() == ""


@pytest.mark.slow
def test_a_viewer_that_stalls_or_is_killed_slows_nothing(
    tmp_path: Path, start: Callable[..., Program]
) -> None:
    program = start(*serve("--speed", 500, "--stream", 0, "--record", tmp_path / "run.rrd"))
    url, port = address_of_stream(program)
    silent = socket.create_connection(("127.0.0.1", port))
    preface = socket.create_connection(("127.0.0.1", port))
    preface.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + b"\x04\x00" + bytes(4))
    with (
        silent, preface, viewer(url, tmp_path / "a.rrd") as stalled,
        viewer(url, tmp_path / "b.rrd") as killed,
    ):  # fmt: skip
        for one in (tmp_path / "a.rrd", tmp_path / "b.rrd", tmp_path / "run.rrd"):
            program.wait_for(partial(step_now, one))
        usual = min(1.0, *(share_made(tmp_path / "run.rrd", 500) for _ in range(3)))
        stalled.send_signal(signal.SIGSTOP)
        killed.kill()
        shares = [share_made(tmp_path / "run.rrd", 500) for _ in range(5)]
        assert sorted(shares)[2] > 0.5 * usual, "what is held up makes no steps"
        reached = step_now(tmp_path / "run.rrd")
        program.wait_for(lambda: step_now(tmp_path / "run.rrd") > reached)
        assert program.err() == ""
        assert program.end() < ENDS
    assert program.process.returncode == 0
    stopped = "recording into the stream has stopped, the run continues"
    left = f"hebbviz: {stopped}: {StreamTarget.silence}\n"
    assert program.err() in ("", left), "what is left at the end is not waited for"
    recording = open_recording(tmp_path / "run.rrd")
    assert (recording.ending, recording.notice) == ("it was stopped", None)


def share_made(path: Path, speed: float, seconds: float = 3.0) -> float:
    """How much of a speed comes into a recording in a while; 1 or more where nothing is lost."""
    before, began = step_now(path), time.monotonic()
    time.sleep(seconds)
    made, took = step_now(path) - before, time.monotonic() - began
    return made / (speed * (took - segment.FLUSH_SECONDS))


def step_now(path: Path) -> int:
    """The last step that is in a recording which goes on; 0 if it does not say yet what it is."""
    with contextlib.suppress(BadRecording, OSError):
        return open_recording(path).last_step
    return 0


def test_a_port_that_is_taken_is_one_line_and_leaves_no_file(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        code = main(
            ["serve", "--no-browser", "--port", "0", "--stream", str(port)]
            + ["--record", str(tmp_path / "run.rrd")]
        )
    out, err = capfd.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert f"cannot stream on port {port}: address already in use; give --stream another" in err
    assert not list(tmp_path.iterdir())


# Which steps are kept


class Simulated:
    """A run with a clock of its own, `speed` steps a second at each time, thinned."""

    def __init__(
        self, budget: int, step_size: int, speed: Callable[[float], float], seconds: float
    ) -> None:
        self.plans: list[tuple[int, Plan]] = []
        self.kept: list[tuple[int, int]] = []
        self.spent: list[tuple[float, float]] = []
        thin, now, step, spent = Thinning(WINDOW, budget, thinning.FULL, 0.0), 0.0, 0, 0.0
        while now < seconds:
            plan = thin.plan(step, step_size, now)
            self.plans.append((step, plan))
            start = step
            while step < plan.until and now < seconds:
                made = min(plan.until - step, max(1, int(speed(now) * 0.05)))
                step, now = step + made, now + made / speed(now)
                thin.note_speed(step, now)
                if plan.keep:
                    thin.spend(made * step_size)
                    spent += made * step_size
                self.spent.append((now, spent))
            if plan.keep and step > start:
                self.kept.append((start, step))
        self.steps = step


WINDOW = 500
BUDGETS = st.integers(10**5, 10**9)
WINDOWS = st.floats(0.2, 300.0)
"""So many windows a minute would take all of the budget."""
SPEEDS = st.floats(-2.0, 5.0).map(lambda power: 10.0**power)
"""In those windows a minute."""
FEW = settings(max_examples=30)


def sizes(budget: int, windows: float) -> tuple[int, float]:
    """Bytes of a step, and how many steps a second take all of the budget."""
    return max(1, round(budget / windows / WINDOW)), windows * WINDOW / 60.0


@FEW
@given(budget=BUDGETS, windows=WINDOWS, one=SPEEDS, other=SPEEDS, period=st.floats(1.0, 100.0))
def test_what_is_kept_stays_within_the_budget(
    budget: int, windows: float, one: float, other: float, period: float
) -> None:
    """At all times, but for what a run makes before it is seen to have become faster."""
    size, fair = sizes(budget, windows)
    run = Simulated(
        budget, size, lambda t: fair * (one if t % period < period / 2 else other), 240.0
    )
    now, spent = np.array(run.spent).T
    allowance = budget * (now / 60.0 + thinning.SAVED_MINUTES)
    unseen = thinning.SPEED_SECONDS / 10 * fair * max(one, other)
    assert (spent <= allowance + (unseen + 2 * WINDOW) * size).all()


@FEW
@given(budget=BUDGETS, windows=WINDOWS, share=st.floats(0.01, 0.95))
def test_every_step_of_a_slow_run_is_kept(budget: int, windows: float, share: float) -> None:
    size, fair = sizes(budget, windows)
    run = Simulated(budget, size, lambda _: share * fair, 240.0)
    assert sum(end - start for start, end in run.kept) == run.steps


@FEW
@given(budget=BUDGETS, windows=WINDOWS, speed=SPEEDS)
def test_windows_are_whole_and_at_regular_intervals(
    budget: int, windows: float, speed: float
) -> None:
    """They stand at all multiples of the interval, which seldom changes."""
    size, fair = sizes(budget, windows)
    run = Simulated(budget, size, lambda _: speed * fair, 240.0)
    for (step, plan), (following, _) in pairwise(run.plans):
        interval = plan.every * WINDOW
        assert math.log2(plan.every).is_integer()
        assert plan.keep == (step % interval == 0)
        assert following == plan.until
        assert plan.until == (step + WINDOW if plan.keep else -(-step // interval) * interval)
    changes = sum(a.every != b.every for (_, a), (_, b) in pairwise(run.plans))
    assert changes <= 240 / 5, "more often than once in 5 s"


@pytest.mark.parametrize("start", [1, 499, 500, 1234])
def test_a_run_that_begins_anywhere_is_kept_from_a_window_on(start: int) -> None:
    thin = Thinning(WINDOW, 10**6, thinning.FULL, 0.0)
    plan = thin.plan(start, 100, 0.0)
    assert plan.until % WINDOW == 0
    assert start < plan.until <= start + WINDOW


def test_light_recordings_keep_no_step() -> None:
    thin = Thinning(WINDOW, 10**9, thinning.LIGHT, 0.0)
    assert not thin.plan(0, 1, 0.0).keep
    assert not thin.affords(1, 1e-9)


@given(number=st.integers(1, 999), unit=st.sampled_from(["k", "M", "G"]), b=st.booleans())
def test_budgets_are_read_as_they_are_written(number: int, unit: str, b: bool) -> None:
    size = number * {"k": 10**3, "M": 10**6, "G": 10**9}[unit]
    for text in (f"{number}{unit}{'B' * b}", f" {number} {unit}", str(size)):
        if size < thinning.LEAST_BUDGET:
            with pytest.raises(ValueError, match=r"budget must be bytes a minute from 100 kB"):
                parse_budget(text)
        else:
            assert parse_budget(text) == size
            assert parse_budget(thinning.words(size).replace(" ", "")) == size


@pytest.mark.parametrize("text", ["", "fast", "-5MB", "30 MiB", "1e9", "nan", "30TB", "2e3GB"])
def test_what_is_no_budget_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="such as 30MB, got"):
        parse_budget(text)
