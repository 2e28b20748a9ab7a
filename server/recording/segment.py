"""A segment: a part of a run without discontinuity, written by its own thread.

The run's thread only puts things on a queue. It is bounded: excess items are dropped and counted,
except keyframes and changes, so that a slow disk never blocks a run.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Block, Frame
from hebbviz.learner.learner import Learner
from hebbviz.server.recording.header import Header
from hebbviz.server.recording.scene import MOST_LIT
from hebbviz.server.recording.status import Status
from hebbviz.server.recording.streams import Stream
from hebbviz.server.recording.targets import Target
from hebbviz.server.recording.writer import Writer
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.thinning import FULL, Plan, Thinning
from hebbviz.task.base import Tally, Task

FLUSH_SECONDS = 0.25
"""A killed program loses at most this much of its recording, plus the time to write it."""
FLUSH_BYTES = 2_000_000
"""Flushed more often under load, so that pending data fits into the last space of a disk."""
FLUSH_PATIENCE = 5.0
CLOSE_SECONDS = 3.0
BEGIN_SECONDS = 30.0
LOOKS_PER_SECOND = 8.0
"""How often weights, traces and the network in 3D are kept in a fast run."""
SLOW = 100.0
"""Steps a second up to which weights and traces are kept at every step."""
MOST_QUEUED = 64_000_000
"""Most bytes that wait for the disk."""
MOST_KEPT = 3 * MOST_QUEUED
"""Beyond this, recording stops: the disk is too slow even for keyframes and changes."""

Array = NDArray[np.float64]
Job = Callable[[Writer], None]


class Take(threading.Thread):
    """Writes a run's data into a stream; its methods only queue the data and return at once.

    `task` is for this thread only; `weight` (synapses,) are the initial weights. The first call is
    `begin`, with the initial keyframe.
    """

    def __init__(
        self,
        stream: Stream,
        target: Target,
        header: Header,
        task: Task,
        weight: Array,
        *,
        on_notice: Callable[[str], None],
    ) -> None:
        super().__init__(name="hebbviz recording", daemon=True)
        self._stream, self._target, self._header, self._task = stream, target, header, task
        self._weight, self._notice = weight, on_notice
        now = time.monotonic()
        self._thinning = Thinning(header.kept_window, header.budget, header.detail, now)
        self._plan = Plan(header.step, keep=False, every=1)
        self._queue: queue.SimpleQueue[tuple[Job, int] | None] = queue.SimpleQueue()
        self._told = self._written = self._flushed = 0
        self._ratio = 1.0
        self._began, self._looked_at = now, 0.0
        self._ended: float | None = None
        self._step, self._kept, self._dropped = header.step, 0, 0
        self._step_size = _step_size(task, header)
        self._weights_size = 16 * header.topology.synapses + 8 * header.topology.inputs + 600
        self._look_size = self._weights_size + 8 * header.topology.synapses + 2_000
        self.error: str | None = None
        self._giving_up: threading.Thread | None = None
        self.begun = threading.Event()
        """Set once it writes; its imports can take long."""
        self.start()

    # Called by the run's thread

    def plan(self, step: int) -> Plan:
        """The step to run to, and whether every step until there is kept."""
        now = time.monotonic()
        self._thinning.note_speed(step, now)
        if step >= self._plan.until:
            before = self._plan.every
            size = self._step_size * self._ratio
            self._plan = self._thinning.plan(step, size, now)
            every = self._plan.every
            if every != before:
                self._tell(lambda w: w.thinning(step, every), 200, must=True)
        if self.keeps_each_weight():
            return Plan(step + 1, keep=True, every=1)
        return self._plan

    def keeps_each_weight(self) -> bool:
        """Whether the run is so slow that weights and traces are kept at every step."""
        speed = self._thinning.speed()
        if not self._plan.keep or self._plan.every > 1 or speed > SLOW:
            return False
        return self._thinning.affords(self._weights_size, speed)

    def block(self, block: Block, learner: Learner) -> None:
        """Steps of the run; `learner` has just made them."""
        steps = len(block.fired)
        self._step = block.end
        if self.error is not None or not self._plan.keep or not steps:
            return
        readings = learner.task.read(block.world)
        if not self._task.props:
            block = replace(block, world=block.world[:0])
        if not self._tell(lambda w: w.block(block, readings), round(steps * self._step_size)):
            self._dropped += steps
            return
        self._kept += steps
        if self.keeps_each_weight():
            self.weights(learner)

    def begin(self, learner: Learner, moment: Moment) -> None:
        """The first call: the initial state of the run."""
        self.keyframe(moment)
        self.parameters(learner)
        if self._header.detail == FULL:
            frame = learner.glance()
            self._tell(lambda w: w.look(frame), self._look_size)
            self._tell(lambda w: w.world(frame.step, frame.world), 1_000)

    def weights(self, learner: Learner) -> None:
        """Weights and traces as they are now, and what the network saw in this step."""
        step, lane = learner.step, learner.watch
        now = [x[:, lane] for x in (learner.weights, learner.traces, learner.seen)]
        self._tell(lambda w: w.weights(step, *now), self._weights_size)

    def frame(self, frame: Frame) -> None:
        """Record the sums since the previous frame, and sometimes weights and traces."""
        if not frame.since.steps:
            return
        full = self._header.detail == FULL
        world = full and not self._plan.keep
        self._tell(lambda w: w.frame(frame, world=world), 1_000)
        in_force = frame.step, float(frame.beta[0]), float(frame.gamma[0])
        self._tell(lambda w: w.parameters(*in_force), 200)
        now = time.monotonic()
        apart = max(now - self._looked_at, 1e-3)
        if apart > 1.0 / LOOKS_PER_SECOND and self._thinning.affords(self._look_size, 1.0 / apart):
            self._looked_at = now
            self._tell(lambda w: w.look(frame), self._look_size)

    def edge(self, total: Tally) -> None:
        """Record the totals at the edge of a window of the learning curve."""
        self._tell(lambda w: w.edge(total), 200, must=True)

    def change(self, logged: Logged, learner: Learner) -> None:
        """Record a change that `learner` has just made."""
        self._tell(lambda w: w.change(logged), 400, must=True)
        self.parameters(learner)

    def parameters(self, learner: Learner) -> None:
        """Record the current β and γ, and whether learning is frozen."""
        step, frozen = learner.step, learner.frozen
        in_force = step, learner.beta, learner.gamma_in_force
        self._tell(lambda w: w.parameters(*in_force), 150, must=True)
        self._tell(lambda w: w.phase(step, frozen=frozen), 50, must=True)

    def keyframe(self, moment: Moment) -> None:
        """Record a keyframe."""
        self._step = moment.step
        size = moment.keyframe.network.nbytes + moment.keyframe.world.nbytes + 400
        self._tell(lambda w: w.keyframe(moment), size, must=True)

    def end(self, learner: Learner, moment: Moment, words: str) -> None:
        """The last call: the final state, and the reason for the end."""
        self.keyframe(moment)
        self.parameters(learner)
        self._tell(lambda w: w.end(moment.step, words), 400, must=True)
        self._ended = time.monotonic()
        self._queue.put(None)

    def check_end(self) -> None:
        """Report it if the segment has not ended by now."""
        if self.is_alive():
            self._fail(self._target.silence)

    @property
    def is_stuck(self) -> bool:
        """Whether the disk still blocks one of its threads."""
        return self.is_alive() or (self._giving_up is not None and self._giving_up.is_alive())

    @property
    def status(self) -> Status:
        steps = self._step - self._header.step
        seconds = (self._ended or time.monotonic()) - self._began
        return Status(
            self._target.words,
            self._target.size(),
            seconds,
            steps,
            self._kept,
            self._plan.every,
            self._dropped,
            self._header.thinning,
            self.error,
        )

    def _tell(self, job: Job, size: int, *, must: bool = False) -> bool:
        """Queue a job if there is room, or in any case if it `must` be kept."""
        if self.error is not None:
            return False
        waiting = self._told - self._written
        if waiting > MOST_KEPT:
            self._fail(self._target.silence)
        if waiting > (MOST_KEPT if must else MOST_QUEUED):
            return False
        self._told += size
        self._thinning.spend(size * self._ratio)
        self._queue.put((job, size))
        return True

    # The thread

    def run(self) -> None:
        try:
            try:
                writer = self._writer()
            finally:
                self.begun.set()
            self._write_all(writer)
            del writer
            self._stream.let_go()
        except Exception as error:  # for disk errors, rerun says only that its writer ended
            why = self._target.trouble(0) or f"{type(error).__name__}: {error}"
            self._fail(why.splitlines()[0][:200])
            # with a full disk this may never return
            self._giving_up = threading.Thread(target=self._stream.let_go, daemon=True)
            self._giving_up.start()

    def _writer(self) -> Writer:
        live = self._target.live
        return Writer(self._stream, self._header, self._task, self._weight, live=live)

    def _write_all(self, writer: Writer) -> None:
        """Write the queue until its end, or until writing fails."""
        next_flush = time.monotonic()  # the header and initial state go to disk first
        goes_on = True
        while goes_on:
            with contextlib.suppress(queue.Empty):
                item = self._queue.get(timeout=max(0.0, next_flush - time.monotonic()))
                goes_on = item is not None
                if item is not None:
                    job, size = item
                    job(writer)
                    self._written += size
            is_much = self._written - self._flushed > FLUSH_BYTES
            if not goes_on or is_much or time.monotonic() >= next_flush:
                trouble = self._target.trouble(self._written - self._flushed)
                if trouble is not None:
                    self._fail(trouble)
                    writer.end(self._step, trouble)
                    goes_on = False
                self._flush(writer)
                next_flush = time.monotonic() + FLUSH_SECONDS

    def _flush(self, writer: Writer) -> None:
        writer.flush()
        while not self._is_flushed():
            pass
        self._flushed = self._written
        size = self._target.size()
        if size is not None and self._written > 1_000_000:
            self._ratio = float(np.clip(size / self._written, 0.1, 10.0))

    def _is_flushed(self) -> bool:
        """Flush in time; returns whether it succeeded. A slow viewer is waited for, while new data
        stays on the bounded queue; a slow disk is an error.
        """
        try:
            self._stream.flush(timeout_sec=FLUSH_PATIENCE)
        except RuntimeError as error:
            if "timed out" not in str(error):
                raise
            if self._target.live and self._ended is None:
                return False
            self._fail(self._target.silence)
            raise
        return True

    def _fail(self, why: str) -> None:
        if self.error is None:
            self.error = why
            self._ended = time.monotonic()
            self._notice(
                f"recording into {self._target.words} has stopped, the run continues: {why}"
            )


def _step_size(task: Task, header: Header) -> int:
    """First estimate of a kept step's size in a file, in bytes; measured sizes correct it."""
    neurons, groups = header.topology.neurons, len(header.topology.neuron_groups)
    light = 12 * neurons if neurons <= MOST_LIT else 0
    props = 40 * len(task.props) + 100 * sum(p.trail for p in task.props)
    readings = sum(6 if r.steps else 15 for r in task.readings)
    return 14 * neurons + 8 * groups + 20 + light + props + readings
