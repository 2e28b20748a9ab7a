"""Evaluates a frozen copy beside the run, in its own thread and on its own learner."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.learner import Learner
from hebbviz.learner.pieces import Stopped, between_pieces
from hebbviz.sims.loading import MakeTask
from hebbviz.task.base import CompiledTask

PAUSE_SECONDS = 2.0
"""Seconds between two automatic evaluations."""
PAUSE_SHARE = 3.0
"""The pause is this many times as long as the evaluation, so that many lanes do not slow the run.
"""
SHOWN_SECONDS = 1.0
"""Progress is shown once an evaluation has taken this long."""


@dataclass(frozen=True)
class Evaluation:
    """Figures of a frozen copy made at `step`, each (lanes,); names as in `Task.evaluate`."""

    step: int
    figures: dict[str, NDArray[np.float64]]


class Evaluator:
    """Evaluates one learner at a time, and keeps the figures of a run."""

    def __init__(self, make_task: MakeTask, on_notice: Callable[[str], None]) -> None:
        self._make_task, self._notice = make_task, on_notice
        self._thread: threading.Thread | None = None
        self._ended_at, self._lasted = -math.inf, 0.0
        self._lock = threading.Lock()
        self._done: list[Evaluation] = []
        self._run = object()
        self.progress: tuple[int, int] | None = None
        """Steps made, and steps in total, of a long evaluation."""

    def is_free(self) -> bool:
        return self._thread is None or not self._thread.is_alive()

    def is_rested(self) -> bool:
        """Whether it is free and the pause after the last evaluation is over."""
        pause = max(PAUSE_SECONDS, PAUSE_SHARE * self._lasted)
        return self.is_free() and time.monotonic() - self._ended_at > pause

    def start(self, learner: Learner, task_name: str) -> None:
        """Evaluate a copy of this learner as it is now; only while `is_free`."""
        copy = learner.twin(self._make_task(task_name, learner.task.preset_name))
        copy.restore(learner.keyframe())
        self._thread = threading.Thread(target=self._evaluate, args=(copy, self._run), daemon=True)
        self._thread.start()

    def forget(self, after_step: int = -1) -> None:
        """Drop the figures of steps after this one; by default all, for a new run."""
        with self._lock:
            self._run = object()
            self._done = [e for e in self._done if e.step <= after_step]

    def results(self) -> tuple[Evaluation, ...]:
        with self._lock:
            return tuple(self._done)

    def _evaluate(self, copy: Learner, run: object) -> None:
        step, began, figures = copy.step, time.monotonic(), {}

        def look(made: int, steps: int) -> None:
            if time.monotonic() - began > SHOWN_SECONDS:
                self.progress = made, steps
            if run is not self._run:
                raise Stopped

        try:
            with between_pieces(look):
                found = copy.task.evaluate(copy)
            figures = {
                name: np.array(values, dtype=np.float64).reshape(copy.lanes)
                for name, values in found.items()
            }
        except Stopped:  # its run has been replaced
            pass
        except Exception as error:  # from the user's own task, for example
            self._notice(f"the evaluation of a frozen copy failed: {type(error).__name__}: {error}")
        self.progress = None
        self._ended_at = time.monotonic()
        self._lasted = self._ended_at - began
        with self._lock:
            if run is self._run and figures:
                self._done.append(Evaluation(step, figures))


def evaluates_by_itself(learner: Learner) -> bool:
    """Compiled tasks are evaluated repeatedly: it costs the run little."""
    return isinstance(learner.task, CompiledTask)
