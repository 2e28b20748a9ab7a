"""What a worker publishes for views: all that may be shown, at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hebbviz.moments import Block, Frame
from hebbviz.task import Task
from server.changes import Logged
from server.estimate import Estimate
from server.evaluation import Evaluation
from server.history import Curve, Curves
from server.player import Check
from server.recording.status import Status
from server.tempo import Speed
from server.watch import Excerpt


@dataclass(frozen=True)
class Past:
    """The past of a run, while it is shown: the step that is, and what is known of it; where it
    does not come out as it was, why.
    """

    cursor: int
    loop: bool
    check: Check
    why: str | None = None


@dataclass(frozen=True)
class Other:
    """The other copy of a fork that began at step `start`."""

    words: str
    start: int
    frame: Frame
    curve: Curve


@dataclass(frozen=True)
class Picture:
    """All that a view may show. `shown` is the excerpt's frame while one plays, or a step of the
    `past` while that is shown, else `live`; `leaps` counts how often it did not follow on what was
    shown before. The past goes back to step `first`.

    All is of the watched `lane`, but for `curves`, which are of all lanes, `evaluations`, the
    `ghost`, which is the curves of the run before, and the lanes that are `stuck`.

    `recent` holds every one of the latest steps up to `shown`, as far as they follow on one
    another; `shown_trail` and `live_trail` the latest frames, likewise, so that a view that skips
    pictures misses nothing. `made_at` is time.monotonic(). `preparing` says what a command
    still waits for; `evaluating` steps made and to be made of a long evaluation.
    """

    number: int
    made_at: float
    task: Task
    task_name: str
    seed: int
    lane: int
    beta: float
    gamma: float
    frozen: bool
    live: Frame
    shown: Frame
    leaps: int
    recent: Block | None
    shown_trail: tuple[Frame, ...]
    live_trail: tuple[Frame, ...]
    excerpt: Excerpt | None
    curve: Curve
    curves: Curves
    ghost: Curves | None
    stuck: tuple[int, ...]
    changes: Sequence[Logged]
    paused: bool
    speed: Speed
    steps_per_second: float
    watching: bool
    watch_speed: float
    undo_words: str | None
    evaluations: tuple[Evaluation, ...]
    evaluating: tuple[int, int] | None
    estimate: Estimate | None
    run_number: int
    error: str | None
    preparing: str | None
    first: int
    past: Past | None
    other: Other | None
    recording: Status | None
    records: bool
    folder: str
    stream_url: str | None

    @property
    def lanes(self) -> int:
        """How many replicas run side by side."""
        return self.curves.lanes
