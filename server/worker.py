"""The one thread that touches the learner: it takes commands and gives pictures.

Commands come through an inbox and act within a few hundredths of a second, whatever the speed.
About 30 times a second it publishes a Picture; whoever draws takes the latest and may skip.
"""

from __future__ import annotations

import threading
import time
import traceback

from hebbviz.learner import TaskError
from server.changes import settled
from server.commands import Command, carry_out
from server.history import Totals
from server.inbox import Inbox
from server.inflow import TimeShare
from server.picture import Picture
from server.preparing import prepare
from server.session import Session

PICTURES_PER_SECOND = 32.0
"""A little over 30, so that 30 that differ reach the page."""

COMMANDS_SHARE, COMMANDS_SECONDS = 1 / 3, 1.0
"""Commands take this part of the time at most, and at first so long, while the run is to go on."""


class Worker(threading.Thread):
    """Steps a run, takes commands with `send`, gives the latest Picture with `wait_for`."""

    def __init__(self, session: Session) -> None:
        super().__init__(name="hebbviz worker", daemon=True)
        self._session = session
        self._inbox = Inbox(lambda command: prepare(command, session.run))
        self._fresh = threading.Condition()
        self._picture: Picture | None = None
        self._stopping = threading.Event()
        self._for_commands = TimeShare(COMMANDS_SHARE, COMMANDS_SECONDS)

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

    def run(self) -> None:
        before = next_picture = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            try:
                self._obey(wait=0.0 if self._is_due() else max(0.0, next_picture - now))
                now = time.monotonic()
                if self._inbox.preparation is None:
                    self._session.go_on(now - before)
                before = now
                if time.monotonic() >= next_picture:
                    self._publish()
                    next_picture = max(next_picture, time.monotonic() - 0.1)
                    next_picture += 1.0 / PICTURES_PER_SECOND
            except Exception as error:  # the page must say what stopped the run
                said = f"{type(error).__name__}: {error}"
                if said != self._session.error:
                    traceback.print_exc()
                    self._session.stop(said)
                self._stopping.wait(0.2)  # what fails on and on must not take the machine

    def _is_due(self) -> bool:
        """Whether there is something to be stepped before the next picture."""
        return self._inbox.preparation is None and self._session.is_due()

    def _obey(self, wait: float) -> None:
        """Carry out what has come in; where nothing has, wait for it.

        However many commands come, the run goes on for most of the time.
        """
        if self._is_due() and not self._for_commands.is_left(time.monotonic()):
            return
        self._inbox.wait(wait)
        began = time.monotonic()
        for command in self._inbox.take(0.0):
            self._carry_out(command)
            if not self._for_commands.is_left(time.monotonic(), spent=time.monotonic() - began):
                break
        self._for_commands.spend(time.monotonic() - began)
        if lost := self._inbox.count_lost():
            self._session.notice(f"commands came too fast: {lost} of them were lost")

    def _carry_out(self, command: Command) -> None:
        try:
            carry_out(command, self._session)
        except (ValueError, TaskError) as error:
            self._session.notice(str(error))

    def _publish(self) -> None:
        number = 1 if self._picture is None else self._picture.number + 1
        picture = self._take_picture(number, 1.0 / PICTURES_PER_SECOND)
        with self._fresh:
            self._picture = picture
            self._fresh.notify_all()

    def _take_picture(self, number: int, seconds: float) -> Picture:
        """All that may be shown now, so long after the picture before."""
        session, preparation = self._session, self._inbox.preparation
        run, tempo, showing = session.run, session.tempo, session.showing
        learner, live = run.learner, run.frame()
        session.find_out(live)
        shown, trail = showing.play(live, seconds, tempo)
        curves = run.history.curves(Totals.of(learner))
        return Picture(
            number=number,
            made_at=time.monotonic(),
            task=learner.task,
            task_name=run.task_name,
            seed=learner.seed,
            lane=learner.watch,
            beta=learner.beta,
            gamma=learner.gamma,
            frozen=learner.frozen,
            live=live,
            shown=shown,
            leaps=showing.seen.leaps,
            recent=trail.recent,
            shown_trail=trail.frames,
            live_trail=showing.live_trail.frames,
            excerpt=showing.watch.excerpt(),
            curve=curves.lane(learner.watch),
            curves=curves,
            ghost=run.ghost,
            stuck=session.stuck.lanes,
            changes=tuple(settled(run.log[-1000:])[-200:]),
            paused=tempo.paused if showing.player is None else not showing.player.playing,
            speed=tempo.speed,
            steps_per_second=tempo.measured(time.monotonic()),
            watching=showing.watch.on,
            watch_speed=showing.watch.speed,
            undo_words=run.undo_words,
            evaluations=session.evaluator.results(),
            evaluating=session.evaluator.progress,
            estimate=session.estimating.estimate,
            run_number=session.run_number,
            error=session.error,
            preparing=None if preparation is None else preparation.words(),
            first=run.tape.first,
            past=showing.past(),
            other=showing.other(),
            recording=session.recordings.status,
            records=session.recordings.is_on,
            folder=str(session.recordings.folder),
            stream_url=session.recordings.stream_url,
        )
