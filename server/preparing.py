"""What a choice needs is compiled beside the page, which goes on and says so."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

from hebbviz.learner import Learner
from server.commands import Choose
from server.train import announced_compiling, warm_up

SHORT_SECONDS = 0.25
"""What is compiled already is ready before this; it is waited for."""


class Preparation(threading.Thread):
    """Has all compiled that a chosen task and network need, with a learner as the choice makes."""

    def __init__(self, command: Choose, chosen: Callable[[Choose], Learner]) -> None:
        super().__init__(name="hebbviz compiler", daemon=True)
        self.command, self._chosen = command, chosen
        self._began, self._compiles = time.monotonic(), False

    def run(self) -> None:
        # what is wrong is said once the choice itself fails by it
        with contextlib.suppress(Exception), announced_compiling(self._note):
            warm_up(self._chosen(self.command))

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
