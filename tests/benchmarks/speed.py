"""How fast hebbviz is, against the limit and against others, all in one run.

    python tests/benchmarks/speed.py [--json] [--seconds S]

What `hebbviz bench` times, and in turn with it a C kernel of the same work (`limit.c`) and Brian2
(`brian.py`); then the memory's bandwidth (`memory.py`). Each rival is first checked to compute the
same thing as hebbviz. One whose spikes are others, and what cannot be had here, is left out, with
the reason. Compiling is not timed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from limit import LANES, SYNAPSES, NoCompiler, Tile, departure
from memory import traffic

from hebbviz.server.cli.speeds import (
    RATIOS,
    Contestant,
    Ratio,
    Speed,
    contestants,
    figures,
    race,
    table,
)

HERE = Path(__file__).parent
BRIAN_STEPS = 20_000
CHECKED = 2_500


@dataclass(frozen=True)
class Bar:
    """A ratio, and what it has to be at least."""

    name: str
    ratio: Ratio
    least: float

    def verdict(self, speeds: Mapping[str, Speed]) -> str:
        if not self.ratio.fits(speeds):
            return "not measured here"
        measured = self.ratio.of(speeds)
        word = "met" if measured >= self.least else "NOT MET"
        return f"{measured:.3g} (at least {self.least:g}): {word}"


def _bar(name: str, fast: str, slow: str, least: float) -> Bar:
    return Bar(name, Ratio(f"{fast}_to_{slow}", name, fast, slow), least)


BARS = (
    _bar("sonar lanes, float32 / Brian2 in C++", "lanes_float32", "brian_cpp", 100.0),
    _bar("sonar lanes / C kernel, float32", "lanes_float32", "c_float32", 0.5),
    _bar("sonar lanes / C kernel, float64", "lanes_float64", "c_float64", 0.5),
    _bar("one lane / Brian2 in C++", "one_lane", "brian_cpp", 5.0),
    _bar("pendulum lanes, float32 / pymunk", "pendulum_lanes", "pymunk", 30.0),
    _bar("two cores / one, float32", "cores_float32", "lanes_float32", 1.8),
    _bar("two cores / one, float64", "cores_float64", "lanes_float64", 1.8),
)


TOLD = (
    *RATIOS,
    *(
        Ratio(f"lanes_{p}_to_brian_cpp", f"lanes, {p} / Brian2 in C++", f"lanes_{p}", "brian_cpp")
        for p in ("float32", "float64")
    ),
)
"""Brian2 computes in float64: beside the ratio that has a bar stands that of like with like."""


class Different(Exception):
    """A rival does not compute the same; the message says how it departs."""


class Program(Contestant):
    """Brian2's C++ program, which runs BRIAN_STEPS steps and times them itself."""

    def __init__(self, folder: Path) -> None:
        super().__init__("brian_cpp", "Brian2, C++ standalone", 1, SYNAPSES, lambda _: self._run())
        self._folder = folder

    def seconds(self, steps: int) -> float:
        return self._run() * steps / BRIAN_STEPS

    def _run(self) -> float:
        subprocess.run(["./main"], cwd=self._folder, check=True, stdout=subprocess.DEVNULL)
        told = (self._folder / "results" / "last_run_info.txt").read_text()
        return float(told.split()[0])


def main() -> None:
    parser = argparse.ArgumentParser(description="Speeds against the limit and against others.")
    parser.add_argument("--json", action="store_true", help="print one line of JSON")
    parser.add_argument("--seconds", type=float, default=40.0, help="how long to race")
    parser.add_argument("--without-brian", action="store_true", help="Brian2 takes its minutes")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rivals = list(limits(folder))
        if not args.without_brian:
            rivals += list(brian(folder))
        speeds = race([*contestants(), *rivals], args.seconds)
        if any(isinstance(rival, Program) for rival in rivals):
            each = ask_brian("time", "20000")["ns_per_step"]
            cython = Speed("brian_cython", "Brian2, Cython", 1, SYNAPSES, 1e9 / each)
            speeds[cython.key] = cython
    memory = traffic()
    if args.json:
        bars = {bar.ratio.key: bar.verdict(speeds) for bar in BARS}
        said = figures(speeds, TOLD) | {"bars": bars, "memory_fraction": memory.fraction}
        sys.stdout.write(f"{json.dumps(said)}\n")
        return
    sys.stdout.write(f"{table(speeds, TOLD)}\n\n")
    sys.stdout.write("".join(f"{line}\n" for line in memory.lines()) + "\n")
    sys.stdout.write("".join(f"{bar.name:<38}{bar.verdict(speeds)}\n" for bar in BARS))


def limits(folder: Path) -> Iterator[Contestant]:
    """The C kernel, in both precisions."""
    for name in ("float32", "float64"):
        try:
            spikes, weights = departure(Tile(np.dtype(name).type, folder), CHECKED)
            against = f"C kernel, {name}, against the learner, {CHECKED} steps of {LANES} lanes"
            check_same(against, spikes, weights)
        except (NoCompiler, Different) as error:
            note(f"C kernel, {name}, left out: {error}")
        else:
            tile = Tile(np.dtype(name).type, folder)
            words = f"C kernel, {LANES} lanes, {name}"
            yield Contestant(f"c_{name}", words, LANES, SYNAPSES, tile.skip)


def brian(folder: Path) -> Iterator[Contestant]:
    """Brian2's C++ program, once both ways of running Brian2 have been checked."""
    try:
        for device in ("runtime", "cpp_standalone"):
            found = ask_brian("check", device, str(folder / "check"))
            against = f"Brian2, {device}, against the reference, {found['steps']} steps"
            departs = found["spikes_that_differ"], found["largest_difference_of_a_weight"]
            check_same(against, *departs)
        ask_brian("build", str(folder / "brian"), str(BRIAN_STEPS))
    except (RuntimeError, Different) as error:
        note(f"Brian2 left out: {error}")
    else:
        yield Program(folder / "brian")


def check_same(against: str, spikes: int, weights: float) -> None:
    """Say how a rival departs; raise Different if that is by a spike."""
    said = f"{against}: {spikes} spikes differ, weights by {weights:.1g}"
    if spikes:
        raise Different(said)
    note(said)


def ask_brian(*arguments: str) -> dict[str, Any]:
    """What `brian.py` says, run in a process of its own. Raises RuntimeError with its last line."""
    done = subprocess.run(
        [sys.executable, str(HERE / "brian.py"), *arguments],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    told: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return told


def note(line: str) -> None:
    sys.stderr.write(f"{line}\n")


if __name__ == "__main__":
    main()
