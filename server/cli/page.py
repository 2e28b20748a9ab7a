"""Shared by the commands that show a page."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from hebbviz.sims.program.terminal import FINE, leave, say, user_can_mend

if TYPE_CHECKING:
    from hebbviz.server.app import Site


def show_page(args: argparse.Namespace, prepare: Callable[[], Site]) -> int:
    """Show the page of a site until Ctrl-C or SIGTERM."""
    from hebbviz.sims.program.interrupts import Interrupts

    def prepare_aloud() -> Site:
        from hebbviz.server.app import COMPILING
        from hebbviz.sims.program.compiling import announced_compiling

        with announced_compiling(lambda: say(COMPILING)):
            return prepare()

    with Interrupts() as interrupts:
        try:
            with user_can_mend(args):
                site = interrupts.prepare(prepare_aloud)
        except KeyboardInterrupt:
            say("stopped before the page opened")
            leave(FINE)
        site.run(interrupts.stop, open_browser=not args.no_browser)
    if site.is_stuck:
        leave(FINE)
    return FINE
