"""What a choice needs is compiled beside the page, which goes on and says so."""

from __future__ import annotations

import contextlib
import threading
import time

from hebbviz.learner import Learner
from hebbviz.rules import make_rule
from server.commands import Choose
from server.run import MakeTask
from server.train import announced_compiling, warm_up

SHORT_SECONDS = 0.25
"""What is compiled already is ready before this; it is waited for."""


class Preparation(threading.Thread):
    """Has all compiled that a chosen task and network need, with a learner of its own."""

    def __init__(self, command: Choose, make_task: MakeTask) -> None:
        super().__init__(name="hebbviz compiler", daemon=True)
        self.command, self._make_task = command, make_task
        self._began, self._compiles = time.monotonic(), False

    def run(self) -> None:
        # what is wrong is said once the choice itself fails by it
        with contextlib.suppress(Exception), announced_compiling(self._note):
            task = self._make_task(self.command.task, self.command.preset)
            lanes = make_rule(task.preset.rule).least_lanes
            warm_up(Learner(task, hidden=self.command.hidden, lanes=lanes))

    def is_ready(self) -> bool:
        """Whether it is, or is within a short time."""
        self.join(SHORT_SECONDS)
        return not self.is_alive()

    def words(self) -> str:
        what = "Compiling" if self._compiles else "Preparing"
        first = ", only this first time" if self._compiles else ""
        seconds = time.monotonic() - self._began
        return (
            f"{what} task {self.command.task} for this machine{first}: {seconds:.0f} s so far. The "
            "run rests, and what you ask for is done after that"
        )

    def _note(self) -> None:
        self._compiles = True
