"""The one thread that touches the learner: it takes commands and gives pictures.

Commands come through a queue. A stretch of steps is cut so short that a command acts within
a few hundredths of a second, whatever the speed. About 30 times a second it publishes a Picture;
whoever draws takes the latest and may skip.
"""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hebbviz.learner import TaskError
from hebbviz.moments import Block, Frame
from hebbviz.task import Task
from server.commands import (
    MAX,
    REALTIME,
    Choose,
    Command,
    Evaluate,
    Freeze,
    GiveReward,
    Logged,
    Pause,
    Press,
    Probe,
    Reset,
    SetBeta,
    SetGamma,
    SetSpeed,
    SetWatch,
    SetWatchSpeed,
    ShowBeginning,
    ShowReward,
    Speed,
    StepOnce,
    Undo,
)
from server.evaluation import Evaluation, Evaluator, evaluates_by_itself
from server.history import Curve
from server.run import Run
from server.trail import Trail
from server.watch import Excerpt, Watch

PICTURES_PER_SECOND = 32.0
"""A little over 30, so that 30 that differ reach the page."""
STRETCH_SECONDS = 0.012
"""Aim for one uninterrupted stretch of steps; a command waits at most about twice this."""
LONGEST_STRETCH = 200_000
MOST_OWED_SECONDS = 0.25
"""A run that cannot keep up with its speed does not save up more than this."""
SLOW_STRETCHES = 5
"""Stretches over which the speed is measured where a second has fewer."""
SAME_GESTURE_SECONDS = 0.7
"""Changes of one kind closer together than this are one for undo: a slider being dragged."""


@dataclass(frozen=True)
class Picture:
    """All that a view may show. `shown` is the excerpt's frame while one plays, else `live`.

    `recent` holds every one of the latest steps up to `shown`, as far as they follow on one
    another; `shown_trail` and `live_trail` the latest frames, likewise, so that a view that skips
    pictures misses nothing. `made_at` is time.monotonic().
    """

    number: int
    made_at: float
    task: Task
    task_name: str
    seed: int
    beta: float
    gamma: float
    frozen: bool
    live: Frame
    shown: Frame
    recent: Block | None
    shown_trail: tuple[Frame, ...]
    live_trail: tuple[Frame, ...]
    excerpt: Excerpt | None
    curve: Curve
    ghost: Curve | None
    changes: Sequence[Logged]
    paused: bool
    speed: Speed
    steps_per_second: float
    watching: bool
    watch_speed: float
    undo_words: str | None
    evaluations: tuple[Evaluation, ...]
    run_number: int
    error: str | None


class Worker(threading.Thread):
    """Steps a run, takes commands with `send`, gives the latest Picture with `wait_for`."""

    def __init__(self, run: Run, *, on_notice: Callable[[str], None]) -> None:
        super().__init__(name="hebbviz worker", daemon=True)
        self._run = run
        self._notice = on_notice
        self._commands: queue.SimpleQueue[Command | None] = queue.SimpleQueue()
        self._fresh = threading.Condition()
        self._picture: Picture | None = None
        self._stopping = threading.Event()
        self._watch = Watch()
        self._evaluator = Evaluator(run.make_task, on_notice)
        self._paused = False
        self._speed: Speed = MAX
        self._owed = 0.0
        self._single_steps = 0
        self._stretch = 16
        self._steps_made: list[tuple[float, int]] = []
        self._excerpt_trail, self._live_trail = Trail(), Trail()
        self._last_change: tuple[type[object], float] = (object, 0.0)
        self._number = self._run_number = 0
        self._error: str | None = None
        self._settle_speed()

    def send(self, command: Command) -> None:
        """Ask for something; from any thread, never blocks."""
        self._commands.put(command)

    def stop(self) -> None:
        self._stopping.set()
        self._commands.put(None)

    @property
    def latest(self) -> Picture | None:
        return self._picture

    def wait_for(self, number: int, timeout: float) -> Picture | None:
        """The latest picture once its number is above `number`, or None after the timeout."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newer(number), timeout)
            return self._picture if self._newer(number) else None

    def _newer(self, number: int) -> bool:
        return self._picture is not None and self._picture.number > number

    # The loop

    def run(self) -> None:
        before = next_picture = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            try:
                self._take_commands(wait=max(0.0, next_picture - now) if self._idle() else 0.0)
                now = time.monotonic()
                self._go_on(now - before)
                before = now
                if time.monotonic() >= next_picture:
                    self._publish(1.0 / PICTURES_PER_SECOND)
                    next_picture = max(next_picture, time.monotonic() - 0.1)
                    next_picture += 1.0 / PICTURES_PER_SECOND
            except Exception as error:  # the page must say what stopped the run
                said = f"{type(error).__name__}: {error}"
                if said != self._error:
                    traceback.print_exc()
                    self._stop_run(said)
                self._stopping.wait(0.2)  # what fails on and on must not take the machine

    def _idle(self) -> bool:
        """Whether nothing is to be stepped before the next picture."""
        return self._single_steps == 0 and (self._paused or self._steps_owed() < 1)

    def _take_commands(self, wait: float) -> None:
        try:
            command = self._commands.get(timeout=wait) if wait else self._commands.get_nowait()
            while command is not None:
                self._obey(command)
                command = self._commands.get_nowait()
        except queue.Empty:
            pass

    def _go_on(self, seconds: float) -> None:
        """Run for a stretch: as many steps as are owed, or as fit into STRETCH_SECONDS."""
        if not self._paused:
            rate = self._rate()
            if rate is not None:
                self._owed = min(self._owed + rate * seconds, max(1.0, rate * MOST_OWED_SECONDS))
        steps = min(self._stretch, self._single_steps or self._steps_owed())
        if steps < 1 or (self._paused and not self._single_steps):
            return
        began = time.monotonic()
        moment = self._run.moment()
        try:
            block = self._run.advance(steps)
        except TaskError as error:
            self._stop_run(str(error))
            return
        done = len(block.fired)
        self._watch.note(moment, block)
        self._live_trail.note(block)
        self._owed = max(0.0, self._owed - done)
        self._single_steps = max(0, self._single_steps - done)
        self._steps_made.append((began, done))
        self._adapt(time.monotonic() - began, done)

    def _steps_owed(self) -> int:
        return LONGEST_STRETCH if self._rate() is None else int(self._owed)

    def _rate(self) -> float | None:
        """Steps per second that are asked for, or None for as fast as it goes."""
        if self._speed == MAX:
            return None
        if self._speed == REALTIME:
            dt = self._run.learner.task.dt
            return 1.0 / dt if dt else None
        return float(self._speed)

    def _adapt(self, seconds: float, steps: int) -> None:
        if steps == self._stretch and seconds < STRETCH_SECONDS / 2:
            self._stretch = min(2 * self._stretch, LONGEST_STRETCH)
        elif seconds > STRETCH_SECONDS and steps > 1:
            self._stretch = max(1, steps // 2)

    def _stop_run(self, error: str) -> None:
        """Pause with an error to be shown; the run is at its last good step."""
        self._error = error
        self._paused, self._single_steps = True, 0
        self._notice(error)

    # Commands

    def _obey(self, command: Command) -> None:
        try:
            self._carry_out(command)
        except (ValueError, TaskError) as error:
            self._notice(str(error))

    def _carry_out(self, command: Command) -> None:
        match command:
            case SetBeta() | SetGamma() | Freeze() | GiveReward() | Press():
                now, kind = time.monotonic(), type(command)
                recent = now - self._last_change[1] < SAME_GESTURE_SECONDS
                drags = isinstance(command, (SetBeta, SetGamma)) and kind is self._last_change[0]
                self._last_change = (kind, now)
                self._run.change(command, undoable=not (drags and recent))
            case Pause(paused):
                self._paused, self._single_steps = paused, 0
                self._owed, self._error, self._steps_made = 0.0, None, []
            case StepOnce(steps):
                self._paused, self._error = True, None
                self._single_steps += steps
            case SetSpeed(speed):
                self._set_speed(speed)
            case Reset():
                self._run.reset(command)
                self._renew()
            case Choose():
                self._run.choose(command)
                self._renew()
                self._settle_speed()
            case Undo():
                self._undo()
            case SetWatch(on):
                self._watch.on = on
                if not on:
                    self._watch.clear()
            case SetWatchSpeed(speed):
                self._watch.speed = speed
            case ShowReward():
                if not self._watch.show_reward(self._run):
                    self._notice("no reward has come yet")
            case ShowBeginning():
                self._watch.show_beginning(self._run)
            case Evaluate():
                self._evaluate()
            case Probe(synapses):
                known = range(self._run.learner.topology.synapses)
                self._run.learner.probe([s for s in synapses if s in known])

    def _evaluate(self) -> None:
        if not self._evaluator.is_free():
            raise ValueError("a frozen copy is being evaluated: its figures come in a moment")
        self._evaluator.start(self._run.learner, self._run.task_name)

    def _set_speed(self, speed: Speed) -> None:
        if speed == REALTIME and self._run.learner.task.dt is None:
            raise ValueError(
                f"task {self._run.learner.task.name!r} has no time but its steps: "
                "choose max or steps per second"
            )
        self._speed, self._owed, self._steps_made = speed, 0.0, []

    def _settle_speed(self) -> None:
        """The speed at which a task opens, and that of its excerpts."""
        task = self._run.learner.task
        self._speed = MAX if task.natural_speed is None else task.natural_speed
        self._watch.on = task.natural_speed is None
        real_time = 1.0 / task.dt if task.dt else None
        self._watch.speed = task.watch_speed or real_time or self._watch.speed

    def _undo(self) -> None:
        words, learner = self._run.undo_words, self._run.learner
        if self._run.undo() is None:
            self._notice("there is nothing to undo")
            return
        self._notice(f"undone: {words}, back at step {self._run.learner.step:,}")
        same = learner is self._run.learner
        self._renew(keep_evaluations_to=self._run.learner.step if same else -1)
        if learner.task is not self._run.learner.task:
            self._settle_speed()

    def _renew(self, *, keep_evaluations_to: int = -1) -> None:
        """After the run became another: forget what belonged to the one before."""
        self._evaluator.forget(keep_evaluations_to)
        self._watch.clear()
        self._excerpt_trail.clear()
        self._live_trail.clear()
        self._owed, self._single_steps, self._error = 0.0, 0, None
        self._stretch = 16
        self._last_change = (object, 0.0)
        self._steps_made = []
        self._run_number += 1

    # Pictures

    def _publish(self, seconds: float) -> None:
        learner = self._run.learner
        live = learner.frame()
        moves = bool(live.since.steps) and evaluates_by_itself(learner)
        if moves and self._evaluator.is_free():
            self._evaluate()
        self._live_trail.add(live)
        shown, trail = self._what_is_shown(live, seconds)
        picture = Picture(
            number=self._number + 1,
            made_at=time.monotonic(),
            task=learner.task,
            task_name=self._run.task_name,
            seed=learner.seed,
            beta=learner.beta,
            gamma=learner.gamma,
            frozen=learner.frozen,
            live=live,
            shown=shown,
            recent=trail.recent,
            shown_trail=trail.frames,
            live_trail=self._live_trail.frames,
            excerpt=self._watch.excerpt(),
            curve=self._run.history.curve(live.tally),
            ghost=self._run.ghost,
            changes=tuple(self._run.log[-200:]),
            paused=self._paused,
            speed=self._speed,
            steps_per_second=self._measured_speed(),
            watching=self._watch.on,
            watch_speed=self._watch.speed,
            undo_words=self._run.undo_words,
            evaluations=self._evaluator.results(),
            run_number=self._run_number,
            error=self._error,
        )
        self._number += 1
        with self._fresh:
            self._picture = picture
            self._fresh.notify_all()

    def _what_is_shown(self, live: Frame, seconds: float) -> tuple[Frame, Trail]:
        """The excerpt's frame while one plays and the run is too fast to be seen, else `live`."""
        if self._watch.in_slow_motion or (self._is_too_fast() and not self._paused):
            played = self._watch.play(self._run, seconds, go_on=not self._paused)
            if played is not None:
                replay, block = played
                shown = replay.learner.frame()
                self._excerpt_trail.add(shown)
                if block is not None:
                    self._excerpt_trail.note(block)
                return shown, self._excerpt_trail
        self._watch.rest()
        return live, self._live_trail

    def _is_too_fast(self) -> bool:
        rate = self._rate()
        return rate is None or rate > 2 * self._watch.speed

    def _measured_speed(self) -> float:
        """Steps per second over the last second, or over the last stretches of a slow run."""
        now = time.monotonic()
        recent = [(t, n) for t, n in self._steps_made if now - t < 1.0]
        if len(recent) < SLOW_STRETCHES:
            recent = self._steps_made[-SLOW_STRETCHES:]
        self._steps_made = recent
        if self._paused or len(recent) < 2:
            return 0.0
        return sum(n for _, n in recent[:-1]) / (recent[-1][0] - recent[0][0])
