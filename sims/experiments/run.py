"""Execution of plans by workers; completed work is saved on disk.

The driver holds all tiles and gives each to a worker for a few seconds at a time. When interrupted,
it waits for the running work units and saves them; when killed, only they are lost.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from hebbviz.learner.learner import Learner
from hebbviz.sims.experiments.plan import Curves, Plan, joined
from hebbviz.sims.experiments.store import Store
from hebbviz.sims.experiments.work_unit import Tile, check_unchanged
from hebbviz.sims.experiments.workers import Workers

TILE = 64
"""Most lanes of a tile, with which the compiled loop is fastest."""

_LOOK_SECONDS = 0.1


class Interrupted(Exception):
    """The run was stopped; completed work is saved."""


def run(
    plan: Plan,
    workers: Workers,
    *,
    folder: Path | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[float], object] | None = None,
) -> Curves:
    """Complete a plan, continuing from the work saved in `folder`.

    Completed work is saved in a subfolder of `folder`; None saves nothing. Once `stop` is set,
    running work units end soon and are saved. `progress` is called with the completed fraction,
    from 0 to 1, at the start and after each work unit.

    Raises
    ------
    Interrupted
        Once `stop` is set and completed work is saved.
    TaskError, ValueError
        If the task fails or rejects the plan's settings, or its file is edited during the run.
    WorkersFailed
        If the workers are gone, or run another version of the program.
    InputError, OSError
        If completed work cannot be saved, or saved work cannot be read.
    """
    return run_all([plan], workers, folder=folder, stop=stop, progress=progress)[0]


def run_all(
    plans: Sequence[Plan],
    workers: Workers,
    *,
    folder: Path | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[Curves]:
    """Run several plans at once; workers move from one to the next without a pause."""
    return [
        done.curves()
        for done in finish(plans, workers, folder=folder, stop=stop, progress=progress)
    ]


def finish(
    plans: Sequence[Plan],
    workers: Workers,
    *,
    folder: Path | None = None,
    stop: threading.Event | None = None,
    progress: Callable[[float], object] | None = None,
) -> list[Done]:
    """Do the same as `run_all`; the results also give the learners at the end."""
    driver = _Driver(plans, workers, folder)
    driver.run(threading.Event() if stop is None else stop, progress or (lambda _: None))
    return driver.done()


@dataclass(frozen=True)
class Done:
    """A completed plan."""

    plan: Plan
    tiles: tuple[Tile, ...]

    def curves(self) -> Curves:
        """Return the results of all lanes."""
        return joined([tile.curves(self.plan) for tile in self.tiles], self.plan.lanes)

    def start(self, lane: int) -> Learner:
        """Return the learner of one lane at step 0, counting the plan's lanes from 0.

        If the rule couples lanes, the learner has all of them.
        """
        if self.plan.rule().lanes_touch:
            return self.plan.learner(self.plan.first_lane, self.plan.lanes)
        return self.plan.learner(self.plan.first_lane + lane, 1)

    def learner(self, lane: int) -> Learner:
        """Return the learner of one lane at the end of the plan, as `start` does."""
        learner = self.start(lane)
        first = learner.first_lane
        tile = next(t for t in self.tiles if t.first_lane <= first < t.end)
        if tile.lanes == learner.lanes:
            return tile.learner(self.plan)
        assert tile.keyframe is not None
        keyframe = tile.keyframe.lane(first - tile.first_lane)
        learner.restore(replace(keyframe, rule=learner.rule))
        return learner


class _Driver:
    def __init__(self, plans: Sequence[Plan], workers: Workers, folder: Path | None) -> None:
        self._plans, self._workers = plans, workers
        self._digests = [plan.digest() for plan in plans]
        self._stores = [None if folder is None else Store(folder, plan) for plan in plans]
        self._tiles: list[dict[int, Tile]] = []
        pieces = -(-workers.count() // len(plans))
        for plan, store in zip(plans, self._stores, strict=True):
            kept = [] if store is None else _apart(plan, store.read())
            self._tiles.append({t.first_lane: t for t in _completed(plan, kept, pieces)})
        self._waiting = [
            (k, tile)
            for k, plan in enumerate(plans)
            for tile in self._tiles[k].values()
            if not tile.is_done(plan)
        ]
        self._running: dict[Future[Tile], int] = {}

    def run(self, stop: threading.Event, progress: Callable[[float], object]) -> None:
        self._workers.hurry(on=False)
        progress(self._fraction())
        while self._waiting or self._running:
            if not stop.is_set():
                self._submit()
            elif not self._running or self._workers.count() == 0:  # no worker would return them
                self._cancel()
                raise Interrupted
            else:
                self._workers.hurry(on=True)
            for share in wait(self._running, _LOOK_SECONDS, FIRST_COMPLETED).done:
                self._take(self._running.pop(share), self._workers.result(share))
                progress(self._fraction())
        for plan, digest in zip(self._plans, self._digests, strict=True):
            check_unchanged(plan, digest)  # the curves must belong to this text

    def _cancel(self) -> None:
        for share in self._running:
            share.cancel()

    def done(self) -> list[Done]:
        tiles = (tuple(t.values()) for t in self._tiles)
        return [Done(*found) for found in zip(self._plans, tiles, strict=True)]

    def _submit(self) -> None:
        """Submit as many work units as there are workers.

        More would wait, and a waiting one cannot be distinguished from a running one when the run
        stops. The tile with most remaining steps comes first, so that no worker has to finish the
        last one while the others idle.
        """
        room = max(1, self._workers.count()) - len(self._running)
        for _ in range(min(room, len(self._waiting))):
            self._waiting.sort(key=self._steps_left)
            k, tile = self._waiting.pop()
            plan = self._plans[k].for_workers()
            self._running[self._workers.submit(plan, tile, self._digests[k])] = k

    def _steps_left(self, waiting: tuple[int, Tile]) -> int:
        k, tile = waiting
        return self._plans[k].steps - tile.step

    def _take(self, k: int, tile: Tile) -> None:
        self._tiles[k][tile.first_lane] = tile
        store = self._stores[k]
        if store is not None:
            store.write(tile)
        if not tile.is_done(self._plans[k]):
            self._waiting.append((k, tile))

    def _fraction(self) -> float:
        done = sum(t.step * t.lanes for tiles in self._tiles for t in tiles.values())
        return done / sum(plan.steps * plan.lanes for plan in self._plans)


def _completed(plan: Plan, kept: Sequence[Tile], pieces: int) -> list[Tile]:
    """Return all tiles of a plan: the saved ones, and new ones for the other lanes.

    If the rule couples lanes, a single tile holds all of them.
    """
    if plan.rule().lanes_touch:
        return list(kept) or [Tile(plan.first_lane, plan.lanes)]
    tiles: list[Tile] = []
    lane, end = plan.first_lane, plan.first_lane + plan.lanes
    for tile in (*kept, Tile(end, 0)):
        tiles += _cut(lane, tile.first_lane - lane, pieces)
        tiles.append(tile)
        lane = tile.end
    return tiles[:-1]


def _cut(first: int, lanes: int, pieces: int) -> list[Tile]:
    """Divide lanes into tiles of nearly equal size, at most TILE, and into `pieces` if possible.

    The division changes no lane.
    """
    count = min(lanes, max(pieces, -(-lanes // TILE)))
    ends = [first + lanes * k // count for k in range(count + 1)] if count else []
    return [Tile(a, b - a) for a, b in pairwise(ends)]


def _apart(plan: Plan, kept: Sequence[Tile]) -> list[Tile]:
    """Choose saved tiles that do not overlap, in the order of their lanes.

    Two simultaneous runs of one plan may have divided it differently. Of two overlapping tiles, the
    one with more completed work is chosen.
    """
    end = plan.first_lane + plan.lanes
    chosen: list[Tile] = []
    for tile in sorted(kept, key=lambda t: t.step * t.lanes, reverse=True):
        inside = plan.first_lane <= tile.first_lane and tile.end <= end
        if inside and all(t.end <= tile.first_lane or tile.end <= t.first_lane for t in chosen):
            chosen.append(tile)
    return sorted(chosen, key=lambda tile: tile.first_lane)
