"""Whatever becomes of stdout, of the terminal or of who reads: what is to be saved is saved."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import TextIO

import pytest
from raw_client import wait_until

from hebbviz.learner import saves
from hebbviz.learner.learner import Learner
from hebbviz.server import app
from hebbviz.server.cli.main import main
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recordings import Options
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.interrupts import Interrupts

ROOT = Path(__file__).parents[2]
HEBBVIZ = [sys.executable, "-m", "hebbviz"]
PATIENCE = 60.0


def left_reader() -> TextIO:
    read, write = os.pipe()
    os.close(read)
    return os.fdopen(write, "w")


def full_disk() -> TextIO:
    return Path("/dev/full").open("w")


STDOUTS: dict[str, Callable[[], TextIO | None]] = {
    "a reader that left": left_reader,
    "a full disk": full_disk,
    "closed": lambda: None,
}
WHY = {
    "a reader that left": "",
    "a full disk": "hebbviz: cannot print to stdout: no space left on device; all else is done "
    "and saved as usual\n",
    "closed": "hebbviz: cannot print to stdout: it is closed; all else is done and saved as "
    "usual\n",
}


@contextlib.contextmanager
def stdout_is(kind: str) -> Iterator[None]:
    before, sys.stdout = sys.stdout, STDOUTS[kind]()  # type: ignore[assignment]  # or None
    lost = sys.stdout
    try:
        yield
    finally:
        sys.stdout = before
        if lost is not None:
            with contextlib.suppress(OSError):
                lost.close()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.rrd"
    assert main(["train", "--task", "synapse", "--steps", "20", "--record", str(path)]) == 0
    return path


COMMANDS = {
    "--help": "",
    "train --task synapse --steps 5 --json --save {0}/x.npz": "x.npz",
    "train --task synapse --steps 5 --record {0}/x.rrd": "x.rrd",
    "inspect {1}": "",
    "export {1} --out {0}/out": "out/*.csv",
}
SLOW_COMMANDS = {
    "figure synapse --quick --out {0}": "synapse*.png",
    "sweep --task synapse --gamma 0.1 --lanes 1 --steps 100 --out {0}": "*.png",
    "bench --seconds 0.1": "",
}


@pytest.mark.parametrize(
    ("command", "stdout"),
    [
        *product(COMMANDS, STDOUTS),
        *(pytest.param(c, "a full disk", marks=pytest.mark.slow) for c in SLOW_COMMANDS),
    ],
)
def test_all_is_saved_and_the_exit_code_says_that_something_was_not_printed(
    command: str, stdout: str, recorded: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with stdout_is(stdout):
        assert main(command.format(tmp_path, recorded).split()) == 1
    told = [line for line in capfd.readouterr().err.splitlines(keepends=True) if "stdout" in line]
    assert "".join(told) == WHY[stdout]
    wanted = {**COMMANDS, **SLOW_COMMANDS}[command]
    assert not wanted or list(tmp_path.glob(wanted))
    for path in tmp_path.glob("*.rrd"):
        assert open_recording(path).notice is None


@pytest.mark.parametrize("stdout", STDOUTS)
def test_a_page_ends_as_it_would_and_its_recording_is_whole(stdout: str, tmp_path: Path) -> None:
    """In a program of the user's own, too, whose stdout nobody looks after."""
    learner, stop = Learner(make_task("synapse")), threading.Event()

    def stop_soon() -> None:
        try:
            wait_until(lambda: learner.step > 5, PATIENCE)
        finally:
            stop.set()

    stopper = threading.Thread(target=stop_soon)
    stopper.start()
    path = tmp_path / "run.rrd"
    with stdout_is(stdout):
        app.serve(learner, port=0, speed=200, stop=stop, recording=Options(file=path))
    stopper.join()
    recording = open_recording(path)
    assert (recording.ending, recording.notice) == ("it was stopped", None)


def test_an_error_is_told_where_stderr_can_take_it_and_does_no_harm_where_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with full_disk() as nowhere, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", nowhere)
        assert main(["train", "--beta", "1", "--steps", "5"]) == 2
        saved = tmp_path / "x.npz"
        assert main(["train", "--task", "synapse", "--steps", "5", "--save", str(saved)]) == 0
        assert saved.exists()
    with contextlib.suppress(OSError):
        nowhere.close()


# Processes


@contextlib.contextmanager
def started(command: str, **options: object) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [*HEBBVIZ, *command.split()], cwd=ROOT, text=True, **options,  # type: ignore[call-overload]
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            process.kill()


SERVE = "serve --task synapse --speed 500 --port 0 --no-browser --record {}"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "number"),
    [("left", signal.SIGINT), ("full", signal.SIGTERM), ("closed", signal.SIGHUP)],
)
def test_a_stopped_page_ends_with_0_and_a_whole_recording(
    lost: str, number: signal.Signals, tmp_path: Path
) -> None:
    """`hebbviz --record f.rrd | tee log`, where Ctrl-C ends tee first; > /dev/full; >&-."""
    path, stderr = tmp_path / "run.rrd", tmp_path / "stderr"
    read, write = os.pipe()
    closes = {"preexec_fn": lambda: os.close(1)} if lost == "closed" else {}
    with contextlib.ExitStack() as stack:
        err = stack.enter_context(stderr.open("w"))
        full = os.open("/dev/full", os.O_WRONLY)
        stack.callback(os.close, full)
        out = full if lost == "full" else write
        process = stack.enter_context(
            started(SERVE.format(path), stdout=out, stderr=err, **closes)
        )  # fmt: skip
        os.close(write)
        wait_until(lambda: path.exists() and path.stat().st_size > 100_000, PATIENCE)
        os.close(read)
        process.send_signal(number)
        assert process.wait(timeout=PATIENCE) == 0
    said = stderr.read_text()
    assert said.count("\n") == (lost != "left"), said
    recording = open_recording(path)
    assert (recording.ending, recording.notice) == ("it was stopped", None)
    assert recording.last_step > 0


@pytest.mark.slow
@pytest.mark.parametrize("lost", STDOUTS)
@pytest.mark.parametrize("command", ["replay", "view"])
def test_a_recording_is_shown_to_the_end_whoever_reads(
    command: str, lost: str, recorded: Path, tmp_path: Path
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    out, stderr = STDOUTS[lost](), tmp_path / "stderr"
    closes = {"preexec_fn": lambda: os.close(1)} if out is None else {"stdout": out}
    with (
        contextlib.nullcontext() if out is None else out,
        stderr.open("w") as err,
        started(f"{command} {recorded} --port {port} --no-browser", stderr=err, **closes) as shown,
    ):
        wait_until(lambda: answers(port), PATIENCE)
        shown.send_signal(signal.SIGTERM)
        assert shown.wait(timeout=PATIENCE) == 0
    assert stderr.read_text() == WHY[lost]


def answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
        return True
    return False


def test_only_a_closed_terminal_may_signal_twice_without_impatience() -> None:
    with Interrupts() as interrupts:
        os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGHUP)
        assert interrupts.stop.is_set()
        assert interrupts.number == signal.SIGHUP
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


TRAIN = "train --task synapse --steps 100000000000 --save {0}/x.npz --record {0}/run.rrd"


def has_begun(folder: Path) -> bool:
    path = folder / "run.rrd"
    return path.exists() and path.stat().st_size > 300_000


def check_saved(folder: Path) -> None:
    saved, recording = saves.load(folder / "x.npz", make_task), open_recording(folder / "run.rrd")
    assert saved.step == recording.last_step > 0
    assert (recording.ending, recording.notice) == ("it was stopped", None)


@contextlib.contextmanager
def training_on_a_terminal(folder: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The training, and our end of its terminal."""
    ours, theirs = os.openpty()
    with started(
        TRAIN.format(folder), stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
        preexec_fn=lambda: os.login_tty(theirs),
    ) as process:  # fmt: skip
        os.close(theirs)
        yield process, ours


@pytest.mark.slow
def test_a_terminal_that_is_closed_ends_a_training_which_is_saved(tmp_path: Path) -> None:
    """Its progress bar is on that terminal; the shell that goes sends SIGHUP a second time."""
    with training_on_a_terminal(tmp_path) as (process, ours):
        drain = threading.Thread(target=read_all, args=(ours,), daemon=True)
        drain.start()
        wait_until(lambda: has_begun(tmp_path), PATIENCE)
        process.send_signal(signal.SIGHUP)  # the shell's; then the terminal's
        process.send_signal(signal.SIGHUP)
        assert process.wait(timeout=PATIENCE) == 128 + signal.SIGHUP
    drain.join()
    os.close(ours)
    check_saved(tmp_path)


def read_all(descriptor: int) -> None:
    with contextlib.suppress(OSError):
        while os.read(descriptor, 65536):
            pass


@pytest.mark.slow
def test_the_terminal_is_gone_before_anything_is_said(tmp_path: Path) -> None:
    with training_on_a_terminal(tmp_path) as (process, ours):
        wait_until(lambda: has_begun(tmp_path), PATIENCE)
        os.close(ours)  # a terminal that is closed sends SIGHUP and takes nothing any more
        assert process.wait(timeout=PATIENCE) == 128 + signal.SIGHUP
    check_saved(tmp_path)


@pytest.mark.slow
def test_under_nohup_a_closed_terminal_ends_nothing(tmp_path: Path) -> None:
    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    with started(
        TRAIN.format(tmp_path), stderr=subprocess.PIPE, preexec_fn=ignore
    ) as process:  # fmt: skip
        wait_until(lambda: has_begun(tmp_path), PATIENCE)
        process.send_signal(signal.SIGHUP)
        size = (tmp_path / "run.rrd").stat().st_size
        wait_until(lambda: (tmp_path / "run.rrd").stat().st_size > size + 10_000, PATIENCE)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signal.SIGTERM
    assert re.fullmatch(r"hebbviz: stopped at step [\d,]+; saved in .*\n", errors)
    check_saved(tmp_path)
