"""`hebbviz bench`: measure how fast this machine runs networks."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import json
import signal
from typing import TYPE_CHECKING, Any

from hebbviz.server.cli.arguments import positive
from hebbviz.sims.program.terminal import FINE, leave, say, tell

if TYPE_CHECKING:
    from hebbviz.server.cli.speeds import Speed


def add(commands: Any) -> None:
    bench = commands.add_parser(
        "bench",
        help="measure how fast this machine runs networks",
        description="Measure how fast this machine runs networks: the NumPy reference, the "
        "compiled rule with one lane, with many, and on all cores; the pendulum in pymunk and "
        "compiled. They take turns, and the best turn of each counts.",
    )
    bench.add_argument(
        "--seconds",
        type=positive("seconds"),
        default=20.0,
        metavar="S",
        help="how long to measure, in all (default %(default)g)",
    )
    bench.add_argument("--json", action="store_true", help="print the figures as one line of JSON")
    bench.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure speeds."""
    from hebbviz.server.cli.speeds import contestants, figures, race, table
    from hebbviz.sims.program.compiling import announced_compiling
    from hebbviz.sims.program.interrupts import Interrupts

    def work() -> dict[str, Speed]:
        with announced_compiling(lambda: tell("compiling for this machine, only this first time")):
            return race(contestants(), args.seconds)

    with Interrupts() as interrupts:
        try:
            speeds = interrupts.prepare(work)
        except KeyboardInterrupt:
            tell("stopped; nothing was measured")
            leave(128 + (interrupts.number or signal.SIGINT))
    say(json.dumps(figures(speeds), allow_nan=False) if args.json else table(speeds))
    return FINE
