"""The yoked control: lane k is sent the reward of lane k + 1, the last one that of the first.

A lane is an independent run, so what it is sent has the statistics of a reward, and knows nothing
of what this lane's neurons did: it must not learn. If it does, the measure is at fault.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hebbviz.rules import Rule


@dataclass(frozen=True)
class Yoked(Rule):
    """Needs two lanes, and takes no more than are stepped together, 64. (Of one lane, fork the run
    in the page with 'reward of another run'.)
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
