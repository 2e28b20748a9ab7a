"""The learner of a command line: a new one, a saved one, or one with the user's own task."""

# ruff: noqa: PLC0415  # heavy modules are imported when needed: --help must be quick

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hebbviz.sims.program.terminal import InputError

if TYPE_CHECKING:
    from hebbviz.learner.learner import Learner
    from hebbviz.rules.base import Rule
    from hebbviz.sims.loading import MakeTask
    from hebbviz.task.base import Task

DEFAULT_TASK = "pendulum"
MOST_SHOWN_LANES = 256
"""Most lanes of a run with a page: each keyframe copies all of them."""


def make_learner(args: argparse.Namespace) -> Learner:
    """Make or load the learner of a command line.

    Raises InputError, ValueError, OSError and TaskError for errors that the user can fix.
    """
    from hebbviz.learner.learner import Learner
    from hebbviz.limits import check_beta, check_fall, check_gamma
    from hebbviz.rules.base import make_rule
    from hebbviz.sims.loading import make_task

    given = (check_beta, args.beta), (check_gamma, args.gamma), (check_fall, args.fall)
    for check, value in given:
        if value is not None:
            check(value)
    rule = asked_rule(args)
    if args.load is not None:
        return _loaded(args, rule)
    task = make_task(DEFAULT_TASK if args.task is None else args.task, args.preset)
    if rule is None:
        rule = make_rule(task.preset.rule)
    return Learner(
        task,
        hidden=args.hidden,
        beta=args.beta,
        gamma=args.gamma,
        rule=rule,
        fall=args.fall,
        seed=args.seed or 0,
        lanes=getattr(args, "lanes", None) or rule.least_lanes,
    )


def asked_rule(args: argparse.Namespace) -> Rule | None:
    """Return the requested rule, None if there is none; register one from a user's file by name."""
    from hebbviz.sims.loading import load_rule

    return None if args.rule is None else load_rule(args.rule)


def _loaded(args: argparse.Namespace, rule: Rule | None) -> Learner:
    from hebbviz.learner import saves

    learner = saves.load(
        saved_file(args.load), lambda *saved: saved_task(args, f"--load {args.load}", *saved)
    )
    if args.seed not in (None, learner.seed):
        raise _contradiction(f"--load {args.load}", "--seed", args.seed, learner.seed)
    lanes = getattr(args, "lanes", None)
    if lanes not in (None, learner.lanes):
        raise _contradiction(f"--load {args.load}", "--lanes", lanes, learner.lanes)
    if args.hidden is not None and learner.task.topology(args.hidden) != learner.topology:
        sizes = ",".join(str(n) for n in args.hidden) or "none"
        raise _contradiction(
            f"--load {args.load}", "--hidden", sizes, f"the network {learner.topology.describe()}"
        )
    if args.beta is not None:
        learner.set_beta(args.beta)
    if args.gamma is not None:
        learner.set_gamma(args.gamma)
    if args.fall is not None:
        learner.set_fall(args.fall)
    only_named = type(rule) is type(learner.rule) and "=" not in args.rule
    if rule not in (None, learner.rule) and not only_named:
        learner.set_rule(rule)
    return learner


def saved_task(args: argparse.Namespace, file: str | Path, name: str, preset: str) -> Task:
    """Return the task that a file names.

    A user's own task runs only if the command line names it, because a saved learner or a
    recording may come from anywhere.
    """
    from hebbviz.sims import TASKS
    from hebbviz.sims.loading import make_task
    from hebbviz.sims.user_file import own_file

    if name in TASKS.names:
        if args.task not in (None, name):
            raise _contradiction(file, "--task", args.task, name)
        return _at_preset(args, file, make_task(name, preset))
    if args.task is None:
        raise InputError(
            f"{file} holds your task {name!r}: name its file again, with --task path.py:Name"
        )
    is_own = own_file(name)[0] is not None
    if args.task in TASKS.names or (is_own and _class_of(name) != _class_of(args.task)):
        raise _contradiction(file, "--task", args.task, name)
    return _at_preset(args, file, make_task(args.task, preset))


def _at_preset(args: argparse.Namespace, file: str | Path, task: Task) -> Task:
    """Return the task; raise InputError if the command line asks for another preset."""
    given = getattr(args, "preset", None)
    if given is not None and task.find_preset(given)[0] != task.preset_name:
        raise _contradiction(file, "--preset", given, task.preset_name)
    return task


def _class_of(spec: str) -> str:
    return spec.rpartition(":")[2]


def _contradiction(file: str | Path, option: str, given: object, saved: object) -> InputError:
    return InputError(
        f"{option} {given} does not go with {file}, which holds {saved}: leave {option} out"
    )


def saved_file(path: Path) -> Path:
    """Return the file that --save with this name wrote: .npz is added if missing."""
    with_suffix = Path(f"{path}.npz")
    return with_suffix if with_suffix.is_file() and not path.is_file() else path


def task_name(args: argparse.Namespace, learner: Learner) -> str:
    """Return the task as the user named it."""
    if args.task is None:
        return learner.task.name
    return str(args.task)


def maker(task: Task, task_name: str | None) -> MakeTask:
    """Return a `make_task` that also makes a task in use, by the user's name for it."""
    from hebbviz.learner.learner import TaskError
    from hebbviz.sims import TASKS
    from hebbviz.sims.loading import make_task

    own, kind = task_name or task.name, type(task)

    def make(name: str, preset: str | None) -> Task:
        if name != own or name in TASKS.names:
            return make_task(name, preset)
        try:
            return kind(preset)
        except Exception as error:
            raise TaskError(f"task {name!r}: {type(error).__name__}: {error}") from error

    return make
