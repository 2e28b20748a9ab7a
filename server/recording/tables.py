"""Rows out of a rerun file: numpy arrays by entity."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from hebbviz.server.recording import rrd_format
from hebbviz.server.recording.header import BadRecording
from hebbviz.server.recording.rows import CHECKSUM, NUMBER, checksum, objects

T = TypeVar("T")

PROPERTIES = "/__properties"
MOST_BYTES = 2_000_000_000
"""That are read of a recording at once."""


@dataclass(frozen=True)
class Table:
    """Rows of one entity, in the order of their steps: `step` (n,), and columns by name.

    A column of numbers is (n, k) where every row has k of them; any other is (n,) of objects.
    """

    step: NDArray[np.int64]
    columns: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.step)

    @property
    def scalars(self) -> NDArray[Any]:
        """(n, series)."""
        return self.columns.get("Scalars:scalars", np.zeros((0, 1)))

    def head(self, rows: int) -> Table:
        """The first rows of it."""
        return Table(self.step[:rows], {name: c[:rows] for name, c in self.columns.items()})


NOTHING = Table(np.zeros(0, dtype=np.int64), {})


def parallel(rows: Mapping[str, Table], names: Sequence[str]) -> list[Table]:
    """Tables whose rows are written together, as far as a file that may be cut has all of them.

    Raises BadRecording if their steps are not the same.
    """
    found = [rows.get(name, NOTHING) for name in names]
    whole = [table.head(min(map(len, found))) for table in found]
    if any((table.step != whole[0].step).any() for table in whole):
        raise BadRecording(f"it is damaged ({names[0]} and what belongs to it are of other steps)")
    return whole


def read(path: Path, size: int, entities: Sequence[str]) -> dict[str, Table]:
    """All rows of these entities, as `/a/b` or `/a/**`, in the first `size` bytes of a file.

    A step's row counts once. Raises ValueError and more where the file is damaged.
    """
    batches: dict[str, list[pa.RecordBatch]] = {}
    left = MOST_BYTES
    for rows in rrd_format.batches(path, size):
        is_static = not any(time in rows.schema.names for time in _TIMES)
        if is_static and not rows.entity.startswith(PROPERTIES):  # how a curve looks
            continue
        if any(_is_in(rows.entity, entity) for entity in entities):
            left -= rows.size
            if left < 0:
                raise BadRecording(f"it holds more than {MOST_BYTES / 1e9:.0f} GB")
            batches.setdefault(rows.entity, []).append(rows.read())
    return {name: _checked(name, _table(found)) for name, found in batches.items()}


def _checked(name: str, table: Table) -> Table:
    """The table without its numbers and checksums, where it has some.

    Raises BadRecording if one of them is wrong.
    """
    columns = dict(table.columns)
    sums = columns.pop(CHECKSUM, None)
    if sums is not None:
        for k, (step, (right,)) in enumerate(zip(table.step.tolist(), sums.tolist(), strict=True)):
            if checksum(step, {n: c[k] for n, c in columns.items()}) != right:
                what = name.rpartition("/")[2]
                raise BadRecording(
                    f"its {what} at step {step:,} was changed: its checksum is wrong"
                )
    numbers = columns.pop(NUMBER, None)
    if numbers is not None and (numbers[:, 0] != np.arange(len(table))).any():
        raise BadRecording(f"it is damaged (a {name.rpartition('/')[2]} is missing)")
    return Table(table.step, columns)


def read_rows(path: Path, entities: tuple[str, ...]) -> dict[str, Table]:
    """Rows of a recording's entities; raises as `readable` does."""
    return readable(path, lambda: read(path, rrd_format.extent(path).size, entities))


def _is_in(name: str, entity: str) -> bool:
    """Whether a name is that of an entity, or in the tree `/a/**`."""
    tree = entity.removesuffix("/**")
    return name == tree or (tree != entity and name.startswith(f"{tree}/"))


def readable(path: Path, read: Callable[[], T]) -> T:
    """Return the result of `read`; raises BadRecording, with one line, if a file is damaged."""
    try:
        return read()
    except OSError:
        raise
    except BadRecording as error:
        raise BadRecording(f"cannot read {path}: {error}") from error
    except Exception as error:  # damaged, it makes arrow and json raise many kinds
        first = (str(error).splitlines() or [""])[0][:160]
        raise BadRecording(f"cannot read {path}: it is damaged ({first})") from error


def numbers(column: Any) -> NDArray[Any]:
    """The numbers of an arrow array without nulls; pyarrow's own way would import pandas."""
    if pa.types.is_boolean(column.type):
        return np.array(column.to_pylist(), dtype=bool)
    data = np.frombuffer(column.buffers()[1], dtype=column.type.to_pandas_dtype())
    return data[column.offset : column.offset + len(column)]


_ROW_ID = "rerun.controls.RowId"
_TIMES = ("step", "sim_time", "log_time", "log_tick")


def _table(batches: list[pa.RecordBatch]) -> Table:
    """The batches as one; rows that stand in two of them are taken once."""
    step = np.concatenate([_steps(b) for b in batches])
    identity = np.concatenate([_identities(b) for b in batches])
    order = np.lexsort((identity[:, 1], identity[:, 0], step))
    again = (np.diff(identity[order].astype(np.int64), axis=0) == 0).all(axis=1)
    order = order[~np.concatenate(([False], again))]
    names = {n: None for b in batches for n in b.schema.names if n not in (*_TIMES, _ROW_ID)}
    return Table(step[order], {n: _column(batches, n)[order] for n in names})


def _steps(batch: pa.RecordBatch) -> NDArray[np.int64]:
    if "step" in batch.schema.names:
        return numbers(batch.column("step"))
    return np.zeros(batch.num_rows, dtype=np.int64)


def _identities(batch: pa.RecordBatch) -> NDArray[np.uint64]:
    """The rows' numbers, (n, 2), ascending as they were written."""
    column = batch.column(_ROW_ID)
    data = np.frombuffer(column.buffers()[1], dtype=">u8").reshape(-1, 2)
    return data[column.offset : column.offset + len(column)].astype(np.uint64)


def _column(batches: list[pa.RecordBatch], name: str) -> NDArray[Any]:
    parts = [
        _rows(b.column(name)) if name in b.schema.names else objects([None] * b.num_rows)
        for b in batches
    ]
    if any(p.dtype == object for p in parts) or len({p.shape[1:] for p in parts}) > 1:
        return objects([row for part in parts for row in part])
    return np.concatenate(parts)


def _rows(column: Any) -> NDArray[Any]:
    """One entry per row: (n, k) numbers where all rows have k, else (n,) objects."""
    if not pa.types.is_list(column.type):
        return objects(column.to_pylist())
    inner = column.values
    if pa.types.is_struct(inner.type):
        return _tensors(column)
    if not (pa.types.is_floating(inner.type) or pa.types.is_integer(inner.type)):
        return objects(v[0] if len(v) == 1 else v for v in column.to_pylist())
    data = np.frombuffer(column.buffers()[1], dtype=np.int32)
    ends = data[column.offset : column.offset + len(column) + 1]
    values, lengths = numbers(inner), np.diff(ends)
    if len(lengths) and (lengths == lengths[0]).all():
        return values[ends[0] : ends[-1]].reshape(len(lengths), -1)
    return objects(values[a:b] for a, b in pairwise(ends))


def _tensors(column: Any) -> NDArray[Any]:
    """The numbers of tensors of float32, one in each row; raises ValueError for any others."""
    buffers = column.flatten().field("buffer")
    code = next(k for k in range(buffers.type.num_fields) if buffers.type.field(k).name == "F32")
    kinds, offsets = (np.asarray(numbers(a)) for a in (buffers.type_codes, buffers.offsets))
    if (kinds != code).any() or (np.diff(offsets) != 1).any() or len(kinds) != len(column):
        raise ValueError("tensors of another kind")
    if not len(kinds):
        return objects(())
    return _rows(buffers.field(code))[offsets[0] : offsets[0] + len(offsets)]
