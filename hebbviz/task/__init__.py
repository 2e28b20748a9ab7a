"""The contract of a task. Files that define a task import from here."""

from hebbviz.task.base import (
    CompiledTask,
    Evaluable,
    Input,
    Measure,
    Output,
    Reading,
    Score,
    Tally,
    Task,
)
from hebbviz.task.presets import Preset
from hebbviz.task.scene import Control, Pose, Prop

__all__ = [
    "CompiledTask",
    "Control",
    "Evaluable",
    "Input",
    "Measure",
    "Output",
    "Pose",
    "Preset",
    "Prop",
    "Reading",
    "Score",
    "Tally",
    "Task",
]
