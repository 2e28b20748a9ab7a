"""What a recording holds of single steps, for a machine that cannot make the run again."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.moments import Block, Frame
from hebbviz.topology import Topology
from server.recording.chunks import Table, read_rows
from server.recording.header import entity

Array = NDArray[np.float64]


class Stored:
    """Steps and weights of a recording; the file is read when they are first asked for."""

    def __init__(self, path: Path, topology: Topology) -> None:
        self._path, self._topology = path, topology

    def frame(self, keyframe: Frame, step: int) -> Frame:
        """The frame of the last keyframe, with all that is known to have been otherwise at `step`.

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
            frame, activity=activity, fired=fired, potential=last.potential[-1],
            reward=(float(last.reward[-1]), float(last.broadcast[-1])),
        )  # fmt: skip

    def recent(self, step: int, most: int) -> Block | None:
        """The steps up to `step` that were kept without a gap, at most so many."""
        kept: Array = self.steps["step"]
        end = int(np.searchsorted(kept, step, side="right"))
        if end == 0 or kept[end - 1] != step:
            return None
        gaps = np.flatnonzero(np.diff(kept[max(0, end - most) : end]) != 1)
        first = max(0, end - most) + (int(gaps[-1]) + 1 if len(gaps) else 0)
        cut = slice(first, end)
        return Block(
            int(kept[first]) - 1, self.steps["fired"][cut], self.steps["reward"][cut],
            self.steps["broadcast"][cut], np.zeros(end - first, dtype=bool),
            self.steps["potential"][cut].astype(np.float64), np.zeros((0, 0)),
        )  # fmt: skip

    @cached_property
    def steps(self) -> dict[str, NDArray[Any]]:
        """Of every step that was kept: `step`, `reward`, `broadcast`, `fired`, `potential`.

        Numbered as in the recording: what stands at n was so after the n-th step.
        """
        return steps_of(self._rows, self._topology)

    @cached_property
    def weights(self) -> tuple[NDArray[np.int64], Array]:
        """Steps (n,), and the weights after them (n, synapses)."""
        return matrices_of(self._rows, self._topology, "weights")

    @cached_property
    def traces(self) -> tuple[NDArray[np.int64], Array]:
        return matrices_of(self._rows, self._topology, "traces")

    @cached_property
    def _rows(self) -> dict[str, Table]:
        trees = ("spikes", "reward", "potentials", "weights", "traces")
        return read_rows(self._path, tuple(f"/{tree}/**" for tree in trees))


def steps_of(rows: dict[str, Table], topology: Topology) -> dict[str, NDArray[Any]]:
    """Rewards, spikes (n, neurons) and potentials (n, neurons) of the steps that were kept."""
    reward = rows.get("/reward/raw")
    step = np.zeros(0, dtype=np.int64) if reward is None else reward.step
    fired = np.zeros((len(step), topology.neurons), dtype=np.uint8)
    potential = np.zeros((len(step), topology.neurons), dtype=np.float32)
    for group in topology.neuron_groups:
        name, where = entity(group.name), topology.neurons_of(group.name)
        if (spikes := rows.get(f"/spikes/{name}")) is not None:
            neuron = spikes.columns["Scalars:scalars"][:, 0].astype(np.int64)
            fired[np.searchsorted(step, spikes.step), neuron] = 1
        if (v := rows.get(f"/potentials/{name}")) is not None:
            potential[:, where] = v.columns["Scalars:scalars"]
    rewards = {"reward": "/reward/raw", "broadcast": "/reward/broadcast"}
    told = {
        name: rows[path].columns["Scalars:scalars"][:, 0] if path in rows else np.zeros(0)
        for name, path in rewards.items()
    }
    return {"step": step, **told, "fired": fired, "potential": potential}


def matrices_of(
    rows: dict[str, Table], topology: Topology, kind: str
) -> tuple[NDArray[np.int64], Array]:
    """Steps (n,) and weights or traces (n, synapses), in the topology's order, in float32."""
    tables = [rows.get(f"/{kind}/{entity(p.name)}") for p in topology.projections]
    found = [t for t in tables if t is not None]
    if len(found) < len(tables):
        return np.zeros(0, dtype=np.int64), np.zeros((0, topology.synapses))
    parts = [np.array([m["buffer"] for m in t.columns["Tensor:data"]]) for t in found]
    return found[0].step, np.concatenate(parts, axis=1).astype(np.float32)


def _latest(
    rows: tuple[NDArray[np.int64], Array], step: int, since: int, otherwise: Array
) -> Array:
    """The last row up to `step` if it is not before `since`."""
    steps, values = rows
    at = int(np.searchsorted(steps, step, side="right")) - 1
    if at < 0 or steps[at] < since:
        return otherwise
    latest: Array = values[at].astype(np.float64)
    return latest
