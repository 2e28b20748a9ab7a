"""The snapshot that a worker publishes: everything that views can show at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hebbviz.learner.frames import Block, Frame
from hebbviz.server.live.evaluation import Evaluation
from hebbviz.server.live.excerpts import Excerpt
from hebbviz.server.live.gradient_estimate import Estimate
from hebbviz.server.live.pacing import Speed
from hebbviz.server.live.playback import Check
from hebbviz.server.recording.status import Status
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.history import Curve, Curves
from hebbviz.task.base import Task


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
class RunState:
    """The run itself: what it is of, how it is set, how it has gone.

    All is of the watched `lane`, but for `curves`, which are of all lanes, and the `ghost`, which
    is the curves of the run before. `number` counts the runs that there were. The past goes back to
    step `first`.
    """

    number: int
    task: Task
    task_name: str
    seed: int
    lane: int
    beta: float
    gamma: float
    frozen: bool
    live: Frame
    curve: Curve
    curves: Curves
    ghost: Curves | None
    changes: Sequence[Logged]
    undo_words: str | None
    first: int

    @property
    def lanes(self) -> int:
        """Number of replicas that run side by side."""
        return self.curves.lanes


@dataclass(frozen=True)
class View:
    """The view of the run: `frame` is the excerpt's while one plays, or a step of the `past`
    while that is shown, else the live one; `leaps` counts how often it did not follow on what was
    shown before.

    `recent` holds every one of the latest steps up to `frame`, as far as they follow on one
    another; `trail` and `live_trail` the latest frames, likewise, so that a view that skips
    snapshots misses nothing.
    """

    frame: Frame
    leaps: int
    recent: Block | None
    trail: tuple[Frame, ...]
    live_trail: tuple[Frame, ...]
    excerpt: Excerpt | None
    watching: bool
    watch_speed: float
    past: Past | None
    other: Other | None


@dataclass(frozen=True)
class Pacing:
    """The speed, the error that stopped the run, and the preparation that a command waits for."""

    paused: bool
    speed: Speed
    steps_per_second: float
    error: str | None
    preparing: str | None


@dataclass(frozen=True)
class Findings:
    """Findings beside the run: `evaluating` is the number of steps made and to be made in a long
    evaluation; `stuck` lists lanes.
    """

    evaluations: tuple[Evaluation, ...]
    evaluating: tuple[int, int] | None
    estimate: Estimate | None
    stuck: tuple[int, ...]


@dataclass(frozen=True)
class RecordingState:
    """The current recording, or the last one."""

    status: Status | None
    is_on: bool
    folder: str
    stream_url: str | None


@dataclass(frozen=True)
class Snapshot:
    """Everything that a view can show at one time; `made_at` is time.monotonic()."""

    number: int
    made_at: float
    run: RunState
    view: View
    pacing: Pacing
    findings: Findings
    recording: RecordingState
