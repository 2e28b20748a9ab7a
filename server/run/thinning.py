"""Which steps of a run are kept one by one: a budget in bytes a minute decides.

A plain stride would alias the spikes. So stretches of every step are kept, at regular intervals:
the run is cut into windows of equal length, and of these every 1st, 2nd, 4th, 8th … is kept. Sums
over all steps, keyframes and changes are always kept, whatever they cost.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass

FULL, LIGHT = "full", "light"
DETAILS = (FULL, LIGHT)

DEFAULT_BUDGET = 40_000_000
LEAST_BUDGET, MOST_BUDGET = 100_000, 10**12
SAVED_MINUTES = 1.0
"""What is not used is saved up to so many minutes' worth, and half of it may be used at once."""
WINDOWS_SHARE = 0.5
"""Of the budget; keyframes and weights have a quarter each at most."""
SPEED_SECONDS = 1.0
MOST_APART = 2**30


def rule(window: int, budget: int, detail: str) -> str:
    """The rule in a sentence."""
    always = "sums over all steps, keyframes and changes are all kept"
    if detail == LIGHT:
        return f"no single steps are kept (--detail light); {always}"
    return (
        f"all steps are kept while that takes less than {words(budget)} a minute; beyond that, "
        f"windows of {window:,} steps at regular intervals, and {always}"
    )


def words(size: float) -> str:
    """A number of bytes: 812 kB, 12.3 MB, 1.2 GB."""
    for unit, name in ((1e9, "GB"), (1e6, "MB")):
        if size >= unit:
            return f"{size / unit:.3g} {name}"
    return f"{size / 1e3:.3g} kB"


def parse_budget(text: str) -> int:
    """Bytes a minute from 30MB, 500kB, 1GB or a plain number; raises ValueError."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kMG]?)B?\s*", text)
    size = float(match[1]) * {"": 1, "k": 1e3, "M": 1e6, "G": 1e9}[match[2]] if match else math.nan
    if not LEAST_BUDGET <= size <= MOST_BUDGET:
        raise ValueError(
            f"budget must be bytes a minute from {words(LEAST_BUDGET)} to {words(MOST_BUDGET)}, "
            f"such as 30MB, got {text[:40]!r}{'; use a point' * (',' in text)}"
        )
    return int(size)


@dataclass(frozen=True)
class Plan:
    """What to do until the step `until`: keep every step or not, one window of `every`."""

    until: int
    keep: bool
    every: int


class Thinning:
    """Knows what was earned and spent; `plan` decides, window by window."""

    def __init__(self, window: int, budget: int, detail: str, now: float) -> None:
        self.window, self.every = window, 1
        self._per_second = budget / 60.0
        self._most = budget * SAVED_MINUTES
        self._saved, self._earned_at = self._most, now
        self._light = detail == LIGHT
        self._speeds: deque[tuple[float, int]] = deque()

    def spend(self, size: float) -> None:
        """Something of `size` bytes was written."""
        self._saved -= size

    def affords(self, size: float, per_second: float) -> bool:
        """Whether a quarter of the budget bears something of `size` so often."""
        return not self._light and size * per_second <= self._per_second / 4

    def plan(self, step: int, step_size: float, now: float) -> Plan:
        """What to do from this step on, if a step that is kept takes `step_size` bytes."""
        self._earn(now)
        if self._light:
            return Plan(step + MOST_APART, keep=False, every=0)
        number, into = divmod(step, self.window)
        if into == 0 and number % self.every == 0:
            self.every = self._interval(step_size)
        keep = number % self.every == 0
        following = number + 1 if keep else -(-number // self.every) * self.every
        return Plan(following * self.window, keep, self.every)

    def _interval(self, step_size: float) -> int:
        """One window in how many can be afforded: a power of two that rather stays as it is."""
        if self._saved > self._most * (0.5 if self.every == 1 else 0.75):
            return 1
        share = max(0.05, min(1.0, 2.0 * self._saved / self._most))
        wanted = step_size * self.speed() / (WINDOWS_SHARE * self._per_second * share)
        wanted = min(max(1.0, wanted), float(MOST_APART))
        if self.every / 4 < wanted <= self.every:
            return self.every
        return int(2 ** math.ceil(math.log2(wanted)))

    def _earn(self, now: float) -> None:
        earned = self._per_second * (now - self._earned_at)
        self._saved, self._earned_at = min(self._most, self._saved + earned), now

    def note_speed(self, step: int, now: float) -> None:
        """The run is at a step; to be told often."""
        speeds = self._speeds
        if len(speeds) < 2 or now - speeds[-1][0] > SPEED_SECONDS / 50:
            speeds.append((now, step))
        while now - speeds[0][0] > SPEED_SECONDS and len(speeds) > 2:
            speeds.popleft()

    def speed(self) -> float:
        """Steps a second, over the last second or so; infinite while that is not known."""
        if len(self._speeds) < 2:
            return math.inf
        (first, start), (last, end) = self._speeds[0], self._speeds[-1]
        return (end - start) / max(last - first, 1e-3)
