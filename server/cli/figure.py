"""`hebbviz figure`: make one of the paper's figures."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from hebbviz.limits import MOST_LANES
from hebbviz.server.cli.arguments import (
    EPILOG,
    INTERRUPTED,
    add_hidden,
    add_length,
    add_rule,
    add_scheduler,
    add_seed,
    add_values,
    path,
    whole_number,
)
from hebbviz.server.cli.experiment import run_experiment

if TYPE_CHECKING:
    import threading


def add(commands: Any) -> None:
    from hebbviz.sims.figures.request import KINDS

    figure = commands.add_parser(
        "figure",
        help="make one of the paper's figures: PNG, SVG and the CSV behind them",
        description="Make one of the paper's figures from new runs: PNG, SVG and the CSV "
        "behind them, and the results as one line of JSON. Ctrl-C ends it early; the same "
        "command then continues.",
        epilog=f"{INTERRUPTED} {EPILOG}",
    )
    figure.add_argument(
        "name",
        choices=KINDS,
        metavar="NAME",
        help="; ".join(f"{name}: {kind.shows}" for name, kind in KINDS.items()),
    )
    figure.add_argument(
        "--out", type=path, required=True, metavar="FOLDER", help="folder to write into"
    )
    figure.add_argument(
        "--preset",
        metavar="P",
        help="a configuration (default the figure's own); with a switch as best:centred=no",
    )
    figure.add_argument(
        "--lanes",
        type=whole_number("lanes", 1, MOST_LANES),
        metavar="N",
        help="independent runs (default the figure's own)",
    )
    add_length(figure)
    add_seed(figure)
    figure.add_argument(
        "--quick",
        action="store_true",
        help="a small version to try it out: less than a minute, once compiled",
    )
    add_scheduler(figure)
    learning = figure.add_argument_group("options of figure learning")
    learning.add_argument("--task", metavar="T", help="a task by name, or your own as path.py:Name")
    add_hidden(learning)
    add_values(learning)
    add_rule(learning)
    figure.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Make one of the paper's figures."""

    def work(stop: threading.Event) -> dict[str, Any] | None:
        from hebbviz.sims.figures.request import Order
        from hebbviz.sims.figures.run_figure import make

        return make(Order.of(args), stop)

    return run_experiment(args, work)
