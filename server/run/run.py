"""A run: a learner, the log of its changes, its history, and the way back.

Nothing here knows threads or clocks. From a keyframe and the log, any later step can be recomputed.
Followers receive everything, and can limit the length of the run's chunks.
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
"""Limit of undo points in bytes, with the keyframes and histories of former runs; many lanes leave
room for fewer.
"""

Switch = tuple[str, bool]


class Follower:
    """An observer of a run, such as a recorder; every method is optional.

    Blocks, frames and edges are those of the watched lane; choosing another lane is a
    discontinuity.
    """

    def plan(self, run: Run) -> Plan:
        """The last step to run to, and whether the follower needs every step until there."""
        return Plan(run.learner.step + MOST_APART, keep=False, every=0)

    def block(self, run: Run, block: Block) -> None:
        """Called with the steps that were just made."""

    def frame(self, run: Run, frame: Frame) -> None:
        """Called with the run now, and the sums since the previous frame."""

    def edge(self, run: Run, total: Tally) -> None:
        """Called with the totals at the edge of a window of the history."""

    def change(self, run: Run, logged: Logged) -> None:
        """Called with a change that was just made."""

    def keyframe(self, run: Run, moment: Moment) -> None:
        """Called with a keyframe that was just stored."""

    def leap(self, run: Run, words: str) -> None:
        """Called before the run continues from another step, or as another run."""


class Stored(Protocol):
    """Stored steps of a run, besides its keyframes.

    `other_now` says how this program differs from the one that recorded the run.
    """

    other_now: str

    def frame(self, keyframe: Frame, step: int) -> Frame:
        """The frame of the last keyframe, updated with all that is known at `step`."""

    def recent(self, step: int, most: int) -> Block | None:
        """The steps up to `step` that are known without a gap."""


@dataclass(frozen=True)
class UndoPoint:
    """Everything that a change can alter, and the text of the change.

    The points of one run share its log; each refers to the entries before its keyframe.
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
    """A learner with its log, history and undo; `task_name` is the user's name for the task.

    `stored` is the data of a run that was read from a file.
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
        """Run at most `steps` steps, up to the edge of the history's window.

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
        """The learner's frame, which the followers receive too."""
        frame = self.learner.frame()
        for follower in self.followers:
            follower.frame(self, frame)
        return frame

    def keep(self) -> None:
        """Store a keyframe of the current step."""
        moment = self.moment()
        self.tape.add(moment)
        for follower in self.followers:
            follower.keyframe(self, moment)

    def change(self, change: Change, *, undoable: bool = True, goes_on: bool = False) -> None:
        """Make a change now and log it. If it is not undoable, undoing the previous change undoes
        it too. If it `goes_on` with the previous change, one undo reverts both.
        """
        undoable = undoable and not goes_on
        if undoable:
            self._remember(str(change))
        try:
            change.apply(self.learner)
        except Exception:
            if undoable:  # a failed change leaves nothing to undo
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
        """Restart the same task and network from step 0, with the current β, γ, rule and switches;
        `switch` sets one of the switches.
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
        """Switch to another task, preset or network, with the preset's β, γ and rule."""
        fresh = self.chosen(task, preset, hidden)
        _look_at_the_same(fresh, self.learner)
        sizes = "" if hidden is None else f", hidden {','.join(map(str, hidden))}"
        self._remember(f"choosing {task}, {fresh.task.preset_name}{sizes}")
        self._leap("another task or network was chosen")
        self._begin(fresh, task, None)

    def undo(self) -> str | None:
        """Go back to before the last change; returns its text, or None if there is none."""
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
        """Continue from the step of a replay of this run, and drop later steps; can be undone."""
        moment = replay.moment()
        self._remember(f"taking over at step {moment.step:,}")
        self._leap(f"the run continues from step {moment.step:,}")
        self.learner.restore(moment.keyframe)
        self.log = self.log[: moment.logged]
        self.history, self.tape = self.history.until(moment.step), self.tape.until(moment.step)
        self.stored = None

    def look_at(self, lane: int) -> None:
        """Show another lane; the run itself does not change. Raises ValueError if it does not
        exist.
        """
        learner = self.learner
        check_lane(lane, learner.lanes)
        if lane != learner.watch:
            self.frame()  # the sums so far belong to the previous lane
            self._leap(f"lane {lane} was selected")
            learner.look_at(lane)

    def moment(self) -> Moment:
        return Moment(self.learner.keyframe(), len(self.log))

    @property
    def moment_size(self) -> int:
        """Approximate size of a keyframe in bytes."""
        return self.learner.nbytes

    def replay(self, moment: Moment, until: Moment | None = None) -> Replay:
        """Recompute the run from a keyframe, without the changes after `until`."""
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
        """Continue with another learner of the same settings; can be undone. Without a tape its
        past cannot be recomputed.
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
        """Whether there are too many undo points, or they and the data that they keep of former
        runs are too large; the current keyframe store does not count.
        """
        tapes = {id(p.tape): p.tape.size for p in self._undo if p.tape is not self.tape}
        histories = {id(p.log): p.history.size for p in self._undo if p.log is not self.log}
        moments = sum(p.moment.size for p in self._undo)
        size = moments + sum(tapes.values()) + sum(histories.values())
        return len(self._undo) > MOST_UNDOS or size > MOST_UNDO_BYTES

    def chosen(self, name: str, preset: str | None, hidden: tuple[int, ...] | None) -> Learner:
        """The learner that a choice starts with: it keeps the number of lanes, but another task
        starts with one lane, or as many as its rule needs.
        """
        task = self.make_task(name, preset)
        least = make_rule(task.preset.rule).least_lanes
        lanes = max(least, self.learner.lanes if name == self.task_name else 1)
        return Learner(task, hidden=hidden, seed=self.learner.seed, lanes=lanes)

    def made_again(self, switch: Switch | None = None) -> Task:
        """A new object of the task, optionally with one of its switches set."""
        task = self.learner.task
        setting = task.preset_name if switch is None else task.switched(*switch)
        return self.make_task(self.task_name, setting)

    def restarted(
        self, task: Task, *, seed: int | None = None, lanes: int | None = None
    ) -> Learner:
        """The learner that a reset starts with."""
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
    """A second learner that recomputes a part of a run, changes included."""

    def __init__(self, run: Run, moment: Moment, until: Moment | None = None) -> None:
        self._of, self._log = run.learner, run.log
        self._next, self._until = moment.logged, until
        self.learner = run.learner.twin()
        self.learner.restore(moment.keyframe)

    def is_of(self, run: Run) -> bool:
        """Whether the run is still the one being recomputed: no reset or undo since."""
        return self._of is run.learner and self._log is run.log

    def advance(self, steps: int, *, closely: bool = False) -> Block:
        """Run at most `steps` steps, up to the next change; a change that is due is made first."""
        return self.learner.advance(self._until_change(steps), closely=closely)

    def go_to(self, step: int) -> None:
        """Skip forward to a step, or to the end of the run if that comes first."""
        while (steps := self._until_change(step - self.learner.step)) > 0:
            self.learner.skip(steps)

    def moment(self) -> Moment:
        """A keyframe of the current step."""
        return Moment(self.learner.keyframe(), self._next)

    def _until_change(self, steps: int) -> int:
        """Make the changes that are due; returns the number of `steps` until the next change."""
        log, made = self._log, len(self._log) if self._until is None else self._until.logged
        while self._next < made and log[self._next].step <= self.learner.step:
            log[self._next].change.apply(self.learner)
            self._next += 1
        if self._next < made:
            steps = min(steps, log[self._next].step - self.learner.step)
        return max(0, min(steps, self._of.step - self.learner.step))


def reset_words(seed: int | None, lanes: int | None, switch: Switch | None) -> str:
    """The text for a reset."""
    if switch is not None:
        name, on = switch
        return f"{name} {'on' if on else 'off'}"
    if lanes is not None:
        return f"{lanes} lane{'s' * (lanes != 1)}"
    return "reset" if seed is None else f"new seed {seed}"


def _new_history(learner: Learner) -> History:
    task = learner.task
    window, speed = usual_window(task), task.natural_speed
    if speed is not None:  # each step of a task that starts slowly, otherwise a tenth of a second
        window = min(window, max(1, round(speed / 10.0)))
    return History(window, Totals.of(learner))


def _look_at_the_same(learner: Learner, before: Learner) -> None:
    """Show the lane that was watched before, if it exists."""
    if before.watch < learner.lanes:
        learner.look_at(before.watch)


def _new_tape(learner: Learner, logged: int = 0) -> Tape:
    """A keyframe store with the learner's first keyframe, bounded in memory."""
    return Tape([Moment(learner.keyframe(), logged)], most_bytes=MOST_BYTES)
