"""A run: a learner, the log of its changes, its history, and the way back.

Nothing here knows of threads or clocks. A moment is a keyframe and how much of the log came
before it; from a moment and the log, any later step can be made again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hebbviz.learner import Learner, TaskError
from hebbviz.moments import Block, Keyframe
from hebbviz.task import Task
from server.commands import Change, Choose, Logged, Reset
from server.history import Curve, History

MOST_UNDOS = 100

MakeTask = Callable[[str, str | None], Task]


@dataclass(frozen=True)
class Moment:
    """A keyframe, and how many changes of the log were made before it."""

    keyframe: Keyframe
    logged: int

    @property
    def step(self) -> int:
        return self.keyframe.step


@dataclass(frozen=True)
class UndoPoint:
    """All that a change may alter, and what the change was."""

    learner: Learner
    task_name: str
    moment: Moment
    log: list[Logged]
    history: History
    ghost: Curve | None
    words: str


class Run:
    """A learner with its log, history and undo; `task_name` is what the user called the task."""

    def __init__(self, learner: Learner, make_task: MakeTask, task_name: str | None = None) -> None:
        self.make_task = make_task
        self.learner = learner
        self.task_name = task_name or learner.task.name
        self.log: list[Logged] = []
        self.ghost: Curve | None = None
        self.history = _new_history(learner)
        self._undo: list[UndoPoint] = []

    def advance(self, steps: int) -> Block:
        """Run at most `steps` steps, no further than the edge of the history's window.

        Raises TaskError with the learner at the last good step.
        """
        steps = min(steps, self.history.until_edge(self.learner.step))
        try:
            return self.learner.advance(steps)
        finally:
            self.history.add(self.learner.tally())

    def change(self, change: Change, *, undoable: bool = True) -> None:
        """Make a change now and log it. Not undoable: it goes on with the change before it."""
        if undoable:
            self._remember(str(change))
        try:
            change.apply(self.learner)
        except Exception:
            if undoable:  # nothing has happened that could be undone
                self._undo.pop()
            raise
        self.log.append(Logged(self.learner.step, change))

    def reset(self, command: Reset) -> None:
        """The same task and network from step 0, with the β and γ that are set."""
        old = self.learner
        fresh = Learner(
            old.task, topology=old.topology, beta=old.beta, gamma=old.gamma,
            seed=old.seed if command.seed is None else command.seed, lanes=old.lanes,
            first_lane=old.first_lane,
        )  # fmt: skip
        fresh.freeze(old.frozen)
        self._remember("reset" if command.seed is None else f"new seed {command.seed}")
        ghost = self.history.curve(old.tally())
        self._begin(fresh, self.task_name, ghost if len(ghost.end) else self.ghost)

    def choose(self, command: Choose) -> None:
        """Another task, preset or network, with the preset's β and γ."""
        task = self.make_task(command.task, command.preset)
        fresh = Learner(task, hidden=command.hidden, seed=self.learner.seed)
        sizes = "" if command.hidden is None else f", hidden {','.join(map(str, command.hidden))}"
        self._remember(f"choosing {command.task}, {task.preset_name}{sizes}")
        self._begin(fresh, command.task, None)

    def undo(self) -> str | None:
        """Go back to the moment before the last change; says which, or None if there is none."""
        if not self._undo:
            return None
        point = self._undo.pop()
        self.learner, self.task_name = point.learner, point.task_name
        self.learner.restore(point.moment.keyframe)
        self.log, self.history, self.ghost = list(point.log), point.history.copy(), point.ghost
        return point.words

    def moment(self) -> Moment:
        return Moment(self.learner.keyframe(), len(self.log))

    def replay(self, moment: Moment) -> Replay:
        """Make the run again from a moment of it."""
        return Replay(self, moment)

    @property
    def undo_words(self) -> str | None:
        return self._undo[-1].words if self._undo else None

    def _remember(self, words: str) -> None:
        self._undo.append(
            UndoPoint(
                self.learner, self.task_name, self.moment(), list(self.log), self.history.copy(),
                self.ghost, words,
            )
        )  # fmt: skip
        del self._undo[:-MOST_UNDOS]

    def _begin(self, learner: Learner, task_name: str, ghost: Curve | None) -> None:
        self.learner, self.task_name, self.ghost = learner, task_name, ghost
        self.log, self.history = [], _new_history(learner)


class Replay:
    """A second learner that makes a stretch of a run again, changes included."""

    def __init__(self, run: Run, moment: Moment) -> None:
        self._of, self._log = run.learner, run.log
        self._next = moment.logged
        self.learner = run.learner.twin()
        self.learner.restore(moment.keyframe)

    def is_of(self, run: Run) -> bool:
        """Whether the run still is the one that is made again: no reset, no undo since."""
        return self._of is run.learner and self._log is run.log

    def advance(self, steps: int) -> Block:
        """Run at most `steps` steps, up to the next change, which is made first if it is due."""
        while self._next < len(self._log) and self._log[self._next].step <= self.learner.step:
            self._log[self._next].change.apply(self.learner)
            self._next += 1
        if self._next < len(self._log):
            steps = min(steps, self._log[self._next].step - self.learner.step)
        left = self._of.step - self.learner.step
        return self.learner.advance(max(0, min(steps, left)))


def _new_history(learner: Learner) -> History:
    task = learner.task
    window = round(10.0 / task.dt) if task.dt else 1000
    return History(1 if task.natural_speed is not None else window, learner.tally())


__all__ = ["MakeTask", "Moment", "Replay", "Run", "TaskError"]
