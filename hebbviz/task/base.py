"""The contract of a task: the world that a network learns in.

A task is a small partially observable decision process whose whole state is one array of numbers.
Its methods are pure functions: the next state depends only on the state, the action and the random
draws. Runs are therefore repeatable, saves are exact, and the page can rewind.
`hebbviz/conformance.py` checks a task against this contract.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hebbviz.task.presets import Preset, Switch, UnknownPreset, find_preset, is_on, spelled
from hebbviz.task.scene import Control, Pose, Prop
from hebbviz.theory.poisson import time_to_event
from hebbviz.topology import SYMMETRIC, Activity, Topology, feedforward

if TYPE_CHECKING:
    from hebbviz.theory.exact_gradient import GradientTruth

Array = NDArray[np.float64]

FROZEN_STEPS = 100_000
"""Steps for which a frozen copy is evaluated, as in the paper."""


@dataclass(frozen=True)
class Input:
    """One input value: its name, its unit, and the gain that converts it to an activity."""

    name: str
    unit: str = ""
    gain: float = 1.0


@dataclass(frozen=True)
class Output:
    """One output neuron: its name, and its effect when it fires and when it is silent."""

    name: str
    fires: str
    silent: str


@dataclass(frozen=True)
class Tally:
    """Totals over a number of steps: task reward, broadcast reward, episodes ended."""

    steps: int
    reward: float
    broadcast: float
    ended: float

    def __sub__(self, earlier: Tally) -> Tally:
        return Tally(
            self.steps - earlier.steps,
            self.reward - earlier.reward,
            self.broadcast - earlier.broadcast,
            self.ended - earlier.ended,
        )

    @property
    def average_reward(self) -> float:
        return self.reward / max(1, self.steps)


@dataclass(frozen=True)
class Score:
    """A value of a task's measure, computed over a number of steps.

    `per_event` makes a mean time to an event, an estimate from `events` counted during `time`.
    """

    value: float
    events: int | None = None
    time: float = 0.0

    @classmethod
    def per_event(cls, time: float, events: float) -> Score:
        """Return time/events, infinite without an event.

        This is the maximum-likelihood estimate, even if the last wait was cut short.
        """
        count = round(events)
        return cls(time / count if count else math.inf, count, time)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval of a mean time to an event, see `poisson.time_to_event`."""
        return time_to_event(self.time, self.events or 0)


@dataclass(frozen=True)
class Measure:
    """The quantity of the learning curve: its name, its key in files, its unit and its axis.

    `span` is the range of the axis; None scales the axis to the curve. A logarithmic axis needs a
    span. A mean time to an event names the `event`, in the singular; `Score.per_event` makes its
    scores.
    """

    name: str
    key: str
    unit: str = ""
    span: tuple[float, float] | None = None
    logarithmic: bool = False
    event: str = ""

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of its figures: its own; for a mean time to an event also those of the number
        of events and of both ends of the 95 % interval.
        """
        return (self.key, f"{self.event}s", *self.ends) if self.event else (self.key,)

    @property
    def ends(self) -> tuple[str, str]:
        """The keys of the lower and upper ends of the 95 % interval."""
        return f"{self.key}_low", f"{self.key}_high"

    def figures(self, score: Score) -> dict[str, float]:
        """Return the figures of a score by the names in `keys`.

        Without an event the mean time and the upper end of its interval are infinite.
        """
        if not self.event:
            return {self.key: score.value}
        return dict(zip(self.keys, (score.value, score.events or 0, *score.interval), strict=True))


@dataclass(frozen=True)
class Reading:
    """A number that recordings plot; `steps` marks one that is piecewise constant."""

    name: str
    unit: str = ""
    steps: bool = False


class Evaluable(Protocol):
    """The part of a `Learner` that `Task.evaluate` and `Task.results` use."""

    watch: int

    @property
    def lanes(self) -> int:
        """Number of lanes."""

    @property
    def weights(self) -> Array:
        """Weights w, (synapses, lanes)."""

    @property
    def world(self) -> Array:
        """State of the task, (numbers, lanes)."""

    def place(self, world: Array) -> None:
        """Set the state of the task, (numbers, lanes)."""

    def skip_tallied(self, steps: int) -> list[Tally]:
        """Run `steps` steps and return their totals in each lane."""

    def frozen_copy(self, task: Task | None = None) -> Evaluable:
        """Return a copy that does not learn, in `task` or in its own."""


class Task:
    """A world to learn in. Subclass it; the README has a worked example.

    Class attributes describe the task, methods define its dynamics. All attributes below `outputs`
    have defaults.

    One object serves one thread at a time; each thread makes its own. A restart draws other random
    numbers than the transition that ended the episode.
    """

    name: ClassVar[str]
    summary: ClassVar[str] = ""
    version: ClassVar[int] = 1
    """Increased when the same state, action and draws lead to another result, so that an older
    recording can explain why its steps cannot be recomputed.
    """
    outputs: ClassVar[tuple[Output, ...]]
    presets: ClassVar[Mapping[str, Preset]]
    dt: ClassVar[float | None] = None
    """Duration of a step in s; None for a task without a time scale."""
    epoch: int | None = None
    """Steps of one pass over the training set; None for a task without one."""
    switches: ClassVar[tuple[Switch, ...]] = ()
    """Options that can be switched on or off with any preset."""
    hidden: ClassVar[tuple[int, ...]] = (8,)
    """Sizes of the hidden layers, unless the preset gives its own."""
    activity: ClassVar[Activity] = SYMMETRIC
    weight_range: ClassVar[float] = 0.1
    """Initial weights are uniform in ±weight_range."""
    measure: ClassVar[Measure] = Measure("average reward", "average_reward", "per step")
    frozen_figures: tuple[str, ...] = ()
    """Keys of `evaluate` for the learning curve; fractions where the measure is in %."""
    readings: ClassVar[tuple[Reading, ...]] = ()
    """Numbers of the world that recordings plot, in the order of `read`."""
    props: Sequence[Prop] = ()
    legend: ClassVar[str] = ""
    """A short explanation of the scene objects."""
    controls: ClassVar[tuple[Control, ...]] = ()
    natural_speed: float | None = None
    """Steps per second when the page opens; None for full speed."""
    watch_speed: ClassVar[float | None] = None
    """Steps per second of the excerpts that the page plays; None for real time, or 25 steps per
    second where `dt` is None.
    """
    hand_reward: ClassVar[float] = 1.0
    """Size of the manual reward that the page's + and - buttons give."""

    inputs: tuple[Input, ...]

    def __init__(self, preset: str | None = None) -> None:
        self.preset_name, self.preset = self.find_preset(preset)

    def find_preset(self, spec: str | None) -> tuple[str, Preset]:
        """Return the shortest name and the preset that `spec` names; for None the first preset.

        `presets.find_preset` reads the spec. Raises UnknownPreset for a preset or a switch that
        the task does not have.
        """
        wanted = next(iter(self.presets)) if spec is None else spec
        try:
            return find_preset(self.presets, self.switches, wanted)
        except UnknownPreset as error:
            raise UnknownPreset(f"task {self.name!r} has {error}") from error

    @property
    def plain_preset(self) -> str:
        """The preset's name without its switches."""
        name = self.preset_name
        return name if name in self.presets else name.partition(":")[0]

    @property
    def settings(self) -> dict[str, bool]:
        """Each switch's name, and whether it is on."""
        return {s.name: is_on(self.preset, s) for s in self.switches}

    @property
    def note(self) -> str:
        """One sentence about the preset and the switches that are on."""
        return "; ".join(
            (self.preset.note, *(s.words for s in self.switches if is_on(self.preset, s)))
        )

    def switched(self, name: str, on: bool) -> str:
        """Return the name of this preset with one of the switches set to `on`."""
        return self.find_preset(spelled(self.plain_preset, self.settings | {name: on}))[0]

    # The world

    def restart(self, draws: Callable[[int], Array]) -> Array:
        """Return the first state of an episode, (numbers,); `draws(n)` gives n uniform numbers."""
        raise NotImplementedError

    def transition(self, state: Array, action: Array, draws: Callable[[int], Array]) -> Array:
        """Return the state after one step; `action` (outputs,) holds the outputs' activities u."""
        raise NotImplementedError

    def observation(self, state: Array) -> Array:
        """Return the input values of a state, (inputs,), with the gains applied."""
        raise NotImplementedError

    def reward(self, state: Array) -> float:
        """Return the reward for entering this state."""
        raise NotImplementedError

    def ended(self, state: Array) -> bool:
        """Whether the episode ends in this state; `restart` then gives the next state."""
        return False

    def clamps(self, state: Array) -> Array | None:
        """Return the clamps of the next step, (neurons,) in the order of the topology, or None.

        1 makes a neuron fire, 0 keeps it silent, NaN lets it draw its spike; None clamps nothing.
        """
        return None

    def press(self, state: Array, control: str) -> Array:
        """Return the state after a button of `controls` was pressed."""
        return state

    def check_states(self, states: Array) -> None:
        """Raise ValueError if one of the states (n, numbers), read from a file, is invalid.

        Check what compiled code uses unchecked, such as an index into a table.
        """

    # What is seen of it

    def pose(self, state: Array) -> Pose:
        """Return the pose of the scene objects in a state."""
        return Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)))

    def poses(self, states: Array) -> tuple[Array, Array, Array]:
        """Return positions, rotations and scales of states (n, numbers), each (n, props, 3 or 4).

        The result equals `pose` of each state. Override it to make recordings with a scene faster.
        """
        poses = [self.pose(state) for state in states]
        return (
            np.array([p.position for p in poses]),
            np.array([p.rotation for p in poses]),
            np.array([p.scale for p in poses]),
        )

    def read(self, states: Array) -> Array:
        """Return the `readings` of states (n, numbers), as (n, readings)."""
        return np.zeros((len(states), 0))

    # How well it goes

    def score(self, tally: Tally) -> Score:
        """Return the measure over the steps of a tally."""
        return Score(tally.average_reward)

    def evaluate(self, learner: Evaluable) -> dict[str, Array]:
        """Return the measure's figures by key, (lanes,) each, of a frozen copy over 100 000 steps.

        The copy runs separately; the learner does not change.
        """
        tallies = learner.frozen_copy().skip_tallied(FROZEN_STEPS)
        figures = [self.measure.figures(self.score(t)) for t in tallies]
        return {key: np.array([f[key] for f in figures]) for key in self.measure.keys}

    def results(self, learner: Evaluable, late: Tally) -> dict[str, float]:
        """Return the figures that `hebbviz train` prints; `late` covers the last fifth of a run."""
        return self.measure.figures(self.score(late))

    def truth(self, weights: Array, topology: Topology, beta: float) -> GradientTruth | None:
        """Return the exact gradient at `weights` (synapses,), or None if the task has none.

        The page shows it beside the rule's estimate. Several threads call this a few times per
        second. Raises ValueError, with the reason, if this network has no exact gradient.
        """
        return None

    # What a learner starts from

    def topology(self, hidden: Sequence[int] | None = None) -> Topology:
        """Return the network: feedforward, with the preset's hidden layers unless given."""
        own = self.hidden if self.preset.hidden is None else self.preset.hidden
        sizes = own if hidden is None else tuple(hidden)
        return feedforward(len(self.inputs), sizes, len(self.outputs), activity=self.activity)

    def initial_weights(self, draws: Array) -> Array:
        """Return initial weights from uniform draws, both of shape (synapses,)."""
        return self.weight_range * (2.0 * draws - 1.0)


class CompiledTask(Task):
    """A task that also has a compiled step for all lanes.

    `answer` is a function compiled with the signature `signature.WORLD`. It must give the same bits
    as the task's methods; the conformance suite compares them.

    Compiled code does not call `clamps`, so a `Learner` refuses a compiled task that defines it.
    Rewards and inputs are checked after all steps of a call: if one is not finite, TaskError is
    raised and the learner returns to its state before the call. An input that was not finite in
    between but is finite at the end is not detected.
    """

    answer: ClassVar[Any]

    def data(self) -> Array:
        """Return the constants that `answer` reads, (rows, columns)."""
        return np.zeros((1, 1))
