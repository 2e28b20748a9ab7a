"""`hebbviz export`: write a recording's timelines as npz and CSV."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import contextlib
from typing import Any

from hebbviz.limits import MOST_STEPS
from hebbviz.server.cli.arguments import add_own_rule, add_own_task, add_recorded, path
from hebbviz.sims.program.interrupts import raising
from hebbviz.sims.program.learner_from_arguments import asked_rule, saved_task
from hebbviz.sims.program.terminal import FINE, prints_aside, say, tell, user_can_mend
from hebbviz.sims.program.typed_numbers import whole


def add(commands: Any) -> None:
    export = commands.add_parser(
        "export",
        help="write a recording's timelines as npz and CSV",
        description="Write a recording's timelines as npz and CSV.",
    )
    add_recorded(export)
    add_own_task(export)
    add_own_rule(export)
    export.add_argument(
        "--out", type=path, required=True, metavar="FOLDER", help="folder to write into"
    )
    export.add_argument(
        "--every-step",
        type=step_range,
        metavar="FROM:TO",
        help="recompute these steps and write everything: inputs, spikes, w, z, β, γ, the world",
    )
    export.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write a recording's timelines as npz and CSV."""
    from hebbviz.server.recording.export import export_steps, export_timelines
    from hebbviz.server.recording.reader import open_recording

    with raising(), user_can_mend(args), prints_aside():
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


def step_range(text: str) -> tuple[int, int]:
    with contextlib.suppress(ValueError):
        first, end = map(whole, text.split(":"))
        if 0 <= first < end <= MOST_STEPS:
            return first, end
    raise argparse.ArgumentTypeError(
        f"steps must be FROM:TO with FROM before TO, such as 1000:2000, got {text!r}"
    )
