"""The paper's rule: every synapse receives the reward itself, m = r."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hebbviz.rules import Rule


@dataclass(frozen=True)
class Paper(Rule):
    """Sends the reward itself: Bartlett and Baxter (1999), equation (neuron-update)."""

    name = "paper"
    summary = "the reward itself, as in the paper"

    @staticmethod
    def modulate(memory: Any, constants: Any, reward: Any, ended: Any, sent: Any) -> None:
        for lane in range(len(reward)):
            sent[lane] = reward[lane]


PAPER = Paper()
