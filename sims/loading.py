"""Loading of tasks and rules by name, or from a user's file by `path.py:Name`."""

from __future__ import annotations

import contextlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar

from hebbviz.learner import saves
from hebbviz.learner.learner import Learner, TaskError
from hebbviz.rules.base import Rule, make_rule, register
from hebbviz.sims import task_class
from hebbviz.sims.user_file import neighbours, own_file
from hebbviz.task.base import Input, Output, Task
from hebbviz.task.presets import Preset, UnknownPreset

T = TypeVar("T")

MakeTask = Callable[[str, str | None], Task]
"""`make_task`, or a function that does the same for other tasks."""

TWINS = {"pendulum": ("hebbviz.sims.worlds.pendulum.compiled", "PendulumLanes")}
"""Built-in tasks that Python steps, and the module and the class of the same world compiled."""

_NEEDED = ("restart", "transition", "observation", "reward")
"""Methods that a task must define."""


def make_task(name: str, preset: str | None = None) -> Task:
    """Make the task called `name` at a preset, by default its first; a preset may set switches.

    Raises
    ------
    ValueError
        If there is no such task, file, class, preset or switch.
    TaskError
        If a user's file or class raises.
    """
    _check_named(name, Task)
    if own_file(name)[0] is not None:
        return _make(_class_from_file(name, Task), name, preset)
    return _make(task_class(name), name, preset)


def compiled_twin(task: Task) -> Task:
    """The same world compiled, for many lanes at once; the task itself where there is no other."""
    if task.name not in TWINS or type(task) is not task_class(task.name):
        return task
    module, name = TWINS[task.name]
    twin: Task = getattr(import_module(module), name)(task.preset_name)
    return twin


def load(path: str | Path) -> Learner:
    """Load a learner that `save` or `hebbviz train --save` wrote, with its task.

    Raises
    ------
    saves.BadFile
        If the file is not a save or is damaged.
    ValueError
        If it was saved with a task that no longer exists.
    """
    return saves.load(path, make_task)


def load_rule(spec: str) -> Rule:
    """Make the rule of `NAME` or `path.py:Name`, optionally with `:parameter=value,...` appended.

    A rule from a user's file is registered, so `make_rule` then knows its name. Raises the same
    errors as `make_task`.
    """
    _check_named(spec, Rule)
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
    _check_all(f"task {name}: outputs", cls.outputs, Output)
    if not isinstance(cls.presets, Mapping):
        raise ValueError(f"task {name}: presets must be a dict of Preset, got {cls.presets!r:.60}")
    _check_all(f"task {name}: the values of presets", tuple(cls.presets.values()), Preset)
    try:
        task = cls(preset)
    except UnknownPreset:
        raise
    except Exception as error:
        raise _failed(f"task {name}", error) from error
    if getattr(task, "inputs", None) is None:
        raise ValueError(f"task {name}: the class must set 'inputs', see hebbviz.task.Task")
    _check_all(f"task {name}: inputs", task.inputs, Input)
    _check_methods(f"task {name}", task)
    return task


def _check_all(what: str, found: Any, kind: type) -> None:
    """Raise ValueError unless `found` is a tuple or list of objects of type `kind`."""
    if not isinstance(found, (tuple, list)) or not all(isinstance(f, kind) for f in found):
        raise ValueError(
            f"{what} must be a tuple of {kind.__name__}, with a comma even if it has only one, got "
            f"{found!r:.60}"
        )


def _check_methods(what: str, task: Task) -> None:
    """Raise ValueError if a required method is missing or does not accept its arguments."""
    for name, plain in vars(Task).items():
        if not isinstance(plain, FunctionType) or name.startswith("_"):
            continue
        own = getattr(task, name)
        if getattr(own, "__func__", None) is plain:
            if name in _NEEDED:
                raise ValueError(f"{what}: the class has no method {name!r}, see hebbviz.task.Task")
            continue
        _, *given = inspect.signature(plain).parameters
        try:
            inspect.signature(own).bind(*given)
        except TypeError as error:
            raise ValueError(
                f"{what}: {name} must take ({', '.join(['self', *given])}): {error}"
            ) from error


def _check_named(spec: str, base: type) -> None:
    """Raise ValueError if a spec names a file but no class; the message lists its classes."""
    if not spec.endswith(".py"):
        return
    what = base.__name__.lower()
    if not Path(spec).is_file():
        raise ValueError(f"{what} {spec}: there is no file {spec}; give it as path.py:Name")
    module = _run_file(Path(spec), f"{what} {spec}")
    has = [f"{spec}:{c.__name__}" for c in vars(module).values() if _is_own(c, base, module)]
    wanted = f"such as {' or '.join(has)}" if has else f"and it has none made from {base.__name__}"
    raise ValueError(f"{what} {spec}: the class must be named too, {wanted}")


def _class_from_file(spec: str, base: type[T]) -> type[T]:
    """Return a task or rule class from a user's file."""
    file, _, class_name = spec.rpartition(":")
    what, path = f"{base.__name__.lower()} {spec}", Path(file)
    if not path.is_file():
        raise ValueError(f"{what}: there is no file {file}")
    module = _run_file(path, what)
    found = getattr(module, class_name, None)
    if not isinstance(found, type) or not issubclass(found, base):
        made_from = f"{base.__module__}.{base.__name__}"
        others = [c for c in vars(module).values() if _is_own(c, base, module)]
        has = f"; it has {', '.join(c.__name__ for c in others)}" if others else ""
        raise ValueError(f"{what}: {file} has no class {class_name} made from {made_from}{has}")
    return found


def _is_own(found: object, base: type, module: ModuleType) -> bool:
    """Whether `found` is a subclass of `base` that the module defines."""
    is_made_from = isinstance(found, type) and issubclass(found, base)
    return is_made_from and found.__module__ == module.__name__


def _run_file(path: Path, what: str) -> ModuleType:
    module_name = f"_hebbviz_own_{path.stem}"
    loader = importlib.util.spec_from_file_location(module_name, path)
    if loader is None or loader.loader is None:
        raise ValueError(f"{what}: {path} is not a Python file")
    module = importlib.util.module_from_spec(loader)
    sys.modules[module_name] = module  # dataclasses and pickling look a class's module up there
    try:
        with _beside(path.resolve()):
            loader.loader.exec_module(module)
    except Exception as error:
        raise _failed(what, error) from error
    return module


@contextlib.contextmanager
def _beside(file: Path) -> Iterator[None]:
    """Allow imports from a file's folder, as Python does for a script.

    In this context the folder comes first in the search path; afterwards, for imports inside its
    functions, last.
    """
    folder = str(file.parent)
    for name, path in neighbours(file).items():
        loaded = getattr(sys.modules.get(name), "__file__", None)
        if loaded in _own_modules and Path(loaded) != path:  # from another user's file
            del sys.modules[name]
        _own_modules.add(str(path))
    before = list(sys.path)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path[:] = [*before, *([] if folder in before else [folder])]


_own_modules: set[str] = set()
"""Files of modules in the folders of users' files."""


def _failed(what: str, error: Exception) -> TaskError:
    first, *_ = str(error).splitlines() or [""]
    return TaskError(f"{what}: {type(error).__name__}: {first}")
