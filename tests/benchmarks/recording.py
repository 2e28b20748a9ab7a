"""What recording costs and takes, and how fast a recording opens and seeks.

python tests/benchmarks/recording.py                # about 3 minutes
python tests/benchmarks/recording.py --minutes 10   # the size and memory of 10 minutes, measured

Speeds are ratios within one run: the same worker, on the same machine, with and without.
"""

from __future__ import annotations

import argparse
import random
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from hebbviz.learner.learner import Learner  # noqa: E402
from hebbviz.server.cli.training import Recorded, train  # noqa: E402
from hebbviz.server.live.commands import SetSpeed, SetWatch  # noqa: E402
from hebbviz.server.live.pacing import MAX  # noqa: E402
from hebbviz.server.live.playback import Check, Player  # noqa: E402
from hebbviz.server.live.session import Session  # noqa: E402
from hebbviz.server.live.worker import Worker  # noqa: E402
from hebbviz.server.recording.reader import open_recording  # noqa: E402
from hebbviz.server.recording.recordings import Options, Recordings  # noqa: E402
from hebbviz.server.run.run import Run  # noqa: E402
from hebbviz.sims.loading import make_task  # noqa: E402
from hebbviz.sims.program.compiling import warm_up  # noqa: E402

SECONDS, SETTLE, ROUNDS = 10.0, 8.0, 2


@contextmanager
def working(task: str, speed: float | str, file: Path | None) -> Iterator[tuple[Worker, Run]]:
    """A worker at a speed, recording into a file or not."""
    learner = Learner(make_task(task), seed=0)
    warm_up(learner)
    run = Run(learner, make_task)
    recordings = Recordings(run, Options(file=file), on_notice=print)
    worker = Worker(Session(run, on_notice=print, recordings=recordings))
    worker.send(SetSpeed(speed))
    worker.send(SetWatch(on=False))
    worker.start()
    try:
        yield worker, run
    finally:
        worker.stop()
        worker.join(5.0)
        recordings.close()


def speed_of(task: str, speed: float | str, file: Path | None, settle: float) -> float:
    """Steps a second over SECONDS, after it has settled."""
    with working(task, speed, file) as (_, run):
        time.sleep(settle)
        start, began = run.learner.step, time.perf_counter()
        time.sleep(SECONDS)
        return (run.learner.step - start) / (time.perf_counter() - began)


def cost(folder: Path, task: str, speed: float | str, label: str) -> None:
    """Speed with and without, by turns."""
    pairs = []
    for k in range(ROUNDS):
        without = speed_of(task, speed, None, 2.0)
        with_it = speed_of(task, speed, folder / f"{label}{k}.rrd", SETTLE)
        pairs.append((without, with_it))
    without, with_it = (statistics.median(x) for x in zip(*pairs, strict=True))
    say(
        f"{task} at {speed}: {without:,.0f} steps/s without, {with_it:,.0f} recording: "
        f"{100 * (1 - with_it / without):.1f} % less"
    )


def burst(folder: Path, task: str) -> None:
    """The first seconds of a recording at full speed, in which every step is kept."""
    without = speed_of(task, MAX, None, 0.5)
    with_it = speed_of(task, MAX, folder / f"burst-{task}.rrd", 0.0)
    say(f"{task} at max, its first {SECONDS:.0f} s: {100 * (1 - with_it / without):.1f} % less")


def size(folder: Path, minutes: float) -> None:
    """Size of the pendulum and of sonar at full speed for some minutes, and memory."""
    for task in ("pendulum", "sonar"):
        file = folder / f"size-{task}.rrd"
        with working(task, MAX, file):
            time.sleep(10.0)
            before = memory()
            time.sleep(60.0 * minutes - 10.0)
            grown = memory() - before
        size = file.stat().st_size
        say(
            f"{task}, {minutes:g} min at full speed: {size / 1e6:.0f} MB, "
            f"{size / 1e7 * 10 / minutes / 100:.2f} GB in 10 min at this rate; "
            f"memory grew by {grown / 1e6:.0f} MB after the first 10 s"
        )


def every_spike(folder: Path) -> None:
    """1e5 steps of sonar, every spike kept."""
    file = folder / "spikes.rrd"
    recorded = Recorded(
        Learner(make_task("sonar")), "sonar", Options(file=file), on_notice=print
    )  # fmt: skip
    with recorded:
        train(recorded, 100_000)
    kept = recorded.status
    assert kept is not None
    say(f"sonar, 1e5 steps: {kept.kept:,} of them kept, {file.stat().st_size / 1e6:.1f} MB")


def seek(folder: Path) -> None:
    """A recording of 1e6 steps of the pendulum: opening, and seeking 100 steps at random."""
    file = folder / "seek.rrd"
    recorded = Recorded(
        Learner(make_task("pendulum")), "pendulum", Options(file=file), on_notice=print
    )  # fmt: skip
    with recorded:
        train(recorded, 1_000_000)
    began = time.perf_counter()
    recording = open_recording(file)
    run = recording.run(make_task, make_task("pendulum"))
    opened = time.perf_counter() - began
    player = Player(run)
    chance, times = random.Random(0), []
    for _ in range(100):
        began = time.perf_counter()
        player.seek(chance.randrange(1_000_000))
        times.append(time.perf_counter() - began)
    while player.check is Check.PENDING:
        player.play(0.03, None)
    say(
        f"1e6 steps, {file.stat().st_size / 1e6:.0f} MB, {len(run.tape)} keyframes: opened in "
        f"{opened:.2f} s; 100 seeks: median {1e3 * statistics.median(times):.0f} ms, slowest "
        f"{1e3 * max(times):.0f} ms; the last one: {player.check.value}"
    )


def memory() -> int:
    """Resident memory in bytes."""
    with Path("/proc/self/statm").open() as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description="What recording costs.")
    parser.add_argument("--minutes", type=float, default=0.5, help="for the size at full speed")
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        every_spike(folder)
        seek(folder)
        cost(folder, "pendulum", 500.0, "ten-times")
        cost(folder, "pendulum", MAX, "full")
        cost(folder, "sonar", MAX, "sonar")
        burst(folder, "pendulum")
        size(folder, minutes)


if __name__ == "__main__":
    main()
