"""The latest frames that were shown, without a discontinuity between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace

from hebbviz.learner.frames import Block, Frame, join

FRAMES = 200
STEPS = 256
MOST_BYTES = 100_000_000
MANY = 50
"""Frames whose step counts differ by more than this factor are not shown together."""


class Trail:
    """Consecutive frames, and every step of the latest ones."""

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque(maxlen=FRAMES)
        self.recent: Block | None = None

    def add(self, frame: Frame) -> None:
        """Append a frame; restart after a discontinuity."""
        if self._frames and not _follows(frame, self._frames[-1]):
            self._frames.clear()
        if frame.since.steps or not self._frames:
            self._frames.append(frame)
        while len(self._frames) * _size(frame) > MOST_BYTES and len(self._frames) > 1:
            self._frames.popleft()

    def note(self, block: Block) -> None:
        """Append steps; restart after a discontinuity."""
        parts = [block.tail(STEPS)]
        if self.recent is not None and self.recent.end == parts[0].start:
            parts.insert(0, self.recent)
        self.recent = join(parts).tail(STEPS)

    def clear(self) -> None:
        self._frames.clear()
        self.recent = None

    @property
    def frames(self) -> tuple[Frame, ...]:
        return tuple(self._frames)


class Seen:
    """The shown Frames, one after another. While nothing moves, a Frame keeps the summary of the
    steps that led to it, so that a page that skips snapshots still gets it.
    """

    def __init__(self) -> None:
        self.leaps = 0
        """Number of discontinuities in the shown frames."""
        self._last: Frame | None = None

    def see(self, frame: Frame) -> Frame:
        """Process the next Frame; returns the Frame to show."""
        last = self._last
        if last is None or not _follows(frame, last):
            self.leaps += 1
        elif not frame.since.steps:
            frame = replace(frame, since=last.since)
        self._last = frame
        return frame

    def forget(self) -> None:
        """Mark a discontinuity before the next frame."""
        self._last = None


def _follows(frame: Frame, last: Frame) -> bool:
    return frame.topology is last.topology and frame.step - frame.since.steps == last.step


def moved(frames: Sequence[Frame]) -> list[Frame]:
    """The frames that represent steps; frames of a paused run represent none."""
    return [f for f in frames if f.since.steps]


def alike(frames: Sequence[Frame]) -> list[Frame]:
    """The latest of these frames, as long as none represents many more steps than the newest:
    single steps would not be visible beside thousands.
    """
    frames = moved(frames)
    far = [k for k, f in enumerate(frames) if f.since.steps > MANY * frames[-1].since.steps]
    return frames[far[-1] + 1 :] if far else frames


def _size(frame: Frame) -> int:
    return 3 * frame.weight.nbytes + 4096
