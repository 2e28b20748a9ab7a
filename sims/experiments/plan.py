"""The plan of an experiment, and its results."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

import hebbviz
from hebbviz.learner.learner import Learner
from hebbviz.rules.base import Rule
from hebbviz.sims.loading import compiled_twin, load_rule, make_task
from hebbviz.sims.user_file import neighbours, own_file, own_files
from hebbviz.task.base import Tally, Task

Array = NDArray[np.float64]

LONG = 5 * 10**9
"""Steps times lanes from which compiling for one network alone pays off."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Lanes of one task, run from step 0 in equal segments, which are points of a learning curve.

    Lane k of a seed is the same run in every plan, whatever the other lanes are, unless the rule
    couples lanes. A plan can be pickled; its JSON form identifies the saved work.

    Parameters
    ----------
    task, preset : by name, or a user's own as path.py:Name; remote workers look for the file at
        the same absolute path.
    hidden, beta, gamma : None for those of the task and its preset.
    lanes : number of replicas; `first_lane` is the number of the first.
    segments, segment_steps : number of points of the curve, and steps of each.
    evaluate : interval, in segments, between evaluations of a frozen copy, which start before the
        first segment; 0 for none.
    evaluate_at : further steps of evaluation, each the end of a segment.
    options : other keyword arguments of `Learner`, as numbers and strings; `load_rule` reads the
        rule.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    task: str
    preset: str | None = None
    hidden: tuple[int, ...] | None = None
    beta: float | None = None
    gamma: float | None = None
    seed: int = 0
    first_lane: int = 0
    lanes: int = 16
    segments: int
    segment_steps: int
    evaluate: int = 0
    evaluate_at: tuple[int, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, least in (("lanes", 1), ("segments", 1), ("segment_steps", 1), ("evaluate", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be {least} or more, got {getattr(self, name)}")

    @property
    def steps(self) -> int:
        """Total steps of each lane."""
        return self.segments * self.segment_steps

    def make_task(self) -> Task:
        """Make the task at its preset, compiled if possible.

        Raises ValueError and TaskError, as `loading.make_task` does.
        """
        return compiled_twin(make_task(self.task, self.preset))

    def rule(self) -> Rule:
        """Make the rule of the options or of the task's preset.

        Raises the same errors as `load_rule` and `make_task`.
        """
        spec = self.options.get("rule") or self.make_task().preset.rule
        return _rule(spec, _text(spec))

    def learner(self, first_lane: int, lanes: int) -> Learner:
        """Make a learner of some lanes at step 0.

        Raises ValueError and TaskError, as `Learner` does.
        """
        return Learner(
            self.make_task(),
            hidden=self.hidden,
            beta=self.beta,
            gamma=self.gamma,
            seed=self.seed,
            first_lane=first_lane,
            lanes=lanes,
            written_out=lanes * self.steps >= LONG,
            **{**self.options, "rule": self.rule()},
        )

    def for_workers(self) -> Self:
        """Return this plan with absolute paths of users' files, for workers in other folders."""
        options = dict(self.options)
        if "rule" in options:
            options["rule"] = _whole(options["rule"])
        return replace(self, task=_whole(self.task), options=options)

    def own(self) -> dict[str, Path]:
        """Return the users' files of this plan, as `own_files` does."""
        return own_files(self.task, self.options.get("rule"))

    def evaluates_at(self, step: int) -> bool:
        """Whether a frozen copy is evaluated at this step, which is the end of a segment, or 0."""
        regularly = self.evaluate > 0 and step % (self.evaluate * self.segment_steps) == 0
        return regularly or step in self.evaluate_at

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def digest(self) -> str:
        """Return 16 hexadecimal digits that identify this plan.

        They depend on hebbviz's version and on the text, not the place, of users' files. Raises
        OSError if such a file cannot be read.
        """
        options = dict(self.options)
        if "rule" in options:
            options["rule"] = _content(options["rule"])
        said = self.to_json() | {"task": _content(self.task), "options": options}
        content = json.dumps([hebbviz.__version__, said], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


@cache
def _rule(spec: str, _text: bytes) -> Rule:
    """Load a rule once per text of its file, because compiled code belongs to its class."""
    return load_rule(spec)


def _text(spec: str) -> bytes:
    """Return the bytes of a user's file and of the modules in its folder that it imports.

    The result is empty for a spec without a file.
    """
    file, _ = own_file(spec)
    if file is None:
        return b""
    texts = [file, *(path for _, path in sorted(neighbours(file).items()))]
    return b"".join(path.read_bytes() for path in texts)


def _content(spec: str) -> list[str]:
    """Return the class name and the text of a spec, independent of the file's place."""
    _, name = own_file(spec)
    return [name, _text(spec).decode(errors="surrogateescape")]


def _whole(spec: str) -> str:
    """Return a spec with the absolute path of its file."""
    file, name = own_file(spec)
    return spec if file is None else f"{file.resolve()}:{name}"


class _Asked(Protocol):
    @property
    def rule(self) -> str | None: ...
    @property
    def fall(self) -> float | None: ...


def options_of(asked: _Asked) -> dict[str, Any]:
    """Return a plan's options for the requested rule and decay time; None leaves the preset's."""
    options = {"rule": asked.rule, "fall": asked.fall}
    return {name: value for name, value in options.items() if value is not None}


@dataclass(frozen=True)
class Curves:
    """The results of a plan for each lane.

    `end` (segments,) is the step at the end of each segment; `reward`, `broadcast` and `ended`
    (lanes, segments) are totals over segments of `steps` steps. Frozen copies were evaluated at
    the steps `evaluated_at` (k,); `figures` holds the results (lanes, k) by the keys of
    `Task.evaluate`.
    """

    end: NDArray[np.int64]
    steps: int
    reward: Array
    broadcast: Array
    ended: Array
    evaluated_at: NDArray[np.int64]
    figures: Mapping[str, Array]

    def tally(self, lane: int, segments: slice = slice(None)) -> Tally:
        """Return the totals of one lane over some segments, by default all."""
        reward, broadcast, ended = (
            a[lane, segments] for a in (self.reward, self.broadcast, self.ended)
        )
        return Tally(self.steps * len(reward), reward.sum(), broadcast.sum(), ended.sum())

    def scores(self, task: Task) -> dict[str, Array]:
        """Return the figures of the task's measure in every segment, each (lanes, segments)."""
        lanes, segments = self.reward.shape
        return figures_of(
            task,
            [[self.tally(lane, slice(k, k + 1)) for k in range(segments)] for lane in range(lanes)],
        )

    def last(self, part: float = 0.2) -> list[Tally]:
        """Return the totals of each lane over the last part of the segments, at least one."""
        count = max(1, round(part * len(self.end)))
        return [self.tally(lane, slice(-count, None)) for lane in range(len(self.reward))]


def figures_of(task: Task, tallies: Sequence[Sequence[Tally]]) -> dict[str, Array]:
    """Return the figures of the task's measure, each with the shape of `tallies`, (lanes, n)."""
    found = [[task.measure.figures(task.score(tally)) for tally in lane] for lane in tallies]
    return {key: np.array([[f[key] for f in lane] for lane in found]) for key in task.measure.keys}


def joined(curves: Sequence[Curves], lanes: int) -> Curves:
    """Join the lanes of curves over the same steps; raise ValueError unless there are `lanes`."""
    first = curves[0]
    found = sum(len(c.reward) for c in curves)
    if found != lanes:
        raise ValueError(f"the curves must have {lanes} lanes together, got {found}")

    def stacked(name: str) -> Array:
        return np.concatenate([getattr(c, name) for c in curves])

    return Curves(
        first.end,
        first.steps,
        stacked("reward"),
        stacked("broadcast"),
        stacked("ended"),
        first.evaluated_at,
        {name: np.concatenate([c.figures[name] for c in curves]) for name in first.figures},
    )
