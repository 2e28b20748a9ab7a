"""The command line: `hebbviz` opens the page, `hebbviz train` learns without one, and what was
recorded is replayed, viewed, inspected and exported; `hebbviz bench` measures speeds.

Exit codes: 0 fine; 2 for what the user gave and can mend, said in one line on stderr; 1 for any
other failure; 130, 143 and 129 for a training that Ctrl-C, SIGTERM or SIGHUP ended. A recording
that had to stop, for want of disk space say, is told of on stderr and changes none of this: the
run is whole. Where stdout cannot be written, all is done and saved as usual. The code is then 1,
but not for a page: it stays what it would be.
"""

# ruff: noqa: PLC0415  # what is heavy is imported once it is needed: --help must be quick

from __future__ import annotations

import argparse
import atexit
import io
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hebbviz.limits import CompilerOff
from server.making import asked_rule, make_learner, saved_file, saved_task, task_name
from server.options import parse, shows_page
from server.output import spared
from server.terminal import (
    BAD_INPUT,
    FAILED,
    FINE,
    InputError,
    WorkersFailed,
    check_writable,
    fail,
    place,
    prints_aside,
    say,
    tell,
    user_can_mend,
)

if TYPE_CHECKING:
    import threading
    from collections.abc import Sequence

    from hebbviz.learner import Learner
    from server.app import Site
    from server.bench import Speed
    from server.entrance import Access
    from server.interrupts import Interrupts
    from server.recording.recordings import Options
    from server.train import Steps, Training


GRACE_SECONDS = 1.5
"""Work that is asked to stop may take so long to keep what was done."""


def program() -> NoReturn:
    """Run the process's command line, and end the process.

    Python would first take apart what the system takes back anyway, for half a second.
    """
    code = main()
    atexit._run_exitfuncs()  # noqa: SLF001  # there is no public way
    os._exit(code)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv`, by default the process's; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without β must not stop a run
            stream.reconfigure(errors="backslashreplace")
    args = list(sys.argv[1:] if argv is None else argv)
    with spared() as stdout:
        code = _obey(args)
    return FAILED if code == FINE and stdout.lost and not shows_page(args) else code


def _obey(argv: list[str]) -> int:
    """The exit code of a command, its output aside."""
    try:
        args = parse(argv)
        code = COMMANDS[args.command](args)
    except SystemExit as done:  # argparse, after --help and --version
        return int(done.code or 0)
    except (InputError, CompilerOff) as error:
        return fail(BAD_INPUT, str(error))
    except KeyboardInterrupt:  # a second Ctrl-C
        return fail(128 + signal.SIGINT, "stopped at once")
    except Exception as error:
        if os.environ.get("HEBBVIZ_TRACEBACK"):
            traceback.print_exc()
        what = f"{type(error).__name__}: {error}"
        return fail(FAILED, f"{what} (set HEBBVIZ_TRACEBACK=1 to see where)")
    return code


# The commands


def serve(args: argparse.Namespace) -> int:
    """Open the page and learn live."""

    def prepare() -> Site:
        from server.app import Site, check_start

        learner = make_learner(args)
        check_start(learner.task, args.speed)
        return Site(
            learner, host=args.host, port=args.port, speed=args.speed,
            task_name=task_name(args, learner), recording=_recording(args), access=_access(args),
        )  # fmt: skip

    return show_page(args, prepare)


def replay(args: argparse.Namespace) -> int:
    """Open the page with a recording."""

    def prepare() -> Site:
        from server.app import Site
        from server.making import maker
        from server.recording.reader import open_recording
        from server.recording.recordings import Options

        asked_rule(args)
        recording = open_recording(args.file)
        header = recording.header
        if recording.notice:
            tell(recording.notice)
        task = saved_task(args, args.file, header.task, header.preset)
        name = args.task or header.task
        past = recording.run(maker(task, name), task, name)
        return Site(
            past.learner, host=args.host, port=args.port, speed=None, task_name=name,
            recording=Options(folder=args.recordings), past=past, access=_access(args),
        )  # fmt: skip

    return show_page(args, prepare)


def show_page(args: argparse.Namespace, prepare: Callable[[], Site]) -> int:
    """Show the page of a site until Ctrl-C or SIGTERM."""
    from server.interrupts import Interrupts

    def prepare_aloud() -> Site:
        from server.app import COMPILING
        from server.train import announced_compiling

        with announced_compiling(lambda: say(COMPILING)):
            return prepare()

    with Interrupts() as interrupts:
        try:
            with user_can_mend(args):
                site = interrupts.prepare(prepare_aloud)
        except KeyboardInterrupt:
            say("stopped before the page was open")
            _leave(FINE)
        site.run(interrupts.stop, open_browser=not args.no_browser)
    if site.is_stuck:
        _leave(FINE)
    return FINE


def view(args: argparse.Namespace) -> int:
    """Open a recording in rerun's web viewer."""
    from server.interrupts import Interrupts
    from server.recording.viewer import Viewer

    with Interrupts() as interrupts:
        with user_can_mend(args):
            viewer = Viewer(args.file, port=args.port, access=_access(args), on_turned_away=tell)
        if viewer.warning:
            say(viewer.warning)
        say(f"{args.file} is shown at {viewer.link} (stop it with Ctrl-C)")
        viewer.run(interrupts.stop, open_browser=not args.no_browser)
    return FINE


def inspect(args: argparse.Namespace) -> int:
    """Say what is in a recording."""
    from server.recording.inspect import describe, figures
    from server.recording.reader import open_recording

    with user_can_mend(args), prints_aside():
        asked_rule(args)
        recording = open_recording(args.file)
    found = figures(recording)
    say(json.dumps(found, allow_nan=False) if args.json else describe(found))
    return FINE


def export(args: argparse.Namespace) -> int:
    """Write a recording's timelines as npz and CSV."""
    from server.recording.export import export_steps, export_timelines
    from server.recording.reader import open_recording

    with user_can_mend(args), prints_aside():
        asked_rule(args)
        recording = open_recording(args.file)
        if recording.notice:
            tell(recording.notice)
        if args.every_step is None:
            written = export_timelines(recording, args.out)
        else:
            header = recording.header
            task = saved_task(args, args.file, header.task, header.preset)
            first, end = args.every_step
            written = export_steps(recording, args.out, first, end, task)
    say("\n".join(str(path) for path in written))
    return FINE


def _access(args: argparse.Namespace) -> Access:
    from server.entrance import Access

    return Access(tuple(args.allow_host), args.token)


def bench(args: argparse.Namespace) -> int:
    """Measure speeds."""
    from server.bench import contestants, figures, race, table
    from server.interrupts import Interrupts
    from server.train import announced_compiling

    def work() -> dict[str, Speed]:
        with announced_compiling(lambda: tell("compiling for this machine, only this first time")):
            return race(contestants(), args.seconds)

    with Interrupts() as interrupts:
        try:
            speeds = interrupts.prepare(work)
        except KeyboardInterrupt:
            tell("stopped; nothing was measured")
            _leave(128 + (interrupts.number or signal.SIGINT))
    say(json.dumps(figures(speeds), allow_nan=False) if args.json else table(speeds))
    return FINE


def _recording(args: argparse.Namespace) -> Options:
    from server.recording.recordings import Options

    given = {name: getattr(args, name) for name in ("budget", "detail") if getattr(args, name)}
    return Options(
        file=args.record, stream=getattr(args, "stream", None),
        folder=getattr(args, "recordings", Options.folder), **given,
    )  # fmt: skip


def train(args: argparse.Namespace) -> int:
    """Learn without a page."""
    from server.interrupts import Interrupts

    is_watched = sys.stderr.isatty()

    def prepare() -> tuple[Learner, Steps]:
        from server.train import announced_on_terminal, warm_up

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
            _leave(128 + (interrupts.number or signal.SIGINT))
        with prints_aside(), recorded:
            training = _run(args, learner, recorded, interrupts, bar=is_watched)
        if training.finished:
            code = _report(args, learner, training, interrupts)
        else:
            saved = _save(args, learner) or "not saved, for want of --save"
            tell(f"stopped at step {learner.step:,}; {saved}")
            code = 128 + (interrupts.number or signal.SIGINT)
    if recorded.is_stuck:
        _leave(code)
    return code


def _leave(code: int) -> NoReturn:
    """End now, though a compiler is still at work in another thread."""
    sys.stdout.flush()
    os._exit(code)


def _recorded(args: argparse.Namespace, learner: Learner) -> Steps:
    """What moves the learner on, and records it if that is asked for."""
    from server.train import Recorded, Unrecorded

    if args.record is None:
        return Unrecorded(learner)
    return Recorded(learner, task_name(args, learner), _recording(args), on_notice=tell)


def _run(
    args: argparse.Namespace, learner: Learner, steps: Steps, interrupts: Interrupts, *, bar: bool
) -> Training:
    from hebbviz.learner import TaskError
    from server.train import train

    try:
        return train(steps, args.steps, stop=interrupts.stop, bar=bar)
    except TaskError as error:
        saved = _save(args, learner) or "mend it and run it again"
        what = f"{error}{place(args, error)}"
        raise InputError(f"{what}, at step {learner.step:,}; {saved}") from error


def _report(
    args: argparse.Namespace, learner: Learner, training: Training, interrupts: Interrupts
) -> int:
    """Save, then find out how it does, then print. A signal ends the second at once."""
    from server.train import describe, figures_of, own_figures, shown_calls

    failure = None
    try:
        saved = _save(args, learner)
    except OSError as error:  # the figures are worth having all the same
        saved, failure = None, f"cannot save to {args.save}: {error.strerror or error}"

    def judge() -> dict[str, Any]:
        with shown_calls("evaluating a frozen copy", shown=sys.stderr.isatty()):
            return own_figures(learner, training)

    try:
        with user_can_mend(args), prints_aside():
            own = interrupts.prepare(judge)
    except KeyboardInterrupt:
        how = failure or saved or "not saved, for want of --save"
        tell(f"stopped at step {learner.step:,}, before a frozen copy was evaluated; {how}")
        _leave(128 + (interrupts.number or signal.SIGINT))
    figures = figures_of(learner, training, task_name(args, learner))
    if args.json:
        say(json.dumps(own | figures, allow_nan=False))
    else:
        say(describe(figures, own, learner.task.measure) + (f"\n{saved}" if saved else ""))
    return FINE if failure is None else fail(FAILED, failure)


# Saving


def _check_save(args: argparse.Namespace) -> None:
    """Find out before the training whether its result can be saved."""
    name: str | None = args.save
    if name is None:
        return
    target = Path(name if name.endswith(".npz") else f"{name}.npz")
    if not name or target.is_dir():
        raise InputError(f"--save must name a file, got {name!r}")
    is_loaded = args.load is not None and saved_file(args.load).resolve() == target.resolve()
    if target.exists() and not is_loaded:
        raise InputError(
            f"{target} exists already and is not written over: name another file for --save, or "
            f"go on with it by --load {name}"
        )
    check_writable(target.parent)


def _check_recording(args: argparse.Namespace) -> None:
    """How to record says nothing where nothing is recorded."""
    for option in ("budget", "detail"):
        if args.record is None and getattr(args, option):
            raise InputError(
                f"--{option} is for a recording: name its file with --record, or leave it out"
            )


def _save(args: argparse.Namespace, learner: Learner) -> str | None:
    """Save if asked for, and say where; None if not asked for. Raises OSError."""
    if args.save is None:
        return None
    from hebbviz import files

    path = files.save(learner, args.save, task_name=task_name(args, learner))
    return f"saved in {path}"


# Figures and maps


def figure(args: argparse.Namespace) -> int:
    """Make one of the paper's figures."""

    def work(stop: threading.Event) -> dict[str, Any] | None:
        from server.figures.command import make
        from server.figures.order import Order

        return make(Order.of(args), stop)

    return _experiment(args, work)


def sweep(args: argparse.Namespace) -> int:
    """Map β against γ."""

    def work(stop: threading.Event) -> dict[str, Any] | None:
        from server.sweep.command import make
        from server.sweep.grid import Sweep

        return make(Sweep.of(args), args.out, stop, scheduler=args.scheduler)

    return _experiment(args, work)


def _experiment(
    args: argparse.Namespace, work: Callable[[threading.Event], dict[str, Any] | None]
) -> int:
    """Do a long work and print what it comes to; `work` returns None if it was stopped."""
    from server.interrupts import Interrupts

    kept = f"the same command goes on from what is kept in {args.out}"
    with Interrupts() as interrupts:
        try:
            with user_can_mend(args), prints_aside():
                made = interrupts.prepare(lambda: work(interrupts.stop), grace=GRACE_SECONDS)
        except WorkersFailed as error:
            return fail(FAILED, f"{error}; {kept}")
        except KeyboardInterrupt:
            tell(f"stopped at once; {kept}")  # its last few seconds of work are lost
            _leave(128 + (interrupts.number or signal.SIGINT))
    if made is None:
        tell(f"stopped; {kept}")
        return 128 + (interrupts.number or signal.SIGINT)
    say(json.dumps(made, allow_nan=False))
    return FINE


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    c.__name__: c for c in (serve, train, replay, view, inspect, export, figure, sweep, bench)
}


if __name__ == "__main__":
    program()
