"""What can be said of a recording that goes on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Status:
    """What can be said of a recording; `size` in bytes, None where it is not known.

    `rule` says by what rule it is thinned.
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
        """What was thinned, in words."""
        dropped = f"; {self.dropped:,} steps dropped: the disk is too slow" * (self.dropped > 0)
        if self.kept >= self.steps:
            return "every step is kept"
        share = f"{100 * self.kept / max(1, self.steps):.3g} % of the steps kept"
        now = {0: "sums, keyframes and changes only", 1: "every step just now"}
        return f"{share}, {now.get(self.every, f'just now 1 window in {self.every:,}')}{dropped}"
