"""`hebbviz replay`: open the page with a recording."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from hebbviz.server.cli.arguments import (
    EPILOG,
    access_of,
    add_own_rule,
    add_own_task,
    add_page,
    add_recorded,
)
from hebbviz.server.cli.page import show_page
from hebbviz.sims.program.learner_from_arguments import asked_rule, maker, saved_task
from hebbviz.sims.program.terminal import tell

if TYPE_CHECKING:
    from hebbviz.server.app import Site


def add(commands: Any) -> None:
    replay = commands.add_parser(
        "replay",
        help="play a recording back in the page, and continue from any step of it",
        description="Play a recording back in the page: any of its steps, recomputed from its "
        "keyframes; continue the run from any step.",
        epilog=EPILOG,
    )
    add_recorded(replay)
    add_own_task(replay)
    add_own_rule(replay)
    add_page(replay)
    replay.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Open the page with a recording."""

    def prepare() -> Site:
        from hebbviz.server.app import Site
        from hebbviz.server.recording.reader import open_recording
        from hebbviz.server.recording.recordings import Options

        asked_rule(args)
        recording = open_recording(args.file)
        header = recording.header
        if recording.notice:
            tell(recording.notice)
        task = saved_task(args, args.file, header.task, header.preset)
        name = args.task or header.task
        past = recording.run(maker(task, name), task, name)
        return Site(
            past.learner,
            host=args.host,
            port=args.port,
            speed=None,
            task_name=name,
            recording=Options(folder=args.recordings),
            past=past,
            access=access_of(args),
        )

    return show_page(args, prepare)
