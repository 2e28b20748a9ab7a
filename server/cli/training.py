"""Training without a page: at full speed, with the figures at the end."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tqdm import tqdm  # type: ignore[import-untyped]

import hebbviz
from hebbviz.learner.learner import TaskError
from hebbviz.learner.pieces import between_pieces
from hebbviz.rules.paper import PAPER
from hebbviz.server.page import event_text
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.recording.status import Status
from hebbviz.server.run.keyframes import Pace
from hebbviz.server.run.run import Run
from hebbviz.sims.experiments.chunks import stretches
from hebbviz.sims.program.learner_from_arguments import maker
from hebbviz.sims.program.terminal import finite

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hebbviz.learner.learner import Learner
    from hebbviz.task.base import Measure, Tally

CHUNK_SECONDS = 0.1
"""Aim for one uninterrupted stretch of steps; a stop waits at most about twice this."""

STRETCH_SECONDS = 0.01
"""Aim for a recorded stretch of steps as long as this."""
LONGEST_STRETCH = 200_000
FRAME_SECONDS = 1.0 / 16.0
"""Seconds between the sums over all steps in a recording."""

Figures = dict[str, Any]
"""By name, and fit for strict JSON."""


@dataclass(frozen=True)
class Training:
    """The result: steps made and requested, their wall time, totals of the last fifth."""

    steps: int
    seconds: float
    late: Tally
    finished: bool


class Unrecorded:
    """Advances a learner at full speed."""

    is_stuck = False

    def __init__(self, learner: Learner) -> None:
        self.learner = learner

    def skip(self, steps: int) -> None:
        self.learner.skip(steps)

    def __enter__(self) -> Unrecorded:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Recorded:
    """Advances a learner and records it; raises as `Recordings` does. Finishes the file on exit."""

    def __init__(
        self,
        learner: Learner,
        task_name: str,
        options: Options,
        *,
        on_notice: Callable[[str], None],
    ) -> None:
        self.learner = learner
        self.is_stuck = False
        self._run = Run(learner, maker(learner.task, task_name), task_name)
        self._recordings = Recordings(self._run, options, on_notice=on_notice)
        self._pace = Pace()
        self._framed_at = self._now = time.perf_counter()
        self._stretch = 16

    def skip(self, steps: int) -> None:
        """Run `steps` steps, with frames and keyframes for the recording."""
        end = self.learner.step + steps
        while self.learner.step < end:
            made = len(self._run.advance(min(self._stretch, end - self.learner.step)).fired)
            now = time.perf_counter()
            seconds, self._now = now - self._now, now
            if made == self._stretch:
                self._stretch = max(1, min(LONGEST_STRETCH, int(made * _factor(seconds))))
            if now - self._framed_at > FRAME_SECONDS:
                self._run.frame()
                self._framed_at = now
            if self._pace.is_due(seconds, seconds, self._run.moment_size):
                self._run.keep()

    @property
    def status(self) -> Status | None:
        """How much was recorded."""
        return self._recordings.status

    def __enter__(self) -> Recorded:
        return self

    def __exit__(self, *_: object) -> None:
        self._run.frame()
        self.is_stuck = self._recordings.close()


Steps = Unrecorded | Recorded


def _factor(seconds: float) -> float:
    """The factor for the next chunk's length, after one that took `seconds`."""
    return min(2.0, max(0.5, STRETCH_SECONDS / max(seconds, 1e-6)))


def train(
    go: Steps, steps: int, *, stop: threading.Event | None = None, bar: bool = False
) -> Training:
    """Run `steps` steps, or until `stop` is set; `bar` shows the progress on stderr.

    Raises TaskError if the task fails, with the learner as `Learner.advance` leaves it.
    """
    stop = threading.Event() if stop is None else stop
    learner = go.learner
    start, began = learner.step, time.perf_counter()
    with _progress(steps, shown=bar) as moved:
        _skip(go, steps * 4 // 5, stop, moved)
        before_late = learner.tally()
        _skip(go, start + steps - learner.step, stop, moved)
    seconds = time.perf_counter() - began
    made = learner.step - start
    return Training(made, seconds, learner.tally() - before_late, finished=made == steps)


def _skip(go: Steps, steps: int, stop: threading.Event, moved: Callable[[int], object]) -> None:
    """`go.skip(steps)`, cut so that `stop` acts soon whatever a step costs."""
    for size in stretches(steps, CHUNK_SECONDS):
        if stop.is_set():
            break
        go.skip(size)
        moved(size)


@contextlib.contextmanager
def _progress(steps: int, *, shown: bool) -> Iterator[Callable[[int], object]]:
    if not shown:
        yield lambda _: None
        return
    with tqdm(total=steps, unit=" steps", unit_scale=True, file=sys.stderr) as bar:
        yield bar.update


@contextlib.contextmanager
def shown_calls(what: str, *, shown: bool) -> Iterator[None]:
    """Show the progress of learners' long calls in this block on stderr, one after the other."""
    if not shown:
        yield
        return
    with tqdm(
        desc=what, unit=" steps", unit_scale=True, file=sys.stderr, delay=1.0, leave=False
    ) as bar:

        def show(made: int, steps: int) -> None:
            bar.total = steps
            bar.update(made - bar.n)

        with between_pieces(show):
            yield


def own_figures(learner: Learner, training: Training) -> Figures:
    """The task's own figures; None if not measured or infinite, such as the time to an event that
    was not seen.

    Raises TaskError if the task fails to give them.
    """
    task = learner.task
    try:
        figures = task.results(learner, training.late)
        own = {str(name): _plain(value) for name, value in figures.items()}
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise TaskError(f"task {task.name!r} failed to give its results: {what}") from error
    if training.late.steps == 0:
        own |= {key: None for key in task.measure.keys if key in own}
    return own


def _plain(value: float) -> float | None:
    """A JSON number: a count stays an integer."""
    return value if isinstance(value, int) else finite(value)


def figures_of(learner: Learner, training: Training, task_name: str) -> Figures:
    """Figures of any run. `steps` were made now, `total_steps` since its start."""
    late, steps = training.late, training.steps
    return {
        "task": task_name,
        "preset": learner.task.preset_name,
        "network": learner.topology.describe(),
        "lanes": learner.lanes,
        "beta": learner.beta,
        "gamma": learner.gamma,
        "rule": str(learner.rule),
        "fall": finite(learner.fall),
        "gamma_in_force": learner.gamma_in_force,
        "frozen": learner.frozen,
        "seed": learner.seed,
        "steps": steps,
        "total_steps": learner.step,
        "seconds": training.seconds,
        "steps_per_second": finite(steps / max(training.seconds, 1e-9)) if steps else None,
        "late_steps": late.steps,
        "average_reward": finite(late.average_reward) if late.steps else None,
        "version": hebbviz.__version__,
    }


def describe(figures: Figures, own: Figures, measure: Measure) -> str:
    """Both as text to read."""
    lines = [
        f"{figures['task']} {figures['preset']}, {figures['network']}, seed {figures['seed']}, "
        + ("" if figures["lanes"] == 1 else f"the first of {figures['lanes']} lanes, ")
        + f"β {figures['beta']:.6g}, γ {figures['gamma']:.3g}"
        + ("" if figures["fall"] is None else f" falling over {figures['fall']:.6g} steps")
        + ("" if figures["rule"] == PAPER.name else f", rule {figures['rule']}")
        + (", learning frozen" if figures["frozen"] else ""),
        f"{figures['steps']:,} steps in {figures['seconds']:.2f} s"
        + (f", {figures['steps_per_second']:,.0f} a second" if figures["steps"] else "")
        + f"; now at step {figures['total_steps']:,}",
    ]
    if figures["average_reward"] is not None:
        lines.append(
            f"average reward: {figures['average_reward']:.6g} a step, "
            f"over the last {figures['late_steps']:,}"
        )
    besides = measure.keys[1:]
    for name, value in own.items():
        if name in figures or name in besides:
            continue
        told = "not measured" if value is None else f"{value:.6g}"
        if name == measure.key and besides and own.get(besides[0]) is not None:
            told = _estimate(own, measure)
        lines.append(f"{name.replace('_', ' ')}: {told}")
    return "\n".join(lines)


def _estimate(own: Figures, measure: Measure) -> str:
    """A mean time to an event, with the number of events and its interval."""
    value, count, low, high = (math.inf if own[k] is None else own[k] for k in measure.keys)
    return event_text.told(measure, (value, count, low, high), lambda time: f"{time:.6g}")
