"""Which figures there are, what can be asked of each, and what one command asked for."""

from __future__ import annotations

import argparse
import math
import re
import shlex
from dataclasses import dataclass, fields
from pathlib import Path

from hebbviz.sims.program.learner_from_arguments import DEFAULT_TASK
from hebbviz.sims.program.terminal import InputError
from hebbviz.sims.user_file import own_file


@dataclass(frozen=True)
class Kind:
    """A figure: what it shows, of which task unless another is asked for, and the options that it
    takes besides --out, --seed and --quick; `least` steps of a run give its curve a few points.
    """

    shows: str
    task: str
    takes: tuple[str, ...] = ()
    least: int = 1


KINDS = {
    "synapse": Kind("the sequences (a)-(l) of the paper's figure of synaptic updates", "synapse"),
    "gradient": Kind(
        "the angle from the rule's running estimate to the exact gradient, for several β",
        "gradient",
        ("lanes", "scheduler"),
    ),
    "sonar": Kind(
        "training and test error of many runs, each of them and their mean and standard deviation",
        "sonar",
        ("preset", "lanes", "epochs", "scheduler"),
    ),
    "pendulum": Kind(
        "time to fall of frozen copies, each run and the median, for every preset",
        "pendulum",
        ("preset", "lanes", "hours", "scheduler"),
        least=1800,
    ),
    "learning": Kind(
        "the learning curves of any task, also your own",
        DEFAULT_TASK,
        (
            "task",
            "preset",
            "hidden",
            "beta",
            "gamma",
            "rule",
            "fall",
            "lanes",
            "epochs",
            "hours",
            "steps",
            "scheduler",
        ),
        least=5,
    ),
}

LENGTHS = ("epochs", "hours", "steps")
"""Three ways to say how long each run is; at most one of them."""

_NOT_OF_THE_RESULT = ("name", "out", "scheduler", "quick", "seed")


@dataclass(frozen=True, kw_only=True)
class Order:
    """A request for a figure; None where the figure chooses. `hours` are simulated hours.

    Raises InputError for an option that the figure does not take.
    """

    name: str
    out: Path
    task: str | None = None
    preset: str | None = None
    hidden: tuple[int, ...] | None = None
    beta: float | None = None
    gamma: float | None = None
    rule: str | None = None
    fall: float | None = None
    lanes: int | None = None
    epochs: int | None = None
    hours: float | None = None
    steps: int | None = None
    seed: int = 0
    quick: bool = False
    scheduler: str | None = None

    def __post_init__(self) -> None:
        takes = KINDS[self.name].takes
        given = [o for o in (*_options(), "scheduler") if getattr(self, o) is not None]
        for option in given:
            if option not in takes:
                known = ", ".join(f"--{o}" for o in (*takes, "seed", "quick"))
                raise InputError(
                    f"figure {self.name} takes no --{option}: leave it out; it takes {known}"
                )
        lengths = [f"--{o}" for o in given if o in LENGTHS]
        if len(lengths) > 1:
            raise InputError(f"{' and '.join(lengths)} contradict each other: give one of them")

    @classmethod
    def of(cls, args: argparse.Namespace) -> Order:
        return cls(**{f.name: getattr(args, f.name) for f in fields(cls)})

    @property
    def command(self) -> str:
        """The command that makes it again, wherever that is written and by whatever workers."""
        words = ["hebbviz", "figure", self.name, "--out", "FOLDER"]
        for option in _options():
            value = getattr(self, option)
            if value is not None:
                words += [f"--{option}", said(value)]
        words += ["--seed", str(self.seed)]
        return shlex.join(words + ["--quick"] * self.quick)

    @property
    def file(self) -> str:
        """Name of its files without their endings: the figure and all options given, so that the
        same figure with other options stands beside it.
        """
        words = [self.name]
        if self.task is not None:
            words.append(task_word(self.task))
        if self.preset is not None:  # two tasks have a preset 'quick'
            words.append("quick-preset" if self.preset == "quick" else self.preset)
        if self.hidden is not None:
            words.append(f"hidden-{said(self.hidden)}")
        if self.rule is not None:
            words.append(_rule_word(self.rule))
        values = ((option, getattr(self, option)) for option in ("beta", "gamma", "fall"))
        words += [f"{option}-{said(value)}" for option, value in values if value is not None]
        counts = ((option, getattr(self, option)) for option in ("lanes", *LENGTHS))
        words += [f"{count}-{option}" for option, count in counts if count is not None]
        if self.seed:
            words.append(f"seed-{self.seed}")
        return re.sub(r"[^\w.=-]+", "-", "-".join(words + ["quick"] * self.quick))


def task_word(task: str) -> str:
    """A task by name; one of the user's own by its file and class, where they are not the same."""
    path, _, class_name = task.rpartition(":")
    stem = Path(path).stem
    if not path:
        return task
    return stem if stem.lower() == class_name.lower() else f"{stem}-{class_name}"


def _rule_word(rule: str) -> str:
    """A rule by its name or its file and class, with the parameters that were given."""
    file, name = own_file(rule)
    if file is None:
        return rule
    class_name, _, given = name.partition(":")
    return "-".join(filter(None, (task_word(f"{file}:{class_name}"), given)))


def said(value: object) -> str:
    """A value as the command line takes it."""
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "none"
    return "never" if value == math.inf else str(value)


def _options() -> tuple[str, ...]:
    """All that decides the result, but the seed and whether it is quick."""
    return tuple(f.name for f in fields(Order) if f.name not in _NOT_OF_THE_RESULT)
