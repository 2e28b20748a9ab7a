"""A rule of a user's own: half of the reward is sent."""

from __future__ import annotations

from typing import Any

from hebbviz import Rule


class Half(Rule):
    name = "half"

    @staticmethod
    def modulate(memory: Any, constants: Any, reward: Any, ended: Any, sent: Any) -> None:
        for lane in range(len(reward)):
            sent[lane] = 0.5 * reward[lane]
