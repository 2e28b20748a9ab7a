"""The presets of a task, what can be switched on or off beside any of them, and their names.

A preset is named as `NAME`, or as `NAME:switch=yes,switch=no` with some of the task's switches
set otherwise than it has them. That name says all of the task's setting, so it is what saves,
recordings, figures and command lines hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

SAID = {"yes": True, "no": False}


class UnknownPreset(ValueError):
    """A task has no preset or no switch of that name; the message, one line, says what it has."""


@dataclass(frozen=True)
class Preset:
    """A named setting of a task: the learner's β, γ and rule, and what the task needs besides.

    `note` says in a sentence how it differs from the paper. `rule` is as `rules.make_rule` reads
    it; `fall` the steps over which γ falls; `hidden` the sizes of the hidden layers, None for the
    task's own.
    """

    beta: float
    gamma: float
    note: str
    options: Mapping[str, Any] = field(default_factory=dict)
    rule: str = "paper"
    fall: float = math.inf
    hidden: tuple[int, ...] | None = None


@dataclass(frozen=True)
class Switch:
    """A choice of two: its name, and in a few words what the world has when it is on.

    Whether it is on is in the `options` of the task's preset, under its name; off if it is not.
    """

    name: str
    words: str


def find_preset(
    presets: Mapping[str, Preset], switches: Sequence[Switch], spec: str
) -> tuple[str, Preset]:
    """The preset that `spec` names, and its shortest name.

    Raises UnknownPreset for a preset or a switch that is not there.
    """
    name, given = (spec, "") if spec in presets else spec.partition(":")[::2]
    if name not in presets:
        raise UnknownPreset(f"no preset {name!r}; choose from {', '.join(presets)}")
    preset = presets[name]
    wanted = dict(_settings(given, [s.name for s in switches]))
    other = [s for s in switches if wanted.get(s.name, is_on(preset, s)) != is_on(preset, s)]
    if not other:
        return name, preset
    now = {s.name: wanted[s.name] for s in other}
    return spelled(name, now), replace(preset, options={**preset.options, **now})


def is_on(preset: Preset, switch: Switch) -> bool:
    return bool(preset.options.get(switch.name, False))


def spelled(name: str, settings: Mapping[str, bool]) -> str:
    """A preset with switches set, as `find_preset` reads it."""
    given = ",".join(f"{switch}={'yes' if on else 'no'}" for switch, on in settings.items())
    return ":".join(filter(None, (name, given)))


def _settings(given: str, known: Sequence[str]) -> Iterator[tuple[str, bool]]:
    for part in filter(None, given.split(",")):
        name, _, said = part.partition("=")
        if name not in known:
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise UnknownPreset(f"no switch {name!r}; {has}")
        if said not in SAID:
            raise UnknownPreset(f"a switch {name}, which is set to yes or no, not to {said!r}")
        yield name, SAID[said]
