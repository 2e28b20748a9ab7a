"""Spiking neurons that learn by themselves: Bartlett and Baxter's rule, exact and compiled.

This is the public API; every other name is internal. Names are imported on first use, so
that `import hebbviz` loads neither the page nor the physics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hebbviz.conformance import check_rule, check_task
    from hebbviz.learner.frames import Block, Frame
    from hebbviz.learner.learner import Learner, TaskError
    from hebbviz.learner.saves import save
    from hebbviz.rules.base import Rule, parameter
    from hebbviz.server.app import serve
    from hebbviz.server.recording.reader import open_recording
    from hebbviz.sims.figures.run_figure import figure
    from hebbviz.sims.loading import load, make_task
    from hebbviz.task.base import Input, Measure, Output, Reading, Task
    from hebbviz.task.presets import Preset
    from hebbviz.task.scene import Control, Pose, Prop
    from hebbviz.topology import Group, Projection, Topology, feedforward

__version__ = "0.1.0"

__all__ = [
    "Block",
    "Control",
    "Frame",
    "Group",
    "Input",
    "Learner",
    "Measure",
    "Output",
    "Pose",
    "Preset",
    "Projection",
    "Prop",
    "Reading",
    "Rule",
    "Task",
    "TaskError",
    "Topology",
    "check_rule",
    "check_task",
    "feedforward",
    "figure",
    "load",
    "make_task",
    "open_recording",
    "parameter",
    "save",
    "serve",
]

_MODULES = {
    "hebbviz.conformance": ("check_rule", "check_task"),
    "hebbviz.learner.frames": ("Block", "Frame"),
    "hebbviz.learner.learner": ("Learner", "TaskError"),
    "hebbviz.learner.saves": ("save",),
    "hebbviz.rules.base": ("Rule", "parameter"),
    "hebbviz.server.app": ("serve",),
    "hebbviz.server.recording.reader": ("open_recording",),
    "hebbviz.sims.figures.run_figure": ("figure",),
    "hebbviz.sims.loading": ("load", "make_task"),
    "hebbviz.task.base": ("Input", "Measure", "Output", "Reading", "Task"),
    "hebbviz.task.presets": ("Preset",),
    "hebbviz.task.scene": ("Control", "Pose", "Prop"),
    "hebbviz.topology": ("Group", "Projection", "Topology", "feedforward"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A name of the public API, imported when it is first used (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
