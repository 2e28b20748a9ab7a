"""The compiler's cache saves time and is never needed: whatever becomes of it, programs run."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = """
from hebbviz.numerics.compile import compiled

@compiled
def halved(x):
    return x / 2.0

print(halved(5.0), len(halved.stats.cache_hits))
"""
KEPT, ANEW = "2.5 1\n", "2.5 0\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A program and the compiler's cache of it."""
    (tmp_path / "mine.py").write_text(SCRIPT)
    assert run(tmp_path) == (ANEW, "")
    return tmp_path


def run(folder: Path, script: str = "mine.py", **settings: str) -> tuple[str, str]:
    """What a process says, and what it tells on stderr."""
    env = {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(ROOT)} | settings
    env = {name: value for name, value in env.items() if value}
    done = subprocess.run(
        [sys.executable, script], cwd=folder, env=env, check=True, capture_output=True, text=True
    )
    return done.stdout, done.stderr


def cached(folder: Path, kind: str) -> Path:
    (path,) = (folder / "cache").glob(f"*/*halved*.{kind}")
    return path


def empty(path: Path) -> None:
    path.write_bytes(b"")


def halve(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        ("nbi", empty),
        *(pytest.param("nbi", d, marks=pytest.mark.slow) for d in (halve, flip)),
        *(pytest.param("nbc", d, marks=pytest.mark.slow) for d in (empty, halve, flip)),
    ],
)
def test_a_damaged_file_is_compiled_again(
    kind: str, damage: Callable[[Path], None], folder: Path
) -> None:
    damage(cached(folder, kind))
    said, told = run(folder)
    assert said == ANEW
    assert told.count("\n") == 1
    assert told.startswith(f"hebbviz: the compiler's cache in {folder}/cache/")
    assert "is damaged" in told
    assert "delete its files" in told
    assert run(folder) == (KEPT, "")


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "full"
    path.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", path], capture_output=True, check=False
    )
    if made.returncode:
        pytest.skip("no small file system can be mounted here")
    (path / "filler").write_bytes(bytes(60_000))
    yield path
    subprocess.run(["umount", path], check=True)


@pytest.mark.slow
def test_on_a_full_disk_nothing_is_kept(folder: Path, full_disk: Path) -> None:
    for _ in range(2):
        said, told = run(folder, NUMBA_CACHE_DIR=str(full_disk))
        assert said == ANEW
        assert told.count("\n") == 1
        assert f"cache in {full_disk}" in told
        assert "cannot be written (No space left on device)" in told
        assert "NUMBA_CACHE_DIR" in told


@pytest.mark.parametrize(
    "home",
    ["/dev/null/none", pytest.param("~", marks=pytest.mark.slow)],
    ids=["none", "unknown, as under env -i"],
)
def test_without_a_folder_nothing_is_kept_and_none_is_made(home: str, tmp_path: Path) -> None:
    """An installation that cannot be written, of a user without a home."""
    (tmp_path / "__pycache__").touch()  # no folder can be made there
    (tmp_path / "mine.py").write_text(SCRIPT)
    said, told = run(tmp_path, NUMBA_CACHE_DIR="", HOME=home)
    assert said == ANEW
    assert told.count("\n") == 1
    assert f"cache in {tmp_path}/__pycache__ cannot be written" in told
    assert "NUMBA_CACHE_DIR" in told
    assert not (tmp_path / "~").exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="needs setpriv")
def test_a_program_that_has_no_place_for_anything_trains_and_says_why_it_starts_slowly(
    tmp_path: Path,
) -> None:
    """Read-only files, an empty environment, no home."""
    for package in ("hebbviz",):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignored)
        for found in (tmp_path / package, *(tmp_path / package).glob("**/")):
            (found / "__pycache__").touch()
    done = subprocess.run(
        [sys.executable, "-m", "hebbviz", "train", "--task", "synapse", "--steps", "5"],
        cwd=tmp_path, env={"HOME": "~"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0
    assert done.stdout.startswith("synapse hand")
    assert all("cannot be written, nor one in a home" in x for x in done.stderr.splitlines())
    assert not (tmp_path / "~").exists()


def test_without_the_compiler_it_is_said_in_one_line_that_nothing_runs() -> None:
    env = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "hebbviz", "train", "--steps", "5"],
        cwd=ROOT, env=env, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    why = "NUMBA_DISABLE_JIT is set, but no network runs without the compiler: unset it"
    assert done.stderr == f"hebbviz: {why}\n"
