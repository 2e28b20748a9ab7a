"""The header that describes a recording's run before its first step, and the format of changes."""

from __future__ import annotations

import dataclasses
import json
import platform
import re
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import hebbviz
from hebbviz.learner.settings import RunSettings
from hebbviz.limits import fall_from_json, fall_to_json
from hebbviz.rules.base import Rule, make_rule
from hebbviz.rules.paper import PAPER
from hebbviz.server.run.changes import (
    Change,
    Freeze,
    GiveReward,
    Logged,
    Press,
    SetBeta,
    SetFall,
    SetGamma,
    SetRule,
)
from hebbviz.task.base import Tally, Task
from hebbviz.topology import Topology

PROGRAM = "hebbviz recording"
FORMAT = 2
"""Format 2 has the rule, in the header and in every keyframe; format 1 had only the paper's rule.
"""
TASK = "task"
"""The key of the task's version among the versions."""
VERSIONS_OF = ("numpy", "numba", "pymunk", "rerun-sdk")

CHANGES = {
    kind.__name__: kind for kind in (SetBeta, SetGamma, SetFall, SetRule, Freeze, GiveReward, Press)
}
_TYPES = {"frozen": (bool,), "control": (str,), "rule": (str,)}
"""Types of the fields of changes; all others are numbers."""


class BadRecording(ValueError):
    """A file that is no recording of hebbviz, or a damaged one; the message says which and why."""


@dataclass(frozen=True)
class Header:
    """The run at the start of the recording.

    `log` holds the earlier changes, `edges` the totals at the windows' edges of the learning curve
    so far, `window` their length in steps. `kept_window` is the length in steps of the windows in
    which every step is kept; `budget` is in bytes a minute. `rule` has the form that
    `rules.make_rule` parses, `fall` the steps over which γ falls.
    """

    task: str
    preset: str
    topology: Topology
    seed: int
    first_lane: int
    rule: str
    beta: float
    gamma: float
    fall: float
    dt: float | None
    step: int
    window: int
    edges: tuple[Tally, ...]
    log: tuple[Logged, ...]
    kept_window: int
    detail: str
    budget: int
    thinning: str
    versions: dict[str, str]
    machine: str

    @property
    def settings(self) -> RunSettings:
        """The settings of the run. Raises BadRecording if its rule is not known here."""
        return RunSettings(
            topology=self.topology,
            beta=self.beta,
            gamma=self.gamma,
            fall=self.fall,
            rule=known_rule(self.rule),
            seed=self.seed,
            first_lane=self.first_lane,
        )

    def to_json(self) -> str:
        said = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        said |= {
            "program": PROGRAM,
            "format": FORMAT,
            "topology": self.topology.to_json(),
            "fall": fall_to_json(self.fall),
            "edges": [dataclasses.astuple(t) for t in self.edges],
            "log": [change_to_json(c) for c in self.log],
        }
        return json.dumps(said)

    def other_now(self, task: Task) -> str:
        """The difference from the program that recorded the run, which may make recomputing fail:
        the version of its task, the type of machine, other versions, or else the only remaining
        cause.
        """
        recorded = self.versions.get(TASK, "1")  # recordings were made before tasks had versions
        if recorded != str(task.version):
            return (
                f"it was recorded with version {recorded} of task {task.name}, this is version "
                f"{task.version}"
            )
        if machine() != self.machine:
            return f"it was recorded on {self.machine}, this machine is {machine()}"
        old, now = self.versions, versions()
        changed = [
            f"{n} {old[n]}, now {now.get(n)}" for n in old if n != TASK and old[n] != now.get(n)
        ]
        if changed:
            return f"it was recorded with {'; '.join(changed)}"
        return "the file of its task or rule has probably changed since the recording"

    @classmethod
    def from_json(cls, text: str) -> Header:
        """Parse a header. Raises BadRecording for another program's or a newer one, ValueError for
        invalid values.
        """
        said = json.loads(text)
        if not isinstance(said, dict) or said.pop("program", None) != PROGRAM:
            raise BadRecording("it is not a recording of hebbviz")
        number = said.pop("format")
        if not isinstance(number, int) or number > FORMAT:
            raise BadRecording(
                f"its format {number!r} is newer than this hebbviz can read ({FORMAT}): "
                "update hebbviz"
            )
        if number < 2:
            said |= {"rule": str(PAPER), "fall": None}
        said["fall"] = fall_from_json(said["fall"])
        said["topology"] = Topology.from_json(said["topology"])
        said["edges"] = tuple(Tally(*t) for t in said["edges"])
        said["log"] = tuple(change_from_json(c) for c in said["log"])
        return cls(**said)


def known_rule(spec: str) -> Rule:
    """The rule that a recording names. Raises BadRecording if it is unknown."""
    try:
        return make_rule(spec)
    except ValueError as error:
        raise BadRecording(f"its rule is unknown: {error}") from error


def check_recordable(rule: Rule) -> None:
    """Raise ValueError for a rule that lets lanes touch: a recording holds a single lane."""
    if rule.lanes_touch:
        raise ValueError(
            f"a recording holds one lane, but lanes under rule {rule.name} depend on each other: "
            "record under another rule"
        )


def versions() -> dict[str, str]:
    """The versions that a run's bits may depend on."""
    return {
        "hebbviz": hebbviz.__version__,
        "python": platform.python_version(),
        **{name: version(name) for name in VERSIONS_OF},
    }


def change_to_json(logged: Logged) -> dict[str, Any]:
    """A logged change as plain data: its kind, its step and its fields."""
    fields = dataclasses.asdict(logged.change)
    if "fall" in fields:
        fields["fall"] = fall_to_json(fields["fall"])
    return {"step": logged.step, "kind": type(logged.change).__name__, **fields}


def change_from_json(said: Any) -> Logged:
    """Parse a change. Raises ValueError if it is invalid or of an unknown kind, and BadRecording
    for an unknown rule.
    """
    try:
        fields = dict(said)
        step, kind = fields.pop("step"), CHANGES[fields.pop("kind")]
        if "fall" in fields:
            fields["fall"] = fall_from_json(fields["fall"])
        if kind is SetRule:
            known_rule(str(fields["rule"]))
        change = kind(**fields)
        _check_types(change)
    except (KeyError, TypeError) as error:
        raise ValueError(f"not a change of a run: {str(said)[:80]}") from error
    if type(step) is not int or step < 0:
        raise ValueError(f"a change needs a step of at least 0, got {step!r}")
    return Logged(step, change)


def _check_types(change: Change) -> None:
    """Raise ValueError unless each field has the type that it is declared with."""
    for field in dataclasses.fields(change):
        value = getattr(change, field.name)
        if type(value) not in _TYPES.get(field.name, (int, float)):
            raise ValueError(f"{field.name} of a change has a wrong type, got {value!r}")


def entity(name: str) -> str:
    """A group's or projection's name as a part of an entity path."""
    return re.sub(r"[^\w.-]+", "_", name.replace(" → ", "-"))


def machine() -> str:
    """The kind of machine; another kind may round differently."""
    return f"{platform.system()} {platform.machine()}"
