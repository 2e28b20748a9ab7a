"""Thinning: a budget in bytes per minute decides which steps of a run are kept one by one.

A plain stride would alias the spikes. So whole windows of steps are kept, at regular intervals: the
run is cut into windows of equal length, and every 1st, 2nd, 4th, 8th … window is kept. Sums over
all steps, keyframes and changes are always kept, whatever they cost.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass

FULL, LIGHT = "full", "light"

DEFAULT_BUDGET = 40_000_000
LEAST_BUDGET, MOST_BUDGET = 100_000, 10**12
SAVED_MINUTES = 1.0
"""Unused budget accumulates up to this many minutes' worth; half of it can be used at once."""
WINDOWS_SHARE = 0.5
"""Share of the budget: keyframes and weights get at most a quarter each."""
SPEED_SECONDS = 1.0
MOST_APART = 2**30


def rule(window: int, budget: int, detail: str) -> str:
    """The thinning rule in a sentence."""
    always = "sums over all steps, keyframes and changes are all kept"
    if detail == LIGHT:
        return f"no single steps are kept (--detail light); {always}"
    return (
        f"all steps are kept while that takes less than {words(budget)} per minute; beyond that, "
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
    """The plan until the step `until`: whether to keep every step, as one window of `every`."""

    until: int
    keep: bool
    every: int


class Thinning:
    """Accounts for the budget; `plan` decides, window by window."""

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
        """Whether a quarter of the budget covers something of `size` bytes at this rate."""
        return not self._light and size * per_second <= self._per_second / 4

    def plan(self, step: int, step_size: float, now: float) -> Plan:
        """The plan from this step on, if a kept step takes `step_size` bytes."""
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
        """The interval between kept windows: a power of two, changed reluctantly."""
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
        """Note the run's step; call this often."""
        speeds = self._speeds
        if len(speeds) < 2 or now - speeds[-1][0] > SPEED_SECONDS / 50:
            speeds.append((now, step))
        while now - speeds[0][0] > SPEED_SECONDS and len(speeds) > 2:
            speeds.popleft()

    def speed(self) -> float:
        """Steps per second over about the last second; infinite while unknown."""
        if len(self._speeds) < 2:
            return math.inf
        (first, start), (last, end) = self._speeds[0], self._speeds[-1]
        return (end - start) / max(last - first, 1e-3)
