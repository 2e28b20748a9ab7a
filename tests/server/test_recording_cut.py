"""A recording that was cut anywhere exports what is whole, and no command leaves half an output."""

from __future__ import annotations

import contextlib
import csv
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hebbviz.learner.learner import Learner
from hebbviz.server.cli.main import main
from hebbviz.server.recording import segment
from hebbviz.server.recording.export import export_timelines
from hebbviz.server.recording.reader import BadRecording, open_recording
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.run.changes import SetBeta
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.whole_folder import whole_folder

Arrays = dict[str, np.ndarray]


def record(path: Path) -> Path:
    """Every step, weights at each, changes, episodes' ends; in several flushes."""
    run = Run(Learner(make_task("pendulum"), hidden=(2,), seed=3), make_task)
    recordings = Recordings(run, Options(file=path), on_notice=pytest.fail)
    for k in range(3):
        for _ in range(4):
            run.advance(60)
            run.frame()
        run.change(SetBeta(0.9 + k / 100))
        run.keep()
        time.sleep(1.5 * segment.FLUSH_SECONDS)
    recordings.close()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("whole") / "run.rrd")


def edges(content: bytes) -> list[int]:
    """Where the messages of a rerun file begin and end."""
    at, found = 12, [12]
    while at < len(content):
        at += 16 + struct.unpack_from("<QQ", content, at)[1]
        found.append(at)
    assert at == len(content)
    return found


def exported(path: Path, out: Path) -> Arrays:
    export_timelines(open_recording(path), out)
    with np.load(out / "timelines.npz") as found:
        arrays = {name: found[name] for name in found.files}
    for table in out.glob("*.csv"):
        lines = list(csv.reader(table.read_text().splitlines()))
        group, step = table.stem, arrays.get(f"{table.stem}_step")
        assert step is None or [int(line[0]) for line in lines[1:]] == step.tolist(), group
    return arrays


def check_beginnings(content: bytes, ends: list[int], folder: Path) -> int:
    """Whether what is exported of each beginning of a file is the beginning of what is exported of
    all; returns how many could be opened.
    """
    (folder / "all.rrd").write_bytes(content)
    everything, opened, before = exported(folder / "all.rrd", folder / "all"), 0, 0
    for end in sorted(ends):
        (folder / "cut.rrd").write_bytes(content[:end])
        with contextlib.suppress(BadRecording):
            open_recording(folder / "cut.rrd")
            opened += 1
            found = exported(folder / "cut.rrd", folder / f"out-{end}")
            for name, values in found.items():
                assert np.array_equal(values, everything[name][: len(values)]), (end, name)
            steps = len(found.get("steps_step", ()))
            assert steps >= before, "of a longer piece less is exported"
            before = steps
    return opened


def test_what_is_whole_of_a_cut_recording_is_exported(whole: Path, tmp_path: Path) -> None:
    """The last edges are those between what the last flush wrote."""
    content = whole.read_bytes()
    places = edges(content)
    anywhere = np.random.default_rng(0).integers(places[-40], len(content), 5).tolist()
    assert check_beginnings(content, [*places[-40::2], *anywhere], tmp_path) == 25


@pytest.mark.slow
def test_what_is_whole_is_exported_wherever_it_was_cut(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    anywhere = np.random.default_rng(1).integers(0, len(content), 150).tolist()
    assert check_beginnings(content, [*edges(content), *anywhere], tmp_path) > 150


@pytest.mark.slow
def test_steps_of_a_cut_recording_are_made_again(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    for end in edges(content)[-60::12]:
        (tmp_path / "cut.rrd").write_bytes(content[:end])
        command = ["export", str(tmp_path / "cut.rrd"), "--every-step", "1:200"]
        assert main([*command, "--out", str(tmp_path / f"out-{end}")]) == 0


# Half an output


@contextlib.contextmanager
def failing_at(number: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The disk is full at the so-manieth file of an export."""
    from hebbviz.server.recording import export

    left = [number]
    write = export._write_lines

    def full(*args: object) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        return write(*args)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(export, "_write_lines", full)
        yield


@pytest.mark.parametrize("options", [[], ["--every-step", "5:9"]])
def test_an_export_that_fails_leaves_nothing(
    options: list[str], whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    old = tmp_path / "old"
    assert main(["export", str(whole), "--out", str(old), *options]) == 0
    kept = {path: path.read_bytes() for path in old.iterdir()}
    capsys.readouterr()
    for out in (tmp_path / "new" / "folder", old):
        with failing_at(0 if options else 2, monkeypatch):
            assert main(["export", str(whole), "--out", str(out), *options]) == 2
        said = capsys.readouterr().err
        assert said == f"hebbviz: cannot write {out}: no space left on device\n"
    assert list(tmp_path.iterdir()) == [old]
    assert {path: path.read_bytes() for path in old.iterdir()} == kept


def test_a_folder_is_there_when_all_of_it_is(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with whole_folder(folder) as part:
        (part / "one").write_text("1")
        assert not folder.exists()
    assert [p.name for p in folder.iterdir()] == ["one"]
    with whole_folder(folder) as part:
        (part / "two").write_text("2")
        assert [p.name for p in folder.iterdir() if not p.name.startswith(".")] == ["one"]
    assert sorted(p.name for p in folder.iterdir()) == ["one", "two"]
    assert [p.name for p in folder.parent.iterdir()] == ["b"]
    for name in ("b", "c"):
        with pytest.raises(OSError, match=str(folder.with_name(name))):
            begin_and_fail(folder.with_name(name))
    assert [p.name for p in folder.parent.iterdir()] == ["b"]
    assert (folder / "one").read_text() == "1"


def begin_and_fail(folder: Path) -> None:
    with whole_folder(folder) as part:
        (part / "one").write_text("another")
        (part / "nowhere" / "three").write_text("3")


def test_an_export_into_a_file_is_refused(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("precious")
    assert main(["export", str(whole), "--out", str(tmp_path / "file")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert (tmp_path / "file").read_text() == "precious"
