"""Find a task or a rule by its name, or in a user's file given as `path.py:Name`."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from hebbviz.learner import TaskError
from hebbviz.rules import Rule, make_rule, register
from hebbviz.switches import UnknownPreset
from hebbviz.task import Task
from sims import task_class

T = TypeVar("T")


def make_task(name: str, preset: str | None = None) -> Task:
    """The task called `name`, at a preset (default its first), its switches set as it says.

    Raises
    ------
    ValueError
        If there is no such task, file, class, preset or switch.
    TaskError
        If a user's file or class raises.
    """
    if ".py:" in name:
        return _make(_class_from_file(name, Task), name, preset)
    return _make(task_class(name), name, preset)


def load_rule(spec: str) -> Rule:
    """The rule that `NAME` or `path.py:Name` says, with `:parameter=value,...` after it or not.

    One of a user's file is known to `make_rule` by its own name from then on. Raises as
    `make_task` does.
    """
    match = re.fullmatch(r"(.+\.py:\w+):?(.*)", spec)
    if match is None:
        return make_rule(spec)
    rule = _class_from_file(match[1], Rule)
    if not getattr(rule, "name", None):
        raise ValueError(f"rule {spec}: the class must set 'name', see hebbviz.rules.Rule")
    register(rule)
    return make_rule(f"{rule.name}:{match[2]}")


def _make(cls: type[Task], name: str, preset: str | None) -> Task:
    for attribute in ("name", "outputs", "presets"):
        if not getattr(cls, attribute, None):
            raise ValueError(
                f"task {name}: the class must set {attribute!r}, see hebbviz.task.Task"
            )
    try:
        task = cls(preset)
    except UnknownPreset:
        raise
    except Exception as error:
        raise _failed(f"task {name}", error) from error
    if getattr(task, "inputs", None) is None:
        raise ValueError(f"task {name}: the class must set 'inputs', see hebbviz.task.Task")
    return task


def _class_from_file(spec: str, base: type[T]) -> type[T]:
    """A task or a rule of the user's own."""
    file, _, class_name = spec.rpartition(":")
    what, path = f"{base.__name__.lower()} {spec}", Path(file)
    if not path.is_file():
        raise ValueError(f"{what}: there is no file {file}")
    module = _run_file(path, what)
    found = getattr(module, class_name, None)
    if not isinstance(found, type) or not issubclass(found, base):
        made_from = f"{base.__module__}.{base.__name__}"
        raise ValueError(f"{what}: {file} has no class {class_name} made from {made_from}")
    return found


def _run_file(path: Path, what: str) -> ModuleType:
    module_name = f"_hebbviz_own_{path.stem}"
    loader = importlib.util.spec_from_file_location(module_name, path)
    if loader is None or loader.loader is None:
        raise ValueError(f"{what}: {path} is not a Python file")
    module = importlib.util.module_from_spec(loader)
    sys.modules[module_name] = module  # dataclasses and pickling look a class's module up there
    try:
        loader.loader.exec_module(module)
    except Exception as error:
        raise _failed(what, error) from error
    return module


def _failed(what: str, error: Exception) -> TaskError:
    first, *_ = str(error).splitlines() or [""]
    return TaskError(f"{what}: {type(error).__name__}: {first}")
