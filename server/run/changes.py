"""The changes that alter a run's trajectory; each is checked on construction.

A change is logged with the step at which it took effect; the seed and the log reproduce the run.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field

from hebbviz.learner.learner import Learner
from hebbviz.limits import check_beta, check_fall, check_gamma, check_reward
from hebbviz.rules.base import make_rule


@dataclass(frozen=True)
class Change(ABC):
    """A change carries its target state, not a toggle; `words` is its text for Undo."""

    @abstractmethod
    def apply(self, learner: Learner) -> None:
        """Change the learner; raises ValueError or TaskError if that is impossible."""


@dataclass(frozen=True)
class SetBeta(Change):
    beta: float

    def __post_init__(self) -> None:
        check_beta(self.beta)

    def apply(self, learner: Learner) -> None:
        learner.set_beta(self.beta)

    def __str__(self) -> str:
        return f"β {self.beta:.6g}"


@dataclass(frozen=True)
class SetGamma(Change):
    gamma: float

    def __post_init__(self) -> None:
        check_gamma(self.gamma)

    def apply(self, learner: Learner) -> None:
        learner.set_gamma(self.gamma)

    def __str__(self) -> str:
        return f"γ {self.gamma:.3g}"


@dataclass(frozen=True)
class SetFall(Change):
    """Let γ fall over this many steps; infinity keeps it constant."""

    fall: float

    def __post_init__(self) -> None:
        check_fall(self.fall)

    def apply(self, learner: Learner) -> None:
        learner.set_fall(self.fall)

    def __str__(self) -> str:
        return "γ constant" if math.isinf(self.fall) else f"γ falls over {self.fall:.6g} steps"


@dataclass(frozen=True)
class SetRule(Change):
    """Switch to another rule or other parameters, in the form that `rules.make_rule` parses."""

    rule: str

    def __post_init__(self) -> None:
        make_rule(self.rule)

    def apply(self, learner: Learner) -> None:
        learner.set_rule(make_rule(self.rule))

    def __str__(self) -> str:
        return f"rule {self.rule}"


@dataclass(frozen=True)
class Freeze(Change):
    frozen: bool

    def apply(self, learner: Learner) -> None:
        learner.freeze(self.frozen)

    def __str__(self) -> str:
        return "learning frozen" if self.frozen else "learning on"


@dataclass(frozen=True)
class GiveReward(Change):
    reward: float

    def __post_init__(self) -> None:
        check_reward(self.reward)

    def apply(self, learner: Learner) -> None:
        learner.give_reward(self.reward)

    def __str__(self) -> str:
        return f"manual reward {self.reward:+.3g}"


@dataclass(frozen=True)
class Press(Change):
    control: str

    def apply(self, learner: Learner) -> None:
        learner.press(self.control)

    def __str__(self) -> str:
        return self.control.lower()


@dataclass(frozen=True)
class Logged:
    """A change and the step before which it took effect. `goes_on`: it continues the previous
    change, as a slider that is dragged does.
    """

    step: int
    change: Change
    goes_on: bool = field(default=False, compare=False)


def settled(log: Sequence[Logged]) -> list[Logged]:
    """A log in which dragging a slider is one change, to the value where it settled.

    Recomputing the run needs all changes; readers need only these.
    """
    following = [*(c.goes_on for c in log[1:]), False]
    return [c for c, is_passing in zip(log, following, strict=False) if not is_passing]
