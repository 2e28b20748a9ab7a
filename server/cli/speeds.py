"""How fast this machine runs networks: every way of running them, timed in one run.

Absolute speeds mean little on a shared machine; ratios mean more. So all contestants are timed in
turn, repeatedly, for a few hundredths of a second each, and the best turn of each counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

import hebbviz
from hebbviz.learner.learner import Learner
from hebbviz.numerics.counter_rng import FIRST_EPISODE, Draws
from hebbviz.reference import Reference
from hebbviz.sims.experiments.workers import core_count
from hebbviz.sims.loading import compiled_twin
from hebbviz.sims.worlds.pendulum.task import Pendulum
from hebbviz.sims.worlds.sonar import Sonar
from hebbviz.task.base import Task

LANES = 64
PRECISIONS: tuple[Any, ...] = (np.float64, np.float32)
TURN_SECONDS = 0.04
"""Turns start at one step and grow fourfold until one takes about this time."""
FEWEST_TURNS = 12


@dataclass
class Contestant:
    """`networks` networks of `synapses` synapses each; `run(n)` runs n steps of every one."""

    key: str
    name: str
    networks: int
    synapses: int
    run: Callable[[int], object]

    def seconds(self, steps: int) -> float:
        """Seconds that `steps` steps of all its networks take."""
        began = time.perf_counter()
        self.run(steps)
        return time.perf_counter() - began


@dataclass(frozen=True)
class Speed:
    """The result of a contestant."""

    key: str
    name: str
    networks: int
    synapses: int
    network_steps_per_second: float

    @property
    def synaptic_updates_per_second(self) -> float:
        """Every synapse counts at every step, in whatever form it is stored."""
        return self.synapses * self.network_steps_per_second

    @property
    def nanoseconds(self) -> float:
        """Time of one step of one network."""
        return 1e9 / self.network_steps_per_second


@dataclass(frozen=True)
class Ratio:
    """How many times as fast the contestant `fast` is as `slow`."""

    key: str
    name: str
    fast: str
    slow: str

    def fits(self, speeds: Mapping[str, Speed]) -> bool:
        """Whether both were measured."""
        return self.fast in speeds and self.slow in speeds

    def of(self, speeds: Mapping[str, Speed]) -> float:
        return (
            speeds[self.fast].network_steps_per_second / speeds[self.slow].network_steps_per_second
        )


RATIOS = (
    Ratio("one_lane_to_reference", "one lane / NumPy reference", "one_lane", "reference"),
    Ratio("lanes_to_one_lane", "lanes, float64 / one lane", "lanes_float64", "one_lane"),
    Ratio("float32_to_float64", "lanes, float32 / float64", "lanes_float32", "lanes_float64"),
    Ratio("all_cores_to_one", "all cores / one core", "cores_float64", "lanes_float64"),
    Ratio("pendulum_lanes_to_pymunk", "pendulum, float32 / pymunk", "pendulum_lanes", "pymunk"),
)


def race(contestants: Sequence[Contestant], seconds: float) -> dict[str, Speed]:
    """Time all of them in turn for about `seconds` in all; the best turn of each counts."""
    for c in contestants:
        c.run(1)  # compiles
    steps = {c.key: 1 for c in contestants}
    best = {c.key: math.inf for c in contestants}
    ends, turns = time.perf_counter() + seconds, 0
    while turns < FEWEST_TURNS or time.perf_counter() < ends:
        for c in contestants:
            n = steps[c.key]
            took = c.seconds(n)
            best[c.key] = min(best[c.key], took / n)
            if took < TURN_SECONDS / 4:
                steps[c.key] = 4 * n
        turns += 1
    return {
        c.key: Speed(c.key, c.name, c.networks, c.synapses, c.networks / best[c.key])
        for c in contestants
    }


# The contestants


def contestants() -> list[Contestant]:
    """Every way of running sonar and the pendulum that this machine has."""
    sonar, cores = Sonar("paper"), core_count()
    found = [reference(sonar, "reference", "NumPy reference")]
    found.append(lanes(sonar, "one_lane", "compiled, one lane", 1))
    for dtype in PRECISIONS:
        name = np.dtype(dtype).name
        found.append(lanes(sonar, f"lanes_{name}", f"{LANES} lanes, {name}", LANES, dtype=dtype))
        if cores > 1:
            key, words = f"cores_{name}", f"{cores} cores, {LANES} lanes each, {name}"
            found.append(lanes(sonar, key, words, LANES, dtype=dtype, threads=cores))
    return [*found, *pendulums()]


def lanes(
    task: Task, key: str, name: str, count: int, *, dtype: Any = np.float64, threads: int = 1
) -> Contestant:
    """`count` lanes in each of `threads` threads."""
    learners = [
        Learner(task, lanes=count, first_lane=k * count, dtype=dtype, written_out=count > 1)
        for k in range(threads)
    ]
    synapses = learners[0].topology.synapses
    if threads == 1:
        return Contestant(key, name, count, synapses, learners[0].skip)
    pool = ThreadPoolExecutor(threads)

    def run(steps: int) -> None:
        for done in [pool.submit(learner.skip, steps) for learner in learners]:
            done.result()

    return Contestant(key, name, threads * count, synapses, run)


def pendulums() -> Iterator[Contestant]:
    """The world in pymunk, and the compiled world."""
    world = Pendulum("raw")
    yield lanes(world, "pymunk", "pendulum, in pymunk", 1)
    words = f"pendulum, compiled, {LANES} lanes, float32"
    yield lanes(compiled_twin(world), "pendulum_lanes", words, LANES, dtype=np.float32)


def reference(task: Task, key: str, name: str) -> Contestant:
    """The paper's equations in NumPy, in a loop with the task."""
    seed = 0
    learner = Learner(task, seed=seed)
    topology = learner.topology
    weights = [
        learner.weights[topology.synapses_of(k), 0].reshape(topology.shape(p))
        for k, p in enumerate(topology.projections)
    ]
    network = Reference(topology, weights, beta=learner.beta, gamma=learner.gamma, seed=seed)
    state = task.restart(Draws(seed, 0, 0, FIRST_EPISODE))

    def run(steps: int) -> None:
        nonlocal state
        for _ in range(steps):
            network.observe(task.observation(state))
            action = network.respond()
            state = task.transition(state, action, Draws(seed, 0, network.step - 1))
            network.reinforce(task.reward(state))

    return Contestant(key, name, 1, topology.synapses, run)


# Output


def figures(speeds: Mapping[str, Speed], ratios: Sequence[Ratio] = RATIOS) -> dict[str, Any]:
    """Speeds and ratios by key, fit for strict JSON."""
    return {
        "version": hebbviz.__version__,
        "cores": core_count(),
        "speeds": {
            s.key: {
                "networks": s.networks,
                "synapses": s.synapses,
                "network_steps_per_second": s.network_steps_per_second,
                "synaptic_updates_per_second": s.synaptic_updates_per_second,
            }
            for s in speeds.values()
        },
        "ratios": {r.key: r.of(speeds) for r in ratios if r.fits(speeds)},
    }


def table(speeds: Mapping[str, Speed], ratios: Sequence[Ratio] = RATIOS) -> str:
    """The same as a table to read."""
    lines = [f"{'':<38}{'network steps/s':>16}{'synaptic updates/s':>20}{'ns a step':>12}"]
    lines += [
        f"{s.name:<38}{s.network_steps_per_second:>16,.4g}{s.synaptic_updates_per_second:>20,.4g}"
        f"{s.nanoseconds:>12,.4g}"
        for s in speeds.values()
    ]
    return "\n".join(
        [*lines, "", *(f"{r.name:<38}{r.of(speeds):>16,.4g}" for r in ratios if r.fits(speeds))]
    )
