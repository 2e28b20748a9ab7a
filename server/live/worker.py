"""The only thread that touches the learner: it takes commands and publishes snapshots.

Commands come through a queue and act within a few hundredths of a second, whatever the speed. About
30 times a second it publishes a snapshot; views take the latest and may skip some.
"""

from __future__ import annotations

import threading
import time
import traceback

from hebbviz.learner.frames import Frame
from hebbviz.learner.learner import TaskError
from hebbviz.server.live.command_queue import Inbox
from hebbviz.server.live.commands import Command, carry_out
from hebbviz.server.live.precompile import prepare
from hebbviz.server.live.session import Session
from hebbviz.server.live.snapshot import Findings, Pacing, RecordingState, RunState, Snapshot
from hebbviz.server.run.changes import settled
from hebbviz.server.run.history import Totals
from hebbviz.server.web.rate_limits import TimeShare

PICTURES_PER_SECOND = 32.0
"""Slightly over 30, so that 30 different snapshots reach the page."""

COMMANDS_SHARE, COMMANDS_SECONDS = 1 / 3, 1.0
"""Largest share of the time for commands, and a first allowance in seconds, while the run is due.
"""


class Worker(threading.Thread):
    """Steps a run, takes commands with `send`, returns the latest snapshot with `wait_for`."""

    def __init__(self, session: Session) -> None:
        super().__init__(name="hebbviz worker", daemon=True)
        self._session = session
        self._inbox = Inbox(lambda command: prepare(command, session.run))
        self._fresh = threading.Condition()
        self._snapshot: Snapshot | None = None
        self._stopping = threading.Event()
        self._for_commands = TimeShare(COMMANDS_SHARE, COMMANDS_SECONDS)

    def send(self, command: Command) -> None:
        """Send a command; from any thread, never blocks."""
        self._inbox.put(command)

    def stop(self) -> None:
        self._stopping.set()
        self._inbox.wake()

    @property
    def latest(self) -> Snapshot | None:
        return self._snapshot

    def wait_for(self, number: int, timeout: float) -> Snapshot | None:
        """The latest snapshot once its number is above `number`, or None after the timeout."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newer(number), timeout)
            return self._snapshot if self._newer(number) else None

    def _newer(self, number: int) -> bool:
        return self._snapshot is not None and self._snapshot.number > number

    def run(self) -> None:
        before = next_snapshot = time.monotonic()
        while not self._stopping.is_set():
            now = time.monotonic()
            try:
                self._obey(wait=0.0 if self._is_due() else max(0.0, next_snapshot - now))
                now = time.monotonic()
                if self._inbox.preparation is None:
                    self._session.go_on(now - before)
                before = now
                if time.monotonic() >= next_snapshot:
                    self._publish()
                    next_snapshot = max(next_snapshot, time.monotonic() - 0.1)
                    next_snapshot += 1.0 / PICTURES_PER_SECOND
            except Exception as error:  # the page must say what stopped the run
                said = f"{type(error).__name__}: {error}"
                if said != self._session.error:
                    traceback.print_exc()
                    self._session.stop(said)
                self._stopping.wait(0.2)  # repeated failures must not use up the CPU

    def _is_due(self) -> bool:
        """Whether steps are due before the next snapshot."""
        return self._inbox.preparation is None and self._session.is_due()

    def _obey(self, wait: float) -> None:
        """Carry out waiting commands, or wait for one.

        However many commands come, the run gets most of the time.
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
        number = 1 if self._snapshot is None else self._snapshot.number + 1
        snapshot = self._take_snapshot(number, 1.0 / PICTURES_PER_SECOND)
        with self._fresh:
            self._snapshot = snapshot
            self._fresh.notify_all()

    def _take_snapshot(self, number: int, seconds: float) -> Snapshot:
        """The current snapshot, `seconds` after the previous one."""
        session, preparation = self._session, self._inbox.preparation
        live = session.run.frame()
        session.find_out(live)
        return Snapshot(
            number=number,
            made_at=time.monotonic(),
            run=_run_state(session, live),
            view=session.showing.view(live, seconds, session.tempo),
            pacing=_pacing(session, None if preparation is None else preparation.words()),
            findings=_findings(session),
            recording=_recording(session),
        )


def _run_state(session: Session, live: Frame) -> RunState:
    run, learner = session.run, session.run.learner
    curves = run.history.curves(Totals.of(learner))
    return RunState(
        number=session.run_number,
        task=learner.task,
        task_name=run.task_name,
        seed=learner.seed,
        lane=learner.watch,
        beta=learner.beta,
        gamma=learner.gamma,
        frozen=learner.frozen,
        live=live,
        curve=curves.lane(learner.watch),
        curves=curves,
        ghost=run.ghost,
        changes=tuple(settled(run.log[-1000:])[-200:]),
        undo_words=run.undo_words,
        first=run.tape.first,
    )


def _pacing(session: Session, preparing: str | None) -> Pacing:
    tempo, player = session.tempo, session.showing.player
    return Pacing(
        paused=tempo.paused if player is None else not player.playing,
        speed=tempo.speed,
        steps_per_second=tempo.measured(time.monotonic()),
        error=session.error,
        preparing=preparing,
    )


def _findings(session: Session) -> Findings:
    return Findings(
        evaluations=session.evaluator.results(),
        evaluating=session.evaluator.progress,
        estimate=session.estimating.estimate,
        stuck=session.stuck.lanes,
    )


def _recording(session: Session) -> RecordingState:
    recordings = session.recordings
    return RecordingState(
        status=recordings.status,
        is_on=recordings.is_on,
        folder=str(recordings.folder),
        stream_url=recordings.stream_url,
    )
