"""`hebbviz sweep`: map β against γ."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hebbviz.limits import MOST_LANES
from hebbviz.server.cli.arguments import (
    EPILOG,
    INTERRUPTED,
    add_length,
    add_rule,
    add_scheduler,
    add_seed,
    add_task,
    path,
    whole_number,
)
from hebbviz.server.cli.experiment import run_experiment

if TYPE_CHECKING:
    import threading


def add(commands: Any) -> None:
    sweep = commands.add_parser(
        "sweep",
        help="map β against γ: how well each pair learns, as a heat map",
        description="Map β against γ: run each pair many times and show how well it did over "
        "the last fifth of the steps, as a heat map (PNG, SVG), a CSV, and one line of JSON. A "
        "learner of each point is saved, together with the command that opens it in the page. "
        "Ctrl-C ends the sweep early; the same command then continues, and so does one "
        "with other values.",
        epilog=f"{INTERRUPTED} {EPILOG}",
    )
    sweep.add_argument(
        "--out",
        type=path,
        default=Path("sweep"),
        metavar="FOLDER",
        help="folder to write into (default %(default)s)",
    )
    add_task(sweep)
    sweep.add_argument(
        "--beta",
        type=values("parse_betas"),
        metavar="LIST",
        help="values of β, as 0.5,0.9,0.99 or as a range 0.5:0.99:5, evenly in the logarithm of "
        "1/(1−β) (default the preset's)",
    )
    sweep.add_argument(
        "--gamma",
        type=values("parse_gammas"),
        metavar="LIST",
        help="values of γ, as 1e-3,1e-2 or as a range 1e-4:1e-1:7, evenly in its logarithm "
        "(default the preset's)",
    )
    add_rule(sweep)
    sweep.add_argument(
        "--lanes",
        type=whole_number("lanes", 1, MOST_LANES),
        default=16,
        metavar="N",
        help="independent runs of each pair (default %(default)s)",
    )
    add_length(sweep, default="1,000,000 steps")
    add_seed(sweep)
    add_scheduler(sweep)
    sweep.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Map β against γ."""

    def work(stop: threading.Event) -> dict[str, Any] | None:
        from hebbviz.sims.sweep.grid import Sweep
        from hebbviz.sims.sweep.run_sweep import make

        return make(Sweep.of(args), args.out, stop, scheduler=args.scheduler)

    return run_experiment(args, work)


def values(parser: str) -> Callable[[str], tuple[float, ...]]:
    def parse(text: str) -> tuple[float, ...]:
        from hebbviz.sims.sweep import grid

        try:
            values: tuple[float, ...] = getattr(grid, parser)(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return values

    return parse
