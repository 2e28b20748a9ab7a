"""Compiles the code that a command needs, in the background, with a status text for the page."""

from __future__ import annotations

import contextlib
import threading
import time

from hebbviz.learner.learner import Learner
from hebbviz.server.live.commands import Choose, Command, Reset
from hebbviz.server.run.changes import SetRule
from hebbviz.server.run.run import Run
from hebbviz.sims.program.compiling import announced_compiling, warm_up

SHORT_SECONDS = 0.25
"""Code that is already compiled is ready within this time; the command waits for it."""


Demanding = Choose | Reset | SetRule
"""Commands that may need new compiled code: for a task, a rule or a width of lanes."""


class Preparation(threading.Thread):
    """Compiles the code that a command needs, with a learner like the one that it makes."""

    def __init__(self, command: Demanding, run: Run) -> None:
        super().__init__(name="hebbviz compiler", daemon=True)
        self.command, self._run = command, run
        self._began, self._compiles = time.monotonic(), False

    def run(self) -> None:
        # the command itself reports the error when it fails
        with contextlib.suppress(Exception), announced_compiling(self._note):
            warm_up(_foreseen(self.command, self._run))

    def is_ready(self) -> bool:
        """Whether it is ready, or is within a short time."""
        self.join(SHORT_SECONDS)
        return not self.is_alive()

    def words(self) -> str:
        what = "Compiling" if self._compiles else "Preparing"
        first = ", on this machine only this first time" if self._compiles else ""
        seconds = time.monotonic() - self._began
        return (
            f"{what} for {self.command}{first}: {seconds:.0f} s so far. The run is paused; "
            "commands are carried out afterwards"
        )

    def _note(self) -> None:
        self._compiles = True


def prepare(command: Command, run: Run) -> Preparation | None:
    """Start the preparation that a command needs; None if it can be carried out at once."""
    if not isinstance(command, Demanding) or _asks_nothing_new(command, run.learner):
        return None
    preparation = Preparation(command, run)
    preparation.start()
    return None if preparation.is_ready() else preparation


def _asks_nothing_new(command: Demanding, learner: Learner) -> bool:
    """Whether compiled code exists: for new parameters of the rule, or a reset."""
    if isinstance(command, SetRule):
        return command.rule.partition(":")[0] == learner.rule.name
    return isinstance(command, Reset) and command.lanes is None and command.switch is None


def _foreseen(command: Demanding, run: Run) -> Learner:
    """A learner at its start, like the run's after the command; it has its own task, so that
    another thread may step it.
    """
    match command:
        case Choose(task, preset, hidden):
            return run.chosen(task, preset, hidden)
        case Reset(seed, lanes, switch):
            return run.restarted(run.made_again(switch), seed=seed, lanes=lanes)
        case SetRule():
            twin = run.learner.twin(run.made_again())
            command.apply(twin)
            return twin
