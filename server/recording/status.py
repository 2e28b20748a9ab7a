"""The status of a running recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Status:
    """The status of a recording; `size` in bytes, None if unknown.

    `rule` is the thinning rule as text.
    """

    where: str
    size: int | None
    seconds: float
    steps: int
    kept: int
    every: int
    dropped: int
    rule: str
    error: str | None

    @property
    def thinned(self) -> str:
        """The thinning as text."""
        dropped = f"; {self.dropped:,} steps dropped: the disk is too slow" * (self.dropped > 0)
        if self.kept >= self.steps:
            return "every step is kept"
        share = f"{100 * self.kept / max(1, self.steps):.3g} % of the steps kept"
        now = {0: "sums, keyframes and changes only", 1: "currently every step"}
        return f"{share}, {now.get(self.every, f'currently 1 window in {self.every:,}')}{dropped}"
