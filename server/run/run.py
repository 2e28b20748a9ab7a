"""A run: a learner, the log of its changes, its history, and the way back.

Nothing here knows of threads or clocks. From a moment on the tape and the log, any later step can
be made again. Followers are told everything, and may have the run's stretches cut to their taste.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from hebbviz.learner.frames import Block, Frame
from hebbviz.learner.learner import Learner
from hebbviz.limits import check_lane
from hebbviz.rules.base import make_rule
from hebbviz.server.run.changes import Change, Logged
from hebbviz.server.run.history import Curves, History, Totals, usual_window
from hebbviz.server.run.keyframes import MOST_BYTES, Moment, Tape
from hebbviz.server.run.thinning import MOST_APART, Plan
from hebbviz.sims.loading import MakeTask
from hebbviz.task.base import Tally, Task

MOST_UNDOS = 100
MOST_UNDO_BYTES = 256_000_000
"""Of the moments to go back to, and the tapes and histories of former runs; with many lanes there
are fewer.
"""

Switch = tuple[str, bool]


class Follower:
    """What is told of a run as it goes on, such as a recorder; each of these may be left out.

    Blocks, frames and edges are those of the watched lane; where another is chosen, that is a leap.
    """

    def plan(self, run: Run) -> Plan:
        """Until which step to run at most, and whether every step until there is to be told."""
        return Plan(run.learner.step + MOST_APART, keep=False, every=0)

    def block(self, run: Run, block: Block) -> None:
        """Steps that were just made."""

    def frame(self, run: Run, frame: Frame) -> None:
        """The run now, and the sums since the frame before."""

    def edge(self, run: Run, total: Tally) -> None:
        """The totals at the edge of a window of the history."""

    def change(self, run: Run, logged: Logged) -> None:
        """A change that was just made."""

    def keyframe(self, run: Run, moment: Moment) -> None:
        """A moment that was put on the tape."""

    def leap(self, run: Run, words: str) -> None:
        """The run is about to go on from another moment, or as another run."""


class Stored(Protocol):
    """What was stored of the steps of a run, besides its keyframes.

    `other_now` is what is another here than where it was recorded, in words.
    """

    other_now: str

    def frame(self, keyframe: Frame, step: int) -> Frame:
        """The frame of the last keyframe, with all that is known to have been otherwise."""

    def recent(self, step: int, most: int) -> Block | None:
        """The steps up to `step` that are known without a gap."""


@dataclass(frozen=True)
class UndoPoint:
    """All that a change may alter, and what the change was.

    The points of one run share its log, of which each means what was logged before its moment.
    """

    learner: Learner
    task_name: str
    moment: Moment
    log: list[Logged]
    history: History
    tape: Tape
    stored: Stored | None
    ghost: Curves | None
    words: str


class Run:
    """A learner with its log, history and undo; `task_name` is what the user called the task.

    `stored` is what a file holds of a run that was read from one.
    """

    stored: Stored | None = None

    def __init__(self, learner: Learner, make_task: MakeTask, task_name: str | None = None) -> None:
        self.make_task = make_task
        self.learner = learner
        self.task_name = task_name or learner.task.name
        self.log: list[Logged] = []
        self.ghost: Curves | None = None
        self.history = _new_history(learner)
        self.tape = _new_tape(learner)
        self.followers: list[Follower] = []
        self._undo: list[UndoPoint] = []

    def advance(self, steps: int) -> Block:
        """Run at most `steps` steps, no further than the edge of the history's window.

        Raises TaskError if the task fails, with the learner as `Learner.advance` leaves it.
        """
        step = self.learner.step
        plans = [f.plan(self) for f in self.followers]
        steps = min(steps, self.history.until_edge(step), *(p.until - step for p in plans))
        try:
            block = self.learner.advance(steps, closely=any(p.keep for p in plans))
        finally:
            self._note_edge()
        for follower in self.followers:
            follower.block(self, block)
        return block

    def frame(self) -> Frame:
        """The learner's frame, shown to the followers too."""
        frame = self.learner.frame()
        for follower in self.followers:
            follower.frame(self, frame)
        return frame

    def keep(self) -> None:
        """Put this moment on the tape."""
        moment = self.moment()
        self.tape.add(moment)
        for follower in self.followers:
            follower.keyframe(self, moment)

    def change(self, change: Change, *, undoable: bool = True, goes_on: bool = False) -> None:
        """Make a change now and log it. Not undoable: what was done before it is undone with it.
        One that `goes_on` with the change before it takes its place where that is undone.
        """
        undoable = undoable and not goes_on
        if undoable:
            self._remember(str(change))
        try:
            change.apply(self.learner)
        except Exception:
            if undoable:  # nothing has happened that could be undone
                self._undo.pop()
            raise
        self.log.append(Logged(self.learner.step, change, goes_on))
        if goes_on and self._undo:
            self._undo[-1] = replace(self._undo[-1], words=str(change))
        for follower in self.followers:
            follower.change(self, self.log[-1])

    def reset(
        self, *, seed: int | None = None, lanes: int | None = None, switch: Switch | None = None
    ) -> None:
        """The same task and network from step 0, with the β, γ and rule that are set, and the
        task's switches, of which one may be set here.
        """
        task = self.learner.task if switch is None else self.made_again(switch)
        fresh = self.restarted(task, seed=seed, lanes=lanes)
        _look_at_the_same(fresh, self.learner)
        self._remember(reset_words(seed, lanes, switch))
        ghost = self.history.curves(Totals.of(self.learner))
        self._leap("the run was reset")
        self._begin(fresh, self.task_name, ghost if len(ghost.edges) > 1 else self.ghost)

    def choose(
        self, task: str, preset: str | None = None, hidden: tuple[int, ...] | None = None
    ) -> None:
        """Another task, preset or network, with the preset's β, γ and rule."""
        fresh = self.chosen(task, preset, hidden)
        _look_at_the_same(fresh, self.learner)
        sizes = "" if hidden is None else f", hidden {','.join(map(str, hidden))}"
        self._remember(f"choosing {task}, {fresh.task.preset_name}{sizes}")
        self._leap("another task or network was chosen")
        self._begin(fresh, task, None)

    def undo(self) -> str | None:
        """Go back to the moment before the last change; says which, or None if there is none."""
        if not self._undo:
            return None
        point = self._undo.pop()
        self._leap(f"{point.words} was undone")
        _look_at_the_same(point.learner, self.learner)
        self.learner, self.task_name = point.learner, point.task_name
        self.learner.restore(point.moment.keyframe)
        self.log = point.log[: point.moment.logged]
        self._undo = [replace(p, log=self.log) if p.log is point.log else p for p in self._undo]
        self.history, self.ghost = point.history.copy(), point.ghost
        self.tape, self.stored = point.tape.until(point.moment.step), point.stored
        return point.words

    def take_over(self, replay: Replay) -> None:
        """Go on from where a replay of this run is, and forget what came after; can be undone."""
        moment = replay.moment()
        self._remember(f"taking over at step {moment.step:,}")
        self._leap(f"the run goes on from step {moment.step:,}")
        self.learner.restore(moment.keyframe)
        self.log = self.log[: moment.logged]
        self.history, self.tape = self.history.until(moment.step), self.tape.until(moment.step)
        self.stored = None

    def look_at(self, lane: int) -> None:
        """Show another lane; the run goes on as it is. Raises ValueError if there is none such."""
        learner = self.learner
        check_lane(lane, learner.lanes)
        if lane != learner.watch:
            self.frame()  # the sums so far are of the lane before
            self._leap(f"lane {lane} was chosen to be watched")
            learner.look_at(lane)

    def moment(self) -> Moment:
        return Moment(self.learner.keyframe(), len(self.log))

    @property
    def moment_size(self) -> int:
        """Bytes of a moment, about."""
        return self.learner.nbytes

    def replay(self, moment: Moment, until: Moment | None = None) -> Replay:
        """Make the run again from a moment of it, with no change that came after `until`."""
        return Replay(self, moment, until)

    def become(
        self,
        learner: Learner,
        *,
        history: History,
        log: list[Logged],
        tape: Tape | None,
        words: str,
    ) -> None:
        """Go on with another learner of the same making; can be undone. With no tape its past
        cannot be made again.
        """
        self._remember(words)
        self._leap(words)
        self.learner, self.history, self.log = learner, history, log
        self.tape = _new_tape(learner, len(log)) if tape is None else tape
        self.stored = None

    @property
    def undo_words(self) -> str | None:
        return self._undo[-1].words if self._undo else None

    def _remember(self, words: str) -> None:
        self._undo.append(
            UndoPoint(
                self.learner,
                self.task_name,
                self.moment(),
                self.log,
                self.history.copy(),
                self.tape,
                self.stored,
                self.ghost,
                words,
            )
        )
        while len(self._undo) > 1 and self._remembers_too_much():
            del self._undo[0]

    def _remembers_too_much(self) -> bool:
        """Whether there are too many points to go back to, or they with what they keep of former
        runs are too large; the tape that is being written is not theirs.
        """
        tapes = {id(p.tape): p.tape.size for p in self._undo if p.tape is not self.tape}
        histories = {id(p.log): p.history.size for p in self._undo if p.log is not self.log}
        moments = sum(p.moment.size for p in self._undo)
        size = moments + sum(tapes.values()) + sum(histories.values())
        return len(self._undo) > MOST_UNDOS or size > MOST_UNDO_BYTES

    def chosen(self, name: str, preset: str | None, hidden: tuple[int, ...] | None) -> Learner:
        """What a choice begins with: as many lanes as there are, but another task begins with one,
        or as many as its rule needs.
        """
        task = self.make_task(name, preset)
        least = make_rule(task.preset.rule).least_lanes
        lanes = max(least, self.learner.lanes if name == self.task_name else 1)
        return Learner(task, hidden=hidden, seed=self.learner.seed, lanes=lanes)

    def made_again(self, switch: Switch | None = None) -> Task:
        """Another object of the task, with one of its switches set if that is asked for."""
        task = self.learner.task
        setting = task.preset_name if switch is None else task.switched(*switch)
        return self.make_task(self.task_name, setting)

    def restarted(
        self, task: Task, *, seed: int | None = None, lanes: int | None = None
    ) -> Learner:
        """What a reset begins with."""
        old = self.learner
        settings = replace(
            old.settings,
            topology=old.topology.with_inputs(len(task.inputs)),
            seed=old.seed if seed is None else seed,
            lanes=old.lanes if lanes is None else lanes,
        )
        return Learner.of(task, settings)

    def _begin(self, learner: Learner, task_name: str, ghost: Curves | None) -> None:
        self.learner, self.task_name, self.ghost = learner, task_name, ghost
        self.log, self.history, self.tape = [], _new_history(learner), _new_tape(learner)
        self.stored = None

    def _note_edge(self) -> None:
        if self.history.add(Totals.of(self.learner)):
            for follower in self.followers:
                follower.edge(self, self.learner.tally())

    def _leap(self, words: str) -> None:
        for follower in self.followers:
            follower.leap(self, words)


class Replay:
    """A second learner that makes a stretch of a run again, changes included."""

    def __init__(self, run: Run, moment: Moment, until: Moment | None = None) -> None:
        self._of, self._log = run.learner, run.log
        self._next, self._until = moment.logged, until
        self.learner = run.learner.twin()
        self.learner.restore(moment.keyframe)

    def is_of(self, run: Run) -> bool:
        """Whether the run still is the one that is made again: no reset, no undo since."""
        return self._of is run.learner and self._log is run.log

    def advance(self, steps: int, *, closely: bool = False) -> Block:
        """Run at most `steps` steps, up to the next change, which is made first if it is due."""
        return self.learner.advance(self._until_change(steps), closely=closely)

    def go_to(self, step: int) -> None:
        """Skip to a step ahead, or to the end of the run if that is before it."""
        while (steps := self._until_change(step - self.learner.step)) > 0:
            self.learner.skip(steps)

    def moment(self) -> Moment:
        """Where it is now, as a moment of the run."""
        return Moment(self.learner.keyframe(), self._next)

    def _until_change(self, steps: int) -> int:
        """Make the changes that are due; how many of `steps` there are until the next one."""
        log, made = self._log, len(self._log) if self._until is None else self._until.logged
        while self._next < made and log[self._next].step <= self.learner.step:
            log[self._next].change.apply(self.learner)
            self._next += 1
        if self._next < made:
            steps = min(steps, log[self._next].step - self.learner.step)
        return max(0, min(steps, self._of.step - self.learner.step))


def reset_words(seed: int | None, lanes: int | None, switch: Switch | None) -> str:
    """What a reset is called."""
    if switch is not None:
        name, on = switch
        return f"{name} {'on' if on else 'off'}"
    if lanes is not None:
        return f"{lanes} lane{'s' * (lanes != 1)}"
    return "reset" if seed is None else f"new seed {seed}"


def _new_history(learner: Learner) -> History:
    task = learner.task
    window, speed = usual_window(task), task.natural_speed
    if speed is not None:  # each step of a task that opens slowly, else a tenth of a second
        window = min(window, max(1, round(speed / 10.0)))
    return History(window, Totals.of(learner))


def _look_at_the_same(learner: Learner, before: Learner) -> None:
    """Show the lane that was watched before, if there is such a one."""
    if before.watch < learner.lanes:
        learner.look_at(before.watch)


def _new_tape(learner: Learner, logged: int = 0) -> Tape:
    """A tape with the learner's first moment, bounded in memory."""
    return Tape([Moment(learner.keyframe(), logged)], most_bytes=MOST_BYTES)
