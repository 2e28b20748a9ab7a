"""How much of its speed a run keeps while one client floods the server, and what comes back after.

    python tests/benchmarks/floods.py                  # each kind of flood; about five minutes
    python tests/benchmarks/floods.py sliders visits   # these; see tests/support/attacker.py

The attacker is a process of its own on the same cores. It is stopped and let go on by turns, and
each turn is compared with the rest before and after it, for the machine may do other things too.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from attacker import CROWDS, FLOODS  # noqa: E402
from raw_client import wait_until  # noqa: E402

from hebbviz.learner.frames import Block  # noqa: E402
from hebbviz.learner.learner import Learner  # noqa: E402
from hebbviz.server.app import Site  # noqa: E402
from hebbviz.server.live.commands import StartRecording, StopRecording  # noqa: E402
from hebbviz.server.recording.recordings import Options  # noqa: E402
from hebbviz.server.run.run import Follower, Run  # noqa: E402
from hebbviz.server.web.access import Access  # noqa: E402
from hebbviz.sims.loading import make_task  # noqa: E402

KEPT, KEPT_AFTER, GROWN = 0.5, 0.9, 60.0
"""Bars: shares of the speed during a flood and a second after it; MB that the allocator keeps."""
KINDS = (*FLOODS, *CROWDS)


class Steps(Follower):
    """Counts those that are made."""

    made = 0

    def block(self, run: Run, block: Block) -> None:
        self.made += len(block.fired)


@dataclass(frozen=True)
class Kept:
    """Shares of the speed during a flood and a second after it, and MB before and after."""

    kind: str
    during: float
    after: float
    before_mb: float
    after_mb: float
    server_cpu: float
    """Seconds of all threads but the run's, of a second of flood."""

    def __str__(self) -> str:
        return (
            f"{self.kind:10} {'met   ' if self.is_met else 'MISSED'} during {self.during:5.0%}, "
            f"a second after {self.after:5.0%}, {self.before_mb:.0f} to {self.after_mb:.0f} MB, "
            f"{self.server_cpu:.2f} s of CPU a second besides the run"
        )

    @property
    def is_met(self) -> bool:
        grown = self.after_mb - self.before_mb
        return self.during > KEPT and self.after > KEPT_AFTER and grown < GROWN


class Bench:
    """A server whose run goes as fast as it can, in this process."""

    def __init__(self, site: Site) -> None:
        self.site, self.steps = site, Steps()
        site._run.followers.append(self.steps)

    def speed(self, seconds: float) -> float:
        """Steps per second."""
        began, made = time.monotonic(), self.steps.made
        time.sleep(seconds)
        return (self.steps.made - made) / (time.monotonic() - began)

    def warm(self) -> None:
        """Record once, so that what is loaded for that is not taken for a flood's."""
        worker = self.site._worker
        assert worker is not None
        worker.send(StartRecording("warm"))
        self.speed(3.0)
        worker.send(StopRecording())
        self.speed(3.0)

    def other_cpu(self) -> float:
        """Seconds of all threads but the run's, so far."""
        worker = self.site._worker
        assert worker is not None
        return time.process_time() - time.clock_gettime(time.pthread_getcpuclockid(worker.ident))  # type: ignore[arg-type]

    def flood(self, kind: str, turns: int = 5, seconds: float = 2.0) -> Kept:
        """Let a flood loose for so many turns."""
        before_mb, first = memory(), self.speed(2.0)
        rests, floods, cpu = [first], [], 0.0
        port = self.site._server.get_port()
        with attack(port, kind, turns * (seconds + 4.0)) as attacker:
            for _ in range(turns):
                attacker.send_signal(signal.SIGCONT)
                began = self.other_cpu()
                floods.append(self.speed(seconds))
                cpu += self.other_cpu() - began
                attacker.send_signal(signal.SIGSTOP)
                time.sleep(1.0)
                rests.append(self.speed(1.0))
        time.sleep(1.0)
        last = self.speed(2.0)
        if kind in CROWDS:  # those who are connected stay so while the attacker is stopped
            rests = [first] + [statistics.mean([first, last])] * (turns - 1) + [last]
        around = [(a + b) / 2 for a, b in pairwise(rests)]
        during = statistics.median(f / r for f, r in zip(floods, around, strict=True))
        later = last / first if kind in CROWDS else statistics.median(rests[1:]) / first
        return Kept(kind, during, later, before_mb, memory(), cpu / (turns * seconds))


@contextlib.contextmanager
def opened(task: str = "pendulum", access: Access = Access()) -> Iterator[Bench]:  # noqa: B008
    """A server as a user starts it, which runs for the time."""
    stop = threading.Event()
    with tempfile.TemporaryDirectory() as folder:
        site = Site(
            Learner(make_task(task), seed=0), host="127.0.0.1", port=0, speed="max",
            task_name=None, recording=Options(folder=Path(folder)), access=access,
        )  # fmt: skip
        thread = threading.Thread(target=lambda: site.run(stop, open_browser=False))
        thread.start()
        try:
            wait_until(lambda: site._worker is not None and site._worker.latest is not None, 60)
            yield Bench(site)
        finally:
            stop.set()
            thread.join()


@contextlib.contextmanager
def attack(port: int, kind: str, seconds: float) -> Iterator[subprocess.Popen[str]]:
    """An attacker that is stopped at first."""
    program = [
        sys.executable,
        str(ROOT / "tests/support/attacker.py"),
        str(port),
        kind,
        str(seconds),
    ]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as attacker:
        assert attacker.stdout is not None
        assert attacker.stdout.readline() == "flooding\n"
        attacker.send_signal(signal.SIGSTOP)
        try:
            yield attacker
        finally:
            attacker.kill()


def memory() -> float:
    """MB of this process that are in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", default=KINDS, metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--task", default="pendulum")
    args = parser.parse_args()
    all_met = True
    with opened(args.task) as bench:
        bench.warm()
        for kind in args.kinds:
            kept = bench.flood(kind)
            all_met = all_met and kept.is_met
            sys.stdout.write(f"{kept}\n")
            sys.stdout.flush()
    return 0 if all_met else 1


if __name__ == "__main__":
    sys.exit(main())
