"""A dry run of a rule: a few steps in plain Python, on NumPy arrays.

A compiled rule continues after an error, and reads and writes beyond its arrays unnoticed. A dry
run detects both.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np

REWARDS = (0.0, -1.0, 1.0)


class Tried(Protocol):
    """The part of a `Rule` that a trial uses."""

    name: ClassVar[str]
    memory: ClassVar[tuple[Any, ...]]
    least_lanes: ClassVar[int]

    @property
    def constants(self) -> np.ndarray: ...

    @staticmethod
    def modulate(memory: Any, constants: Any, reward: Any, ended: Any, sent: Any) -> None: ...


@lru_cache(maxsize=256)
def try_out(rule: Tried) -> None:
    """Raise ValueError, with a one-line message, if a rule fails in a dry run.

    It fails if it raises, reads or writes beyond its arrays, changes an argument that it may only
    read, or sends or stores a non-finite value. The run has the least number of lanes that the
    rule needs, then two more.
    """
    for lanes in (rule.least_lanes, rule.least_lanes + 2):
        memory = np.zeros((len(rule.memory), lanes))
        for step in range(2 * len(REWARDS)):
            reward = np.resize(np.roll(REWARDS, -step), lanes)
            ended = np.full(lanes, float(step >= len(REWARDS)))
            _step(rule, memory, reward, ended)


def _step(rule: Tried, *given: np.ndarray) -> None:
    memory, reward, ended = given
    constants, sent = rule.constants, np.full(len(reward), np.nan)
    for array in (constants, reward, ended):
        array.flags.writeable = False
    try:
        with np.errstate(all="ignore"):  # as when it is compiled
            type(rule).modulate(memory, constants, reward, ended, sent)
    except Exception as error:
        first, *_ = str(error).splitlines() or [""]
        raise ValueError(
            f"rule {rule.name}: modulate fails in a dry run, lanes: {len(reward)}: "
            f"{type(error).__name__}: {first}"[:400]
        ) from error
    for what, array in (("send", sent), ("keep", memory)):
        if not np.isfinite(array).all():
            wrong = array[~np.isfinite(array)][0]
            raise ValueError(
                f"rule {rule.name}: modulate must {what} a finite number in each lane at each "
                f"step, got {wrong} in a dry run, where the reward was {reward[0]:g}"
            )
