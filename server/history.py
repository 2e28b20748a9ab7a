"""The whole run in a bounded number of windows, each a sum over every one of its steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Tally, Task

Array = NDArray[np.float64]

CAPACITY = 512
BEGINNING = Tally(0, 0.0, 0.0, 0.0)


def usual_window(task: Task) -> int:
    """Steps of a window that sums up a task: 10 s of its time, or 1 000 where it has none."""
    return round(10.0 / task.dt) if task.dt else 1000


@dataclass(frozen=True)
class Curve:
    """Windows of a run: `end` step, and over each `steps`, `reward`, `broadcast`, `ended`.

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


class History:
    """Totals at the edges of equal windows; when there are too many, two become one."""

    def __init__(self, window: int, start: Tally = BEGINNING) -> None:
        """Windows of at least `window` steps, from the totals at the `start`."""
        self.window = window
        self._edges = [start]

    def until_edge(self, step: int) -> int:
        """How many steps may be run before `add` must be called."""
        return self.window - step % self.window

    def add(self, total: Tally) -> bool:
        """Note the totals since the start; kept, and True, where the step is a window's edge."""
        if total.steps % self.window or total.steps <= self._edges[-1].steps:
            return False
        self._edges.append(total)
        if len(self._edges) > CAPACITY:
            self.window *= 2
            first, *rest = self._edges
            self._edges = [first, *(t for t in rest if t.steps % self.window == 0)]
        return True

    @property
    def edges(self) -> tuple[Tally, ...]:
        """The totals at the edges, the first those it began with."""
        return tuple(self._edges)

    def copy(self) -> History:
        return History.of(self.window, self._edges)

    def until(self, step: int) -> History:
        """A copy without what came after a step."""
        first, *rest = self._edges
        return History.of(self.window, [first, *(t for t in rest if t.steps <= step)])

    @classmethod
    def of(cls, window: int, edges: Sequence[Tally]) -> History:
        """As it was with these `edges`."""
        made = cls(window, edges[0])
        made._edges = list(edges)
        return made

    def curve(self, now: Tally | None = None) -> Curve:
        """The windows so far; with `now`, the unfinished one too once it is half full."""
        edges = list(self._edges)
        if now is not None and now.steps - edges[-1].steps >= self.window / 2:
            edges.append(now)
        totals = np.array([(t.steps, t.reward, t.broadcast, t.ended) for t in edges])
        steps, reward, broadcast, ended = np.diff(totals, axis=0).T
        return Curve(self.window, totals[1:, 0], steps, reward, broadcast, ended)
