"""The work unit: a worker advances a tile of lanes for a few seconds.

A worker keeps no state: it receives a tile and returns it advanced. Any worker can therefore
continue it, and a worker that dies costs at most its last few seconds.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import hebbviz
from hebbviz.learner.frames import Keyframe
from hebbviz.learner.learner import Learner
from hebbviz.learner.pieces import Stopped, stop_when
from hebbviz.rules.paper import PAPER
from hebbviz.sims.experiments.chunks import stretches
from hebbviz.sims.experiments.plan import Curves, Plan
from hebbviz.sims.program.terminal import WorkersFailed, place_in

Array = NDArray[np.float64]

STRETCH_SECONDS = 0.25
"""A work unit may exceed its time by about this, or by an evaluation; a stopped one by this alone.
"""


class WrongVersion(WorkersFailed):
    """A worker runs another version of the program, which may compute another run."""


class ChangedTask(ValueError):
    """The file of the user's task or rule has changed since the run began."""


@dataclass(frozen=True)
class Tile:
    """Lanes that run together, and their state.

    `keyframe` is None at the start. It leaves out the rule, which the plan gives: a rule from a
    user's file could not be unpickled by a process that has not loaded the file.

    `totals` (completed segments, 3, lanes) holds the totals since the start of reward, broadcast
    reward and ended episodes at the end of each segment; `figures` holds evaluations (completed
    ones, lanes) by the keys of `Task.evaluate`. `pending` means that the evaluation due at this
    step, if any, has not been made.
    """

    first_lane: int
    lanes: int
    keyframe: Keyframe | None = None
    totals: Array = field(default_factory=lambda: np.zeros((0, 3, 0)))
    figures: Mapping[str, Array] = field(default_factory=dict)
    pending: bool = True

    def is_done(self, plan: Plan) -> bool:
        return self.step >= plan.steps and not self.pending

    @property
    def step(self) -> int:
        return 0 if self.keyframe is None else self.keyframe.step

    @property
    def end(self) -> int:
        """The lane after its last one."""
        return self.first_lane + self.lanes

    def learner(self, plan: Plan) -> Learner:
        """Return a learner with the tile's lanes in their present state."""
        learner = plan.learner(self.first_lane, self.lanes)
        if self.keyframe is not None:
            learner.restore(replace(self.keyframe, rule=learner.rule))
        return learner

    def check_fit(self, plan: Plan) -> None:
        """Raise ValueError unless the tile, read from a file, fits the plan."""
        if not plan.first_lane <= self.first_lane < self.end <= plan.first_lane + plan.lanes:
            raise ValueError("its lanes are not the plan's")
        if self.step > plan.steps or type(self.pending) is not bool:
            raise ValueError("it is beyond the end of the plan")
        done = self.step // plan.segment_steps
        steps = [s for s in range(0, self.step + 1, plan.segment_steps) if plan.evaluates_at(s)]
        made = len(steps) - (self.pending and self.step in steps)
        if self.totals.shape != (done, 3, self.lanes) or not np.isfinite(self.totals).all():
            raise ValueError("its totals are not the plan's")
        if bool(self.figures) != bool(made) or any(
            values.shape != (made, self.lanes) for values in self.figures.values()
        ):
            raise ValueError("its figures are not the plan's")
        self.learner(plan)

    def curves(self, plan: Plan) -> Curves:
        """Return the results of the completed segments."""
        ends = plan.segment_steps * np.arange(1, len(self.totals) + 1)
        start = np.zeros((1, 3, self.lanes))
        sums = np.diff(np.concatenate([start, self.totals]), axis=0)
        at = [s for s in (0, *ends.tolist()) if plan.evaluates_at(s)]
        return Curves(
            end=ends,
            steps=plan.segment_steps,
            reward=sums[:, 0].T.copy(),
            broadcast=sums[:, 1].T.copy(),
            ended=sums[:, 2].T.copy(),
            evaluated_at=np.array(at, dtype=np.int64),
            figures={name: values.T.copy() for name, values in self.figures.items()},
        )


class Stop(Protocol):
    """An event of `threading` or `multiprocessing`."""

    def is_set(self) -> bool: ...


_stop: Stop = threading.Event()


def obey(stop: Stop) -> None:
    """Make all work units of this process end soon after `stop` is set."""
    global _stop  # noqa: PLW0603  # it cannot be sent with a share
    _stop = stop


def bring_on(
    plan: Plan, tile: Tile, seconds: float, version: str, digest: str, stop: Stop | None = None
) -> Tile:
    """Advance a tile for about `seconds`, to the plan's end, or until soon after `stop` is set.

    Results depend only on the plan and its lanes, not on the division into work units. `version`
    and `digest` are those of the program and the plan when the run began. Raises TaskError if the
    task fails, WrongVersion and ChangedTask if these differ now.
    """
    if version != hebbviz.__version__:
        raise WrongVersion(
            f"a worker runs hebbviz {hebbviz.__version__}, this is {version}: install the same "
            "version for all workers"
        )
    check_unchanged(plan, digest)
    try:
        share = _Share(plan, tile, _stop if stop is None else stop)
        check_unchanged(plan, digest)  # so the text that runs is the one that was checked
        share.run(time.monotonic() + seconds)
    except Exception as error:
        for file in plan.own().values():
            if where := place_in(file, error):
                error.add_note(where)
        raise
    return share.tile()


def check_unchanged(plan: Plan, digest: str) -> None:
    """Raise ChangedTask if a user's file in the plan has changed since `digest` was computed."""
    if plan.digest() != digest:
        raise ChangedTask(
            f"{' or '.join(plan.own())}: the file has changed since the run began, here or on a "
            "worker: restore it to continue, or start again with the same file everywhere"
        )


class _Share:
    """A work unit in progress."""

    def __init__(self, plan: Plan, tile: Tile, stop: Stop) -> None:
        self._plan, self._tile, self._stop = plan, tile, stop
        self._learner = tile.learner(plan)
        self._totals = list(tile.totals)
        self._figures = {name: list(values) for name, values in tile.figures.items()}
        self._pending = tile.pending

    def run(self, deadline: float) -> None:
        """Run until the deadline, the end of the plan, or a stop."""
        plan, learner = self._plan, self._learner

        def is_over() -> bool:
            return time.monotonic() > deadline or self._stop.is_set()

        self._evaluate()
        while learner.step < plan.steps and not self._pending:
            left = plan.segment_steps - learner.step % plan.segment_steps
            for steps in stretches(left, STRETCH_SECONDS):
                learner.skip(steps)
                if is_over():
                    break
            if learner.step % plan.segment_steps == 0:
                self._totals.append(self._tally())
                self._pending = True
                self._evaluate()
            if is_over():
                break

    def tile(self) -> Tile:
        tile = self._tile
        return Tile(
            tile.first_lane,
            tile.lanes,
            replace(self._learner.keyframe(), rule=PAPER),
            np.array(self._totals).reshape(-1, 3, tile.lanes),
            {name: np.array(values) for name, values in self._figures.items()},
            self._pending,
        )

    def _tally(self) -> Array:
        return np.array([[t.reward, t.broadcast, t.ended] for t in self._learner.tallies()]).T

    def _evaluate(self) -> None:
        """Make a pending evaluation; one that is stopped stays pending."""
        if not self._pending:
            return
        if self._plan.evaluates_at(self._learner.step):
            try:
                with stop_when(self._stop.is_set):
                    found = self._learner.task.evaluate(self._learner)
            except Stopped:
                return
            for name, values in found.items():
                self._figures.setdefault(name, []).append(values)
        self._pending = False
