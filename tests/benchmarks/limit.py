"""The C kernel of `limit.c`, compiled for this machine and called from Python.

    python tests/benchmarks/limit.py

prints the time of a step of one lane in float32 and float64.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from hebbviz.learner.learner import Learner
from hebbviz.sims.worlds.sonar import HOLD, PATTERNS, TRAINING, Sonar, load

SOURCE = Path(__file__).with_name("limit.c")
FLAGS = (
    "-std=gnu11", "-O3", "-march=native", "-ffast-math", "-fPIC",
    "-fno-associative-math",  # rounding by adding and taking away a large number must not be undone
)  # fmt: skip
GCC_FLAGS = ("-fschedule-insns", "-fsched-pressure")
"""A quarter faster: the rounds of one random number wait for each other, others need not."""
LANES, SYNAPSES, NEURONS = 64, 8 * 60 + 8, 9


class NoCompiler(Exception):
    """There is no C compiler here, or it refused; the message says which."""


def compiled(dtype: type, folder: Path) -> ctypes.CDLL:
    """`limit.c` for float32 or float64, as a library in `folder`. Raises NoCompiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise NoCompiler("no C compiler found: neither gcc nor cc is on the path")
    size = np.dtype(dtype).itemsize
    extra = GCC_FLAGS if Path(compiler).name == "gcc" else ()
    built, library = folder / f"limit{size}.o", folder / f"limit{size}.so"
    # Linked on its own: with -ffast-math the linker would change the whole process's arithmetic.
    for arguments in (
        [*FLAGS, *extra, f"-DREAL_BYTES={size}", "-c", str(SOURCE), "-o", str(built)],
        ["-shared", str(built), "-o", str(library)],
    ):
        done = subprocess.run([compiler, *arguments], capture_output=True, text=True, check=False)
        if done.returncode:
            raise NoCompiler(f"{compiler} failed: {done.stderr.strip().splitlines()[-1]}")
    loaded = ctypes.CDLL(str(library))
    loaded.tile_new.restype = ctypes.c_void_p
    return loaded


class Tile:
    """64 lanes of sonar in C that begin as `Learner(Sonar("paper"), seed=seed, lanes=64)` does.

    It is the same run for the learner's first epoch, 187 000 steps; later ones are not shuffled.
    """

    def __init__(self, dtype: type, folder: Path, *, seed: int = 0) -> None:
        self._c, self._real = compiled(dtype, folder), np.ctypeslib.as_ctypes_type(dtype)
        learner = Learner(Sonar("paper"), seed=seed, lanes=LANES)
        self.seed, self.step, self.beta, self.gamma = seed, 0, learner.beta, learner.gamma
        self._dtype = dtype
        self._data = load().astype(dtype)
        self._order = learner.world[-PATTERNS:][:TRAINING].astype(np.int32)
        weights = learner.weights.astype(dtype)
        self._tile = ctypes.c_void_p(
            self._c.tile_new(_pointer(weights), _pointer(self._data), _pointer(self._order))
        )

    def skip(self, steps: int) -> None:
        """Run `steps` steps."""
        self._c.tile_run(
            self._tile, ctypes.c_int64(steps), ctypes.c_int64(self.step),
            ctypes.c_uint32(self.seed), ctypes.c_uint32(0), self._real(self.beta),
            self._real(self.gamma), _pointer(self._data), _pointer(self._order),
            ctypes.c_int64(len(self._order)),
        )  # fmt: skip
        self.step += steps

    @property
    def weights(self) -> NDArray[Any]:
        """w of every synapse, (synapses, lanes)."""
        return self._read()[0]

    @property
    def activities(self) -> NDArray[Any]:
        """u of the neurons, (neurons, lanes)."""
        return self._read()[1]

    def _read(self) -> tuple[NDArray[Any], NDArray[Any]]:
        weights = np.empty((SYNAPSES, LANES), self._dtype)
        activities = np.empty((NEURONS, LANES), self._dtype)
        self._c.tile_read(self._tile, _pointer(weights), _pointer(activities))
        return weights, activities

    def __del__(self) -> None:
        self._c.tile_free(self._tile)


def departure(tile: Tile, steps: int) -> tuple[int, float]:
    """What a new tile and hebbviz's learner do differently in `steps` steps.

    The number of spikes that differ, compared after every step, and the largest difference of a
    weight at the end.
    """
    learner = Learner(Sonar("paper"), seed=tile.seed, lanes=LANES)
    differing = 0
    for _ in range(steps):
        tile.skip(1)
        learner.skip(1)
        differing += int((tile.activities != learner.activities[-NEURONS:]).sum())
    return differing, float(np.abs(tile.weights - learner.weights).max())


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def main() -> None:
    """Print how long a step takes, the best of many times, and whether it is the right one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for dtype in (np.float32, np.float64):
            tile = Tile(dtype, folder)
            best = min(_seconds(tile, HOLD) for _ in range(400))
            each = 1e9 * best / (HOLD * LANES)
            say(f"{np.dtype(dtype)}: {each:.2f} ns a step of one lane")
        spikes, weights = departure(Tile(np.float64, folder), 2500)
    say(f"float64, 2500 steps: {spikes} spikes differ from the learner's, weights {weights:.1g}")


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")


def _seconds(tile: Tile, steps: int) -> float:
    began = time.perf_counter()
    tile.skip(steps)
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
