"""A rerun file taken apart: message after message, and in each the rows of one entity.

A file is a header and messages: their kind, their length, and fields as protocol buffers write
them. One field is a stream of Arrow's, packed with LZ4. rerun could read all of this too, but where
a byte is wrong its reader may end the whole program; Arrow's raises.

A file may say little and unfold to much. So what a message holds is bounded, packed or not, and of
Arrow's own ways to say much in few bytes none is taken that rerun does not use: packed columns,
columns without numbers of their own, rows that share them.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
from pyarrow import ipc

from hebbviz.learner.npz import open_regular

MAGIC = b"RRF2"
MOST_BYTES = 256_000_000
"""Of a message."""
_FILE_HEADER, _MESSAGE_HEADER = 12, struct.Struct("<QQ")
_END, _ROWS = 0, 2
"""Kinds of messages; after the end there is only an index."""
_STORE, _COMPRESSION, _SIZE, _PAYLOAD = 1, 2, 3, 5
"""Fields of a message of rows."""
_KIND_OF_STORE, _RECORDING = 1, 1
_PLAIN, _LZ4 = 1, 2
_PATH = b"rerun:entity_path"
_ROW_ID_BYTES = 16
_HEADER, _BUFFERS_ARE_PACKED = 2, 3
"""Fields of Arrow's tables Message and RecordBatch, by their place in Message.fbs."""

Fields = dict[int, int | bytes]


@dataclass(frozen=True)
class Rows:
    """Rows of one entity, still to be read; `size` is in bytes."""

    entity: str
    schema: pa.Schema
    size: int
    _message: ipc.Message

    def read(self) -> pa.RecordBatch:
        """The rows, checked: none of them leads outside of what was read. Raises ValueError."""
        for kind in self.schema.types:
            _check_type(kind)
        if _is_packed(self._message.metadata):
            raise ValueError("packed columns")
        try:
            batch = ipc.read_record_batch(self._message, self.schema)
        except OSError as error:  # Arrow's, for a column that is said to lie outside
            raise ValueError(str(error)) from error
        batch.validate(full=True)
        if batch.num_rows * _ROW_ID_BYTES > self.size:
            raise ValueError("more rows than it has room for")
        return batch


@dataclass(frozen=True)
class Extent:
    """How far a file is whole: bytes of whole messages, whether a part of one is missing, and
    whether the message that ends a file is there.
    """

    size: int
    is_cut: bool
    has_end: bool


def extent(path: Path) -> Extent:
    """Walk from message to message; raises ValueError if it does not begin as rerun's files do."""
    with open_regular(path) as file:
        total = os.fstat(file.fileno()).st_size
        if not total:
            raise ValueError("it is empty")
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it is no rerun file")
        at, kind = _FILE_HEADER, -1
        while kind != _END and (message := _message(file, at, total)) is not None:
            kind, at = message
    return Extent(at, is_cut=kind != _END and at < total, has_end=kind == _END)


def batches(path: Path, size: int) -> Iterator[Rows]:
    """The rows of each message in the first `size` bytes.

    Of the first recording, if there are several, and of no blueprint. Raises ValueError where
    they are damaged, or larger than `MOST_BYTES`.
    """
    recording, at = None, _FILE_HEADER
    with open_regular(path) as file:
        while (message := _message(file, at, size)) is not None and message[0] != _END:
            kind, end = message
            if kind == _ROWS:
                length = end - at - _MESSAGE_HEADER.size
                if length > MOST_BYTES:
                    raise ValueError(f"a message of {length:,} bytes")
                fields = _fields(file.read(length))
                store = _bytes(fields, _STORE)
                if _fields(store).get(_KIND_OF_STORE) == _RECORDING:
                    recording = store if recording is None else recording
                    if store == recording:
                        yield _rows(fields)
            at = end


def _message(file: BinaryIO, at: int, total: int) -> tuple[int, int] | None:
    """Kind and end of the message at a place, None if it is not whole; its fields are next."""
    file.seek(at)
    head = file.read(_MESSAGE_HEADER.size)
    if len(head) < _MESSAGE_HEADER.size:
        return None
    kind, length = _MESSAGE_HEADER.unpack(head)
    end = at + _MESSAGE_HEADER.size + length
    return (kind, end) if end <= total else None


def _rows(fields: Fields) -> Rows:
    packed, size = _bytes(fields, _PAYLOAD), fields.get(_SIZE, 0)
    try:
        if fields.get(_COMPRESSION, _PLAIN) == _LZ4:
            if not isinstance(size, int) or size > MOST_BYTES:
                raise ValueError(f"a message of {size!r} bytes")
            packed = pa.Codec("lz4_raw").decompress(packed, size)
        messages = ipc.MessageReader.open_stream(packed)
        schema = ipc.read_schema(messages.read_next_message())
        message = messages.read_next_message()
    except (OSError, StopIteration) as error:  # Arrow's, where the bytes make no sense
        raise ValueError(f"not rows: {error}") from error
    if message.type != "record batch":
        raise ValueError(f"not rows but a {message.type}")
    entity = (schema.metadata or {}).get(_PATH, b"").decode()
    return Rows(entity, schema, len(packed), message)


def _check_type(kind: Any, depth: int = 0) -> None:
    """Raise ValueError for columns that rerun writes none of."""
    is_few = pa.types.is_fixed_size_list(kind) and 1 <= kind.list_size <= 16
    if is_few or pa.types.is_list(kind):
        _check_type(kind.value_type, depth + 1)
    elif not (
        pa.types.is_floating(kind)
        or pa.types.is_integer(kind)
        or pa.types.is_boolean(kind)
        or pa.types.is_string(kind)
        or pa.types.is_temporal(kind)
        or (pa.types.is_fixed_size_binary(kind) and kind.byte_width == _ROW_ID_BYTES)
        or (pa.types.is_struct(kind) and depth == 1)  # a tensor, see `chunks`
    ):
        raise ValueError(f"a column of {kind}")


def _is_packed(message: Any) -> bool:
    """Whether the buffers of a record batch are packed, by the flat buffer that describes it."""
    data = memoryview(message)
    (root,) = struct.unpack_from("<I", data, 0)
    header = _place(data, root, _HEADER)
    assert header is not None
    (batch,) = struct.unpack_from("<I", data, header)
    return _place(data, header + batch, _BUFFERS_ARE_PACKED) is not None


def _place(data: memoryview, table: int, field: int) -> int | None:
    """Where a field of a flat buffer's table is, None if it has none."""
    (back,) = struct.unpack_from("<i", data, table)
    (length,) = struct.unpack_from("<H", data, table - back)
    if 4 + 2 * field >= length:
        return None
    (offset,) = struct.unpack_from("<H", data, table - back + 4 + 2 * field)
    return table + offset if offset else None


def _bytes(fields: Fields, number: int) -> bytes:
    value = fields.get(number, b"")
    if not isinstance(value, bytes):
        raise ValueError(f"a number in the place of field {number}")
    return value


def _fields(message: bytes) -> Fields:
    """Fields by their number; of those that are repeated, the last."""
    fields: Fields = {}
    at = 0
    while at < len(message):
        key, at = _number(message, at)
        kind, value = key & 7, 0
        if kind == 0:
            value, at = _number(message, at)
            fields[key >> 3] = value
            continue
        if kind == 2:
            length, at = _number(message, at)
        else:
            length = {1: 8, 5: 4}[kind]
        if at + length > len(message):
            raise ValueError("a field that goes on beyond its message")
        fields[key >> 3] = message[at : at + length]
        at += length
    return fields


def _number(message: bytes, at: int) -> tuple[int, int]:
    """A number in as many bytes as it needs, 7 bits in each, and where it ends."""
    number = shift = 0
    while True:
        byte = message[at]
        number |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return number, at
