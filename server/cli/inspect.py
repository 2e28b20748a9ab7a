"""`hebbviz inspect`: summarize a recording."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import json
from typing import Any

from hebbviz.server.cli.arguments import add_own_rule, add_recorded
from hebbviz.sims.program.interrupts import raising
from hebbviz.sims.program.learner_from_arguments import asked_rule
from hebbviz.sims.program.terminal import FINE, prints_aside, say, user_can_mend


def add(commands: Any) -> None:
    inspect = commands.add_parser(
        "inspect",
        help="summarize a recording",
        description="Summarize a recording: task, seed, length, changes, keyframes, final "
        "figures, and whether it is complete.",
    )
    add_recorded(inspect)
    add_own_rule(inspect)
    inspect.add_argument(
        "--json", action="store_true", help="print the summary as one line of JSON"
    )
    inspect.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Summarize a recording."""
    from hebbviz.server.recording.inspect import describe, figures
    from hebbviz.server.recording.reader import open_recording

    with raising(), user_can_mend(args), prints_aside():
        asked_rule(args)
        recording = open_recording(args.file)
    found = figures(recording)
    say(json.dumps(found, allow_nan=False) if args.json else describe(found))
    return FINE
