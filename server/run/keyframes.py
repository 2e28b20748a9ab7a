"""Keyframes of a run, from which any of its steps can be recomputed in a fraction of a second."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from hebbviz.learner.frames import Keyframe

MOST_BYTES = 128_000_000
"""Limit of keyframes in memory; beyond it, every second one is dropped."""
OBJECTS_BYTES = 900
"""Overhead of a keyframe in bytes, which is most of it for a small network."""
COMPUTED_SECONDS = 0.1
"""Computing time between keyframes, so that every step is reached soon."""
RESTED_SECONDS = 5.0
"""A slow run has a keyframe at least this often."""
BYTES_PER_SECOND = 150_000
"""Keyframes of large networks are further apart, to stay below this rate in bytes."""


@dataclass(frozen=True)
class Moment:
    """A keyframe, and how many changes of the log were made before it."""

    keyframe: Keyframe
    logged: int

    def lane(self, lane: int) -> Moment:
        """The same keyframe for one lane alone."""
        return Moment(self.keyframe.lane(lane), self.logged)

    @property
    def step(self) -> int:
        return self.keyframe.step

    @property
    def size(self) -> int:
        """Bytes in memory."""
        k = self.keyframe
        numbers = (k.network, k.world, k.gamma, k.memory)
        return sum(array.nbytes for array in numbers) + OBJECTS_BYTES

    @property
    def lane_size(self) -> int:
        """Bytes of one lane, which is what a recording stores."""
        return self.size // int(self.keyframe.network.shape[1])


class Tape:
    """A store of keyframes in the order of their steps; it always has the first and the last one.

    If they take more than `most_bytes`, every second one is dropped, and from then on only one in
    2, 4, 8 … added ones is kept.
    """

    def __init__(
        self, moments: Sequence[Moment] = (), *, most_bytes: int | None = None, every: int = 1
    ) -> None:
        self._moments = list(moments)
        self._most, self._every, self._after_kept = most_bytes, every, 0

    def add(self, moment: Moment) -> None:
        """Append a keyframe; one at or before the last step is ignored."""
        if self._moments and moment.step <= self._moments[-1].step:
            return
        if self._after_kept:
            self._moments.pop()  # kept only as the last one
        self._moments.append(moment)
        self._after_kept = (self._after_kept + 1) % self._every
        if self._most is not None and self.size > self._most:
            self._moments = [*self._moments[:-1:2], moment]
            self._every, self._after_kept = 2 * self._every, 1

    def before(self, step: int) -> Moment | None:
        """The last keyframe at or before a step."""
        at = bisect_right(self._moments, step, key=lambda m: m.step)
        return self._moments[at - 1] if at else None

    def after(self, step: int) -> Moment | None:
        """The first keyframe after a step."""
        at = bisect_right(self._moments, step, key=lambda m: m.step)
        return self._moments[at] if at < len(self._moments) else None

    def until(self, step: int) -> Tape:
        """A copy that ends at a step."""
        kept = [m for m in self._moments if m.step <= step]
        return Tape(kept, most_bytes=self._most, every=self._every)

    @property
    def first(self) -> int:
        """The first step from which the run can be recomputed."""
        return self._moments[0].step if self._moments else 0

    @property
    def size(self) -> int:
        """Bytes, about."""
        return len(self) * self._moments[-1].size if self._moments else 0

    def __len__(self) -> int:
        return len(self._moments)


class Pace:
    """Decides when the next keyframe of a run is due."""

    def __init__(self) -> None:
        self._computed = self._rested = 0.0

    def is_due(self, computed: float, passed: float, size: int) -> bool:
        """Whether a keyframe of `size` bytes is due; arguments are further seconds of computing and
        of time.
        """
        self._computed += computed
        self._rested += passed
        enough = self._computed >= COMPUTED_SECONDS or self._rested >= RESTED_SECONDS
        if not enough or self._rested < size / BYTES_PER_SECOND:
            return False
        self._computed = self._rested = 0.0
        return True
