"""Two copies of a learner from the same step, side by side, that differ in one setting.

One copy is the run itself, which continues. The other follows it to the same step and draws the
same random numbers, so that only the chosen setting separates them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.learner.learner import Learner
from hebbviz.limits import check_beta, check_gamma
from hebbviz.numerics.counter_rng import LARGEST_SEED
from hebbviz.server.live.recent_frames import Seen
from hebbviz.server.run.changes import Change, Logged, SetBeta, SetGamma
from hebbviz.server.run.history import Curve, Totals
from hebbviz.server.run.keyframes import Moment, Tape
from hebbviz.server.run.run import Run

BETA, GAMMA, NO_MEMORY, NO_REWARD, OTHER_REWARD = (
    "another β",
    "another γ",
    "β = 0",
    "no reward",
    "reward of another run",
)
KINDS = (BETA, GAMMA, NO_MEMORY, NO_REWARD, OTHER_REWARD)


@dataclass(frozen=True)
class Difference:
    """The one setting: its kind, and the other value of β or γ."""

    kind: str
    value: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"a fork must differ in one of {', '.join(KINDS)}, got {self.kind!r}")
        if self.kind in (BETA, GAMMA):
            if self.value is None:
                raise ValueError(f"a fork with {self.kind} needs its value")
            (check_beta if self.kind == BETA else check_gamma)(self.value)

    @property
    def change(self) -> Change | None:
        """The change to the other copy; None if its rewards differ."""
        if self.kind in (BETA, NO_MEMORY):
            return SetBeta(self.value or 0.0)
        return SetGamma(self.value or 0.0) if self.kind == GAMMA else None

    def __str__(self) -> str:
        if self.kind == BETA:
            return f"β {self.value:.6g}"
        return f"γ {self.value:.3g}" if self.kind == GAMMA else self.kind


class Fork:
    """The other copy of a run, from where the run is now."""

    def __init__(self, run: Run, difference: Difference) -> None:
        self.difference = difference
        self.start = run.learner.step
        self.learner = run.learner.twin()
        self.learner.restore(run.learner.keyframe())
        self.history = run.history.copy()
        self.log = list(run.log)
        self._donor = _donor(run) if difference.kind == OTHER_REWARD else None
        self._seen = Seen()
        self.tape: Tape | None = None
        """None if the rewards differ: the log is then not enough to recompute the copy."""
        if difference.change is not None:
            self.tape = run.tape.until(self.start)
            self.keep()
            self._make(difference.change)

    def follow(self, step: int) -> None:
        """Advance to the run's step. Raises TaskError if the task fails here."""
        steps = step - self.learner.step
        self.learner.advance(steps, reward=self._reward(steps))
        self.history.add(Totals.of(self.learner))

    def change(self, change: Change) -> None:
        """Apply a change of the run here too, unless it sets what the copies differ in."""
        if type(change) is not type(self.difference.change):
            self._make(change)

    def _make(self, change: Change) -> None:
        change.apply(self.learner)
        self.log.append(Logged(self.learner.step, change))

    def keep(self) -> None:
        """Store a keyframe of the current step."""
        if self.tape is not None:
            self.tape.add(Moment(self.learner.keyframe(), len(self.log)))

    def look_at(self, lane: int) -> None:
        """Show another lane."""
        self.learner.look_at(lane)
        self._seen.forget()

    def frame(self) -> Frame:
        """The frame that is shown."""
        return self._seen.see(self.learner.frame())

    def curve(self) -> Curve:
        """The learning curve of the watched lane; before the fork it is the run's own."""
        return self.history.curves(Totals.of(self.learner)).lane(self.learner.watch)

    def _reward(self, steps: int) -> NDArray[np.float64] | None:
        if self.difference.kind == NO_REWARD:
            return np.zeros(steps)
        if self._donor is not None:
            return self._donor.advance(steps).broadcast
        return None


def _donor(run: Run) -> Learner:
    """The same learner, continuing with other random numbers.

    All lanes of the other copy get the rewards of its first lane.
    """
    learner = run.learner
    seed = (learner.seed + 1) % LARGEST_SEED
    donor = Learner.of(learner.task, replace(learner.settings, seed=seed))
    donor.restore(learner.keyframe())
    return donor
