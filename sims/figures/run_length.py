"""How long runs are: asked for in epochs, simulated hours or steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from hebbviz.limits import MOST_STEPS
from hebbviz.sims.program.terminal import InputError

if TYPE_CHECKING:
    from hebbviz.task.base import Task


class Asked(Protocol):
    """A length in one of three units, or in none."""

    @property
    def epochs(self) -> int | None: ...
    @property
    def hours(self) -> float | None: ...
    @property
    def steps(self) -> int | None: ...


@dataclass(frozen=True)
class Time:
    """The axis of time: its name for figures and files, and how many steps its unit has."""

    name: str
    key: str
    steps: float


def time_of(asked: Asked, task: Task) -> Time:
    """Epochs or steps where they were asked for or there is nothing else, else simulated time.

    Raises InputError where the task has no such time.
    """
    if asked.epochs is not None:
        if task.epoch is None:
            raise InputError(f"task {task.name!r} has no epochs: give --hours or --steps")
        return Time("epochs", "epoch", task.epoch)
    if asked.hours is not None and task.dt is None:
        raise InputError(f"task {task.name!r} has no time but its steps: give --steps")
    if task.dt is None or asked.steps is not None:
        return Time("steps", "step", 1.0)
    return Time("simulated time, hours", "hours", 3600.0 / task.dt)


def cut(length: int, about: int) -> tuple[int, int]:
    """Number and length of about `about` equal pieces. Together they are as near to `length` as
    pieces of that length can be.
    """
    piece = max(1, round(length / about))
    return max(1, round(length / piece)), piece


def steps_of(asked: Asked, task: Task, *, least: int = 1) -> int | None:
    """The requested length in steps; None if none was requested. Raises InputError if it is too
    long, or too short to be drawn: less than `least` steps.
    """
    for length in (asked.epochs, asked.hours, asked.steps):
        if length is not None:
            return _whole(length, time_of(asked, task).steps, least)
    return None


def _whole(length: float, unit: float, least: int) -> int:
    """A length in whole steps; `unit` is the number of steps in its unit."""
    steps = length * unit
    if steps > MOST_STEPS:
        raise InputError(f"a run has at most {MOST_STEPS:,} steps, got {steps:.3g}: ask for fewer")
    if round(steps) < least:
        raise InputError(
            f"a run of {length:g} is too short for a curve: ask for {least / unit:.3g} or more"
        )
    return round(steps)
