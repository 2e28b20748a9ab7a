"""Presets of a task, switches that can be set with any of them, and the spelling of both.

A preset is named as `NAME`, or as `NAME:switch=yes,switch=no` where switches differ from the
preset's own. This name describes the task's whole setting; saves, recordings, figures and command
lines use it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

SAID = {"yes": True, "no": False}


class UnknownPreset(ValueError):
    """The task has no such preset or switch; the one-line message lists those that it has."""


@dataclass(frozen=True)
class Preset:
    """A named setting of a task: the learner's β, γ and rule, and options of the task.

    `note` states in one sentence how the preset differs from the paper. `rule` is a spec for
    `rules.make_rule`; `fall` is the step-size decay time in steps; `hidden` gives the sizes of the
    hidden layers, None for the task's default.
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
    """An option of a task: its name, and a few words that describe the world when it is on.

    The preset's `options` hold its state under its name; it is off if they do not.
    """

    name: str
    words: str


def find_preset(
    presets: Mapping[str, Preset], switches: Sequence[Switch], spec: str
) -> tuple[str, Preset]:
    """Return the shortest name and the preset that `spec` names.

    Raises UnknownPreset for an unknown preset or switch.
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
    """Whether the switch is on in this preset."""
    return bool(preset.options.get(switch.name, False))


def spelled(name: str, settings: Mapping[str, bool]) -> str:
    """Return the spec of a preset with these switches set; `find_preset` reads it."""
    given = ",".join(f"{switch}={'yes' if on else 'no'}" for switch, on in settings.items())
    return ":".join(filter(None, (name, given)))


def _settings(given: str, known: Sequence[str]) -> Iterator[tuple[str, bool]]:
    for part in filter(None, given.split(",")):
        name, _, said = part.partition("=")
        if name not in known:
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise UnknownPreset(f"no switch {name!r}; {has}")
        if said not in SAID:
            raise UnknownPreset(f"a switch {name}, which must be yes or no, got {said!r}")
        yield name, SAID[said]
