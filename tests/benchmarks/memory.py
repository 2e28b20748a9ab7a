"""A network that does not fit in the cache, against the memory's own bandwidth.

1 000-1 000-10 with one lane, and an input that is another one at every step, so that nothing can be
held: each step folds all 10⁶ synapses from the inputs, which reads and writes w₀ and z₀ once, and
moves w and z of the other 10⁴. Every number is counted as read once and written once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import cfunc, njit
from numpy.typing import NDArray

from hebbviz.learner.learner import Learner
from hebbviz.task.base import CompiledTask, Input, Output
from hebbviz.task.presets import Preset
from hebbviz.task.signature import WORLD

INPUTS, HIDDEN, OUTPUTS = 1000, 1000, 10
LARGE = 64 * 2**20 // 8
"""Numbers in each of the three arrays of the triad: 64 MiB."""
TURNS = 12
FEW, MANY = 2, 12
"""Steps."""


@cfunc(WORLD)
def _answer(world, action, data, keys, step, observation, reward, ended):
    for lane in range(world.shape[1]):
        reward[lane] = action[0, lane]
        ended[lane] = 0.0
        for j in range(observation.shape[0]):
            observation[j, lane] = data[step % 2, j]
    return 1


class Flicker(CompiledTask):
    """Two patterns take turns at every step. State: nothing of interest."""

    name = "flicker"
    inputs = tuple(Input(f"input {k}") for k in range(INPUTS))
    outputs = tuple(Output(f"output {k}", "on", "off") for k in range(OUTPUTS))
    hidden = (HIDDEN,)
    presets = {"only": Preset(0.5, 1e-9, "not in the paper")}
    answer = _answer

    def data(self) -> NDArray[np.float64]:
        return np.random.default_rng(0).uniform(-1.0, 1.0, (2, INPUTS))

    def restart(self, draws: Any) -> NDArray[np.float64]:
        return np.zeros(1)

    def observation(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.data()[0]


@njit(nogil=True)
def _triad(a, b, c):
    for k in range(a.shape[0]):
        a[k] = b[k] + 3.0 * c[k]


@dataclass(frozen=True)
class Traffic:
    """Bytes moved a second: by a step of the network, and by a[k] = b[k] + 3 c[k]."""

    bytes_per_step: int
    step_seconds: float
    triad_bytes_per_second: float
    triad_of_that_size_bytes_per_second: float

    @property
    def bytes_per_second(self) -> float:
        return self.bytes_per_step / self.step_seconds

    @property
    def fraction(self) -> float:
        """Of the triad on arrays that no cache holds."""
        return self.bytes_per_second / self.triad_bytes_per_second

    def lines(self) -> Iterator[str]:
        yield f"a step of 1000-1000-10 moves {self.bytes_per_step / 1e6:.1f} MB"
        yield f"{self.bytes_per_second / 1e9:.2f} GB/s in {1e3 * self.step_seconds:.2f} ms a step"
        yield f"{self.triad_bytes_per_second / 1e9:.2f} GB/s: triad of 3 arrays of 64 MiB"
        yield (
            f"{self.triad_of_that_size_bytes_per_second / 1e9:.2f} GB/s: triad of three arrays "
            "that take as much room as the network"
        )
        yield f"{100 * self.fraction:.0f} % of the memory's bandwidth"


def traffic() -> Traffic:
    """Network and triads in turn; the best turn of each counts."""
    learner = Learner(Flicker())
    state = 2 * 8 * learner.topology.synapses
    large, same = _arrays(LARGE), _arrays(state // 8 // 3)
    runs: tuple[Callable[[], Any], ...] = (
        lambda: learner.skip(FEW),
        lambda: learner.skip(MANY),  # what a call of skip costs besides its steps is taken away
        lambda: _triad(*large),
        lambda: _triad(*same),
    )
    best = [np.inf] * len(runs)
    for run in runs:
        run()  # compiles
    for _ in range(TURNS):
        for k, run in enumerate(runs):
            began = time.perf_counter()
            run()
            best[k] = min(best[k], time.perf_counter() - began)
    return Traffic(
        bytes_per_step=2 * state,
        step_seconds=(best[1] - best[0]) / (MANY - FEW),
        triad_bytes_per_second=3 * large[0].nbytes / best[2],
        triad_of_that_size_bytes_per_second=3 * same[0].nbytes / best[3],
    )


def _arrays(size: int) -> tuple[NDArray[np.float64], ...]:
    return tuple(np.ones(size) for _ in range(3))
