"""The values of β and γ in a sweep, and what one command asks for."""

from __future__ import annotations

import argparse
import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from hebbviz.limits import check_beta, check_gamma
from hebbviz.sims.experiments import Plan, options_of
from hebbviz.sims.figures.request import said, task_word
from hebbviz.sims.figures.run_length import steps_of
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.learner_from_arguments import DEFAULT_TASK
from hebbviz.sims.program.terminal import InputError
from hebbviz.sims.program.typed_numbers import about_commas

MOST_VALUES = 1000
"""Of a list, and points of a map."""
STEPS, LANES = 10**6, 16
PARTS = 5
"""A run is divided into fifths; the last one is scored."""


def parse_betas(text: str) -> tuple[float, ...]:
    """β by value, as 0.5,0.9, or from one to another as 0.5:0.99:5, in rising order.

    Of a range the time constants 1/(1 - β) are a geometric series. Raises ValueError.
    """
    return _parse(text, check_beta, _time_constants)


def parse_gammas(text: str) -> tuple[float, ...]:
    """γ by value, as 1e-3,1e-2, or from one to another as 1e-4:1e-1:7, a geometric series."""
    return _parse(text, check_gamma, _series)


def _time_constants(first: float, last: float, count: int) -> list[float]:
    """Beside a β of 0.999999 six digits tell no more: then as many as 1 - β needs for two."""
    gaps = np.geomspace(1.0 - first, 1.0 - last, count)
    return [round_off(1.0 - gap, max(6, 2 - math.floor(math.log10(gap)))) for gap in gaps]


def _series(first: float, last: float, count: int) -> list[float]:
    if min(first, last) <= 0.0:
        raise ValueError("a range of gamma must lie above 0: add 0 as a value of its own")
    return [round_off(value) for value in np.geomspace(first, last, count)]


def _parse(
    text: str, check: Callable[[float], float], series: Callable[[float, float, int], list[float]]
) -> tuple[float, ...]:
    values: set[float] = set()
    for part in text.split(","):
        match part.split(":"):
            case [value]:
                values.add(_checked(value, text, check))
            case [first, last, count]:
                ends = check(_number(first, text)), check(_number(last, text))
                values |= {check(value) for value in series(*ends, _count(count))}
            case _:
                raise _wrong(text)
    return tuple(sorted(values))


def _checked(value: str, whole: str, check: Callable[[float], float]) -> float:
    try:
        return check(_number(value, whole))
    except ValueError as error:
        raise ValueError(f"{error}{about_commas(whole)}") from None


def round_off(value: float, digits: int = 6) -> float:
    """A value that is the same when it is written down and read again."""
    return float(f"{value:.{digits}g}")


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise _wrong(whole) from None


def _count(text: str) -> int:
    if not (text.isdecimal() and 2 <= int(text) <= MOST_VALUES):
        raise ValueError(f"a range must have from 2 to {MOST_VALUES} values, got {text!r}")
    return int(text)


def _wrong(text: str) -> ValueError:
    return ValueError(
        f"values must be numbers as 0.5,0.9 or ranges as FIRST:LAST:HOW_MANY, got {text!r}"
    )


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """A map of β against γ: each pair is run in `lanes` replicas, all from the same seed."""

    betas: tuple[float, ...]
    gammas: tuple[float, ...]
    task: str = DEFAULT_TASK
    preset: str | None = None
    hidden: tuple[int, ...] | None = None
    rule: str | None = None
    fall: float | None = None
    lanes: int = LANES
    steps: int = STEPS
    seed: int = 0

    def __post_init__(self) -> None:
        if len(self.betas) * len(self.gammas) > MOST_VALUES:
            raise InputError(
                f"a map has at most {MOST_VALUES} points, got {len(self.betas)} × "
                f"{len(self.gammas)}: give fewer values"
            )

    @classmethod
    def of(cls, args: argparse.Namespace) -> Sweep:
        """The sweep that a command line requests; raises InputError, ValueError and TaskError."""
        name = args.task or DEFAULT_TASK
        task = make_task(name, args.preset)
        given = {f.name: getattr(args, f.name) for f in fields(cls) if hasattr(args, f.name)}
        return cls(
            **given
            | {
                "task": name,
                "preset": task.preset_name,
                "steps": steps_of(args, task) or STEPS,
                "betas": args.beta or (task.preset.beta,),
                "gammas": args.gamma or (task.preset.gamma,),
            }
        )

    def plan(self, beta: float, gamma: float) -> Plan:
        """The runs of a point."""
        return Plan(
            task=self.task,
            preset=self.preset,
            hidden=self.hidden,
            beta=beta,
            gamma=gamma,
            seed=self.seed,
            lanes=self.lanes,
            segments=PARTS,
            segment_steps=-(-self.steps // PARTS),
            options=options_of(self),
        )

    def plans(self) -> list[Plan]:
        """All points, β by β, and last the same lanes without learning, to compare with."""
        points = [self.plan(beta, gamma) for beta in self.betas for gamma in self.gammas]
        return [*points, self.untrained]

    @property
    def untrained(self) -> Plan:
        """γ = 0: the network as it was at the start."""
        return self.plan(0.0, 0.0)

    @property
    def command(self) -> str:
        """The command that makes the map again."""
        network = ["--task", self.task, "--preset", str(self.preset)]
        for option in ("hidden", "rule", "fall"):
            if getattr(self, option) is not None:
                network += [f"--{option}", said(getattr(self, option))]
        return shlex.join(
            [
                "hebbviz",
                "sweep",
                *network,
                "--beta",
                _listed(self.betas),
                "--gamma",
                _listed(self.gammas),
                "--lanes",
                str(self.lanes),
                "--steps",
                str(self.steps),
                "--seed",
                str(self.seed),
                "--out",
                "FOLDER",
            ]
        )

    @property
    def file(self) -> str:
        """Name of the files of the first such map in a folder, without their endings."""
        return f"sweep-{task_word(self.task)}"


def _listed(values: tuple[float, ...]) -> str:
    return ",".join(map(repr, values))
