"""Single steps stored in a recording, for a machine that cannot recompute the run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Block, Frame
from hebbviz.server.recording.header import entity
from hebbviz.server.recording.tables import NOTHING, Table, parallel, read_rows
from hebbviz.topology import Topology

Array = NDArray[np.float64]


class Stored:
    """Steps and weights of a recording; the file is read when they are first asked for."""

    def __init__(self, path: Path, topology: Topology, other_now: str) -> None:
        self._path, self._topology, self.other_now = path, topology, other_now

    def frame(self, keyframe: Frame, step: int) -> Frame:
        """The frame of the last keyframe, updated with all that is known at `step`.

        The world and the inputs stay as they were at the keyframe.
        """
        weight = _latest(self.weights, step, keyframe.step, keyframe.weight)
        trace = _latest(self.traces, step, keyframe.step, keyframe.trace)
        frame = replace(keyframe, step=step, weight=weight, trace=trace)
        last = self.recent(step, 1)
        if last is None:
            return frame
        fired = last.fired[-1].astype(np.float64)
        activity = frame.activity.copy()
        silent, firing = self._topology.activity
        activity[self._topology.inputs :] = np.where(fired > 0, firing, silent)
        return replace(
            frame,
            activity=activity,
            fired=fired,
            potential=last.potential[-1],
            reward=(float(last.reward[-1]), float(last.broadcast[-1])),
        )

    def recent(self, step: int, most: int) -> Block | None:
        """The kept steps up to `step` without a gap, at most `most`."""
        kept: Array = self.steps["step"]
        end = int(np.searchsorted(kept, step, side="right"))
        if end == 0 or kept[end - 1] != step:
            return None
        gaps = np.flatnonzero(np.diff(kept[max(0, end - most) : end]) != 1)
        first = max(0, end - most) + (int(gaps[-1]) + 1 if len(gaps) else 0)
        cut = slice(first, end)
        return Block(
            int(kept[first]) - 1,
            self.steps["fired"][cut],
            self.steps["reward"][cut],
            self.steps["broadcast"][cut],
            np.zeros(end - first, dtype=bool),
            self.steps["potential"][cut].astype(np.float64),
            np.zeros((0, 0)),
        )

    @cached_property
    def steps(self) -> dict[str, NDArray[Any]]:
        """`step`, `reward`, `broadcast`, `fired` and `potential` of every step that was kept.

        Numbered as in the recording: index n is the state after the n-th step.
        """
        return steps_of(self._rows, self._topology)

    @cached_property
    def weights(self) -> tuple[NDArray[np.int64], Array]:
        """Steps (n,), and the weights after them (n, synapses)."""
        return self._matrices("weights")

    @cached_property
    def traces(self) -> tuple[NDArray[np.int64], Array]:
        return self._matrices("traces")

    def _matrices(self, kind: str) -> tuple[NDArray[np.int64], Array]:
        step, found = matrices_of(self._rows, self._topology, [kind])
        return step, found[kind]

    @cached_property
    def _rows(self) -> dict[str, Table]:
        trees = ("spikes", "reward", "potentials", "weights", "traces")
        return read_rows(self._path, tuple(f"/{tree}/**" for tree in trees))


def steps_of(rows: dict[str, Table], topology: Topology) -> dict[str, NDArray[Any]]:
    """Rewards, spikes (n, neurons) and potentials (n, neurons) of the steps that were kept.

    From a truncated file, only complete steps: rewards are written after spikes.
    """
    groups = {group.name: entity(group.name) for group in topology.neuron_groups}
    names = ["/reward/raw", "/reward/broadcast", *(f"/potentials/{n}" for n in groups.values())]
    reward, broadcast, *potentials = parallel(rows, names)
    step = reward.step
    fired = np.zeros((len(step), topology.neurons), dtype=np.uint8)
    potential = np.zeros((len(step), topology.neurons), dtype=np.float32)
    for (group, name), v in zip(groups.items(), potentials, strict=True):
        potential[:, topology.neurons_of(group)] = v.scalars
        spikes = rows.get(f"/spikes/{name}", NOTHING)
        whole = np.isin(spikes.step, step)
        neuron = spikes.scalars[whole, 0].astype(np.int64)
        fired[np.searchsorted(step, spikes.step[whole]), neuron] = 1
    return {
        "step": step,
        "reward": reward.scalars[:, 0],
        "broadcast": broadcast.scalars[:, 0],
        "fired": fired,
        "potential": potential,
    }


def matrices_of(
    rows: dict[str, Table], topology: Topology, kinds: Sequence[str]
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Steps (n,), and of each kind, weights or traces, (n, synapses) in the topology's order, in
    float32. From a truncated file, only complete ones.
    """
    names = [entity(p.name) for p in topology.projections]
    tables = parallel(rows, [f"/{kind}/{name}" for kind in kinds for name in names])
    step = tables[0].step
    if not len(step):
        return step, {kind: np.zeros((0, topology.synapses)) for kind in kinds}
    parts = [table.columns["Tensor:data"] for table in tables]
    each = (parts[k * len(names) : (k + 1) * len(names)] for k in range(len(kinds)))
    found: list[Array] = [np.concatenate(of, axis=1).astype(np.float32) for of in each]
    return step, dict(zip(kinds, found, strict=True))


def _latest(
    rows: tuple[NDArray[np.int64], Array], step: int, since: int, otherwise: Array
) -> Array:
    """The last row up to `step`, unless it is before `since`."""
    steps, values = rows
    at = int(np.searchsorted(steps, step, side="right")) - 1
    if at < 0 or steps[at] < since:
        return otherwise
    latest: Array = values[at].astype(np.float64)
    return latest
