"""The whole run in a bounded number of windows, each a sum over all of its steps, by lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.learner import Learner
from hebbviz.task.base import Tally, Task

Array = NDArray[np.float64]

CAPACITY = 512
OBJECTS_BYTES = 250
"""Memory overhead of totals besides their numbers, in bytes."""


def usual_window(task: Task) -> int:
    """Steps of a task's usual window: 10 s of simulated time, or 1 000 without a time step."""
    return round(10.0 / task.dt) if task.dt else 1000


@dataclass(frozen=True, eq=False)
class Totals:
    """Totals of each lane after `steps` steps: reward, broadcast, episodes ended, (3, lanes)."""

    steps: int
    sums: Array

    @classmethod
    def of(cls, learner: Learner) -> Totals:
        return cls(learner.step, learner.totals)

    @classmethod
    def of_one(cls, tally: Tally) -> Totals:
        """Totals of a run of one lane."""
        return cls(tally.steps, np.array([[tally.reward], [tally.broadcast], [tally.ended]]))

    def lane(self, lane: int) -> Tally:
        return Tally(self.steps, *(float(x) for x in self.sums[:, lane]))


@dataclass(frozen=True)
class Curve:
    """Windows of a lane: `end` step, and over each `steps`, `reward`, `broadcast`, `ended`.

    All of shape (windows,); `window` is their length in steps (the last may be shorter).
    """

    window: int
    end: Array
    steps: Array
    reward: Array
    broadcast: Array
    ended: Array

    def tallies(self) -> list[Tally]:
        columns = (self.steps, self.reward, self.broadcast, self.ended)
        return [Tally(int(s), r, b, e) for s, r, b, e in zip(*columns, strict=True)]


@dataclass(frozen=True)
class Curves:
    """Windows of all lanes between `edges`; `window` is their length in steps."""

    window: int
    edges: tuple[Totals, ...]

    @property
    def lanes(self) -> int:
        return int(self.edges[0].sums.shape[1])

    def lane(self, lane: int) -> Curve:
        steps = np.array([t.steps for t in self.edges], dtype=np.float64)
        sums = np.array([t.sums[:, lane] for t in self.edges])
        return Curve(self.window, steps[1:], np.diff(steps), *np.diff(sums, axis=0).T)

    def coarser(self, most: int) -> Curves:
        """At most `most` windows: while there are more, pairs are merged."""
        window, edges = self.window, self.edges
        while len(edges) > most + 1:
            window *= 2
            edges = (edges[0], *(t for t in edges[1:] if t.steps % window == 0))
        return Curves(window, edges)


class History:
    """Totals at the edges of equal windows; when there are too many, pairs are merged."""

    def __init__(self, window: int, start: Totals) -> None:
        """Windows of at least `window` steps, from the totals at the `start`."""
        self.window = window
        self._edges = [start]

    def until_edge(self, step: int) -> int:
        """How many steps may be run before `add` must be called."""
        return self.window - step % self.window

    def add(self, total: Totals) -> bool:
        """Note the totals since the start; keeps them and returns True at a window's edge."""
        if total.steps % self.window or total.steps <= self._edges[-1].steps:
            return False
        self._edges.append(total)
        if len(self._edges) > CAPACITY:
            self.window *= 2
            first, *rest = self._edges
            self._edges = [first, *(t for t in rest if t.steps % self.window == 0)]
        return True

    def edges(self, lane: int = 0) -> tuple[Tally, ...]:
        """The totals of a lane at the edges, starting with the initial ones."""
        return tuple(t.lane(lane) for t in self._edges)

    @property
    def size(self) -> int:
        """Bytes of its totals in memory, which its copies share."""
        return len(self._edges) * (self._edges[-1].sums.nbytes + OBJECTS_BYTES)

    def copy(self) -> History:
        return History.of(self.window, self._edges)

    def until(self, step: int) -> History:
        """A copy that ends at a step."""
        first, *rest = self._edges
        return History.of(self.window, [first, *(t for t in rest if t.steps <= step)])

    @classmethod
    def of(cls, window: int, edges: Sequence[Totals]) -> History:
        """The history with these `edges`."""
        made = cls(window, edges[0])
        made._edges = list(edges)
        return made

    def curves(self, now: Totals | None = None) -> Curves:
        """The windows so far; with `now`, the unfinished one too once it is half full."""
        edges = tuple(self._edges)
        if now is not None and now.steps - edges[-1].steps >= self.window / 2:
            edges = (*edges, now)
        return Curves(self.window, edges)
