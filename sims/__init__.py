"""The worlds a network learns in, by name."""

from __future__ import annotations

from importlib import import_module

from hebbviz.task.base import Task

TASKS = {
    "pendulum": "Pendulum",
    "sonar": "Sonar",
    "synapse": "Synapse",
    "gradient": "Gradient",
    "prediction": "Prediction",
    "filtering": "Filtering",
}
"""Built-in tasks: module of this package, and the class in it."""


def task_class(name: str) -> type[Task]:
    """The class of a built-in task; raises ValueError for an unknown name."""
    if name not in TASKS:
        raise ValueError(
            f"there is no task {name!r}; choose from {', '.join(TASKS)}, "
            "or give your own as path.py:Name"
        )
    found: type[Task] = getattr(import_module(f"hebbviz.sims.{name}"), TASKS[name])
    return found
