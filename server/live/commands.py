"""Commands to a session other than changes of its run; each is checked on construction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from hebbviz.server.live.fork import Difference
from hebbviz.server.live.pacing import Speed, check_speed
from hebbviz.server.live.session import Session
from hebbviz.server.live.view_mode import Event
from hebbviz.server.run.changes import Change
from hebbviz.server.run.run import reset_words
from hebbviz.sims.program.learner_from_arguments import MOST_SHOWN_LANES


class Action(ABC):
    """A command that controls how a run is stepped and shown, or which run it is. It carries its
    target state, not a toggle.
    """

    @abstractmethod
    def apply(self, session: Session) -> None:
        """Carry it out; raises ValueError or TaskError if that is impossible."""


Command = Change | Action


def carry_out(command: Command, session: Session) -> None:
    """Carry out a command; raises ValueError or TaskError if that is impossible."""
    if isinstance(command, Change):
        session.change(command)
    else:
        command.apply(session)


@dataclass(frozen=True)
class Pause(Action):
    paused: bool

    def apply(self, session: Session) -> None:
        session.pause(self.paused)


@dataclass(frozen=True)
class StepOnce(Action):
    steps: int = 1

    def apply(self, session: Session) -> None:
        session.step(self.steps)


@dataclass(frozen=True)
class SetSpeed(Action):
    speed: Speed

    def __post_init__(self) -> None:
        check_speed(self.speed)

    def apply(self, session: Session) -> None:
        session.set_speed(self.speed)


@dataclass(frozen=True)
class Reset(Action):
    """Start again with the current β, γ and rule, optionally with a new seed or another number of
    lanes. Lane k of a seed is the same run whatever lanes are beside it, unless the rule lets lanes
    touch each other. `switch` sets one of the task's switches.
    """

    seed: int | None = None
    lanes: int | None = None
    switch: tuple[str, bool] | None = None

    def __post_init__(self) -> None:
        if self.lanes is not None and not 1 <= self.lanes <= MOST_SHOWN_LANES:
            raise ValueError(f"lanes must be from 1 to {MOST_SHOWN_LANES}, got {self.lanes}")

    def apply(self, session: Session) -> None:
        session.reset(seed=self.seed, lanes=self.lanes, switch=self.switch)

    def __str__(self) -> str:
        return reset_words(self.seed, self.lanes, self.switch)


@dataclass(frozen=True)
class Choose(Action):
    """Choose another task, preset or network."""

    task: str
    preset: str | None = None
    hidden: tuple[int, ...] | None = None

    def apply(self, session: Session) -> None:
        session.choose(self.task, self.preset, self.hidden)

    def __str__(self) -> str:
        return f"task {self.task}"


@dataclass(frozen=True)
class Undo(Action):
    def apply(self, session: Session) -> None:
        session.undo()


@dataclass(frozen=True)
class SetWatch(Action):
    """Play excerpts at a speed the eye can follow, while the run continues."""

    on: bool

    def apply(self, session: Session) -> None:
        session.showing.watch_excerpts(on=self.on)


@dataclass(frozen=True)
class SetWatchSpeed(Action):
    """Set the steps per second of the excerpts."""

    speed: float

    def __post_init__(self) -> None:
        if not isinstance(check_speed(self.speed), float):
            raise ValueError(f"the speed of excerpts must be in steps per second, got {self.speed}")

    def apply(self, session: Session) -> None:
        session.showing.watch.speed = self.speed


@dataclass(frozen=True)
class ShowReward(Action):
    """Play the latest reward in slow motion."""

    def apply(self, session: Session) -> None:
        session.showing.show_reward()


@dataclass(frozen=True)
class ShowBeginning(Action):
    """Play the first steps of the run, if Watch is on."""

    def apply(self, session: Session) -> None:
        session.showing.show_beginning()


@dataclass(frozen=True)
class Evaluate(Action):
    """Evaluate a frozen copy while the run continues."""

    def apply(self, session: Session) -> None:
        session.evaluate()


@dataclass(frozen=True)
class WatchLane(Action):
    """Choose the lane that is shown."""

    lane: int

    def apply(self, session: Session) -> None:
        session.showing.look_at(self.lane)


@dataclass(frozen=True)
class NextLane(Action):
    """Show the next lane, or the previous one with -1; wraps around."""

    by: int = 1

    def apply(self, session: Session) -> None:
        session.showing.look_at_next(self.by)


@dataclass(frozen=True)
class Probe(Action):
    """Set the synapses whose traces the tabs follow."""

    synapses: tuple[int, ...]

    def apply(self, session: Session) -> None:
        session.showing.probe(self.synapses)


@dataclass(frozen=True)
class Seek(Action):
    """Show a step of the run; the run itself pauses until takeover or return to now."""

    step: int

    def __post_init__(self) -> None:
        if self.step < 0:
            raise ValueError(f"steps are counted from 0, got {self.step}")

    def apply(self, session: Session) -> None:
        session.showing.visit().seek(self.step)


@dataclass(frozen=True)
class SeekEvent(Action):
    event: Event

    def apply(self, session: Session) -> None:
        session.showing.seek_event(self.event)


@dataclass(frozen=True)
class SetLoop(Action):
    """Play from the beginning again at the end."""

    loop: bool

    def apply(self, session: Session) -> None:
        session.showing.visit().loop = self.loop


@dataclass(frozen=True)
class BackToNow(Action):
    """Leave the past and show the run's present."""

    def apply(self, session: Session) -> None:
        session.showing.back_to_now()


@dataclass(frozen=True)
class TakeOver(Action):
    """Continue live from the step that is shown."""

    def apply(self, session: Session) -> None:
        session.take_over()


@dataclass(frozen=True)
class StartFork(Action):
    """Continue from the step that is shown in two copies that differ in one setting, see `fork`."""

    kind: str
    value: float | None = None

    def apply(self, session: Session) -> None:
        session.begin_fork(Difference(self.kind, self.value))


@dataclass(frozen=True)
class EndFork(Action):
    """Keep one of the two copies."""

    keep_other: bool = False

    def apply(self, session: Session) -> None:
        session.end_fork(keep_other=self.keep_other)


@dataclass(frozen=True)
class StartRecording(Action):
    """Record into a file of this name, in the folder for recordings."""

    name: str

    def apply(self, session: Session) -> None:
        session.start_recording(self.name)


@dataclass(frozen=True)
class StopRecording(Action):
    def apply(self, session: Session) -> None:
        session.recordings.stop()
