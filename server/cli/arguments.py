"""Options that several commands share, and the values that they take."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hebbviz.limits import MOST_STEPS
from hebbviz.sims.program.learner_from_arguments import DEFAULT_TASK
from hebbviz.sims.program.terminal import InputError
from hebbviz.sims.program.typed_numbers import about_commas, whole

if TYPE_CHECKING:
    from hebbviz.server.recording.recordings import Options
    from hebbviz.server.web.access import Access

EPILOG = "The rule, the presets and how to write a task of your own are in the README."
INTERRUPTED = "Exit code 130, 143 or 129 if Ctrl-C, SIGTERM or SIGHUP ended it."

_NUMERIC = (
    "--beta",
    "--gamma",
    "--fall",
    "--seed",
    "--speed",
    "--port",
    "--steps",
    "--stream",
    "--epochs",
    "--hours",
    "--lanes",
    "--seconds",
)


class Parser(argparse.ArgumentParser):
    """Takes options only by their whole names, and raises InputError in place of exiting."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Report unknown options as the command's own error, which names its help."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return found, unknown

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


def joined(argv: list[str]) -> list[str]:
    """`--gamma -1e-3` as `--gamma=-1e-3`: argparse would read the value as an option."""
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


def whole_number(name: str, least: int, most: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        with contextlib.suppress(ValueError):
            if least <= whole(text) <= most:
                return whole(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a whole number from {least} to {most}, got {text!r}"
            f"{about_commas(text)}"
        )

    return parse


def path(text: str) -> Path:
    if not text.strip():  # Path("") is the current folder
        raise argparse.ArgumentTypeError(f"a path must have a name, got {text!r}")
    return Path(text)


def number(name: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with contextlib.suppress(ValueError):
            if math.isfinite(float(text)):
                return float(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a finite number, got {text!r}{about_commas(text)}"
        )

    return parse


def positive(name: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        with contextlib.suppress(ValueError):
            if math.isfinite(float(text)) and float(text) > 0.0:
                return float(text)
        raise argparse.ArgumentTypeError(
            f"{name} must be a number above 0, got {text!r}{about_commas(text)}"
        )

    return parse


def step_size_fall(text: str) -> float:
    with contextlib.suppress(ValueError):
        return math.inf if text == "never" else float(text)
    raise argparse.ArgumentTypeError(
        f"fall must be a number of steps or never, got {text!r}{about_commas(text)}"
    )


def hidden_sizes(text: str) -> tuple[int, ...]:
    from hebbviz.topology import parse_hidden

    try:
        return parse_hidden(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def add_learner(parser: argparse.ArgumentParser) -> None:
    add_task(parser)
    add_values(parser)
    add_rule(parser)
    parser.add_argument(
        "--seed",
        type=whole_number("seed", 0, 2**32 - 1),
        metavar="N",
        help="random seed (default 0)",
    )
    parser.add_argument(
        "--load",
        type=path,
        metavar="FILE",
        help="continue a saved learner with its task and preset",
    )


def add_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task",
        metavar="T",
        help="pendulum, sonar, synapse, gradient, prediction, filtering, or your own as "
        f"path.py:Name (default {DEFAULT_TASK})",
    )
    parser.add_argument(
        "--preset",
        metavar="P",
        help="a configuration of the task (default its first); with a switch as best:centred=no",
    )
    add_hidden(parser)


def add_values(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--beta",
        type=number("beta"),
        metavar="β",
        help="how long traces last, in [0, 1) (default the preset's)",
    )
    parser.add_argument(
        "--gamma",
        type=number("gamma"),
        metavar="γ",
        help="step size, 0 or more (default the preset's)",
    )


def add_rule(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--rule",
        metavar="R",
        help="paper, baseline, yoked, or your own as path.py:Name; with parameters as "
        "baseline:time=1000 (default the preset's)",
    )
    parser.add_argument(
        "--fall",
        type=step_size_fall,
        metavar="STEPS",
        help="gamma falls over STEPS steps: at step t it is gamma STEPS/(STEPS + t); never: it is "
        "constant (default the preset's)",
    )


def add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--seed",
        type=whole_number("seed", 0, 2**32 - 1),
        default=0,
        metavar="N",
        help="random seed (default %(default)s)",
    )


def add_hidden(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--hidden",
        type=hidden_sizes,
        metavar="SIZES",
        help="hidden layers, as 16 or 8,8 or none (default the task's)",
    )


def add_length(parser: argparse.ArgumentParser, *, default: str = "the figure's own") -> None:
    length = parser.add_mutually_exclusive_group()
    length.add_argument(
        "--epochs",
        type=whole_number("epochs", 1, MOST_STEPS),
        metavar="N",
        help="length of each run, for tasks with a training set",
    )
    length.add_argument(
        "--hours",
        type=positive("hours"),
        metavar="H",
        help="length of each run in simulated hours, for tasks with a time step",
    )
    length.add_argument(
        "--steps",
        type=whole_number("steps", 1, MOST_STEPS),
        metavar="N",
        help=f"length of each run in steps (default {default})",
    )


def add_scheduler(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run it on the workers of a Dask scheduler, as tcp://HOST:PORT (default all cores)",
    )


def add_recorded(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=path, metavar="FILE", help="a recording (.rrd)")


def add_own_task(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--task",
        metavar="T",
        help="the task, if the recording used one of your own, as path.py:Name",
    )


def add_own_rule(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rule",
        metavar="R",
        help="the rule, if the recording used one of your own, as path.py:Name",
    )


def add_page(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address to listen on (default %(default)s: this machine only; any other makes the "
        "link contain a token)",
    )
    add_access(parser)
    parser.add_argument(
        "--port",
        type=whole_number("port", 0, 65535),
        metavar="N",
        help="port to listen on, 0 for any (default 8080, or the next free one)",
    )
    parser.add_argument(
        "--recordings",
        type=path,
        default=Path("hebbviz-recordings"),
        metavar="FOLDER",
        help="folder for recordings started on the page (default %(default)s)",
    )
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")


def add_access(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--allow-host",
        type=allowed_host,
        action="append",
        default=[],
        metavar="NAME[:PORT]",
        help="another name that reaches the page, such as a proxy's; the link then has a token",
    )
    parser.add_argument(
        "--token",
        action=argparse.BooleanOptionalAction,
        help="require a token in the link (default only if other machines can reach the page)",
    )


def allowed_host(text: str) -> str:
    from hebbviz.server.web.access import allowed_name

    try:
        return str(allowed_name(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def access_of(args: argparse.Namespace) -> Access:
    from hebbviz.server.web.access import Access

    return Access(tuple(args.allow_host), args.token)


def add_recording(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--record",
        type=path,
        metavar="FILE",
        help="record into a new file (.rrd): for replay, view, inspect and export",
    )
    parser.add_argument(
        "--budget",
        type=budget,
        metavar="SIZE",
        help="size limit of a recording per minute, as 500kB or 1GB (default 40MB): every step is "
        "kept within this limit, and stretches at regular intervals beyond it",
    )
    parser.add_argument(
        "--detail",
        choices=("full", "light"),
        help="light: no single steps, only sums over all steps, keyframes and changes (default "
        "full)",
    )


def budget(text: str) -> int:
    from hebbviz.server.run.thinning import parse_budget

    try:
        return parse_budget(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def recording_options(args: argparse.Namespace) -> Options:
    from hebbviz.server.recording.recordings import Options

    given = {name: getattr(args, name) for name in ("budget", "detail") if getattr(args, name)}
    return Options(
        file=args.record,
        stream=getattr(args, "stream", None),
        folder=getattr(args, "recordings", Options.folder),
        **given,
    )
