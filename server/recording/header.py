"""What a recording says of its run before its first step, and how a change is written down."""

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
"""2 says the rule, in the header and of every keyframe; 1 knew the paper's rule alone."""
TASK = "task"
"""Under which the versions have that of the task."""
VERSIONS_OF = ("numpy", "numba", "pymunk", "rerun-sdk")

CHANGES = {
    kind.__name__: kind for kind in (SetBeta, SetGamma, SetFall, SetRule, Freeze, GiveReward, Press)
}
_TYPES = {"frozen": (bool,), "control": (str,), "rule": (str,)}
"""Of the fields of changes; of all others a number."""


class BadRecording(ValueError):
    """A file that is no recording of ours, or a damaged one; the message says which and why."""


@dataclass(frozen=True)
class Header:
    """A run as it was when the recording began.

    `log` holds the changes made before, `edges` the totals at the windows' edges of the learning
    curve so far, `window` their length in steps. `kept_window` is the length of the stretches of
    which every step is kept, in steps; `budget` is in bytes a minute. `rule` is as
    `rules.make_rule` reads it, `fall` the steps over which γ falls.
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
        """What is another here than where it was recorded, so that the run may not come out the
        same again: the version of its task, the type of machine, else versions, else what alone
        is left.
        """
        recorded = self.versions.get(TASK, "1")  # recordings were made before tasks had versions
        if recorded != str(task.version):
            return (
                f"it was recorded with version {recorded} of task {task.name}, this is version "
                f"{task.version}"
            )
        if machine() != self.machine:
            return f"it was recorded on {self.machine}, this is {machine()}"
        old, now = self.versions, versions()
        changed = [
            f"{n} {old[n]}, now {now.get(n)}" for n in old if n != TASK and old[n] != now.get(n)
        ]
        if changed:
            return f"it was recorded with {'; '.join(changed)}"
        return "the file of its task or of its rule must be another one than when it was recorded"

    @classmethod
    def from_json(cls, text: str) -> Header:
        """Raises BadRecording for another program's or a newer one, ValueError for nonsense."""
        said = json.loads(text)
        if not isinstance(said, dict) or said.pop("program", None) != PROGRAM:
            raise BadRecording("it is no recording of hebbviz")
        number = said.pop("format")
        if not isinstance(number, int) or number > FORMAT:
            raise BadRecording(
                f"it is of format {number!r}, newer than this hebbviz knows ({FORMAT}): "
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
    """The rule that a recording names. Raises BadRecording if it is not known here."""
    try:
        return make_rule(spec)
    except ValueError as error:
        raise BadRecording(f"its rule is not known here: {error}") from error


def check_recordable(rule: Rule) -> None:
    """Raise ValueError for a rule under which a lane alone, as it is recorded, is no run."""
    if rule.lanes_touch:
        raise ValueError(
            f"a recording holds one lane, which under rule {rule.name} is no run of its own: "
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
    """Raises ValueError if it is no change, or one of a kind or value that is not allowed, and
    BadRecording for a rule that is not known here.
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
        raise ValueError(f"a change has a step from 0 on, got {step!r}")
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
