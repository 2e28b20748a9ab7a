"""What can be given on the command line: commands, options, and which values they take."""

# ruff: noqa: PLC0415  # what is heavy is imported once it is needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hebbviz import __version__
from hebbviz.limits import MOST_LANES
from server.making import DEFAULT_TASK, MOST_SHOWN_LANES
from server.numbers import about_commas, whole
from server.terminal import InputError

if TYPE_CHECKING:
    from server.commands import Speed

MOST_STEPS = 10**12

_NUMERIC = ("--beta", "--gamma", "--fall", "--seed", "--speed", "--port", "--steps", "--stream",
            "--epochs", "--hours", "--lanes", "--seconds")  # fmt: skip

EPILOG = "The rule, the presets and how to write a task of your own are in the README."


class _Parser(argparse.ArgumentParser):
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """What is unknown to a command is told by the command, with its own help."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def parse(argv: list[str]) -> argparse.Namespace:
    """The command and its options; `command` is its name. Raises InputError."""
    return _parser().parse_args(_joined(_with_command(argv)))


def shows_page(argv: list[str]) -> bool:
    """Whether this is a command that shows a page."""
    return _with_command(argv)[0] in ("serve", "replay", "view")


def _with_command(argv: list[str]) -> list[str]:
    """The command line in which the command is named."""
    alone = {"-h", "--help", "--version"}
    is_named = bool(argv) and (not argv[0].startswith("-") or argv[0] in alone)
    return argv if is_named else ["serve", *argv]


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
        epilog=f"More: hebbviz COMMAND --help. {EPILOG}",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"hebbviz {__version__}")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=_Parser
    )
    for add in (_add_serve, _add_train, _add_replay, _add_view, _add_inspect, _add_export,
                _add_figure, _add_sweep, _add_bench):  # fmt: skip
        add(commands)
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
        "--lanes", type=_whole("lanes", 1, MOST_SHOWN_LANES), metavar="N",
        help="how many replicas learn side by side, one of them watched (default 1)",
    )  # fmt: skip
    _add_page(serve)
    _add_recording(serve)
    serve.add_argument(
        "--stream", nargs="?", type=_whole("port", 0, 65535), const=9876, metavar="PORT",
        help="serve what is recorded to rerun's viewers on this machine too (default port "
        "%(const)s, 0 for any)",
    )  # fmt: skip


def _add_train(commands: Any) -> None:
    train = commands.add_parser(
        "train",
        help="learn without a page, and print the figures",
        description="Learn without a page, and print the figures: rewards and times to fall "
        "over the last fifth of the steps. Ctrl-C ends it early and still saves.",
        epilog=f"Exit code 130, 143 or 129 if Ctrl-C, SIGTERM or SIGHUP ended it. {EPILOG}",
        allow_abbrev=False,
    )
    train.add_argument(
        "--steps", type=_whole("steps", 0, MOST_STEPS), required=True, metavar="N",
        help="how many steps to run",
    )  # fmt: skip
    _add_learner(train)
    _add_recording(train)
    train.add_argument(
        "--save", metavar="FILE",
        help="save the learner (.npz) for --load; a file is written over only if it was loaded",
    )  # fmt: skip
    train.add_argument("--json", action="store_true", help="print the figures as one line of JSON")


def _add_learner(parser: argparse.ArgumentParser) -> None:
    _add_task(parser)
    _add_values(parser)
    _add_rule(parser)
    parser.add_argument(
        "--seed", type=_whole("seed", 0, 2**32 - 1), metavar="N", help="random seed (default 0)"
    )
    parser.add_argument(
        "--load", type=_path, metavar="FILE",
        help="go on with a saved learner, its task and its preset",
    )  # fmt: skip


def _add_values(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--beta", type=_number("beta"), metavar="β",
        help="how long traces last, in [0, 1) (default the preset's)",
    )  # fmt: skip
    parser.add_argument(
        "--gamma", type=_number("gamma"), metavar="γ",
        help="step size, 0 or more (default the preset's)",
    )  # fmt: skip


def _add_rule(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--rule", metavar="R",
        help="paper, baseline, yoked, or your own as path.py:Name; with parameters as "
        "baseline:time=1000 (default the preset's)",
    )  # fmt: skip
    parser.add_argument(
        "--fall", type=_fall, metavar="STEPS",
        help="gamma falls over so many steps: at step t it is gamma STEPS/(STEPS + t); never: it "
        "stays (default the preset's)",
    )  # fmt: skip


def _add_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task", metavar="T",
        help="pendulum, sonar, synapse, gradient, prediction, filtering, or your own as "
        f"path.py:Name (default {DEFAULT_TASK})",
    )  # fmt: skip
    parser.add_argument(
        "--preset", metavar="P",
        help="a setting of the task (default its first); with a switch as best:centred=no",
    )  # fmt: skip
    _add_hidden(parser)


def _add_hidden(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--hidden", type=_hidden, metavar="SIZES",
        help="hidden layers, as 16 or 8,8 or none (default the task's)",
    )  # fmt: skip


def _whole(name: str, least: int, most: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        with contextlib.suppress(ValueError):
            if least <= whole(text) <= most:
                return whole(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a whole number from {least} to {most}, got {text!r}"
            f"{about_commas(text)}"
        )

    return parse


def _path(text: str) -> Path:
    if not text.strip():  # Path("") is the folder that one is in
        raise argparse.ArgumentTypeError(f"a path must have a name, got {text!r}")
    return Path(text)


def _number(name: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with contextlib.suppress(ValueError):
            if math.isfinite(float(text)):
                return float(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a finite number, got {text!r}{about_commas(text)}"
        )

    return parse


def _fall(text: str) -> float:
    with contextlib.suppress(ValueError):
        return math.inf if text == "never" else float(text)
    raise argparse.ArgumentTypeError(
        f"fall must be a number of steps or never, got {text!r}{about_commas(text)}"
    )


def _positive(name: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with contextlib.suppress(ValueError):
            if math.isfinite(float(text)) and float(text) > 0.0:
                return float(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a number above 0, got {text!r}{about_commas(text)}"
        )

    return parse


def _speed(text: str) -> Speed:
    if text in ("realtime", "max"):
        return text
    with contextlib.suppress(ValueError):
        if math.isfinite(float(text)) and float(text) > 0.0:
            return float(text)
    raise argparse.ArgumentTypeError(
        f"speed must be steps per second above 0, realtime or max, got {text!r}{about_commas(text)}"
    )


def _hidden(text: str) -> tuple[int, ...]:
    from hebbviz.topology import parse_hidden

    try:
        return parse_hidden(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser(
        "replay",
        help="play a recording back in the page, and go on from any moment of it",
        description="Play a recording back in the page: any step of it, made again from its "
        "keyframes; go on from any moment.",
        epilog=EPILOG,
        allow_abbrev=False,
    )
    _add_recorded(replay)
    _add_own_task(replay)
    _add_own_rule(replay)
    _add_page(replay)


def _add_view(commands: Any) -> None:
    view = commands.add_parser(
        "view",
        help="open a recording in rerun's web viewer, from this machine alone",
        description="Open a recording in the web viewer that comes with rerun, served on "
        "127.0.0.1; nothing is sent outside.",
        allow_abbrev=False,
    )
    _add_recorded(view)
    view.add_argument(
        "--port", type=_whole("port", 0, 65535), default=0, metavar="N",
        help="port to listen on (default any)",
    )  # fmt: skip
    _add_access(view)
    view.add_argument("--no-browser", action="store_true", help="open no browser")


def _add_inspect(commands: Any) -> None:
    inspect = commands.add_parser(
        "inspect",
        help="say what is in a recording",
        description="Say what is in a recording: task, seed, length, changes, keyframes, final "
        "figures, whether it is whole.",
        allow_abbrev=False,
    )
    _add_recorded(inspect)
    _add_own_rule(inspect)
    inspect.add_argument("--json", action="store_true", help="say it as one line of JSON")


def _add_export(commands: Any) -> None:
    export = commands.add_parser(
        "export",
        help="write a recording's timelines as npz and CSV",
        description="Write a recording's timelines as npz and CSV.",
        allow_abbrev=False,
    )
    _add_recorded(export)
    _add_own_task(export)
    _add_own_rule(export)
    export.add_argument(
        "--out", type=_path, required=True, metavar="FOLDER", help="folder to write into"
    )
    export.add_argument(
        "--every-step", type=_steps, metavar="FROM:TO",
        help="make these steps again, and write all of each: inputs, spikes, w, z, β, γ, the world",
    )  # fmt: skip


def _add_figure(commands: Any) -> None:
    from server.figures.order import KINDS

    figure = commands.add_parser(
        "figure",
        help="make one of the paper's figures: PNG, SVG and the CSV behind them",
        description="Make one of the paper's figures, from runs of its own: PNG, SVG and the CSV "
        "behind them, and what it comes to as one line of JSON. Ctrl-C ends it early; the same "
        "command then goes on where it was.",
        epilog=f"Exit code 130, 143 or 129 if Ctrl-C, SIGTERM or SIGHUP ended it. {EPILOG}",
        allow_abbrev=False,
    )
    figure.add_argument(
        "name", choices=KINDS, metavar="NAME",
        help="; ".join(f"{name}: {kind.shows}" for name, kind in KINDS.items()),
    )  # fmt: skip
    figure.add_argument(
        "--out", type=_path, required=True, metavar="FOLDER", help="folder to write into"
    )
    figure.add_argument(
        "--preset",
        metavar="P",
        help="a setting of the task (default the figure's own); with a switch as best:centred=no",
    )
    figure.add_argument(
        "--lanes", type=_whole("lanes", 1, MOST_LANES), metavar="N",
        help="independent runs (default the figure's own)",
    )  # fmt: skip
    _add_length(figure)
    figure.add_argument(
        "--seed", type=_whole("seed", 0, 2**32 - 1), default=0, metavar="N",
        help="random seed (default %(default)s)",
    )  # fmt: skip
    figure.add_argument(
        "--quick",
        action="store_true",
        help="a small version in less than a minute, once compiled, to try it",
    )
    _add_scheduler(figure)
    learning = figure.add_argument_group("of figure learning")
    learning.add_argument("--task", metavar="T", help="a task by name, or your own as path.py:Name")
    _add_hidden(learning)
    _add_values(learning)
    _add_rule(learning)


def _add_sweep(commands: Any) -> None:
    sweep = commands.add_parser(
        "sweep",
        help="map β against γ: how well each pair learns, as a heat map",
        description="Map β against γ: run each pair many times over and tell how well it did over "
        "the last fifth of the steps, as a heat map (PNG, SVG), a CSV, and one line of JSON. A "
        "learner of each point is saved, and the command that opens it in the page is told with "
        "it. Ctrl-C ends it early; the same command then goes on where it was, and so does one "
        "with other values.",
        epilog=f"Exit code 130, 143 or 129 if Ctrl-C, SIGTERM or SIGHUP ended it. {EPILOG}",
        allow_abbrev=False,
    )
    sweep.add_argument(
        "--out", type=_path, default=Path("sweep"), metavar="FOLDER",
        help="folder to write into (default %(default)s)",
    )  # fmt: skip
    _add_task(sweep)
    sweep.add_argument(
        "--beta", type=_values("parse_betas"), metavar="LIST",
        help="values of β, as 0.5,0.9,0.99 or as a range 0.5:0.99:5, evenly in the logarithm of "
        "1/(1−β) (default the preset's)",
    )  # fmt: skip
    sweep.add_argument(
        "--gamma", type=_values("parse_gammas"), metavar="LIST",
        help="values of γ, as 1e-3,1e-2 or as a range 1e-4:1e-1:7, evenly in its logarithm "
        "(default the preset's)",
    )  # fmt: skip
    _add_rule(sweep)
    sweep.add_argument(
        "--lanes", type=_whole("lanes", 1, MOST_LANES), default=16, metavar="N",
        help="independent runs of each pair (default %(default)s)",
    )  # fmt: skip
    _add_length(sweep, default="1,000,000 steps")
    sweep.add_argument(
        "--seed", type=_whole("seed", 0, 2**32 - 1), default=0, metavar="N",
        help="random seed (default %(default)s)",
    )  # fmt: skip
    _add_scheduler(sweep)


def _values(parser: str) -> Callable[[str], tuple[float, ...]]:
    def parse(text: str) -> tuple[float, ...]:
        from server.sweep import grid

        try:
            values: tuple[float, ...] = getattr(grid, parser)(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return values

    return parse


def _add_length(parser: argparse.ArgumentParser, *, default: str = "the figure's own") -> None:
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--epochs", type=_whole("epochs", 1, MOST_STEPS), metavar="N",
        help="length of each run, for tasks with a training set",
    )  # fmt: skip
    length.add_argument(
        "--hours", type=_positive("hours"), metavar="H",
        help="length of each run in simulated hours, for tasks with a time step",
    )  # fmt: skip
    length.add_argument(
        "--steps", type=_whole("steps", 1, MOST_STEPS), metavar="N",
        help=f"length of each run in steps (default {default})",
    )  # fmt: skip


def _add_scheduler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="run it on the workers of a Dask scheduler, as tcp://HOST:PORT (default all cores)",
    )  # fmt: skip


def _add_bench(commands: Any) -> None:
    bench = commands.add_parser(
        "bench",
        help="measure how fast this machine runs networks",
        description="Measure how fast this machine runs networks: the NumPy reference, the "
        "compiled rule with one lane, with many, and on all cores; the pendulum in pymunk and "
        "compiled. They take turns, and the best turn of each counts.",
        allow_abbrev=False,
    )
    bench.add_argument(
        "--seconds", type=_positive("seconds"), default=20.0, metavar="S",
        help="how long to measure, in all (default %(default)g)",
    )  # fmt: skip
    bench.add_argument("--json", action="store_true", help="print the figures as one line of JSON")


def _add_recorded(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=_path, metavar="FILE", help="a recording (.rrd)")


def _add_own_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task", metavar="T",
        help="where a task of yours was recorded: its file again, as path.py:Name",
    )  # fmt: skip


def _add_own_rule(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rule", metavar="R",
        help="where a rule of yours was recorded: its file again, as path.py:Name",
    )  # fmt: skip


def _add_page(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on (default %(default)s: this machine only; with another the link "
        "holds a token)",
    )  # fmt: skip
    _add_access(parser)
    parser.add_argument(
        "--port", type=_whole("port", 0, 65535), metavar="N",
        help="port to listen on, 0 for any (default 8080, or the next free one)",
    )  # fmt: skip
    parser.add_argument(
        "--recordings", type=_path, default=Path("hebbviz-recordings"), metavar="FOLDER",
        help="folder for recordings that are begun on the page (default %(default)s)",
    )  # fmt: skip
    parser.add_argument("--no-browser", action="store_true", help="open no browser")


def _add_access(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--allow-host", type=_allowed_host, action="append", default=[], metavar="NAME[:PORT]",
        help="another name under which it is reached, by a proxy say; the link then holds a token",
    )  # fmt: skip
    parser.add_argument(
        "--token", action=argparse.BooleanOptionalAction,
        help="whether the link must hold a token (default only where other machines can reach it)",
    )  # fmt: skip


def _allowed_host(text: str) -> str:
    from server.entrance import allowed_name

    try:
        return str(allowed_name(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--record", type=_path, metavar="FILE",
        help="record into a new file (.rrd): for replay, view, inspect and export",
    )  # fmt: skip
    parser.add_argument(
        "--budget", type=_budget, metavar="SIZE",
        help="what recording may take in a minute, as 500kB or 1GB (default 40MB): every "
        "step is kept while that suffices, beyond it stretches of them at regular intervals",
    )  # fmt: skip
    parser.add_argument(
        "--detail", choices=("full", "light"),
        help="light: no single steps, only sums over all steps, keyframes and changes (default "
        "full)",
    )  # fmt: skip


def _budget(text: str) -> int:
    from server.recording.thinning import parse_budget

    try:
        return parse_budget(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _steps(text: str) -> tuple[int, int]:
    with contextlib.suppress(ValueError):
        first, end = map(whole, text.split(":"))
        if 0 <= first < end <= MOST_STEPS:
            return first, end
    raise argparse.ArgumentTypeError(
        f"steps must be FROM:TO with FROM before TO, such as 1000:2000, got {text!r}"
    )
