"""Rules of learning: how the task's reward r becomes m, the one number every synapse is sent.

    w ← w + γ m z

The paper's rule sends the reward itself, m = r. Another rule is a class in one file, see
`baseline.py`. It may keep a few numbers of its own from step to step, its memory; they are a part
of the learner's state, so it is saved, rewound, recorded and shown like the paper's. It
cannot distinguish synapses: m is one number for the whole network.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numba import njit, types
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from hebbviz.limits import MOST_LANES
from hebbviz.numerics.compile import WIDTHS, called
from hebbviz.registry import Registry
from hebbviz.rules.trial import try_out
from hebbviz.task.base import Reading
from hebbviz.task.signature import PER_LANE

Array = NDArray[np.float64]

MODULATE = types.void(types.Array(types.float64, 2, "C"), PER_LANE, PER_LANE, PER_LANE, PER_LANE)
"""The signature of a compiled `Rule.modulate`."""


def parameter(default: float, *, least: float, most: float, unit: str = "", hint: str = "") -> Any:
    """A number that a rule can be given, from `least` to `most`."""
    said = {"least": least, "most": most, "unit": unit, "hint": hint}
    return field(default=default, metadata=said)


class RuleError(Exception):
    """A rule raised in mid-run, or sends or keeps what is no number."""


@dataclass(frozen=True)
class Rule:
    """A rule with its parameters. A subclass is a frozen dataclass; its fields are `parameter`s.

    Two of the same class and parameters are equal. `str` of it, such as `baseline:time=1000`,
    makes it again with `make_rule`. Raises ValueError for a parameter out of its bounds.
    """

    name: ClassVar[str]
    summary: ClassVar[str] = ""
    memory: ClassVar[tuple[Reading, ...]] = ()
    """Name and unit of each row of its memory."""
    least_lanes: ClassVar[int] = 1
    lanes_touch: ClassVar[bool] = False
    """Whether what a lane is sent depends on other lanes; no lane is a run of its own then."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):
            value, least, most = getattr(self, f.name), f.metadata["least"], f.metadata["most"]
            if not (isinstance(value, (int, float)) and least <= value <= most):  # NaN is neither
                raise ValueError(
                    f"rule {self.name}: {f.name} must be from {least:g} to {most:g}, got {value!r}"
                )

    @staticmethod
    def modulate(memory: Any, constants: Any, reward: Any, ended: Any, sent: Any) -> None:
        """One step of all lanes of a tile, that is of all there are if `lanes_touch`; compiled by
        numba, so in the part of Python that it knows.

        `memory` (rows, lanes) is zero at first and is changed in place; `constants` (parameters,)
        holds the parameters in the order of the fields; `reward` (lanes,) is r of the task,
        `ended` (lanes,) 1 where an episode ended. It writes m into `sent` (lanes,), a finite number
        for each lane at each step.

        Compiled code looks neither at bounds nor at errors, so a rule is first tried out in plain
        Python, see `trial`. Whether what it sends and keeps is finite is looked at after all the
        steps of a call, as it is for a `CompiledTask`.
        """
        raise NotImplementedError

    @classmethod
    def most_lanes(cls) -> int:
        """Where lanes touch each other, as many as are stepped together."""
        return WIDTHS[-1] if cls.lanes_touch else MOST_LANES

    @classmethod
    def fits(cls, lanes: int) -> bool:
        """Whether the rule works with this number of lanes."""
        return cls.least_lanes <= lanes <= cls.most_lanes()

    @classmethod
    def check_lanes(cls, lanes: int) -> None:
        """Raise ValueError unless it `fits`."""
        if cls.fits(lanes):
            return
        if lanes < cls.least_lanes:
            raise ValueError(
                f"rule {cls.name} needs {cls.least_lanes} lanes or more, this learner has {lanes}"
            )
        raise ValueError(
            f"rule {cls.name} lets lanes touch each other, so all must be stepped together: take "
            f"at most {cls.most_lanes()} lanes, this learner has {lanes}"
        )

    @property
    def constants(self) -> Array:
        """The parameters, (parameters,) float64, in the order of the fields."""
        return np.array([getattr(self, f.name) for f in dataclasses.fields(self)], dtype=float)

    def compiled(self) -> tuple[Any, Any]:
        """`modulate`, compiled: to be called by compiled code, and by Python.

        Raises ValueError if numba cannot do that, or if it fails in a dry run.
        """
        if type(self).modulate is Rule.modulate:
            raise ValueError(
                f"rule {self.name}: the class has no method 'modulate', see hebbviz.rules.Rule"
            )
        try_out(self)
        try:
            return _compiled(type(self).modulate)
        except NumbaError as error:
            where, *why = str(error).splitlines()  # the first line tells of numba alone
            said = (why or [where])[0][:200]
            raise ValueError(f"rule {self.name}: modulate cannot be compiled: {said}") from error

    def __str__(self) -> str:
        given = (f"{f.name}={_shortest(getattr(self, f.name))}" for f in dataclasses.fields(self))
        return ":".join(filter(None, (self.name, ",".join(given))))


@cache
def _compiled(modulate: Any) -> tuple[Any, Any]:
    inner = called(MODULATE, allocates=True)(modulate)
    return inner, njit(error_model="numpy")(modulate)  # two caches of one would clash


def _shortest(value: float) -> str:
    """The shortest text that is this number to the bit."""
    short = f"{value:g}"
    return short if float(short) == value else repr(value)


# By name

RULES = Registry("hebbviz.rules", first="paper", besides=("base", "trial"))
"""The built-in rules."""

_own: dict[str, type[Rule]] = {}


def rule_names() -> tuple[str, ...]:
    """Of all rules that can be made, those of the user's own files last."""
    return (*RULES.names, *_own)


def register(rule: type[Rule]) -> None:
    """Let `make_rule` know a rule of the user's own. Raises ValueError for a name that is taken."""
    if rule.name in RULES.names:
        raise ValueError(f"rule {rule.name!r} comes with hebbviz: give yours another name")
    _own[rule.name] = rule


def rule_class(name: str) -> type[Rule]:
    """The class of a rule; raises ValueError for an unknown name."""
    if name in _own:
        return _own[name]
    if name not in RULES.names:
        raise ValueError(
            f"there is no rule {name!r}; choose from {', '.join(rule_names())}, "
            "or name the file of your own with --rule path.py:Name"
        )
    found: type[Rule] = RULES.find(name)
    return found


def make_rule(spec: str) -> Rule:
    """The rule that `NAME` or `NAME:parameter=value,...` says; ValueError says what is wrong."""
    name, _, given = spec.partition(":")
    return rule_class(name)(**_values(rule_class(name), given))


def _values(rule: type[Rule], given: str) -> dict[str, float]:
    known = [f.name for f in dataclasses.fields(rule)]
    values = {}
    for part in filter(None, given.split(",")):
        name, _, text = part.partition("=")
        if name not in known:
            has = f"it has {', '.join(known)}" if known else "it has none"
            hint = "; use a point in numbers" if name.isdigit() else ""
            raise ValueError(f"rule {rule.name} has no parameter {name!r}; {has}{hint}")
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = math.nan
        if math.isnan(values[name]):
            raise ValueError(f"rule {rule.name}: {name} must be a number, got {text!r}")
    return values
