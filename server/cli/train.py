"""`hebbviz train`: learn without a page, and print the figures."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hebbviz.limits import MOST_STEPS
from hebbviz.server.cli.arguments import (
    EPILOG,
    INTERRUPTED,
    add_learner,
    add_recording,
    recording_options,
    whole_number,
)
from hebbviz.sims.program.learner_from_arguments import make_learner, saved_file, task_name
from hebbviz.sims.program.terminal import (
    FAILED,
    FINE,
    InputError,
    check_writable,
    fail,
    leave,
    place,
    prints_aside,
    say,
    tell,
    user_can_mend,
)

if TYPE_CHECKING:
    from hebbviz.learner.learner import Learner
    from hebbviz.server.cli.training import Steps, Training
    from hebbviz.sims.program.interrupts import Interrupts


def add(commands: Any) -> None:
    train = commands.add_parser(
        "train",
        help="learn without a page, and print the figures",
        description="Learn without a page, and print the figures: rewards and times to fall "
        "over the last fifth of the steps. Ctrl-C ends it early and still saves.",
        epilog=f"{INTERRUPTED} {EPILOG}",
    )
    train.add_argument(
        "--steps",
        type=whole_number("steps", 0, MOST_STEPS),
        required=True,
        metavar="N",
        help="how many steps to run",
    )
    add_learner(train)
    add_recording(train)
    train.add_argument(
        "--save",
        metavar="FILE",
        help="save the learner (.npz) for --load; overwrites only the file that was loaded",
    )
    train.add_argument("--json", action="store_true", help="print the figures as one line of JSON")
    train.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Learn without a page."""
    from hebbviz.sims.program.interrupts import Interrupts

    is_watched = sys.stderr.isatty()

    def prepare() -> tuple[Learner, Steps]:
        from hebbviz.sims.program.compiling import announced_on_terminal, warm_up

        with announced_on_terminal():
            learner = make_learner(args)
            warm_up(learner)
            return learner, _recorded(args, learner)

    with Interrupts() as interrupts:
        try:
            with user_can_mend(args), prints_aside():
                _check_save(args)
                _check_recording(args)
                learner, recorded = interrupts.prepare(prepare)
        except KeyboardInterrupt:
            tell("stopped before the training began")
            leave(128 + (interrupts.number or signal.SIGINT))
        with prints_aside(), recorded:
            training = _run(args, learner, recorded, interrupts, bar=is_watched)
        if training.finished:
            code = _report(args, learner, training, interrupts)
        else:
            saved = _save(args, learner) or "not saved: no --save was given"
            tell(f"stopped at step {learner.step:,}; {saved}")
            code = 128 + (interrupts.number or signal.SIGINT)
    if recorded.is_stuck:
        leave(code)
    return code


def _recorded(args: argparse.Namespace, learner: Learner) -> Steps:
    """The object that advances the learner, and records it if requested."""
    from hebbviz.server.cli.training import Recorded, Unrecorded

    if args.record is None:
        return Unrecorded(learner)
    return Recorded(learner, task_name(args, learner), recording_options(args), on_notice=tell)


def _run(
    args: argparse.Namespace, learner: Learner, steps: Steps, interrupts: Interrupts, *, bar: bool
) -> Training:
    from hebbviz.learner.learner import TaskError
    from hebbviz.server.cli.training import train

    try:
        return train(steps, args.steps, stop=interrupts.stop, bar=bar)
    except TaskError as error:
        saved = _save(args, learner) or "fix the task and run it again"
        what = f"{error}{place(args, error)}"
        raise InputError(f"{what}, at step {learner.step:,}; {saved}") from error


def _report(
    args: argparse.Namespace, learner: Learner, training: Training, interrupts: Interrupts
) -> int:
    """Save, then evaluate, then print. A signal ends the evaluation at once."""
    from hebbviz.server.cli.training import describe, figures_of, own_figures, shown_calls

    failure = None
    try:
        saved = _save(args, learner)
    except OSError as error:  # print the figures even so
        saved, failure = None, f"cannot save to {args.save}: {error.strerror or error}"

    def judge() -> dict[str, Any]:
        with shown_calls("evaluating a frozen copy", shown=sys.stderr.isatty()):
            return own_figures(learner, training)

    try:
        with user_can_mend(args), prints_aside():
            own = interrupts.prepare(judge)
    except KeyboardInterrupt:
        how = failure or saved or "not saved: no --save was given"
        tell(f"stopped at step {learner.step:,}, before a frozen copy was evaluated; {how}")
        leave(128 + (interrupts.number or signal.SIGINT))
    figures = figures_of(learner, training, task_name(args, learner))
    if args.json:
        say(json.dumps(own | figures, allow_nan=False))
    else:
        say(describe(figures, own, learner.task.measure) + (f"\n{saved}" if saved else ""))
    return FINE if failure is None else fail(FAILED, failure)


def _check_save(args: argparse.Namespace) -> None:
    """Check before the training that its result can be saved."""
    name: str | None = args.save
    if name is None:
        return
    target = Path(name if name.endswith(".npz") else f"{name}.npz")
    if not name or target.is_dir():
        raise InputError(f"--save must name a file, got {name!r}")
    is_loaded = args.load is not None and saved_file(args.load).resolve() == target.resolve()
    if target.exists() and not is_loaded:
        raise InputError(
            f"{target} exists already and is not overwritten: name another file for --save, or "
            f"continue it with --load {name}"
        )
    check_writable(target.parent)


def _check_recording(args: argparse.Namespace) -> None:
    """Refuse recording options without a recording."""
    for option in ("budget", "detail"):
        if args.record is None and getattr(args, option):
            raise InputError(
                f"--{option} needs a recording: name its file with --record, or leave it out"
            )


def _save(args: argparse.Namespace, learner: Learner) -> str | None:
    """Save if requested; returns a text that says where, or None. Raises OSError."""
    if args.save is None:
        return None
    from hebbviz.learner import saves

    path = saves.save(learner, args.save, task_name=task_name(args, learner))
    return f"saved in {path}"
