"""Shared by the commands that run experiments."""

# ruff: noqa: PLC0415  # heavy modules are imported when they are needed: --help must be quick

from __future__ import annotations

import argparse
import json
import signal
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hebbviz.sims.program.terminal import (
    FAILED,
    FINE,
    WorkersFailed,
    fail,
    leave,
    prints_aside,
    say,
    tell,
    user_can_mend,
)

if TYPE_CHECKING:
    import threading

GRACE_SECONDS = 1.5
"""How long an interrupted experiment may take to keep its results."""


def run_experiment(
    args: argparse.Namespace, work: Callable[[threading.Event], dict[str, Any] | None]
) -> int:
    """Do long work and print its result; `work` returns None if it was stopped."""
    from hebbviz.sims.program.interrupts import Interrupts

    kept = f"the same command continues from the results in {args.out}"
    with Interrupts() as interrupts:
        try:
            with user_can_mend(args), prints_aside():
                made = interrupts.prepare(lambda: work(interrupts.stop), grace=GRACE_SECONDS)
        except WorkersFailed as error:
            return fail(FAILED, f"{error}; {kept}")
        except KeyboardInterrupt:
            tell(f"stopped at once; {kept}")  # the last few seconds of work are lost
            leave(128 + (interrupts.number or signal.SIGINT))
    if made is None:
        tell(f"stopped; {kept}")
        return 128 + (interrupts.number or signal.SIGINT)
    say(json.dumps(made, allow_nan=False))
    return FINE
