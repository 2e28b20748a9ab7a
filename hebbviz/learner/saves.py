"""Saved learners: an npz without pickle, with a format version and everything that a run needs.

A loaded learner continues exactly. Files are written under a temporary name and then renamed, so a
file of the final name is always complete.
"""

from __future__ import annotations

import json
import math
import os
import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner import npz
from hebbviz.learner.frames import Keyframe
from hebbviz.learner.learner import Learner
from hebbviz.limits import check_fall, fall_from_json, fall_to_json
from hebbviz.rules.base import Rule, make_rule
from hebbviz.rules.paper import PAPER
from hebbviz.task.base import Task
from hebbviz.topology import Topology

FORMAT = 2
"""Format 1 is that of the first versions, for the paper's rule and a constant γ; format 2 adds the
rule and the step-size decay time.
"""
PROGRAM = "hebbviz learner"
WHAT = "learner saved by hebbviz"

_ARRAYS = ("network", "world", "gamma")
_MEMORY = "memory"
"""One more array, for a rule with a memory."""


_KINDS = {
    "task": str,
    "preset": str,
    "seed": int,
    "lanes": int,
    "first_lane": int,
    "step": int,
    "frozen": bool,
    "dtype": str,
}
"""Types of the header's plain values; `Learner` checks their bounds."""


class BadFile(ValueError):
    """The file is not a learner, is damaged, or has a newer format; the message says which."""


@dataclass(frozen=True)
class Header:
    """The header of a saved learner: everything except the arrays."""

    task: str
    preset: str
    topology: Topology
    seed: int
    lanes: int
    first_lane: int
    step: int
    frozen: bool
    rule: Rule
    fall: float
    dtype: str


def save(learner: Learner, path: str | Path, *, task_name: str | None = None) -> Path:
    """Write a learner to `path` (.npz is added if missing) and return the path written.

    `task_name` is the user's spec of the task, if it differs from the task's name. Raises OSError
    if the file cannot be written; an older file of that name then stays unchanged.
    """
    target = Path(path) if str(path).endswith(".npz") else Path(f"{path}.npz")
    keyframe = learner.keyframe()
    is_first = (keyframe.rule, keyframe.fall) == (PAPER, math.inf)
    header = {
        "program": PROGRAM,
        "format": 1 if is_first else FORMAT,
        "task": task_name or learner.task.name,
        "preset": learner.task.preset_name,
        "topology": learner.topology.to_json(),
        "seed": learner.seed,
        "lanes": learner.lanes,
        "first_lane": learner.first_lane,
        "step": keyframe.step,
        "frozen": keyframe.frozen,
    }
    if learner.dtype != np.float64:
        header["dtype"] = learner.dtype.__name__
    if not is_first:
        header |= {"rule": str(keyframe.rule), "fall": fall_to_json(keyframe.fall)}
    arrays = {name: getattr(keyframe, name) for name in _names(keyframe.rule)}
    write_arrays(target, header, arrays)
    return target


def load(path: str | Path, make_task: Callable[[str, str], Task]) -> Learner:
    """Read a learner; `make_task(name, preset)` makes the task that the file names.

    Raises BadFile, with a one-line message, unless the file is a complete learner of this format
    or an older one, and OSError if it cannot be read.
    """
    header, arrays = _read(Path(path))
    task = make_task(header.task, header.preset)
    try:
        learner = Learner(
            task,
            topology=header.topology,
            seed=header.seed,
            lanes=header.lanes,
            first_lane=header.first_lane,
            dtype=header.dtype,
        )
        learner.restore(
            Keyframe(
                header.step, frozen=header.frozen, rule=header.rule, fall=header.fall, **arrays
            )
        )
    except ValueError as error:
        raise BadFile(f"{path} does not fit task {header.task!r}: {error}") from error
    return learner


def write_arrays(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write an npz of arrays and a JSON header under a temporary name, then rename it.

    Raises OSError if the file cannot be written; an older file of that name then stays unchanged.
    """
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        with part.open("xb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def read_arrays(
    path: Path,
    program: str,
    newest: int,
    *,
    what: str,
    names: Callable[[dict[str, Any]], Iterable[str]],
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read header and arrays of a file that `write_arrays` wrote for `program`.

    Its format must be `newest` or older. `what` describes the file in messages; `names` gives the
    arrays to read, from the header. Raises BadFile, with a one-line message, for any other or a
    damaged file, and OSError.
    """
    try:
        with npz.opened(path) as file:
            header = json.loads(file.text("header"))
            _check_origin(path, header, program, newest, what)
            return header, {name: file.array(name) for name in names(header)}
    except (OSError, BadFile):
        raise
    except Exception as error:  # a damaged file makes zipfile, numpy and json raise many kinds
        raise BadFile(f"{path} is not a {what}, or it is damaged") from error


def _read(path: Path) -> tuple[Header, dict[str, Any]]:
    data, found = read_arrays(
        path, PROGRAM, FORMAT, what=WHAT, names=lambda data: _names(_header(path, data).rule)
    )
    header = _header(path, data)
    if any(a.ndim != 2 or a.shape[1] != header.lanes for a in found.values()):
        raise BadFile(f"{path} is damaged: an array has a wrong shape")
    if not header.topology.fits_in(len(found["network"])):
        raise BadFile(f"{path} is damaged: its arrays are too small for its network")
    arrays = {name: array.astype(np.float64) for name, array in found.items()}
    return header, {_MEMORY: np.zeros((0, header.lanes))} | arrays


def _names(rule: Rule) -> tuple[str, ...]:
    """Return the names of the arrays of a learner with this rule."""
    return (*_ARRAYS, _MEMORY) if rule.memory else _ARRAYS


def _check_origin(path: Path, header: Any, program: str, newest: int, what: str) -> None:
    if not isinstance(header, dict) or header.get("program") != program:
        raise BadFile(f"{path} is not a {what}")
    if not isinstance(header.get("format"), int) or header["format"] > newest:
        raise BadFile(
            f"{path} has format {header.get('format')!r}, newer than this hebbviz knows "
            f"({newest}): update hebbviz"
        )


def _header(path: Path, data: dict[str, Any]) -> Header:
    try:
        rule = make_rule(str(data.get("rule", PAPER)))
    except ValueError as error:
        raise BadFile(f"{path} was saved with another rule: {error}") from error
    said = data | {"dtype": data.get("dtype", "float64")}
    for name, kind in _KINDS.items():
        if type(said[name]) is not kind:  # a bool is an int besides
            raise BadFile(f"{path} is damaged: its {name} is {said[name]!r}"[:400])
    return Header(
        topology=Topology.from_json(data["topology"]),
        rule=rule,
        fall=check_fall(fall_from_json(data.get("fall"))),
        **{name: said[name] for name in _KINDS},
    )
