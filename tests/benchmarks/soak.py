"""A server at work for a quarter of an hour: no traceback, no thread, file or memory too many.

    python tests/benchmarks/soak.py                  # 15 minutes
    python tests/benchmarks/soak.py --seconds 120    # a try

`hebbviz --record` runs at full speed. Eight clients watch it, of which one is always leaving and
coming again, and they move sliders, give rewards, reset and undo; a tab in Chromium shows the page.
After the first third (5 minutes of 15) the process has what it needs: its threads and files must
then stay as many (but for viser's pool of them), and its memory flat. Its stores for rewinding and
undoing are bounded at 128 and 256 MB and would fill up all the while: here they hold 1 MB each.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from browser import open_browser, tab_at  # noqa: E402
from raw_client import CAMERA, RawClient, wait_until  # noqa: E402

from hebbviz.server.recording.reader import open_recording  # noqa: E402

CLIENTS = 8
STAY_SECONDS = 10.0
"""A client that comes and goes stays so long."""
SAMPLE_SECONDS = 2.0
GROWN_MB = 10.0
"""More since the first third is a leak; the allocators' pools and the page's log take some."""
PROGRAM = """
import hebbviz.server.run.run
from hebbviz.server.cli.main import program
hebbviz.server.run.run.MOST_BYTES = hebbviz.server.run.run.MOST_UNDO_BYTES = 1_000_000
program()
"""
"""The stores for rewinding and undoing are full within a minute; they would fill up for an hour."""
POOL = 32
"""viser's callbacks run in so many threads at most, which come as they are needed."""
LOST_SECONDS = 60.0
"""Within this a whole recording must end, on a machine that is busy."""


@dataclass(frozen=True)
class Sample:
    """Of a process: seconds since the start, threads, open files and MB in memory."""

    at: float
    threads: int
    files: int
    memory: float

    @classmethod
    def of(cls, pid: int, at: float) -> Sample:
        process = Path(f"/proc/{pid}")
        pages = int((process / "statm").read_text().split()[1])
        return cls(
            at, len(list((process / "task").iterdir())), len(list((process / "fd").iterdir())),
            pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        )  # fmt: skip


class Visitor(threading.Thread):
    """A client that does something now and then, and leaves and comes again if it `travels`."""

    def __init__(self, port: int, number: int, stop: threading.Event, *, travels: bool) -> None:
        super().__init__(name=f"visitor {number}", daemon=True)
        self._port, self._stop_all, self._travels = port, stop, travels
        self._random = random.Random(number)
        self.frames = 0
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            while not self._stop_all.is_set():
                with RawClient(self._port) as client:
                    self._stay(client)
                    self.frames += client.frames
        except BaseException as error:  # it is told in the end
            self.error = error

    def _stay(self, client: RawClient) -> None:
        client.find("Reset", timeout=30.0)
        until = time.monotonic() + (STAY_SECONDS if self._travels else float("inf"))
        while time.monotonic() < until and not self._stop_all.wait(self._random.uniform(0.2, 2.0)):
            self._act(client)

    def _act(self, client: RawClient) -> None:
        """Mostly looking and learning; a new run now and then."""
        chance = self._random.random()
        if chance < 0.4:
            client.send(CAMERA | {"position": [self._random.uniform(2.0, 6.0), 3.0, 3.0]})
        elif chance < 0.6:
            client.send_value("β by memory", round(self._random.uniform(1.0, 2.0), 2))
        elif chance < 0.8:
            client.send_value("γ, step size", -2.0)
        elif chance < 0.97:
            client.send_value("reward", self._random.choice(["+ reward", "− punishment"]))
        else:
            client.trigger("Undo" if chance < 0.997 else "Reset")


@contextlib.contextmanager
def served(recording: Path, said: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The program with small stores, and its port; what it says goes into a file."""
    program = [sys.executable, "-c", PROGRAM, "--no-browser", "--port", "0"]
    with said.open("wb") as out, subprocess.Popen(
        [*program, "--record", str(recording)], cwd=ROOT, stdout=out, stderr=subprocess.STDOUT
    ) as process:  # fmt: skip
        try:
            wait_until(lambda: b"hebbviz is at" in said.read_bytes(), 120)
            port = said.read_text().partition("127.0.0.1:")[2].partition(" ")[0]
            yield process, int(port)
        finally:
            process.kill()


def watch(process: subprocess.Popen[bytes], port: int, seconds: float) -> list[Sample]:
    """Let clients and a tab come, and look at the process until the time is over."""
    stop, began = threading.Event(), time.monotonic()
    visitors = [Visitor(port, k, stop, travels=k == 0) for k in range(CLIENTS)]
    samples = [Sample.of(process.pid, 0.0)]
    for visitor in visitors:
        visitor.start()
    with open_browser() as browser:
        address = f"http://127.0.0.1:{port}"
        with tab_at(browser, address, width=1000, height=700) as tab:
            while (at := time.monotonic() - began) < seconds and process.poll() is None:
                samples.append(Sample.of(process.pid, at))
                tab.wait_for_timeout(1000.0 * SAMPLE_SECONDS)
                if len(samples) % 15 == 1:
                    tell(samples[-1])
    stop.set()
    for visitor in visitors:
        visitor.join(30.0)
        if visitor.error is not None:
            raise RuntimeError(f"{visitor.name} failed") from visitor.error
    return samples


def faults(samples: list[Sample], seconds: float) -> Iterator[str]:
    """What has grown since the first third."""
    later = [s for s in samples if s.at >= seconds / 3]
    half = len(later) // 2
    first, last = later[:half], later[half:]
    # the middle one, for two recordings overlap for a moment when a run is reset or undone
    before, after = (statistics.median_low([s.files for s in part]) for part in (first, last))
    if after > before:
        yield f"files: {before}, and later {after}"
    most = max(s.threads for s in samples)
    if most > samples[0].threads + POOL:
        yield f"threads: {samples[0].threads} at first, and up to {most}"
    times, memory = [s.at for s in later], [s.memory for s in later]
    grown = statistics.linear_regression(times, memory).slope * (times[-1] - times[0])
    tell_line(f"memory: {grown:+.1f} MB since the first third")
    if grown > GROWN_MB:
        yield f"memory has grown by {grown:.1f} MB"


def ending(process: subprocess.Popen[bytes], recording: Path, said: Path) -> Iterator[str]:
    """What is wrong with how it ends, with what it said, and with what it recorded."""
    process.send_signal(signal.SIGINT)
    try:
        code = process.wait(LOST_SECONDS)
    except subprocess.TimeoutExpired:
        yield f"it did not end within {LOST_SECONDS:.0f} s"
        return
    text = said.read_text()
    if code != 0:
        yield f"exit code {code}"
    if any(word in text for word in ("Traceback", "socket.send", "Error")):
        yield f"it said:\n{text[:2000]}"
    whole = open_recording(recording)
    tell_line(f"recorded to step {whole.last_step:,}; it said:\n{text.strip()}")


def tell(sample: Sample) -> None:
    tell_line(
        f"{sample.at:6.0f} s: {sample.threads} threads, {sample.files} files, "
        f"{sample.memory:.1f} MB"
    )


def tell_line(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=900.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder:
        recording, said = Path(folder) / "soak.rrd", Path(folder) / "said.txt"
        with served(recording, said) as (process, port):
            samples = watch(process, port, seconds)
            found = [*faults(samples, seconds), *ending(process, recording, said)]
    tell(samples[-1])
    for fault in found:
        tell_line(f"FAULT: {fault}")
    tell_line("failed" if found else "no fault")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
