"""What was recorded is let go of: threads and memory are what they were before."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from raw_client import wait_until

import hebbviz.server.run.run
from hebbviz.learner.learner import Learner
from hebbviz.server.recording import streams
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.recording.rows import Rows, scalars
from hebbviz.server.recording.streams import Stream
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task

ROOT = Path(__file__).parents[2]


def threads() -> int:
    """All of the process, rerun's too."""
    return len(list(Path("/proc/self/task").iterdir()))


linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="counts threads by /proc")


def begun(folder: Path) -> tuple[Run, Recordings]:
    run = Run(Learner(make_task("pendulum"), seed=1), make_task)
    return run, Recordings(run, Options(folder=folder), on_notice=pytest.fail)


def record(run: Run, recordings: Recordings, path: Path) -> None:
    recordings.start(path)
    run.advance(50)
    run.frame()
    recordings.stop()


def record_and_reset(run: Run) -> None:
    run.advance(50)
    run.frame()
    run.reset()


@linux
def test_recordings_and_resets_leave_no_threads(tmp_path: Path) -> None:
    run, recordings = begun(tmp_path)
    record(run, recordings, tmp_path / "first.rrd")
    before = threads()
    for k in range(4):
        record(run, recordings, tmp_path / f"run-{k}.rrd")
    wait_until(lambda: threads() <= before, 20.0)
    recordings.start(tmp_path / "resets.rrd")
    for _ in range(4):
        record_and_reset(run)
    recordings.close()
    wait_until(lambda: threads() <= before, 20.0)
    assert open_recording(tmp_path / "resets-4.rrd").last_step == 50


def measured(folder: Path) -> list[list[float]]:
    """Threads and megabytes before 50 recordings, after them, and after as many resets twice."""

    def now() -> list[float]:
        time.sleep(1.0)  # what is begun comes to its end
        words = Path("/proc/self/status").read_text()
        size = next(line for line in words.splitlines() if line.startswith("VmRSS"))
        return [threads(), int(size.split()[1]) / 1000]

    hebbviz.server.run.run.MOST_UNDOS = 5  # a hundred would be kept
    run, recordings = begun(folder)
    for k in range(10):
        record(run, recordings, folder / f"warm-{k}.rrd")
    found = [now()]
    for k in range(50):
        record(run, recordings, folder / f"run-{k}.rrd")
    found.append(now())
    recordings.start(folder / "resets.rrd")
    for times in (10, 50):
        for _ in range(times):
            record_and_reset(run)
        found.append(now())
    recordings.close()
    return found


def in_a_process_of_its_own(name: str, folder: Path) -> Any:
    """What a function of this module returns of a folder."""
    program = (
        "import sys, json, pathlib; sys.path[:0] = ['tests/support', '.']; import "
        "hebbviz.server.recording;"
        " "
        "import tests.server.test_recording_streams as t; measure = getattr(t, sys.argv[1]);"
        " print(json.dumps(measure(pathlib.Path(sys.argv[2]))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, name, str(folder)], cwd=ROOT, capture_output=True,
        text=True, check=True, timeout=300,
    )  # fmt: skip
    return json.loads(done.stdout)


@linux
@pytest.mark.slow
def test_threads_and_memory_stay_as_they_are(tmp_path: Path) -> None:
    first, recorded, reset, again = in_a_process_of_its_own("measured", tmp_path)
    assert recorded[0] <= first[0] + 1
    assert again[0] <= reset[0] + 1
    assert recorded[1] < first[1] + 30.0, "50 of 1.6 MB each would be 80"
    assert again[1] < reset[1] + 30.0


def anonymous_memory() -> float:
    """MB of this process that no file stands behind."""
    words = Path("/proc/self/status").read_text()
    return int(words.partition("RssAnon:")[2].split()[0]) / 1000


def kept_of_what_was_sent(folder: Path) -> float:
    """MB more than before, once chunks of ever more rows have passed through a stream."""
    stream = Stream()
    stream.set_sinks(rr.FileSink(folder / "run.rrd", write_footer=False))
    rows = Rows(stream, None)

    def send(count: int) -> None:
        rows.add("numbers", np.arange(count), np.random.default_rng(0).random(count), scalars)
        rows.flush()
        stream.flush(timeout_sec=30.0)

    for _ in range(20):
        send(1000)
    before = anonymous_memory()
    for thousands in range(1, 180, 5):
        send(1000 * thousands)
    return anonymous_memory() - before


@linux
def test_what_has_passed_through_a_stream_leaves_no_memory(tmp_path: Path) -> None:
    assert in_a_process_of_its_own("kept_of_what_was_sent", tmp_path) < 20.0, "of 40 MB"


def test_one_that_is_held_up_is_left_alone_and_holds_up_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is cleared up then: rerun would wait for it."""
    monkeypatch.setattr(streams, "LOOK", 0.01)
    held_up, cleared = Stream(), []
    monkeypatch.setattr(held_up, "answers", lambda: False)
    clear = streams.rerun_bindings.flush_and_cleanup_orphaned_recordings
    monkeypatch.setattr(
        streams.rerun_bindings, "flush_and_cleanup_orphaned_recordings",
        lambda: (cleared.append(1), clear()),
    )  # fmt: skip
    for _ in range(2):
        other = Stream()
        other.set_sinks(rr.FileSink(tmp_path / f"{other.identity}.rrd"))
        other.let_go()
    assert not cleared
    held_up.let_go()
    assert cleared


def test_a_stream_that_cannot_be_had_is_an_error_that_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(streams, "PATIENCE", 0.05)
    held, done = threading.Event(), threading.Event()

    def clear() -> None:
        held.set()
        done.wait(30.0)

    bindings = streams.rerun_bindings
    with monkeypatch.context() as patch:
        patch.setattr(bindings, "flush_and_cleanup_orphaned_recordings", clear)
        closing = threading.Thread(target=Stream().let_go)
        closing.start()
        assert held.wait(30.0)
        with pytest.raises(OSError, match="another recording is held up by its disk"):
            Stream()
        done.set()
        closing.join(30.0)
    Stream().let_go()
