"""The yoked control: lane k receives the reward of lane k + 1, the last lane that of the first.

Lanes are independent runs. The received reward therefore has the right statistics but does not
depend on this lane's neurons, so the lane must not learn. If it does, the measure is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hebbviz.rules import Rule


@dataclass(frozen=True)
class Yoked(Rule):
    """Sends each lane the reward of the next one.

    It needs at least two lanes and takes at most 64, the number stepped together. For a single
    lane, fork the run on the page with 'reward of another run'.
    """

    name = "yoked"
    summary = "the reward of another run, a control that must not learn"
    least_lanes = 2
    lanes_touch = True

    @staticmethod
    def modulate(memory: Any, constants: Any, reward: Any, ended: Any, sent: Any) -> None:
        lanes = len(reward)
        for lane in range(lanes):
            sent[lane] = reward[(lane + 1) % lanes]
