"""Rows on their way into a rerun stream: gathered by entity, sent as columns, a chunk at a time."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

_ORDER = ("hebbviz/change", "", "reward/raw", "reward/broadcast", "hebbviz/end")
"""A file may be cut anywhere: no keyframe is in it without the changes before it, no step without
its spikes, no end without all. Entities that are not named stand in the place of "".
"""
SEEN = "inputs"
"""Entity of what the network saw, written with weights and traces."""
WIDER = 1.8
"""Times as wide as it is, the range of a map."""
NUMBER, CHECKSUM = "row", "crc32"
"""Columns of rows for programs: each has its number, so that none can be lost unnoticed."""

Steps = NDArray[np.int64]
Columns = Iterable[Any]
"""Columns as `RecordingStream.send_columns` takes them."""


class Rows:
    """Collects rows of each entity until `flush`; a chunk of its own for each would be large.

    Times are `step`, and `sim_time` for a task whose steps last `dt` seconds.
    """

    def __init__(self, stream: rr.RecordingStream, dt: float | None) -> None:
        self._stream, self._dt = stream, dt
        self._waiting: dict[str, _Entity] = {}

    def add(
        self, path: str, steps: Steps, values: NDArray[Any], make: Callable[[Any], Columns]
    ) -> None:
        """Add rows: the i-th at steps[i], of values[i]; `make` turns all values into columns."""
        if len(steps):
            entity = self._waiting.setdefault(path, _Entity(make))
            entity.steps.append(steps)
            entity.values.append(values)

    def flush(self) -> None:
        """Send all that was added."""
        waiting, self._waiting = self._waiting, {}
        for path in sorted(waiting, key=lambda p: _ORDER.index(p if p in _ORDER else "")):
            entity = waiting[path]
            columns = entity.make(np.concatenate(entity.values))
            self._stream.send_columns(path, self.times(np.concatenate(entity.steps)), columns)

    def times(self, steps: Steps) -> list[rr.TimeColumn]:
        """The time columns of rows at these steps."""
        made = [rr.TimeColumn("step", sequence=steps)]
        if self._dt is not None:
            made.append(rr.TimeColumn("sim_time", duration=steps * self._dt))
        return made


class _Entity:
    def __init__(self, make: Callable[[Any], Columns]) -> None:
        self.make = make
        self.steps: list[Steps] = []
        self.values: list[NDArray[Any]] = []


def scalars(values: NDArray[Any]) -> Columns:
    """(n,) or (n, series) numbers."""
    return rr.Scalars.columns(scalars=values)


def texts(values: NDArray[Any]) -> Columns:
    """(n, 2) texts and levels."""
    return rr.TextLog.columns(text=values[:, 0].tolist(), level=values[:, 1].tolist())


def states(values: NDArray[Any]) -> Columns:
    """(n,) names of the state that begins."""
    return rr.StateChange.columns(state=values.tolist())


def tensors(values: NDArray[np.float32]) -> Columns:
    """(n, post, pre) matrices, each with a range of its own, symmetric about zero.

    The range is passed upside down, and wider than it is, so that rerun's colours are the scene's:
    blue above zero and orange below. Its own ends are cyan and yellow.
    """
    rows = [rr.Tensor(m, dim_names=("post", "pre"), value_range=_range(m)) for m in values]
    batches = [row.as_component_batches() for row in rows]
    return [
        rr.ComponentColumn(parts[0].component_descriptor(), _Batch(parts))
        for parts in zip(*batches, strict=True)
    ]


def records(values: NDArray[Any]) -> Columns:
    """(n,) dictionaries of the same keys, as untyped components; arrays are kept to the bit."""
    columns = {key: pa.array([_plain(v[key]) for v in values]) for key in values[0]}
    return rr.AnyValues.columns(drop_untyped_nones=True, **columns)


def checksum(step: int, values: Mapping[str, Any]) -> int:
    """CRC-32 of a step and of texts and numbers by name, bit for bit."""
    crc = zlib.crc32(str(step).encode())
    for name in sorted(values):
        value = values[name]
        data = value.encode() if isinstance(value, str) else np.asarray(value).tobytes()
        crc = zlib.crc32(data, zlib.crc32(name.encode(), crc))
    return crc


def objects(items: Iterable[Any]) -> NDArray[Any]:
    """A one-dimensional array of whatever objects."""
    made = list(items)
    array = np.empty(len(made), dtype=object)
    for k, item in enumerate(made):
        array[k] = item
    return array


class _Batch:
    """Several batches of one component as one."""

    def __init__(self, parts: Iterable[Any]) -> None:
        self._array = pa.concat_arrays([p.as_arrow_array() for p in parts])

    def as_arrow_array(self) -> pa.Array:
        return self._array


def _range(matrix: NDArray[np.float32]) -> tuple[float, float]:
    full = float(np.abs(matrix).max(initial=0.0))
    full = WIDER * full if np.isfinite(full) and full > 0.0 else 1.0
    return full, -full


def _plain(value: Any) -> Any:
    return value.ravel() if isinstance(value, np.ndarray) else value
