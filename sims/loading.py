"""Find a task by its name, or in a user's file given as `path.py:Name`."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from hebbviz.learner import TaskError
from hebbviz.task import Task
from sims import task_class


def make_task(name: str, preset: str | None = None) -> Task:
    """The task called `name`, at a preset (default its first).

    Raises
    ------
    ValueError
        If there is no such task, file, class or preset.
    TaskError
        If a user's file or class raises.
    """
    if ".py:" in name:
        return _make(_class_from_file(name), name, preset)
    return _make(task_class(name), name, preset)


def _make(cls: type[Task], name: str, preset: str | None) -> Task:
    for attribute in ("name", "outputs", "presets"):
        if not getattr(cls, attribute, None):
            raise ValueError(
                f"task {name}: the class must set {attribute!r}, see hebbviz.task.Task"
            )
    if preset is not None and preset not in cls.presets:
        raise ValueError(
            f"task {cls.name!r} has no preset {preset!r}; choose from {', '.join(cls.presets)}"
        )
    try:
        task = cls(preset)
    except Exception as error:
        raise _failed(name, error) from error
    if getattr(task, "inputs", None) is None:
        raise ValueError(f"task {name}: the class must set 'inputs', see hebbviz.task.Task")
    return task


def _class_from_file(spec: str) -> type[Task]:
    file, _, class_name = spec.rpartition(":")
    path = Path(file)
    if not path.is_file():
        raise ValueError(f"task {spec}: there is no file {file}")
    module = _run_file(path, spec)
    found = getattr(module, class_name, None)
    if not isinstance(found, type) or not issubclass(found, Task):
        raise ValueError(
            f"task {spec}: {file} has no class {class_name} made from hebbviz.task.Task"
        )
    return found


def _run_file(path: Path, spec: str) -> ModuleType:
    module_name = f"_hebbviz_task_{path.stem}"
    loader = importlib.util.spec_from_file_location(module_name, path)
    if loader is None or loader.loader is None:
        raise ValueError(f"task {spec}: {path} is not a Python file")
    module = importlib.util.module_from_spec(loader)
    sys.modules[module_name] = module  # dataclasses and pickling look a class's module up there
    try:
        loader.loader.exec_module(module)
    except Exception as error:
        raise _failed(spec, error) from error
    return module


def _failed(name: str, error: Exception) -> TaskError:
    first, *_ = str(error).splitlines() or [""]
    return TaskError(f"task {name}: {type(error).__name__}: {first}")
