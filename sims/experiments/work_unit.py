"""The piece of a plan that a worker does: a tile of lanes, brought on for a few seconds.

A worker keeps nothing: it is given how far the tile has come and returns how far it has brought
it. So any worker can go on from there, and one that dies costs no more than its last few seconds.
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
"""A share may last longer than it was to by about this, or by an evaluation; one that is stopped by
this alone.
"""


class WrongVersion(WorkersFailed):
    """A worker runs another version of the program, which may not make the same run."""


class ChangedTask(ValueError):
    """A worker read another text of the user's task or rule than the run began with."""


@dataclass(frozen=True)
class Tile:
    """Lanes that are run side by side, and how far they have come.

    `keyframe` is None before anything was done. It does not say the rule, which is the plan's: one
    of a user's own could not be unpickled where its file was not read before.

    `totals` (segments done, 3, lanes) are those since the start, of reward, broadcast reward and
    ended episodes, at the end of each segment; `figures` (evaluations done, lanes) by the names of
    `Task.evaluate`. `pending`: the evaluation at this step, if there is one, was not made yet.
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
        """The tile's lanes as they are now."""
        learner = plan.learner(self.first_lane, self.lanes)
        if self.keyframe is not None:
            learner.restore(replace(self.keyframe, rule=learner.rule))
        return learner

    def check_fit(self, plan: Plan) -> None:
        """Raise ValueError unless it can have come of this plan, which a file may only say."""
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
        """What came of the segments that are done."""
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
    """An event of threads, or of processes."""

    def is_set(self) -> bool: ...


_stop: Stop = threading.Event()


def obey(stop: Stop) -> None:
    """End the shares of this process, from now on, soon after `stop` is set."""
    global _stop  # noqa: PLW0603  # it cannot be sent with a share
    _stop = stop


def bring_on(
    plan: Plan, tile: Tile, seconds: float, version: str, digest: str, stop: Stop | None = None
) -> Tile:
    """The tile after about `seconds` more, or at the plan's end, or soon after `stop` is set.

    What it has come through is a function of the plan and its lanes alone: how it was cut into
    shares tells only where a share ends. `version` of the program and `digest` of the plan are
    those that the run began with. Raises TaskError if the task fails, WrongVersion, ChangedTask.
    """
    if version != hebbviz.__version__:
        raise WrongVersion(
            f"a worker runs hebbviz {hebbviz.__version__}, this is {version}: install the same "
            "version for all workers"
        )
    check_unchanged(plan, digest)
    try:
        share = _Share(plan, tile, _stop if stop is None else stop)
        check_unchanged(plan, digest)  # nor was it edited since: this text is the one that was run
        share.run(time.monotonic() + seconds)
    except Exception as error:
        for file in plan.own().values():
            if where := place_in(file, error):
                error.add_note(where)
        raise
    return share.tile()


def check_unchanged(plan: Plan, digest: str) -> None:
    """Raise ChangedTask if a user's file in the plan is another than when this was its digest."""
    if plan.digest() != digest:
        raise ChangedTask(
            f"{' or '.join(plan.own())}: the file is not what the run began with, here or on a "
            "worker: put it back to go on, or start again with it everywhere"
        )


class _Share:
    """A tile at work."""

    def __init__(self, plan: Plan, tile: Tile, stop: Stop) -> None:
        self._plan, self._tile, self._stop = plan, tile, stop
        self._learner = tile.learner(plan)
        self._totals = list(tile.totals)
        self._figures = {name: list(values) for name, values in tile.figures.items()}
        self._pending = tile.pending

    def run(self, deadline: float) -> None:
        """Go on until the deadline, or to the end of the plan, or until it is stopped."""
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
        """Make the evaluation that is pending, if there is one; if it is stopped, it stays so."""
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
