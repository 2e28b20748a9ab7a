"""Files that are small and claim to be large, and what is no file: refused in one line, at once."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import ipc

from hebbviz.learner import npz, saves
from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main
from hebbviz.server.recording import reader, rrd_format, tables
from hebbviz.server.recording.header import BadRecording
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task

ROOT = Path(__file__).parents[2]
GIGABYTE = 10**9
MOST_MEMORY = 0.8
"""Gigabytes that the program takes, everything that it imports included; a bomb has 1 to 3."""


def varint(number: int) -> bytes:
    low, rest = number & 127, number >> 7
    return bytes([low | 128]) + varint(rest) if rest else bytes([low])


def field(number: int, value: int | bytes) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    return varint(number << 3 | 2) + varint(len(value)) + value


def message(payload: bytes, *, size: int | None = None) -> bytes:
    """A message of rows, packed with LZ4 to be of a size, or as it is."""
    packed = field(2, 1 if size is None else 2) + field(3, size or len(payload))
    fields = field(1, field(1, 1)) + packed + field(5, payload)
    return struct.pack("<QQ", 2, len(fields)) + fields


def recording(*parts: bytes) -> bytes:
    return b"RRF2" + bytes(8) + b"".join(parts)


def arrow(
    columns: dict[str, pa.Array], *, entity: str = reader.RUN, packed: str | None = None
) -> bytes:
    """Arrow's stream of one batch of an entity."""
    batch = pa.RecordBatch.from_pydict(columns)
    batch = batch.replace_schema_metadata({"rerun:entity_path": entity})
    sink = pa.BufferOutputStream()
    options = ipc.IpcWriteOptions(compression=packed)
    with ipc.new_stream(sink, batch.schema, options=options) as writer:
        writer.write_batch(batch)
    return bytes(sink.getvalue())


def ids(rows: int) -> pa.Array:
    return pa.array([bytes(16)] * rows, pa.binary(16))


def of_zstd() -> bytes:
    """3 GB, made of the same columns again and again."""
    column = pa.array(np.zeros(GIGABYTE // 80))
    return recording(message(arrow({f"a{k}": column for k in range(30)}, packed="zstd")))


def of_lz4() -> bytes:
    content = bytes(GIGABYTE)
    return recording(message(pa.Codec("lz4_raw").compress(content).to_pybytes(), size=GIGABYTE))


def of_rows_without_columns() -> bytes:
    return recording(message(arrow({"a": pa.nulls(10**7)})))


def of_runs() -> bytes:
    ends, values = pa.array([2**31 - 1], pa.int32()), pa.array(["x"])
    return recording(message(arrow({"a": pa.RunEndEncodedArray.from_arrays(ends, values)})))


def of_a_column_outside() -> bytes:
    column = pa.array(np.zeros(1000))
    place, elsewhere = struct.pack("<qq", 8000, 8000), struct.pack("<qq", 8000 << 30, 8000)
    first, _, rest = arrow({"a": column, "b": column}).rpartition(place)
    return recording(message(first + elsewhere + rest))


RECORDINGS: dict[str, tuple[Callable[[], bytes], str]] = {
    "zstd": (of_zstd, "packed columns"),
    "lz4": (of_lz4, "a message of 1000000000 bytes"),
    "null": (of_rows_without_columns, "a column of null"),
    "runs": (of_runs, "a column of run_end_encoded"),
    "outside": (of_a_column_outside, "it is damaged (Read out of bounds"),
}


def saved(path: Path) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """Header and arrays of a learner that was saved."""
    saves.save(Learner(make_task("synapse")), path)
    with np.load(path) as found:
        arrays = {name: found[name] for name in found.files}
    return json.loads(str(arrays.pop("header"))), arrays


def save(path: Path, header: dict[str, object], arrays: dict[str, np.ndarray]) -> None:
    np.savez(path, header=np.array(json.dumps(header)), **arrays)


def npz_bombs(folder: Path) -> dict[str, str]:
    """Files that are written there, and what is said of them."""
    header, arrays = saved(folder / "plain.npz")
    np.savez_compressed(
        folder / "packed.npz", header=np.array(json.dumps(header)),
        **arrays | {"network": np.zeros((GIGABYTE // 8, 1))},
    )  # fmt: skip
    with zipfile.ZipFile(folder / "claims.npz", "w") as file:
        for name, array in {"header": np.array(json.dumps(header)), **arrays}.items():
            with file.open(f"{name}.npy", "w") as part:
                shape = (10**12, 1) if name == "network" else array.shape
                said = np.lib.format.header_data_from_array_1_0(array) | {"shape": shape}
                np.lib.format.write_array_header_1_0(part, said)
                part.write(array.tobytes())
    topology = header["topology"]
    assert isinstance(topology, dict)
    groups = [[name, 1500, is_input] for name, _, is_input in topology["groups"]]
    save(folder / "network.npz", header | {"topology": topology | {"groups": groups}}, arrays)
    return {
        "packed.npz": "or it is damaged", "claims.npz": "or it is damaged",
        "network.npz": "its arrays are too small for its network",
    }  # fmt: skip


PROGRAM = """
import resource, sys
from hebbviz.server.cli.main import main
for command in sys.stdin.read().splitlines():
    print(main(command.split()))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9)
"""


@pytest.mark.slow
def test_bombs_are_refused_and_take_no_memory(tmp_path: Path) -> None:
    """All in one process, whose memory at its most is looked at."""
    commands, told = [], []
    for name, (make, words) in RECORDINGS.items():
        (tmp_path / f"{name}.rrd").write_bytes(make())
        commands.append(f"inspect {tmp_path}/{name}.rrd")
        told.append(words)
    with (tmp_path / "long.rrd").open("wb") as file:
        file.write(recording(struct.pack("<QQ", 2, 4 * GIGABYTE)))
        file.truncate(5 * GIGABYTE)  # sparse: it takes no room
    commands.append(f"inspect {tmp_path}/long.rrd")
    told.append("a message of 4,000,000,000 bytes")
    for name, words in npz_bombs(tmp_path).items():
        commands.append(f"train --steps 1 --load {tmp_path}/{name}")
        told.append(words)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=ROOT, input="\n".join(commands), text=True, check=True,
        capture_output=True, timeout=60,
    )  # fmt: skip
    *codes, memory = done.stdout.split()
    lines = done.stderr.splitlines()
    assert codes == ["2"] * len(commands), done.stderr
    assert len(lines) == len(told)
    for line, words in zip(lines, told, strict=True):
        assert words in line
    assert float(memory) < MOST_MEMORY


def test_a_column_that_lies_outside_is_damage(tmp_path: Path) -> None:
    (tmp_path / "a.rrd").write_bytes(of_a_column_outside())
    with pytest.raises(BadRecording, match="it is damaged"):
        open_recording(tmp_path / "a.rrd")


def test_an_array_that_nobody_asked_for_is_not_read(tmp_path: Path) -> None:
    header, arrays = saved(tmp_path / "plain.npz")
    save(tmp_path / "more.npz", header, arrays | {"more": np.zeros(10**6)})
    content = (tmp_path / "more.npz").read_bytes()
    at = content.index(b"more.npy") + 10_000
    (tmp_path / "more.npz").write_bytes(content[:at] + b"x" + content[at + 1 :])
    learner = saves.load(tmp_path / "more.npz", make_task)
    assert learner.keyframe().digest() == Learner(make_task("synapse")).keyframe().digest()


def test_what_a_recording_holds_in_all_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "MOST_BYTES", 2_000_000)
    rows = {"rerun.controls.RowId": ids(1000), "a": pa.array(np.zeros(1000))}
    small = arrow(rows)
    (tmp_path / "many.rrd").write_bytes(recording(*[message(small)] * 90))
    with pytest.raises(BadRecording, match="holds more than 0 GB"):
        open_recording(tmp_path / "many.rrd")
    monkeypatch.setattr(rrd_format, "MOST_BYTES", 10_000)
    with pytest.raises(BadRecording, match="a message of 2"):
        open_recording(tmp_path / "many.rrd")


def test_steps_far_beyond_the_last_keyframe_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They would have to be made again, for ever."""
    run = Run(Learner(make_task("synapse")), make_task)
    recordings = Recordings(run, Options(file=tmp_path / "run.rrd"), on_notice=pytest.fail)
    while run.learner.step < 50:
        run.advance(50)
    run.frame()
    recordings.close()
    open_recording(tmp_path / "run.rrd")
    table = reader._moments
    monkeypatch.setattr(reader, "_moments", lambda t: table(t)[:1])
    monkeypatch.setattr(reader, "MOST_AHEAD", 40)
    with pytest.raises(BadRecording, match="far beyond its last keyframe"):
        open_recording(tmp_path / "run.rrd")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a system with named pipes")
@pytest.mark.parametrize(
    "command", ["inspect {}", "export {} --out nowhere", "replay {}", "view {}", "train --load {}"]
)
@pytest.mark.parametrize("kind", ["pipe", "folder", "device"])
def test_what_is_no_file_is_refused_at_once(
    kind: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pipe that nobody writes into would be waited for for ever."""
    path = Path("/dev/zero") if kind == "device" else tmp_path / "it"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    options = " --steps 1" if command.startswith("train") else ""
    options += " --no-browser --port 0" if command.startswith(("replay", "view")) else ""
    assert main((command.format(path) + options).split()) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(path) in said
    assert "a regular file" in said or "is a directory" in said or "it is not a file" in said


def test_a_pipe_is_no_npz(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a regular file"):
        npz.open_regular(tmp_path / "pipe")
