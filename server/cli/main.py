"""The command line: each command is a module of this package.

Exit codes: 0 success; 2 an error in what the user gave, explained in one line on stderr; 1 any
other failure; 130, 143 and 129 if Ctrl-C, SIGTERM or SIGHUP ended the command. A recording that
had to stop, for lack of disk space for example, is reported on stderr and does not change the code:
the run is complete. If stdout cannot be written, all work is done and saved as usual, and the code
is 1, except for commands that show a page.
"""

from __future__ import annotations

import argparse
import atexit
import io
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn

from hebbviz import __version__
from hebbviz.limits import CompilerOff
from hebbviz.server.cli import bench, export, figure, inspect, replay, serve, sweep, train, view
from hebbviz.server.cli.arguments import EPILOG, Parser, joined
from hebbviz.sims.program.output import spared
from hebbviz.sims.program.terminal import BAD_INPUT, FAILED, FINE, InputError, fail

COMMANDS = (serve, train, replay, view, inspect, export, figure, sweep, bench)


def program() -> NoReturn:
    """Run the process's command line, and end the process.

    Python's own clean-up takes half a second to free what the system frees anyway.
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
    """Run a command; returns its exit code, output errors aside."""
    try:
        args = parse(argv)
        code: int = args.run(args)
    except SystemExit as done:  # argparse, after --help and --version
        return int(done.code or 0)
    except (InputError, CompilerOff) as error:
        return fail(BAD_INPUT, str(error))
    except KeyboardInterrupt as stopped:  # a second Ctrl-C, or a `Stopped`
        number: int = getattr(stopped, "number", signal.SIGINT)
        return fail(128 + number, "stopped at once")
    except Exception as error:
        if os.environ.get("HEBBVIZ_TRACEBACK"):
            traceback.print_exc()
        what = f"{type(error).__name__}: {error}"
        return fail(FAILED, f"{what} (set HEBBVIZ_TRACEBACK=1 to see where)")
    return code


def parse(argv: list[str]) -> argparse.Namespace:
    """The command and its options; `command` is its name. Raises InputError."""
    return _parser().parse_args(joined(_with_command(argv)))


def shows_page(argv: list[str]) -> bool:
    """Whether the command shows a page."""
    return _with_command(argv)[0] in ("serve", "replay", "view")


def _with_command(argv: list[str]) -> list[str]:
    """The command line with the command named explicitly."""
    alone = {"-h", "--help", "--version"}
    is_named = bool(argv) and (not argv[0].startswith("-") or argv[0] in alone)
    return argv if is_named else ["serve", *argv]


def _parser() -> Parser:
    parser = Parser(
        prog="hebbviz",
        description="Watch a network of spiking neurons learn by itself. "
        "The default command is serve, with all of its options.",
        epilog=f"More: hebbviz COMMAND --help. {EPILOG}",
    )
    parser.add_argument("--version", action="version", version=f"hebbviz {__version__}")
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=Parser
    )
    for command in COMMANDS:
        command.add(commands)
    return parser
