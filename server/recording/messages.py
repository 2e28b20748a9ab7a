"""A rerun file taken apart: message after message, and in each the rows of one entity.

A file is a header and messages: their kind, their length, and fields as protocol buffers write
them. One field is a stream of Arrow's, packed with LZ4. rerun could read all of this too, but where
a byte is wrong its reader may end the whole program; Arrow's raises.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
from pyarrow import ipc

MAGIC = b"RRF2"
_FILE_HEADER, _MESSAGE_HEADER = 12, struct.Struct("<QQ")
_END, _ROWS = 0, 2
"""Kinds of messages; after the end there is only an index."""
_STORE, _COMPRESSION, _SIZE, _PAYLOAD = 1, 2, 3, 5
"""Fields of a message of rows."""
_KIND_OF_STORE, _RECORDING = 1, 1
_PLAIN, _LZ4 = 1, 2
_MOST_PACKED = 256
"""LZ4 makes nothing smaller by more than this."""
_PATH = b"rerun:entity_path"

Fields = dict[int, int | bytes]


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
    total = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise ValueError("it is no rerun file")
        at, kind = _FILE_HEADER, -1
        while kind != _END and (message := _message(file, at, total)) is not None:
            kind, at = message
    return Extent(at, is_cut=kind != _END and at < total, has_end=kind == _END)


def batches(path: Path, size: int) -> Iterator[tuple[str, ipc.RecordBatchStreamReader]]:
    """Entity and rows, still to be read, of each message in the first `size` bytes.

    Of the first recording, if there are several, and of no blueprint. Raises ValueError where
    they are damaged.
    """
    recording, at = None, _FILE_HEADER
    with path.open("rb") as file:
        while (message := _message(file, at, size)) is not None and message[0] != _END:
            kind, end = message
            if kind == _ROWS:
                fields = _fields(file.read(end - at - _MESSAGE_HEADER.size))
                store = _bytes(fields, _STORE)
                if _fields(store).get(_KIND_OF_STORE) == _RECORDING:
                    recording = store if recording is None else recording
                    if store == recording:
                        yield _rows(fields)
            at = end


def read_batch(reader: ipc.RecordBatchStreamReader) -> pa.RecordBatch:
    """The rows, checked: none of them leads outside of what was read. Raises ValueError."""
    try:
        batch = reader.read_next_batch()
    except (OSError, StopIteration) as error:
        raise ValueError(f"not rows: {error}") from error
    batch.validate(full=True)
    return batch


def _message(file: BinaryIO, at: int, total: int) -> tuple[int, int] | None:
    """Kind and end of the message at a place, None if it is not whole; its fields are next."""
    file.seek(at)
    head = file.read(_MESSAGE_HEADER.size)
    if len(head) < _MESSAGE_HEADER.size:
        return None
    kind, length = _MESSAGE_HEADER.unpack(head)
    end = at + _MESSAGE_HEADER.size + length
    return (kind, end) if end <= total else None


def _rows(fields: Fields) -> tuple[str, ipc.RecordBatchStreamReader]:
    packed, size = _bytes(fields, _PAYLOAD), fields.get(_SIZE, 0)
    try:
        if fields.get(_COMPRESSION, _PLAIN) == _LZ4:
            if not isinstance(size, int) or size > _MOST_PACKED * len(packed):
                raise ValueError(f"{len(packed)} bytes hold no {size!r}")
            packed = pa.Codec("lz4_raw").decompress(packed, size)
        reader = ipc.open_stream(packed)
    except OSError as error:  # Arrow's, where the bytes make no sense
        raise ValueError(str(error)) from error
    return (reader.schema.metadata or {}).get(_PATH, b"").decode(), reader


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
