"""The requested speed of a run, and the number of steps to make next.

At a speed of k steps/s every second owes k steps, and a stretch makes those that are owed. At full
speed none are counted. Either way a stretch is no longer than lets a command act soon, by how long
the stretches before it took. Callers pass seconds and steps: nothing here knows of runs or clocks.
"""

from __future__ import annotations

import math

LARGEST_SPEED = 1e9
REALTIME = "realtime"
MAX = "max"

Speed = float | str
"""Steps per second, or 'realtime' (tasks with a dt), or 'max'."""

STRETCH_SECONDS = 0.012
"""Aim for one uninterrupted stretch of steps; a command waits at most about twice this."""
LONGEST_STRETCH_SECONDS = 0.05
"""A stretch is as long as that where the copy of its first moment, of many lanes, takes so long."""
FIRST_STRETCH, LONGEST_STRETCH = 16, 200_000
MOST_OWED_SECONDS = 0.25
"""A run that cannot keep up with its speed does not save up more than this."""
SLOW_STRETCHES = 5
"""Stretches over which the speed is measured where a second has fewer."""


def check_speed(speed: Speed) -> Speed:
    """The speed itself; raises ValueError unless it is 'max', 'realtime' or steps/s above 0."""
    if speed in (REALTIME, MAX):
        return speed
    if isinstance(speed, bool) or not isinstance(speed, (int, float)):
        raise ValueError(f"speed must be steps per second, realtime or max, got {speed!r}")
    if not math.isfinite(speed) or not 0.0 < speed <= LARGEST_SPEED:
        raise ValueError(f"speed must be above 0 and at most {LARGEST_SPEED:g}, got {speed!r}")
    return float(speed)


class Tempo:
    """The speed that is asked for, whether the run is paused, and the steps that are due.

    Steps are `dt` seconds long, in a run that has a time.
    """

    def __init__(self, dt: float | None = None) -> None:
        self.speed: Speed = MAX
        self.paused = False
        self._dt = dt
        self._owed, self._single = 0.0, 0
        self._stretch = FIRST_STRETCH
        self._made: list[tuple[float, int]] = []

    @property
    def rate(self) -> float | None:
        """Requested steps per second, or None for full speed."""
        if self.speed == MAX:
            return None
        if self.speed == REALTIME:
            return 1.0 / self._dt if self._dt else None
        return float(self.speed)

    def begin(self, dt: float | None) -> None:
        """Owe no steps: the run was replaced."""
        self._dt, self._single, self._stretch = dt, 0, FIRST_STRETCH
        self._forget()

    def set_speed(self, speed: Speed) -> None:
        self.speed = speed
        self._forget()

    def pause(self, paused: bool) -> None:
        """Pause or resume."""
        self.paused, self._single = paused, 0
        self._forget()

    def step(self, steps: int) -> None:
        """Make this many more steps, then pause."""
        self.paused = True
        self._single += steps

    def is_due(self) -> bool:
        """Whether there are steps to make."""
        return self._due() > 0

    def next(self, seconds: float) -> int:
        """Number of steps to make now, `seconds` after the last call."""
        rate = self.rate
        if rate is not None and not self.paused:
            self._owed = min(self._owed + rate * seconds, max(1.0, rate * MOST_OWED_SECONDS))
        return min(self._stretch, self._due())

    def made(self, steps: int, began: float, seconds: float, copied: float) -> None:
        """So many were made, from the time `began`, in `seconds` besides those of the copy of
        their first moment.
        """
        self._owed = max(0.0, self._owed - steps)
        self._single = max(0, self._single - steps)
        self._made.append((began, steps))
        self._adapt(steps, seconds, copied)

    def measured(self, now: float) -> float:
        """Steps per second over the last second, or over the last stretches of a slow run."""
        recent = [(t, n) for t, n in self._made if now - t < 1.0]
        if len(recent) < SLOW_STRETCHES:
            recent = self._made[-SLOW_STRETCHES:]
        self._made = recent
        if self.paused or len(recent) < 2:
            return 0.0
        return sum(n for _, n in recent[:-1]) / (recent[-1][0] - recent[0][0])

    def _due(self) -> int:
        if self.paused:
            return self._single
        return LONGEST_STRETCH if self.rate is None else int(self._owed)

    def _adapt(self, steps: int, seconds: float, copied: float) -> None:
        """Lengthen or shorten the next stretches by how long one took, besides the copy, which is
        to take the lesser part of the time.
        """
        aim = min(max(STRETCH_SECONDS, 2.0 * copied), LONGEST_STRETCH_SECONDS)
        if steps == self._stretch and seconds < aim / 2:
            self._stretch = min(2 * self._stretch, LONGEST_STRETCH)
        elif seconds > aim and steps > 1:
            self._stretch = max(1, steps // 2)

    def _forget(self) -> None:
        self._owed, self._made = 0.0, []
