"""The command line: `hebbviz` opens the page, `hebbviz train` learns without one.

Exit codes: 0 fine; 2 for what the user gave and can mend, said in one line on stderr; 1 for any
other failure; 130 and 143 for a training that Ctrl-C or SIGTERM ended.
"""

# ruff: noqa: PLC0415  # what is heavy is imported once it is needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import os
import signal
import sys
import tempfile
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hebbviz import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from hebbviz.learner import Learner
    from hebbviz.task import Task
    from server.app import Site
    from server.commands import Speed
    from server.interrupts import Interrupts
    from server.train import Training

FINE, FAILED, BAD_INPUT = 0, 1, 2

DEFAULT_TASK = "pendulum"
MOST_STEPS = 10**12
LONGEST_LINE = 600

_NUMERIC = ("--beta", "--gamma", "--seed", "--speed", "--port", "--steps")

EPILOG = "The rule, the presets and how to write a task of your own are in the README."


class InputError(Exception):
    """Something that the user gave and can mend; the message says what, why and what to do."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv`, by default the process's; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without β must not stop a run
            stream.reconfigure(errors="backslashreplace")
    try:
        args = _parse(list(sys.argv[1:] if argv is None else argv))
        code: int = args.command(args)
        sys.stdout.flush()
    except SystemExit as done:  # argparse, after --help and --version
        return int(done.code or 0)
    except InputError as error:
        return _fail(BAD_INPUT, str(error))
    except BrokenPipeError:  # whoever read our output has gone; nothing can be said any more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except KeyboardInterrupt:  # a second Ctrl-C
        return _fail(128 + signal.SIGINT, "stopped at once")
    except Exception as error:
        if os.environ.get("HEBBVIZ_TRACEBACK"):
            traceback.print_exc()
        what = f"{type(error).__name__}: {error}"
        return _fail(FAILED, f"{what} (set HEBBVIZ_TRACEBACK=1 to see where)")
    return code


# What can be given


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def _parse(argv: list[str]) -> argparse.Namespace:
    alone = {"-h", "--help", "--version"}
    if not argv or (argv[0].startswith("-") and argv[0] not in alone):
        argv = ["serve", *argv]
    return _parser().parse_args(_joined(argv))


def _joined(argv: list[str]) -> list[str]:
    """`--gamma -1e-3` as `--gamma=-1e-3`: argparse would take the value for an option."""
    joined: list[str] = []
    for text in argv:
        if joined and joined[-1] in _NUMERIC and _is_number(text):
            joined[-1] += f"={text}"
        else:
            joined.append(text)
    return joined


def _is_number(text: str) -> bool:
    with contextlib.suppress(ValueError):
        float(text)
        return True
    return False


def _parser() -> _Parser:
    parser = _Parser(
        prog="hebbviz",
        description="Watch a network of spiking neurons learn by itself. "
        "Without a command: serve, with any of its options.",
        epilog=f"More: hebbviz serve --help, hebbviz train --help. {EPILOG}",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"hebbviz {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    _add_serve(commands)
    _add_train(commands)
    return parser


def _add_serve(commands: Any) -> None:
    serve = commands.add_parser(
        "serve",
        help="open the page in the browser and learn live",
        description="Open the page in the browser and learn live, until Ctrl-C.",
        epilog=EPILOG,
        allow_abbrev=False,
    )
    _add_learner(serve)
    serve.add_argument(
        "--speed", type=_speed, metavar="S",
        help="steps per second, realtime (tasks with a time step) or max; can be changed on "
        "the page",
    )  # fmt: skip
    serve.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on (default %(default)s: this machine only; there is no password)",
    )  # fmt: skip
    serve.add_argument(
        "--port", type=_whole("port", 0, 65535), metavar="N",
        help="port to listen on, 0 for any (default 8080, or the next free one)",
    )  # fmt: skip
    serve.add_argument("--no-browser", action="store_true", help="open no browser")
    serve.set_defaults(command=_serve)


def _add_train(commands: Any) -> None:
    train = commands.add_parser(
        "train",
        help="learn without a page, and print the figures",
        description="Learn without a page, and print the figures: rewards and times to fall "
        "over the last fifth of the steps. Ctrl-C ends it early and still saves.",
        epilog=f"Exit code 130 or 143 if Ctrl-C or SIGTERM ended it. {EPILOG}",
        allow_abbrev=False,
    )
    train.add_argument(
        "--steps", type=_whole("steps", 0, MOST_STEPS), required=True, metavar="N",
        help="how many steps to run",
    )  # fmt: skip
    _add_learner(train)
    train.add_argument("--save", metavar="FILE", help="save the learner (.npz) for --load")
    train.add_argument("--json", action="store_true", help="print the figures as one line of JSON")
    train.set_defaults(command=_train)


def _add_learner(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task", metavar="T",
        help="pendulum, sonar, synapse, or your own as path.py:Name "
        f"(default {DEFAULT_TASK})",
    )  # fmt: skip
    parser.add_argument("--preset", metavar="P", help="a setting of the task (default its first)")
    parser.add_argument(
        "--beta", type=_number("beta"), metavar="β",
        help="how long traces last, in [0, 1) (default the preset's)",
    )  # fmt: skip
    parser.add_argument(
        "--gamma", type=_number("gamma"), metavar="γ",
        help="step size, 0 or more (default the preset's)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=_whole("seed", 0, 2**32 - 1), metavar="N", help="random seed (default 0)"
    )
    parser.add_argument(
        "--hidden", type=_hidden, metavar="SIZES",
        help="hidden layers, as 16 or 8,8 or none (default the task's)",
    )  # fmt: skip
    parser.add_argument(
        "--load", metavar="FILE", help="go on with a saved learner, its task and its preset"
    )


def _whole(name: str, least: int, most: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        with contextlib.suppress(ValueError):
            if least <= int(text) <= most:
                return int(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a whole number from {least} to {most}, got {text!r}"
        )

    return parse


def _number(name: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with contextlib.suppress(ValueError):
            if math.isfinite(float(text)):
                return float(text)
        raise argparse.ArgumentTypeError(f"{name} must be a finite number, got {text!r}")

    return parse


def _speed(text: str) -> Speed:
    if text in ("realtime", "max"):
        return text
    with contextlib.suppress(ValueError):
        if math.isfinite(float(text)) and float(text) > 0.0:
            return float(text)
    raise argparse.ArgumentTypeError(
        f"speed must be steps per second above 0, realtime or max, got {text!r}"
    )


def _hidden(text: str) -> tuple[int, ...]:
    from hebbviz.topology import parse_hidden

    try:
        return parse_hidden(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


# The commands


def _serve(args: argparse.Namespace) -> int:
    from server.interrupts import Interrupts

    def prepare() -> Site:
        from server.app import COMPILING, Site, check_start
        from server.train import announced_compiling

        with announced_compiling(lambda: _say(COMPILING)):
            learner = _learner(args)
            check_start(learner.task, args.speed)
            return Site(
                learner, host=args.host, port=args.port, speed=args.speed,
                task_name=_task_name(args, learner),
            )  # fmt: skip

    with Interrupts() as interrupts:
        try:
            with _user_can_mend(args):
                site = interrupts.prepare(prepare)
        except KeyboardInterrupt:
            _say("stopped before the page was open")
            _leave(FINE)
        site.run(interrupts.stop, open_browser=not args.no_browser)
    return FINE


def _train(args: argparse.Namespace) -> int:
    from server.interrupts import Interrupts

    is_watched = sys.stderr.isatty()

    def say() -> None:
        if is_watched:
            _tell("compiling for this machine, only this first time")

    def prepare() -> Learner:
        from server.train import announced_compiling, warm_up

        with announced_compiling(say):
            learner = _learner(args)
            warm_up(learner)
            return learner

    with Interrupts() as interrupts:
        try:
            with _user_can_mend(args):
                _check_save(args.save)
                learner = interrupts.prepare(prepare)
        except KeyboardInterrupt:
            _tell("stopped before the training began")
            _leave(128 + (interrupts.number or signal.SIGINT))
        training = _run(args, learner, interrupts, bar=is_watched)
        if training.finished:
            return _report(args, learner, training)
        saved = _save(args, learner) or "not saved, for want of --save"
        _tell(f"stopped at step {learner.step:,}; {saved}")
        return 128 + (interrupts.number or signal.SIGINT)


def _leave(code: int) -> NoReturn:
    """End now, though a compiler is still at work in another thread."""
    sys.stdout.flush()
    os._exit(code)


def _run(
    args: argparse.Namespace, learner: Learner, interrupts: Interrupts, *, bar: bool
) -> Training:
    from hebbviz.learner import TaskError
    from server.train import train

    try:
        return train(learner, args.steps, stop=interrupts.stop, bar=bar)
    except TaskError as error:
        saved = _save(args, learner) or "mend the task and run it again"
        what = f"{error}{_place(args, error)}"
        raise InputError(f"{what}, at step {learner.step:,}; {saved}") from error


def _report(args: argparse.Namespace, learner: Learner, training: Training) -> int:
    from server.train import describe, figures_of, own_figures

    failure = None
    try:
        saved = _save(args, learner)
    except OSError as error:  # the figures are worth having all the same
        saved, failure = None, f"cannot save to {args.save}: {error.strerror or error}"
    with _user_can_mend(args):
        own = own_figures(learner, training)
    figures = figures_of(learner, training, _task_name(args, learner))
    if args.json:
        _say(json.dumps(own | figures, allow_nan=False))
    else:
        _say(describe(figures, own) + (f"\n{saved}" if saved else ""))
    return FINE if failure is None else _fail(FAILED, failure)


# Making the learner


def _learner(args: argparse.Namespace) -> Learner:
    """The learner that was asked for, new or loaded. Raises InputError, ValueError, OSError and
    TaskError for what the user can mend.
    """
    from hebbviz.learner import Learner
    from hebbviz.limits import check_beta, check_gamma
    from sims.loading import make_task

    for check, value in ((check_beta, args.beta), (check_gamma, args.gamma)):
        if value is not None:
            check(value)
    if args.load is not None:
        return _loaded(args)
    task = make_task(args.task or DEFAULT_TASK, args.preset)
    return Learner(task, hidden=args.hidden, beta=args.beta, gamma=args.gamma, seed=args.seed or 0)


def _loaded(args: argparse.Namespace) -> Learner:
    from hebbviz import files

    learner = files.load(_saved_file(args.load), lambda *saved: _saved_task(args, *saved))
    if args.seed not in (None, learner.seed):
        raise _contradiction(args, "--seed", args.seed, learner.seed)
    if args.hidden is not None and learner.task.topology(args.hidden) != learner.topology:
        sizes = ",".join(str(n) for n in args.hidden) or "none"
        raise _contradiction(args, "--hidden", sizes, f"a {learner.topology.describe()} network")
    if args.beta is not None:
        learner.set_beta(args.beta)
    if args.gamma is not None:
        learner.set_gamma(args.gamma)
    return learner


def _saved_task(args: argparse.Namespace, name: str, preset: str) -> Task:
    """The task a file names. A user's file is run only if the user names it: a saved learner may
    come from anywhere.
    """
    from sims import TASKS
    from sims.loading import make_task

    if args.preset not in (None, preset):
        raise _contradiction(args, "--preset", args.preset, preset)
    if name in TASKS:
        if args.task not in (None, name):
            raise _contradiction(args, "--task", args.task, name)
        return make_task(name, preset)
    if args.task is None:
        raise InputError(
            f"{args.load} learns a task of yours, {name!r}: name its file again, with "
            "--task path.py:Name"
        )
    if args.task in TASKS or (".py:" in name and _class_of(name) != _class_of(args.task)):
        raise _contradiction(args, "--task", args.task, name)
    return make_task(args.task, preset)


def _class_of(spec: str) -> str:
    return spec.rpartition(":")[2]


def _contradiction(
    args: argparse.Namespace, option: str, given: object, saved: object
) -> InputError:
    return InputError(
        f"{option} {given} does not go with --load {args.load}, which holds {saved}: leave "
        f"{option} out"
    )


def _saved_file(name: str) -> Path:
    """The file that --save with this name wrote: .npz is added if missing."""
    path, with_suffix = Path(name), Path(f"{name}.npz")
    return with_suffix if with_suffix.is_file() and not path.is_file() else path


def _task_name(args: argparse.Namespace, learner: Learner) -> str:
    """What the user called the task."""
    if args.task is None:
        return learner.task.name
    return str(args.task)


def _check_save(name: str | None) -> None:
    """Find out before the training whether its result can be saved."""
    if name is None:
        return
    target = Path(name if name.endswith(".npz") else f"{name}.npz")
    if not name or target.is_dir():
        raise InputError(f"--save must name a file, got {name!r}")
    try:
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except OSError as error:
        raise InputError(
            f"cannot save in {target.parent}: {_reason(error)}; choose another folder"
        ) from error


def _save(args: argparse.Namespace, learner: Learner) -> str | None:
    """Save if asked for, and say where; None if not asked for. Raises OSError."""
    if args.save is None:
        return None
    from hebbviz import files

    path = files.save(learner, args.save, task_name=_task_name(args, learner))
    return f"saved in {path}"


# What goes wrong


@contextlib.contextmanager
def _user_can_mend(args: argparse.Namespace) -> Iterator[None]:
    """What goes wrong in here does so for what the user gave."""
    from hebbviz.learner import TaskError

    try:
        yield
    except (InputError, MemoryError):
        raise
    except OSError as error:
        known = error.filename is not None
        what = f"cannot open {error.filename}: {_reason(error)}" if known else str(error)
        raise InputError(what) from error
    except (ValueError, TaskError) as error:
        raise InputError(f"{error}{_place(args, error)}") from error
    except (Exception, SystemExit) as error:
        if _user_file(args) is None:
            raise
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"task {args.task}: {what}{_place(args, error)}") from error


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


def _place(args: argparse.Namespace, error: BaseException) -> str:
    """Where in the user's own file an error came from, as '(my.py, line 12)', or nothing."""
    file = _user_file(args)
    if file is None:
        return ""
    causes = [error]
    while causes[-1].__cause__ is not None:
        causes.append(causes[-1].__cause__)
    for cause in reversed(causes):
        frames = traceback.extract_tb(cause.__traceback__)
        lines = [f.lineno for f in frames if Path(f.filename).resolve() == file]
        if lines:
            return f" ({file.name}, line {lines[-1]})"
    return ""


def _user_file(args: argparse.Namespace) -> Path | None:
    """The user's own file, if the task is in one."""
    file, _, _ = (args.task or "").rpartition(":")
    return Path(file).resolve() if file.endswith(".py") else None


def _fail(code: int, message: str) -> int:
    _tell(message)
    return code


def _tell(message: str) -> None:
    """One line on stderr, whatever is in the message."""
    line = " ".join(message.split())
    line = "".join(c if c.isprintable() else "?" for c in line)
    sys.stderr.write(f"hebbviz: {line[:LONGEST_LINE]}\n")
    sys.stderr.flush()


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
