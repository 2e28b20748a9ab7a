"""`hebbviz view`: open a recording in rerun's web viewer."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
from typing import Any

from hebbviz.server.cli.arguments import access_of, add_access, add_recorded, whole_number
from hebbviz.sims.program.terminal import FINE, say, tell, user_can_mend


def add(commands: Any) -> None:
    view = commands.add_parser(
        "view",
        help="open a recording in rerun's web viewer, from this machine alone",
        description="Open a recording in the web viewer that comes with rerun, served on "
        "127.0.0.1; nothing is sent to other machines.",
    )
    add_recorded(view)
    view.add_argument(
        "--port",
        type=whole_number("port", 0, 65535),
        default=0,
        metavar="N",
        help="port to listen on (default any)",
    )
    add_access(view)
    view.add_argument("--no-browser", action="store_true", help="do not open a browser")
    view.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Open a recording in rerun's web viewer."""
    from hebbviz.server.recording.viewer import Viewer
    from hebbviz.sims.program.interrupts import Interrupts

    with Interrupts() as interrupts:
        with user_can_mend(args):
            viewer = Viewer(args.file, port=args.port, access=access_of(args), on_turned_away=tell)
        if viewer.warning:
            say(viewer.warning)
        say(f"{args.file} is shown at {viewer.link} (stop it with Ctrl-C)")
        viewer.run(interrupts.stop, open_browser=not args.no_browser)
    return FINE
