"""Files and the command line of a checkout, as `digests.py` reads them."""

from __future__ import annotations

import csv
import importlib
import json
import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import digest_source
import numpy as np
from digest_source import Parts

UNSTABLE = {"seconds", "steps_per_second", "bytes", "version", "versions", "machine", "thinning"}
"""Keys of JSON that tell of the program or of this moment, not of the run."""


def command(folder: Path, *words: str) -> str:
    """Output of a command of the checkout; raises RuntimeError if it fails."""
    environment = os.environ | {"PYTHONPATH": str(digest_source.root), "HEBBVIZ_TRACEBACK": "1"}
    made = subprocess.run(
        [sys.executable, "-m", "hebbviz", *words], cwd=folder, env=environment, check=False,
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    if made.returncode:
        raise RuntimeError(f"hebbviz {' '.join(words)}: {made.stderr[-300:]}")
    return made.stdout


def trained(*options: str) -> Parts:
    """Learn, save, and go on with what was saved."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begun = command(folder, "train", *options, "--steps", "3000", "--save", "a", "--json")
        saves = arrays_of(folder / "a.npz")
        more = ("--beta", "0.6", "--gamma", "1e-3", "--fall", "1e4", "--steps", "1000")
        on = command(folder, "train", "--load", "a.npz", *more, "--save", "b", "--json")
        found = {"begun": begun, "on": on}
        parts = {key: stable(json.loads(text)) for key, text in found.items()}
        return {**parts, "save": saves, "second save": arrays_of(folder / "b.npz")}


def train_recorded(*options: str) -> Parts:
    """Recorded from the command line; when frames and keyframes are made depends on the clock."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command(folder, "train", *options, "--steps", "2000", "--record", "a.rrd", "--save", "a")
        command(folder, "export", "a.rrd", "--out", "timelines")
        command(folder, "export", "a.rrd", "--out", "steps", "--every-step", "1:1500")
        timelines = files_of(folder / "timelines")
        names = ("steps.csv", "curve.csv", "episodes.csv", "events.csv")
        return {
            "save": arrays_of(folder / "a.npz"),
            "timelines": {name: timelines[name] for name in names if name in timelines},
            "every step": files_of(folder / "steps"),
        }


def figured(*words: str) -> Parts:
    with tempfile.TemporaryDirectory() as name:
        said = command(Path(name), *words, "--out", "made")
        return {"json": stable(json.loads(said)), "files": files_of(Path(name) / "made")}


def arrays_of(path: Path) -> Parts:
    """All of an npz; what it says of itself as JSON."""
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    if "header" in arrays:
        arrays["header"] = stable(json.loads(str(arrays["header"])))
    return arrays


def files_of(folder: Path) -> Parts:
    """All files under a folder, by name, but for pictures of points and what a run is kept in."""
    readers = {".npz": arrays_of, ".csv": _lines, ".svg": _text, ".txt": _text}
    return {
        str(file.relative_to(folder)): readers[file.suffix](file)
        for file in sorted(folder.rglob("*"))
        if file.suffix in readers and "runs" not in file.relative_to(folder).parts
    }


def _lines(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.reader(file) if not row[0].startswith("# version")]


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8").replace(_version(), "VERSION")


@cache
def _version() -> str:
    return str(importlib.import_module("hebbviz").__version__)


def stable(said: Any) -> Any:
    """JSON without what is UNSTABLE."""
    if isinstance(said, dict):
        return {key: stable(value) for key, value in said.items() if key not in UNSTABLE}
    return [stable(value) for value in said] if isinstance(said, list) else said
