"""What random numbers cost: lanes of sonar as they are, and with a generator of no rounds.

    python tests/benchmarks/random_numbers.py [--turns N]

A Philox of no rounds gives its counter back: not random, and next to free. So the ratio of the two
is the most that any other generator could win. Each turn is a process of its own, by turns; times
are of the thread's own processor time, and the least of each counts.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

LANES, STEPS, REPEATS = 64, 4_000, 40


def main() -> None:
    parser = argparse.ArgumentParser(description="What random numbers cost.")
    parser.add_argument("--turns", type=int, default=5, help="processes of each (default 5)")
    parser.add_argument("--rounds", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.rounds is not None:
        say(" ".join(str(time) for time in measured(args.rounds)))
        return
    with tempfile.TemporaryDirectory() as cache:
        turns = [(turn(7, cache), turn(0, cache)) for _ in range(args.turns)]
    for k, dtype in enumerate(("float32", "float64")):
        real, free = (min(pair[i][k] for pair in turns) for i in (0, 1))
        say(f"{dtype}: {real:.2f} ns a step and lane, {free:.2f} with free numbers: "
            f"at most {real / free:.2f} times as fast")  # fmt: skip


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")


def turn(rounds: int, cache: str) -> list[float]:
    """The times of a process of its own, whose compiled code is not kept with the program's."""
    done = subprocess.run(
        [sys.executable, __file__, "--rounds", str(rounds)],
        env={"NUMBA_CACHE_DIR": f"{cache}/{rounds}", "PATH": ""},
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return [float(word) for word in done.stdout.split()]


def measured(rounds: int) -> list[float]:
    """Nanoseconds of processor time a step and lane, in float32 and in float64."""
    from hebbviz.numerics import counter_rng

    counter_rng._ROUNDS = rounds  # before anything is compiled
    import numpy as np

    from hebbviz.learner.learner import Learner
    from hebbviz.sims.worlds.sonar import Sonar

    return [
        _least(Learner(Sonar("paper"), lanes=LANES, dtype=dtype, written_out=True))
        for dtype in (np.float32, np.float64)
    ]


def _least(learner) -> float:
    learner.skip(STEPS)
    times = []
    for _ in range(REPEATS):
        began = time.thread_time()
        learner.skip(STEPS)
        times.append(time.thread_time() - began)
    return min(times) / STEPS / LANES * 1e9


if __name__ == "__main__":
    main()
