"""How much of its speed a run keeps while a lecture hall looks on, and how many frames each gets.

    python tests/benchmarks/lecture.py                      # 40 readers; about a minute
    python tests/benchmarks/lecture.py --readers 60 --task sonar

The readers are in a process of their own on the same cores. They come and go, and each turn is
compared with the speed before and after it.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from raw_client import RawClient  # noqa: E402

from hebbviz.server.web.access import Access, Role  # noqa: E402
from tests.benchmarks.floods import opened  # noqa: E402

KEPT = 0.8
"""Bar: share of the speed."""


def sit(port: int, path: str, readers: int) -> None:
    """Look on until stdin is closed; for each line say how many frames came, and who is out."""
    audience = [RawClient(port, path=path, decode=False) for _ in range(readers)]
    sys.stdout.write("seated\n")
    sys.stdout.flush()
    for _ in sys.stdin:
        frames, out = sum(one.frames for one in audience), sum(one.closed for one in audience)
        sys.stdout.write(f"{frames} {out}\n")
        sys.stdout.flush()


class Audience:
    """Readers in a process of their own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def count(self) -> tuple[int, int]:
        """How many frames have come in all, and how many readers were turned out."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        frames, out = self._process.stdout.readline().split()
        return int(frames), int(out)


@contextlib.contextmanager
def seated(port: int, path: str, readers: int) -> Iterator[Audience]:
    program = [sys.executable, __file__, "--sit", str(port), path, "--readers", str(readers)]
    pipe = subprocess.PIPE
    with subprocess.Popen(program, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "seated\n"
        yield Audience(process)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--readers", type=int, default=40)
    parser.add_argument("--task", default="pendulum")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--sit", nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.sit is not None:
        sit(int(args.sit[0]), args.sit[1], args.readers)
        return 0
    with opened(args.task, access=Access(token=True)) as bench:
        port = bench.site._server.get_port()
        path = bench.site._entrance.link("", Role.READER)
        bench.speed(2.0)
        alone, watched, rates = [bench.speed(4.0)], [], []
        for _ in range(args.turns):
            with seated(port, path, args.readers) as audience:
                bench.speed(1.0)
                (first, _), began = audience.count(), time.monotonic()
                watched.append(bench.speed(4.0))
                last, out = audience.count()
                rates.append((last - first) / args.readers / (time.monotonic() - began))
            bench.speed(1.0)
            alone.append(bench.speed(4.0))
    around = [(a + b) / 2 for a, b in pairwise(alone)]
    kept = statistics.median(w / a for w, a in zip(watched, around, strict=True))
    verdict = "met" if kept >= KEPT and not out else "MISSED"
    sys.stdout.write(
        f"{args.readers} readers, {out} of them turned out: the run keeps {kept:.0%} of its speed "
        f"(bar {KEPT:.0%}: {verdict}), {statistics.median(rates):.1f} frames a second for each\n"
    )
    return 0 if verdict == "met" else 1


if __name__ == "__main__":
    sys.exit(main())
