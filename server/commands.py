"""What can be asked of a run. Commands carry targets, not toggles, and are checked when made.

The first group changes the trajectory: such a command is logged with the step at which it took
effect, and the log with the seed makes the run again. The second group only says how the run is
stepped and shown.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from hebbviz.learner import Learner
from hebbviz.limits import check_beta, check_fall, check_gamma, check_reward
from hebbviz.rules import make_rule
from server.making import MOST_SHOWN_LANES

LARGEST_SPEED = 1e9
REALTIME = "realtime"
MAX = "max"

Speed = float | str
"""Steps per second, or 'realtime' (tasks with a dt), or 'max'."""


def check_speed(speed: Speed) -> Speed:
    """The speed itself; raises ValueError unless it is 'max', 'realtime' or steps/s above 0."""
    if speed in (REALTIME, MAX):
        return speed
    if isinstance(speed, bool) or not isinstance(speed, (int, float)):
        raise ValueError(f"speed must be steps per second, realtime or max, got {speed!r}")
    if not math.isfinite(speed) or not 0.0 < speed <= LARGEST_SPEED:
        raise ValueError(f"speed must be above 0 and at most {LARGEST_SPEED:g}, got {speed!r}")
    return float(speed)


@dataclass(frozen=True)
class SetBeta:
    beta: float

    def __post_init__(self) -> None:
        check_beta(self.beta)

    def apply(self, learner: Learner) -> None:
        learner.set_beta(self.beta)

    def __str__(self) -> str:
        return f"β {self.beta:.6g}"


@dataclass(frozen=True)
class SetGamma:
    gamma: float

    def __post_init__(self) -> None:
        check_gamma(self.gamma)

    def apply(self, learner: Learner) -> None:
        learner.set_gamma(self.gamma)

    def __str__(self) -> str:
        return f"γ {self.gamma:.3g}"


@dataclass(frozen=True)
class SetFall:
    """Let γ fall over so many steps; infinity: let it stay."""

    fall: float

    def __post_init__(self) -> None:
        check_fall(self.fall)

    def apply(self, learner: Learner) -> None:
        learner.set_fall(self.fall)

    def __str__(self) -> str:
        return "γ stays" if math.isinf(self.fall) else f"γ falls over {self.fall:.6g} steps"


@dataclass(frozen=True)
class SetRule:
    """Go on with another rule, or other parameters of it, as `rules.make_rule` reads them."""

    rule: str

    def __post_init__(self) -> None:
        make_rule(self.rule)

    def apply(self, learner: Learner) -> None:
        learner.set_rule(make_rule(self.rule))

    def __str__(self) -> str:
        return f"rule {self.rule}"


@dataclass(frozen=True)
class Freeze:
    frozen: bool

    def apply(self, learner: Learner) -> None:
        learner.freeze(self.frozen)

    def __str__(self) -> str:
        return "learning frozen" if self.frozen else "learning on"


@dataclass(frozen=True)
class GiveReward:
    reward: float

    def __post_init__(self) -> None:
        check_reward(self.reward)

    def apply(self, learner: Learner) -> None:
        learner.give_reward(self.reward)

    def __str__(self) -> str:
        return f"reward {self.reward:+.3g} by hand"


@dataclass(frozen=True)
class Press:
    control: str

    def apply(self, learner: Learner) -> None:
        learner.press(self.control)

    def __str__(self) -> str:
        return self.control.lower()


Change = SetBeta | SetGamma | SetFall | SetRule | Freeze | GiveReward | Press
"""A command that changes the trajectory of a run."""


@dataclass(frozen=True)
class Logged:
    """A change and the step before which it took effect. `goes_on`: it goes on with the change
    before it, as a slider that is dragged.
    """

    step: int
    change: Change
    goes_on: bool = field(default=False, compare=False)


def settled(log: Sequence[Logged]) -> list[Logged]:
    """A log in which a slider that was dragged is one change, where it settled.

    The run needs all of them to be made again; who reads of them needs no more than these.
    """
    following = [*(c.goes_on for c in log[1:]), False]
    return [c for c, is_passing in zip(log, following, strict=False) if not is_passing]


@dataclass(frozen=True)
class Pause:
    paused: bool


@dataclass(frozen=True)
class StepOnce:
    steps: int = 1


@dataclass(frozen=True)
class SetSpeed:
    speed: Speed

    def __post_init__(self) -> None:
        check_speed(self.speed)


@dataclass(frozen=True)
class Reset:
    """Start again with the set β, γ and rule, from the same seed or from another, with as many
    lanes or another number: lane k of a seed is the same run whatever lanes are beside it, unless
    the rule lets lanes touch each other. `switch` sets one of the task's switches.
    """

    seed: int | None = None
    lanes: int | None = None
    switch: tuple[str, bool] | None = None

    def __post_init__(self) -> None:
        if self.lanes is not None and not 1 <= self.lanes <= MOST_SHOWN_LANES:
            raise ValueError(f"lanes must be from 1 to {MOST_SHOWN_LANES}, got {self.lanes}")

    def __str__(self) -> str:
        if self.switch is not None:
            name, on = self.switch
            return f"{name} {'on' if on else 'off'}"
        if self.lanes is not None:
            return f"{self.lanes} lane{'s' * (self.lanes != 1)}"
        return "reset" if self.seed is None else f"new seed {self.seed}"


@dataclass(frozen=True)
class Choose:
    """Another task, preset or network."""

    task: str
    preset: str | None = None
    hidden: tuple[int, ...] | None = None

    def __str__(self) -> str:
        return f"task {self.task}"


@dataclass(frozen=True)
class Undo:
    pass


@dataclass(frozen=True)
class SetWatch:
    """Play excerpts at a speed the eye can follow, while the run goes on."""

    on: bool


@dataclass(frozen=True)
class SetWatchSpeed:
    """Steps per second of the excerpts."""

    speed: float

    def __post_init__(self) -> None:
        if not isinstance(check_speed(self.speed), float):
            raise ValueError(f"the speed of excerpts must be in steps per second, got {self.speed}")


@dataclass(frozen=True)
class ShowReward:
    """Play the latest reward in slow motion."""


@dataclass(frozen=True)
class ShowBeginning:
    """Play the first steps of the run, if Watch is on."""


@dataclass(frozen=True)
class Evaluate:
    """See how a frozen copy does, while the run goes on."""


@dataclass(frozen=True)
class WatchLane:
    """The lane that is shown."""

    lane: int


@dataclass(frozen=True)
class NextLane:
    """Show the next lane, or with -1 the one before, round and round."""

    by: int = 1


@dataclass(frozen=True)
class Probe:
    """The synapses whose traces the tabs follow."""

    synapses: tuple[int, ...]


@dataclass(frozen=True)
class Seek:
    """Show a step of the run; the run itself rests until it is taken over, or left for now."""

    step: int

    def __post_init__(self) -> None:
        if self.step < 0:
            raise ValueError(f"steps are counted from 0, got {self.step}")


class Event(enum.Enum):
    """What can be looked for from the step that is shown."""

    CHANGE_BEFORE = "the change before"
    NEXT_CHANGE = "the next change"
    NEXT_REWARD = "the next reward"


@dataclass(frozen=True)
class SeekEvent:
    event: Event


@dataclass(frozen=True)
class SetLoop:
    """Play from the beginning again at the end."""

    loop: bool


@dataclass(frozen=True)
class BackToNow:
    """Leave the past and show the run where it is."""


@dataclass(frozen=True)
class TakeOver:
    """Go on live from the step that is shown."""


@dataclass(frozen=True)
class StartFork:
    """Go on from what is shown in two copies that differ in one thing, see `fork`."""

    kind: str
    value: float | None = None


@dataclass(frozen=True)
class EndFork:
    """Keep one of the two copies."""

    keep_other: bool = False


@dataclass(frozen=True)
class StartRecording:
    """Record into a file of this name, in the folder for recordings."""

    name: str


@dataclass(frozen=True)
class StopRecording:
    pass


Looking = (
    SetWatch | SetWatchSpeed | ShowReward | ShowBeginning | WatchLane | NextLane | Probe | Seek
    | SeekEvent | SetLoop | BackToNow
)  # fmt: skip
"""What only says how the run is looked at."""

Command = (
    Change | Pause | StepOnce | SetSpeed | Reset | Choose | Undo | Looking | TakeOver | StartFork
    | EndFork | Evaluate | StartRecording | StopRecording
)  # fmt: skip
