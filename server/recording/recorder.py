"""Follows a run and records it: a segment for each part without a discontinuity."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from copy import copy
from dataclasses import replace

from hebbviz.learner.frames import Block, Frame
from hebbviz.server.recording.header import TASK, Header, check_recordable, machine, versions
from hebbviz.server.recording.segment import BEGIN_SECONDS, CLOSE_SECONDS, Take
from hebbviz.server.recording.status import Status
from hebbviz.server.recording.targets import Target
from hebbviz.server.run import thinning
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.history import usual_window
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Follower, Run
from hebbviz.server.run.thinning import Plan
from hebbviz.sims.program.terminal import reason
from hebbviz.task.base import Tally


class Recorder(Follower):
    """Records a run to a target, from now on.

    `budget` is in bytes a minute, see `thinning`; `on_notice` is called when it has to stop; it
    then never starts again. With several lanes it records the watched one as an independent run.
    Raises OSError if the target cannot be opened, ValueError under a rule that lets lanes touch;
    later it raises nothing, so that the run always continues.
    """

    def __init__(
        self,
        target: Target,
        run: Run,
        *,
        budget: int = thinning.DEFAULT_BUDGET,
        detail: str = thinning.FULL,
        on_notice: Callable[[str], None],
    ) -> None:
        self._target, self._budget, self._detail = target, budget, detail
        self._notice = on_notice
        self._takes: list[Take] = []
        self._begun = 0
        self._error: str | None = None
        self._closing: threading.Thread | None = None
        self._open_take: Take | None = self._new_take(run)

    # Called by the run

    def plan(self, run: Run) -> Plan:
        """The last step to run to, and whether every step until there is kept."""
        take = self._take(run)
        if take is None or take.error is not None:
            return super().plan(run)
        return take.plan(run.learner.step)

    def block(self, run: Run, block: Block) -> None:
        if self._open_take is not None:
            self._open_take.block(block, run.learner)

    def frame(self, run: Run, frame: Frame) -> None:
        if self._open_take is not None:  # a run paused after a discontinuity has no segment
            self._open_take.frame(frame)

    def edge(self, run: Run, total: Tally) -> None:
        if self._open_take is not None:
            self._open_take.edge(total)

    def change(self, run: Run, logged: Logged) -> None:
        if self._open_take is not None:  # otherwise the next segment starts with it
            self._open_take.change(logged, run.learner)

    def keyframe(self, run: Run, moment: Moment) -> None:
        if self._open_take is not None:
            self._open_take.keyframe(moment.lane(run.learner.watch))

    def leap(self, run: Run, words: str) -> None:
        """End this segment; the next one starts with the next step."""
        take, self._open_take = self._open_take, None
        if take is not None:
            take.end(run.learner, run.moment().lane(run.learner.watch), words)
            self._error = take.error

    # Called by the owner

    def close(
        self, run: Run, words: str = "it was stopped", *, seconds: float = CLOSE_SECONDS
    ) -> None:
        """End it complete; returns once everything is on disk, or after `seconds` of writing."""
        self.leap(run, words)
        self.wait_until_begun()
        until = time.monotonic() + seconds
        for take in self._takes:
            take.join(max(0.0, until - time.monotonic()))
            take.check_end()
        self._closing = threading.Thread(target=self._target.close, daemon=True)
        self._closing.start()
        self._closing.join(max(0.0, until - time.monotonic()))

    def wait_until_begun(self) -> None:
        """Wait until it writes, which can take long on a busy machine."""
        for take in self._takes:
            take.begun.wait(BEGIN_SECONDS)

    @property
    def status(self) -> Status:
        status = self._takes[-1].status
        return status if self._error is None else replace(status, error=self._error)

    @property
    def is_stuck(self) -> bool:
        """Whether the disk still blocks one of its threads, which the program must then abandon."""
        closing = self._closing is not None and self._closing.is_alive()
        return closing or any(take.is_stuck for take in self._takes)

    # Inside

    def _take(self, run: Run) -> Take | None:
        """The open segment, or a new one after a discontinuity; None if recording has failed."""
        if self._open_take is None and self._error is None:
            try:
                self._open_take = self._new_take(run)
            except Exception as error:  # a failed recording must not end the run
                self._error = _in_words(error)
                self._notice(f"recording has stopped, the run continues: {self._error}")
        return self._open_take

    def _new_take(self, run: Run) -> Take:
        check_recordable(run.learner.rule)
        task = run.make_task(run.task_name, run.learner.task.preset_name)
        header = _header(run, self._budget, self._detail)
        weight = run.learner.weights[:, run.learner.watch]
        target = copy(self._target)  # the previous segment may still be writing its own file
        stream = target.open(self._begun + 1)
        take = Take(stream, target, header, task, weight, on_notice=self._notice)
        take.begin(run.learner, run.moment().lane(run.learner.watch))
        self._begun += 1
        self._takes = [*(one for one in self._takes if one.is_stuck), take]
        return take


def _in_words(error: Exception) -> str:
    if isinstance(error, ValueError):
        return str(error)
    if isinstance(error, FileExistsError):
        return f"{error.filename} exists already and is not overwritten"
    if isinstance(error, OSError):
        return f"cannot open {error.filename}: {reason(error)}" if error.filename else str(error)
    return f"{type(error).__name__}: {error}"


def _header(run: Run, budget: int, detail: str) -> Header:
    learner, task = run.learner, run.learner.task
    window = usual_window(task)
    return Header(
        task=run.task_name,
        preset=task.preset_name,
        topology=learner.topology,
        seed=learner.seed,
        first_lane=learner.first_lane + learner.watch,
        rule=str(learner.rule),
        beta=learner.beta,
        gamma=learner.gamma,
        fall=learner.fall,
        dt=task.dt,
        step=learner.step,
        window=run.history.window,
        edges=run.history.edges(learner.watch),
        log=tuple(run.log),
        kept_window=window,
        detail=detail,
        budget=budget,
        thinning=thinning.rule(window, budget, detail),
        versions=versions() | {TASK: str(task.version)},
        machine=machine(),
    )
