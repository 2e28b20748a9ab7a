"""`hebbviz serve`: open the page and learn live."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
import math
from typing import TYPE_CHECKING, Any

from hebbviz.server.cli.arguments import (
    EPILOG,
    access_of,
    add_learner,
    add_page,
    add_recording,
    recording_options,
    whole_number,
)
from hebbviz.server.cli.page import show_page
from hebbviz.sims.program.learner_from_arguments import MOST_SHOWN_LANES, make_learner, task_name
from hebbviz.sims.program.typed_numbers import about_commas

if TYPE_CHECKING:
    from hebbviz.server.app import Site
    from hebbviz.server.live.pacing import Speed


def add(commands: Any) -> None:
    serve = commands.add_parser(
        "serve",
        help="open the page in the browser and learn live",
        description="Open the page in the browser and learn live, until Ctrl-C.",
        epilog=EPILOG,
    )
    add_learner(serve)
    serve.add_argument(
        "--speed",
        type=speed,
        metavar="S",
        help="steps per second, realtime (tasks with a time step) or max; can be changed on "
        "the page",
    )
    serve.add_argument(
        "--lanes",
        type=whole_number("lanes", 1, MOST_SHOWN_LANES),
        metavar="N",
        help="number of replicas that learn side by side; one is shown (default 1)",
    )
    add_page(serve)
    add_recording(serve)
    serve.add_argument(
        "--stream",
        nargs="?",
        type=whole_number("port", 0, 65535),
        const=9876,
        metavar="PORT",
        help="also stream the recording to rerun viewers on this machine (default port "
        "%(const)s, 0 for any)",
    )
    serve.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Open the page and learn live."""

    def prepare() -> Site:
        from hebbviz.server.app import Site, check_start

        learner = make_learner(args)
        check_start(learner.task, args.speed)
        return Site(
            learner,
            host=args.host,
            port=args.port,
            speed=args.speed,
            task_name=task_name(args, learner),
            recording=recording_options(args),
            access=access_of(args),
        )

    return show_page(args, prepare)


def speed(text: str) -> Speed:
    if text in ("realtime", "max"):
        return text
    with contextlib.suppress(ValueError):
        if math.isfinite(float(text)) and float(text) > 0.0:
            return float(text)
    raise argparse.ArgumentTypeError(
        f"speed must be steps per second above 0, realtime or max, got {text!r}{about_commas(text)}"
    )
