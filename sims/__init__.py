"""The paper's simulations: worlds, experiments, figures and maps."""

from __future__ import annotations

from hebbviz.registry import Registry
from hebbviz.task.base import Task

TASKS = Registry("hebbviz.sims.worlds", first="pendulum", besides=("lamps", "strip_chart"))
"""The built-in tasks."""


def task_class(name: str) -> type[Task]:
    """The class of a built-in task; raises ValueError for an unknown name."""
    if name not in TASKS.names:
        raise ValueError(
            f"there is no task {name!r}; choose from {', '.join(TASKS.names)}, "
            "or give your own as path.py:Name"
        )
    found: type[Task] = TASKS.find(name)
    return found
