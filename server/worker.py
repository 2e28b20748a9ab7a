"""The one thread that touches the learner: it takes commands and gives pictures.

Commands come through an inbox and act within a few hundredths of a second, whatever the speed.
About 30 times a second it publishes a Picture; whoever draws takes the latest and may skip.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Sequence

from hebbviz.learner import TaskError
from hebbviz.moments import Frame
from hebbviz.rules import make_rule
from server.commands import (
    MAX,
    REALTIME,
    BackToNow,
    Change,
    Choose,
    Command,
    EndFork,
    Evaluate,
    Event,
    Freeze,
    GiveReward,
    Looking,
    NextLane,
    Pause,
    Press,
    Probe,
    Reset,
    Seek,
    SeekEvent,
    SetBeta,
    SetFall,
    SetGamma,
    SetLoop,
    SetRule,
    SetSpeed,
    SetWatch,
    SetWatchSpeed,
    ShowBeginning,
    ShowReward,
    Speed,
    StartFork,
    StartRecording,
    StepOnce,
    StopRecording,
    TakeOver,
    Undo,
    WatchLane,
)
from server.estimate import Estimating
from server.evaluation import Evaluator, evaluates_by_itself
from server.fork import Difference, Fork
from server.history import Totals
from server.inbox import Inbox
from server.picture import Other, Past, Picture
from server.player import Player
from server.preparing import prepare
from server.recording.recordings import Options, Recordings
from server.run import Run
from server.stuck import StuckLanes
from server.tape import Pace
from server.tempo import Tempo
from server.trail import Trail
from server.watch import Watch

PICTURES_PER_SECOND = 32.0
"""A little over 30, so that 30 that differ reach the page."""
NOTHING_TO_PLAY = (
    "the latest reward is played of a run that is shown live and alone: go back to now, or end the "
    "fork"
)
SAME_GESTURE_SECONDS = 0.7
"""Changes of one kind closer together than this are one for undo: a slider being dragged."""


class Worker(threading.Thread):
    """Steps a run, takes commands with `send`, gives the latest Picture with `wait_for`."""

    def __init__(
        self,
        run: Run,
        *,
        on_notice: Callable[[str], None],
        recordings: Recordings | None = None,
        in_the_past: bool = False,
    ) -> None:
        super().__init__(name="hebbviz worker", daemon=True)
        self._run = run
        self._notice = on_notice
        self._recordings = recordings or Recordings(run, Options(), on_notice=on_notice)
        self._player: Player | None = None
        self._fork: Fork | None = None
        self._tempo, self._pace = Tempo(run.learner.task.dt), Pace()
        self._inbox = Inbox(lambda command: prepare(command, run))
        self._fresh = threading.Condition()
        self._picture: Picture | None = None
        self._stopping = threading.Event()
        self._watch = Watch()
        self._evaluator = Evaluator(run.make_task, on_notice)
        self._stuck = StuckLanes()
        self._estimating = Estimating()
        run.followers.append(self._estimating)
        self._probes: tuple[int, ...] = ()
        self._excerpt_trail, self._live_trail = Trail(), Trail()
        self._last_change: tuple[type[object], float] = (object, 0.0)
        self._number = self._run_number = 0
        self._error: str | None = None
        self._settle_speed()
        if in_the_past:
            self._player = Player(run)
            self._player.seek(0)
            self._set_speed(REALTIME if run.learner.task.dt else self._watch.speed)

    def send(self, command: Command) -> None:
        """Ask for something; from any thread, never blocks."""
        self._inbox.put(command)

    def stop(self) -> None:
        self._stopping.set()
        self._inbox.wake()

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
                self._obey(wait=max(0.0, next_picture - now) if self._idle() else 0.0)
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
        if self._player is not None or self._inbox.preparation is not None:
            return True
        return not self._tempo.is_due()

    def _go_on(self, seconds: float) -> None:
        """Run for a stretch, so long after the stretch before."""
        rests = self._player is not None or self._inbox.preparation is not None
        steps = 0 if rests else self._tempo.next(seconds)
        if steps < 1:
            return
        began = time.monotonic()
        moment = self._run.moment()
        copied = time.monotonic() - began
        try:
            block = self._run.advance(steps)
        except TaskError as error:
            self._follow()
            self._stop_run(str(error))
            return
        self._follow()
        self._watch.note(moment, block)
        self._live_trail.note(block)
        computed = time.monotonic() - began
        self._tempo.made(len(block.fired), began, computed - copied, copied)
        passed = computed if self._tempo.rate is None else seconds
        if self._pace.is_due(computed, passed, moment.lane_size):
            self._run.keep()
            if self._fork is not None:
                self._fork.keep()

    def _follow(self) -> None:
        """Let the other copy of a fork make as many steps; where it cannot, the fork ends."""
        if self._fork is None:
            return
        try:
            self._fork.follow(self._run.learner.step)
        except TaskError as error:
            self._notice(f"the fork has ended, as in the other copy {error}")
            self._fork = None

    def _stop_run(self, error: str) -> None:
        """Pause with an error to be shown; the run is at its last good step."""
        self._error = error
        self._tempo.pause(paused=True)
        self._notice(error)

    # Commands

    def _obey(self, wait: float) -> None:
        """Carry out what has come in; where nothing has, wait for it."""
        for command in self._inbox.take(wait):
            try:
                self._carry_out(command)
            except (ValueError, TaskError) as error:
                self._notice(str(error))

    def _carry_out(self, command: Command) -> None:
        match command:
            case SetBeta() | SetGamma() | SetFall() | SetRule() | Freeze() | GiveReward() | Press():
                self._change(command)
            case Pause() | StepOnce() | SetSpeed():
                self._steer(command)
            case Reset() | Choose() | Undo():
                self._go_elsewhere(command)
            case Seek() | SeekEvent() | SetLoop() | BackToNow() | TakeOver():
                self._travel(command)
            case StartFork(kind, value):
                self._begin_fork(Difference(kind, value))
            case EndFork(keep_other):
                self._end_fork(keep_other=keep_other)
            case StartRecording(name):
                self._recordings.start_named(name)
            case StopRecording():
                self._recordings.stop()
            case _:
                self._look(command)

    def _steer(self, command: Pause | StepOnce | SetSpeed) -> None:
        match command:
            case Pause(paused):
                self._pause(paused)
            case StepOnce(steps) if self._player is not None:
                self._player.step(steps)
            case StepOnce(steps):
                self._tempo.step(steps)
                self._error = None
            case SetSpeed(speed):
                self._set_speed(speed)

    def _go_elsewhere(self, command: Reset | Choose | Undo) -> None:
        match command:
            case Reset():
                self._run.reset(command)
                self._renew()
            case Choose():
                self._run.choose(command)
                self._renew()
                self._settle_speed()
            case Undo():
                self._undo()

    def _look(self, command: Looking) -> None:
        """What is shown of the run, and found out about it."""
        match command:
            case SetWatch(on):
                self._watch.on = on
                if not on:
                    self._watch.clear()
            case SetWatchSpeed(speed):
                self._watch.speed = speed
            case ShowReward() if self._player is not None or self._fork is not None:
                raise ValueError(NOTHING_TO_PLAY)
            case ShowReward():
                if not self._watch.show_reward(self._run):
                    self._notice("no reward has come yet")
            case ShowBeginning():
                self._watch.show_beginning(self._run)
            case Evaluate():
                self._evaluate()
            case WatchLane(lane):
                self._look_at(lane)
            case NextLane(by):
                self._look_at((self._run.learner.watch + by) % self._run.learner.lanes)
            case Probe(synapses):
                self._probes = synapses
                self._run.learner.probe(self._known(synapses))

    def _known(self, synapses: Sequence[int]) -> list[int]:
        """Those of them that the network has."""
        known = range(self._run.learner.topology.synapses)
        return [s for s in synapses if s in known]

    def _look_at(self, lane: int) -> None:
        """Show another lane: now, in excerpts, in the past, in both copies of a fork."""
        if lane == self._run.learner.watch:
            return
        self._run.look_at(lane)
        self._watch.look_at(lane)
        self._excerpt_trail.clear()
        self._live_trail.clear()
        if self._fork is not None:
            self._fork.look_at(lane)
        if self._player is not None:
            self._player.seek(self._player.cursor)

    def _change(self, change: Change) -> None:
        """Make a change in the run; in its past, by taking over there."""
        if isinstance(change, SetRule):
            self._recordings.check_rule(make_rule(change.rule))
        takes_over = self._player is not None
        if takes_over:
            self._take_over()
        now, kind = time.monotonic(), type(change)
        recent = now - self._last_change[1] < SAME_GESTURE_SECONDS
        drags = isinstance(change, (SetBeta, SetGamma)) and kind is self._last_change[0]
        self._last_change = (kind, now)
        self._run.change(change, undoable=not (takes_over or (drags and recent)))
        if self._fork is not None:
            self._fork.change(change)

    def _pause(self, paused: bool) -> None:
        if self._player is not None:
            if not paused and self._player.cursor >= self._player.last:
                self._player.seek(self._player.first)
            self._player.playing = not paused
            return
        self._tempo.pause(paused)
        self._error = None

    # The past, and other ways the run might have gone

    def _travel(self, command: Seek | SeekEvent | SetLoop | BackToNow | TakeOver) -> None:
        match command:
            case Seek(step):
                self._visit().seek(step)
            case SeekEvent(event):
                self._seek_event(event)
            case SetLoop(loop):
                self._visit().loop = loop
            case BackToNow():
                self._player = None
                self._live_trail.clear()
            case TakeOver():
                if self._player is None:
                    raise ValueError("the run is shown where it is: there is nothing to take over")
                self._take_over()

    def _visit(self) -> Player:
        """Show the past of the run, which rests meanwhile."""
        if self._player is None:
            if self._fork is not None:
                raise ValueError("end the fork first: two copies have two pasts")
            self._player = Player(self._run)
        return self._player

    def _seek_event(self, event: Event) -> None:
        player = self._visit()
        if event is Event.NEXT_REWARD:
            step = player.next_reward()
        else:
            step = player.next_change(1 if event is Event.NEXT_CHANGE else -1)
        if step is None:
            self._notice(f"{event.value} was not found from step {player.cursor:,}")
        else:
            player.seek(step)

    def _take_over(self) -> None:
        """The run goes on from what is shown of its past."""
        assert self._player is not None
        step = self._player.cursor
        self._run.take_over(self._player.replay)
        self._renew(keep_evaluations_to=step)
        self._tempo.paused = False

    def _begin_fork(self, difference: Difference) -> None:
        if self._player is not None:
            self._take_over()
        self._fork = Fork(self._run, difference)
        self._watch.clear()
        self._live_trail.clear()

    def _end_fork(self, *, keep_other: bool) -> None:
        if self._fork is None:
            raise ValueError("there is no fork to end")
        fork, self._fork = self._fork, None
        if keep_other:
            self._run.become(
                fork.learner, history=fork.history, log=fork.log, tape=fork.tape,
                words=f"keeping the copy with {fork.difference}",
            )  # fmt: skip
            self._renew()

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
        self._tempo.set_speed(speed)

    def _settle_speed(self) -> None:
        """The speed at which a task opens, and that of its excerpts."""
        task = self._run.learner.task
        self._tempo.set_speed(MAX if task.natural_speed is None else task.natural_speed)
        self._watch.on = task.natural_speed is None
        real_time = 1.0 / task.dt if task.dt else None
        self._watch.speed = task.watch_speed or real_time or self._watch.speed

    def _undo(self) -> None:
        words, learner = self._run.undo_words, self._run.learner
        if self._run.undo() is None:
            self._notice("there is nothing to undo")
            return
        self._notice(f"undone: {words}, back at step {self._run.learner.step:,}")
        now = self._run.learner
        self._renew(keep_evaluations_to=now.step if learner is now else -1)
        if (learner.task.name, learner.task.plain_preset) != (now.task.name, now.task.plain_preset):
            self._settle_speed()

    def _renew(self, *, keep_evaluations_to: int = -1) -> None:
        """After the run became another: forget what belonged to the one before."""
        self._player = self._fork = None
        self._run.learner.probe(self._known(self._probes))
        self._evaluator.forget(keep_evaluations_to)
        self._stuck.forget()
        self._watch.clear()
        self._excerpt_trail.clear()
        self._live_trail.clear()
        self._tempo.begin(self._run.learner.task.dt)
        self._error = None
        self._last_change = (object, 0.0)
        self._run_number += 1

    # Pictures

    def _publish(self, seconds: float) -> None:
        learner, preparation = self._run.learner, self._inbox.preparation
        live = self._run.frame()
        if live.since.steps:
            self._stuck.look(learner)
        moves = bool(live.since.steps) and evaluates_by_itself(learner)
        if moves and self._evaluator.is_rested():
            self._evaluate()
        self._live_trail.add(live)
        shown, trail = self._what_is_shown(live, seconds)
        curves = self._run.history.curves(Totals.of(learner))
        picture = Picture(
            number=self._number + 1,
            made_at=time.monotonic(),
            task=learner.task,
            task_name=self._run.task_name,
            seed=learner.seed,
            lane=learner.watch,
            beta=learner.beta,
            gamma=learner.gamma,
            frozen=learner.frozen,
            live=live,
            shown=shown,
            recent=trail.recent,
            shown_trail=trail.frames,
            live_trail=self._live_trail.frames,
            excerpt=self._watch.excerpt(),
            curve=curves.lane(learner.watch),
            curves=curves,
            ghost=self._run.ghost,
            stuck=self._stuck.lanes,
            changes=tuple(self._run.log[-200:]),
            paused=self._tempo.paused if self._player is None else not self._player.playing,
            speed=self._tempo.speed,
            steps_per_second=self._tempo.measured(time.monotonic()),
            watching=self._watch.on,
            watch_speed=self._watch.speed,
            undo_words=self._run.undo_words,
            evaluations=self._evaluator.results(),
            estimate=self._estimating.estimate,
            run_number=self._run_number,
            error=self._error,
            preparing=None if preparation is None else preparation.words(),
            first=self._run.tape.first,
            past=self._past(),
            other=self._other(),
            recording=self._recordings.status,
            records=self._recordings.is_on,
            folder=str(self._recordings.folder),
            stream_url=self._recordings.stream_url,
        )
        self._number += 1
        with self._fresh:
            self._picture = picture
            self._fresh.notify_all()

    def _what_is_shown(self, live: Frame, seconds: float) -> tuple[Frame, Trail]:
        """The past; or the excerpt's frame while one plays and the run is too fast to be seen;
        else `live`.
        """
        is_alone = self._player is None and self._fork is None
        plays = self._watch.in_slow_motion or (self._is_too_fast() and not self._tempo.paused)
        if is_alone and plays:
            played = self._watch.play(self._run, seconds, go_on=not self._tempo.paused)
            if played is not None:
                replay, block = played
                shown = replay.learner.frame()
                self._excerpt_trail.add(shown)
                if block is not None:
                    self._excerpt_trail.note(block)
                return shown, self._excerpt_trail
        self._watch.rest()
        if self._player is not None:
            return self._player.play(seconds, self._tempo.rate), self._player.trail
        return live, self._live_trail

    def _past(self) -> Past | None:
        player = self._player
        return None if player is None else Past(player.cursor, player.loop, player.check)

    def _other(self) -> Other | None:
        fork = self._fork
        if fork is None:
            return None
        return Other(str(fork.difference), fork.start, fork.frame(), fork.curve())

    def _is_too_fast(self) -> bool:
        rate = self._tempo.rate
        return rate is None or rate > 2 * self._watch.speed
