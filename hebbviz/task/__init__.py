"""The contract of a task. Files that define a task import from here."""

from hebbviz.task.base import (
    CompiledTask,
    Control,
    Evaluable,
    Input,
    Measure,
    Output,
    Pose,
    Prop,
    Reading,
    Score,
    Tally,
    Task,
)
from hebbviz.task.presets import Preset

__all__ = [
    "CompiledTask", "Control", "Evaluable", "Input", "Measure", "Output", "Pose", "Preset", "Prop",
    "Reading", "Score", "Tally", "Task",
]  # fmt: skip
