"""An interactive run: a session steps it at its speed, shows it, and carries out commands.

There is one session for all tabs. It knows no queue and no thread: its owner steps it and passes it
the commands one by one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from hebbviz.learner.frames import Frame
from hebbviz.learner.learner import TaskError
from hebbviz.rules.base import make_rule
from hebbviz.server.live.evaluation import Evaluator, evaluates_by_itself
from hebbviz.server.live.fork import Difference, Fork
from hebbviz.server.live.gradient_estimate import Estimating
from hebbviz.server.live.pacing import MAX, REALTIME, Speed, Tempo
from hebbviz.server.live.saturation import StuckLanes
from hebbviz.server.live.view_mode import Showing
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.run.changes import Change, SetBeta, SetGamma, SetRule
from hebbviz.server.run.keyframes import Pace
from hebbviz.server.run.run import Run
from hebbviz.server.web.rate_limits import Allowance

SAME_GESTURE_SECONDS = 2.0
"""Changes of one kind closer together than this count as one: a slider being dragged, with possible
pauses. (A page does not report the release.)
"""

RECORDINGS_A_MINUTE = 6


class Session:
    """A run, its pacing, its view mode and its findings.

    `error` says what stopped it; `run_number` counts the runs so far.
    """

    def __init__(
        self,
        run: Run,
        *,
        on_notice: Callable[[str], None],
        recordings: Recordings | None = None,
        in_the_past: bool = False,
    ) -> None:
        self.run, self.notice = run, on_notice
        self.recordings = recordings or Recordings(run, Options(), on_notice=on_notice)
        self.tempo, self._pace = Tempo(run.learner.task.dt), Pace()
        self.showing = Showing(run, on_notice)
        self.evaluator = Evaluator(run.make_task, on_notice)
        self.stuck = StuckLanes()
        self.estimating = Estimating()
        run.followers.append(self.estimating)
        self.error: str | None = None
        self.run_number = 0
        self._last_change: tuple[type[object], float] = (object, 0.0)
        self._begins_recordings = Allowance(RECORDINGS_A_MINUTE, 60.0)
        self._settle_speed()
        if in_the_past:
            self.showing.visit().seek(0)
            self.set_speed(REALTIME if run.learner.task.dt else self.showing.watch.speed)

    # Stepping

    def is_due(self) -> bool:
        """Whether there are steps to make."""
        return self.showing.player is None and self.tempo.is_due()

    def go_on(self, seconds: float) -> None:
        """Run a chunk of steps, `seconds` after the previous chunk."""
        steps = 0 if self.showing.player is not None else self.tempo.next(seconds)
        if steps < 1:
            return
        began = time.monotonic()
        moment = self.run.moment()
        copied = time.monotonic() - began
        try:
            block = self.run.advance(steps)
        except TaskError as error:
            self._follow()
            self.stop(str(error))
            return
        self._follow()
        self.showing.note(moment, block)
        computed = time.monotonic() - began
        self.tempo.made(len(block.fired), began, computed - copied, copied)
        passed = computed if self.tempo.rate is None else seconds
        if self._pace.is_due(computed, passed, moment.lane_size):
            self.run.keep()
            if self.showing.fork is not None:
                self.showing.fork.keep()

    def _follow(self) -> None:
        """Advance the other copy of a fork by the same steps; if that fails, the fork ends."""
        if self.showing.fork is None:
            return
        try:
            self.showing.fork.follow(self.run.learner.step)
        except TaskError as error:
            self.notice(f"the fork has ended: in the other copy, {error}")
            self.showing.fork = None

    def stop(self, error: str) -> None:
        """Pause and show an error; the run is at its last good step."""
        self.error = error
        self.tempo.pause(paused=True)
        self.notice(error)

    def find_out(self, live: Frame) -> None:
        """Update the findings after a frame of the run."""
        learner = self.run.learner
        if live.since.steps:
            self.stuck.look(learner)
            if evaluates_by_itself(learner) and self.evaluator.is_rested():
                self.evaluate()

    # Commands

    def change(self, change: Change) -> None:
        """Make a change in the run; in its past, by taking over there."""
        if isinstance(change, SetRule):
            self.recordings.check_rule(make_rule(change.rule))
        takes_over = self.showing.player is not None
        if takes_over:
            self.take_over()
        now, kind = time.monotonic(), type(change)
        recent = now - self._last_change[1] < SAME_GESTURE_SECONDS
        drags = isinstance(change, (SetBeta, SetGamma)) and kind is self._last_change[0] and recent
        self._last_change = (kind, now)
        self.run.change(change, undoable=not takes_over, goes_on=drags and not takes_over)
        if self.showing.fork is not None:
            self.showing.fork.change(change)

    def pause(self, paused: bool) -> None:
        """Pause or run what is shown: the run, or its past."""
        if self.showing.player is not None:
            self.showing.player.pause(paused)
        else:
            self.tempo.pause(paused)
            self.error = None

    def step(self, steps: int) -> None:
        """Make this many steps of the run or its past, then pause."""
        if self.showing.player is not None:
            self.showing.player.step(steps)
        else:
            self.tempo.step(steps)
            self.error = None

    def set_speed(self, speed: Speed) -> None:
        """Set the speed; raises ValueError for 'realtime' if the task has no time step."""
        task = self.run.learner.task
        if speed == REALTIME and task.dt is None:
            raise ValueError(f"task {task.name!r} has no time step: choose max or steps per second")
        self.tempo.set_speed(speed)

    def _settle_speed(self) -> None:
        """Set the initial speed of a task and of its excerpts."""
        task, watch = self.run.learner.task, self.showing.watch
        self.tempo.set_speed(MAX if task.natural_speed is None else task.natural_speed)
        watch.on = task.natural_speed is None
        real_time = 1.0 / task.dt if task.dt else None
        watch.speed = task.watch_speed or real_time or watch.speed

    def reset(
        self, *, seed: int | None, lanes: int | None, switch: tuple[str, bool] | None
    ) -> None:
        """Start again, as `Run.reset` does."""
        self.run.reset(seed=seed, lanes=lanes, switch=switch)
        self._renew()

    def choose(self, task: str, preset: str | None, hidden: tuple[int, ...] | None) -> None:
        """Run another task, preset or network."""
        self.run.choose(task, preset, hidden)
        self._renew()
        self._settle_speed()

    def undo(self) -> None:
        """Go back to before the last change, if there is one."""
        words, learner = self.run.undo_words, self.run.learner
        if self.run.undo() is None:
            self.notice("there is nothing to undo")
            return
        now = self.run.learner
        self.notice(f"undone: {words}, back at step {now.step:,}")
        self._renew(keep_evaluations_to=now.step if learner is now else -1)
        if (learner.task.name, learner.task.plain_preset) != (now.task.name, now.task.plain_preset):
            self._settle_speed()

    def take_over(self) -> None:
        """Continue the run from the past step that is shown."""
        player = self.showing.player
        if player is None:
            raise ValueError("the run already shows its present: there is nothing to take over")
        step = player.cursor
        self.run.take_over(player.replay)
        self._renew(keep_evaluations_to=step)
        self.tempo.pause(paused=False)

    def begin_fork(self, difference: Difference) -> None:
        """Continue from the step that is shown in two copies."""
        if self.showing.player is not None:
            self.take_over()
        self.showing.fork = Fork(self.run, difference)
        self.showing.forget()

    def end_fork(self, *, keep_other: bool) -> None:
        """Keep one of the two copies."""
        fork, self.showing.fork = self.showing.fork, None
        if fork is None:
            raise ValueError("there is no fork to end")
        if keep_other:
            self.run.become(
                fork.learner,
                history=fork.history,
                log=fork.log,
                tape=fork.tape,
                words=f"keeping the copy with {fork.difference}",
            )
            self._renew()

    def start_recording(self, name: str) -> None:
        """Start a recording; their rate is limited, because each takes a file and threads."""
        wait = self._begins_recordings.wait(time.monotonic())
        if wait:
            most = f"at most {RECORDINGS_A_MINUTE} recordings can start in a minute"
            raise ValueError(f"{most}: try again in {math.ceil(wait)} s")
        self.recordings.start_named(name)

    def evaluate(self) -> None:
        """Evaluate a frozen copy while the run continues."""
        if not self.evaluator.is_free():
            raise ValueError("a frozen copy is being evaluated: wait for its figures")
        self.evaluator.start(self.run.learner, self.run.task_name)

    def _renew(self, *, keep_evaluations_to: int = -1) -> None:
        """After the run was replaced: forget the data of the previous one."""
        self.showing.begin()
        self.tempo.begin(self.run.learner.task.dt)
        self.evaluator.forget(keep_evaluations_to)
        self.stuck.forget()
        self.error = None
        self._last_change = (object, 0.0)
        self.run_number += 1
