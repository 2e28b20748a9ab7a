"""What a world must say so that a network can learn in it.

A task is a small partially observable decision process with all of its state in one array of
numbers. Its parts are separate functions, and each is pure: the next state depends on nothing but
the state, the action and the draws. That alone makes runs repeatable, saves exact, and lets the
page rewind. `hebbviz/conformance.py` checks any task against this contract.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hebbviz.task.presets import Preset, Switch, UnknownPreset, find_preset, is_on, spelled
from hebbviz.theory.poisson import time_to_event
from hebbviz.topology import SYMMETRIC, Activity, Topology, feedforward

if TYPE_CHECKING:
    from hebbviz.learner.learner import Learner
    from hebbviz.theory.exact_gradient import GradientTruth

Array = NDArray[np.float64]

FROZEN_STEPS = 100_000
"""Of a frozen copy that is evaluated, as in the paper."""


@dataclass(frozen=True)
class Input:
    """One input value: what it is, its unit, and the gain that makes it an activity."""

    name: str
    unit: str = ""
    gain: float = 1.0


@dataclass(frozen=True)
class Output:
    """One output neuron: what the world does when it fires and when it is silent."""

    name: str
    fires: str
    silent: str


@dataclass(frozen=True)
class Tally:
    """Totals over a stretch of steps: the task's reward, the broadcast one, episodes ended."""

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
    """A task's measure of success over a stretch.

    A mean time to an event is an estimate, made by `per_event`: `events` were counted in a `time`.
    """

    value: float
    events: int | None = None
    time: float = 0.0

    @classmethod
    def per_event(cls, time: float, events: float) -> Score:
        """time/events, the maximum-likelihood estimate also if the last wait was cut short;
        infinite without an event.
        """
        count = round(events)
        return cls(time / count if count else math.inf, count, time)

    @property
    def interval(self) -> tuple[float, float]:
        """Of a mean time to an event: its 95 % interval, see `poisson.time_to_event`."""
        return time_to_event(self.time, self.events or 0)


@dataclass(frozen=True)
class Measure:
    """What the learning curve shows: a name, a key for files, a unit, and its axis.

    `span` is the range of the axis, None for one that follows the curve; a logarithmic axis
    needs one. A mean time to an event says which `event`, in the singular: its scores are made by
    `Score.per_event`.
    """

    name: str
    key: str
    unit: str = ""
    span: tuple[float, float] | None = None
    logarithmic: bool = False
    event: str = ""

    @property
    def keys(self) -> tuple[str, ...]:
        """The figures that tell it: the key alone, or with the number of events and both ends of
        the 95 % interval.
        """
        return (self.key, f"{self.event}s", *self.ends) if self.event else (self.key,)

    @property
    def ends(self) -> tuple[str, str]:
        """The keys of the ends of the 95 % interval."""
        return f"{self.key}_low", f"{self.key}_high"

    def figures(self, score: Score) -> dict[str, float]:
        """A score as the figures of `keys`; infinite are the time to an event that was not seen,
        and the upper end of its interval.
        """
        if not self.event:
            return {self.key: score.value}
        return dict(zip(self.keys, (score.value, score.events or 0, *score.interval), strict=True))


@dataclass(frozen=True)
class Prop:
    """A thing of the world's scene: 'box', 'sphere' or 'cylinder' of unit size, to be scaled.

    `color` is red, green, blue in 0..1, or the name of a role in the page's palette: 'world',
    'world strong', 'accent', 'positive', 'negative'. `trail` asks for the path it took.
    """

    name: str
    shape: str
    color: str | tuple[float, float, float] = "world"
    trail: bool = False


@dataclass(frozen=True)
class Pose:
    """Where the props are: arrays in the order of `Task.props`, and a line of words.

    `position` (props, 3) in scene units, z up; `rotation` (props, 4) quaternions, w first;
    `scale` (props, 3) full extent along each axis.
    """

    position: Array
    rotation: Array
    scale: Array
    words: str = ""


@dataclass(frozen=True)
class Reading:
    """A number of the world to be recorded and plotted; `steps`: it jumps, and holds between."""

    name: str
    unit: str = ""
    steps: bool = False


@dataclass(frozen=True)
class Control:
    """A button of the task on the page; pressing it calls `Task.press` with its name."""

    name: str
    hint: str
    key: str | None = None


class Task:
    """A world to learn in. Subclass it; a worked example is in the README.

    One object serves one thread at a time; whoever needs another makes another.

    The draws of a restart are others than those of the transition that ended the episode.

    Class attributes say what it is; the methods say how it goes. Everything below `outputs` may
    be left as it is.
    """

    name: ClassVar[str]
    summary: ClassVar[str] = ""
    version: ClassVar[int] = 1
    """Raised when the same state, action and draws come to lead to something else: a recording made
    before then says why its steps cannot be made again.
    """
    outputs: ClassVar[tuple[Output, ...]]
    presets: ClassVar[Mapping[str, Preset]]
    dt: ClassVar[float | None] = None
    """Seconds that a step lasts; None for a task that has no time but its steps."""
    epoch: int | None = None
    """Steps of one pass over a training set; None for a task that has none."""
    switches: ClassVar[tuple[Switch, ...]] = ()
    """What can be switched on or off beside any preset."""
    hidden: ClassVar[tuple[int, ...]] = (8,)
    """Sizes of the hidden layers, where the preset brings none of its own."""
    activity: ClassVar[Activity] = SYMMETRIC
    weight_range: ClassVar[float] = 0.1
    """Initial weights are uniform in ± this."""
    measure: ClassVar[Measure] = Measure("average reward", "average_reward", "per step")
    frozen_figures: tuple[str, ...] = ()
    """Keys of `evaluate` for the learning curve; fractions where the measure is in %."""
    readings: ClassVar[tuple[Reading, ...]] = ()
    """What recordings plot of the world, in the order of `read`."""
    props: Sequence[Prop] = ()
    legend: ClassVar[str] = ""
    """What is to be known of the props to see what they show."""
    controls: ClassVar[tuple[Control, ...]] = ()
    natural_speed: float | None = None
    """Steps per second at which the page opens; None for as fast as it goes."""
    watch_speed: ClassVar[float | None] = None
    """Steps per second of the excerpts that the page plays; None for real time, or 25."""
    hand_reward: ClassVar[float] = 1.0
    """How much reward the page's + and - buttons give."""

    inputs: tuple[Input, ...]

    def __init__(self, preset: str | None = None) -> None:
        self.preset_name, self.preset = self.find_preset(preset)

    def find_preset(self, spec: str | None) -> tuple[str, Preset]:
        """The preset of a name, as `presets.find_preset` reads it, and its shortest name; the
        task's first for None.

        Raises UnknownPreset for a preset or a switch that the task does not have.
        """
        wanted = next(iter(self.presets)) if spec is None else spec
        try:
            return find_preset(self.presets, self.switches, wanted)
        except UnknownPreset as error:
            raise UnknownPreset(f"task {self.name!r} has {error}") from error

    @property
    def plain_preset(self) -> str:
        """The preset's name without what was switched."""
        name = self.preset_name
        return name if name in self.presets else name.partition(":")[0]

    @property
    def settings(self) -> dict[str, bool]:
        """Which of the switches are on."""
        return {s.name: is_on(self.preset, s) for s in self.switches}

    @property
    def note(self) -> str:
        """What the preset and the switches that are on make of it, in a sentence."""
        return "; ".join(
            (self.preset.note, *(s.words for s in self.switches if is_on(self.preset, s)))
        )

    def switched(self, name: str, on: bool) -> str:
        """The name of this setting with one of the switches set."""
        return self.find_preset(spelled(self.plain_preset, self.settings | {name: on}))[0]

    # The world

    def restart(self, draws: Callable[[int], Array]) -> Array:
        """A new episode's state, shape (numbers of the state,)."""
        raise NotImplementedError

    def transition(self, state: Array, action: Array, draws: Callable[[int], Array]) -> Array:
        """The state after one step; `action` (outputs,) holds the outputs' activities u."""
        raise NotImplementedError

    def observation(self, state: Array) -> Array:
        """The input values, shape (inputs,), gains applied."""
        raise NotImplementedError

    def reward(self, state: Array) -> float:
        """The reward for having come into this state."""
        raise NotImplementedError

    def ended(self, state: Array) -> bool:
        """Whether the episode ends here; the next state is then a restart."""
        return False

    def clamps(self, state: Array) -> Array | None:
        """What makes neurons fire (1) or not (0) at the next step, NaN leaving it to chance.

        Shape (neurons,), in the order of the topology; None leaves all of them to chance.
        """
        return None

    def press(self, state: Array, control: str) -> Array:
        """The state after a button of `controls` was pressed."""
        return state

    def check_states(self, states: Array) -> None:
        """Raise ValueError if one of the states (n, numbers), read from a file, cannot be.

        For what compiled code would trip over unseen, such as a number that it looks up a table by.
        """

    def in_lanes(self) -> Task:
        """The same world compiled, for many lanes at once; itself where there is no other."""
        return self

    # What is seen of it

    def pose(self, state: Array) -> Pose:
        """The scene of a state."""
        return Pose(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros((0, 3)))

    def poses(self, states: Array) -> tuple[Array, Array, Array]:
        """Positions, rotations and scales of many states (n, numbers), each (n, props, 3 or 4).

        As `pose` says for each of them; worth writing for a task whose recordings show a world.
        """
        poses = [self.pose(state) for state in states]
        return (
            np.array([p.position for p in poses]), np.array([p.rotation for p in poses]),
            np.array([p.scale for p in poses]),
        )  # fmt: skip

    def read(self, states: Array) -> Array:
        """The `readings` of many states: (n, numbers) in, (n, readings) out."""
        return np.zeros((len(states), 0))

    # How well it goes

    def score(self, tally: Tally) -> Score:
        """The measure of success over a stretch of steps."""
        return Score(tally.average_reward)

    def evaluate(self, learner: Learner) -> dict[str, Array]:
        """How a frozen copy does in each lane, (lanes,), in a run of its own: the figures of the
        measure over 100 000 steps.

        The learner is left as it is.
        """
        tallies = learner.frozen_copy().skip_tallied(FROZEN_STEPS)
        figures = [self.measure.figures(self.score(t)) for t in tallies]
        return {key: np.array([f[key] for f in figures]) for key in self.measure.keys}

    def results(self, learner: Learner, late: Tally) -> dict[str, float]:
        """The figures `hebbviz train` reports; `late` covers the last fifth of its steps."""
        return self.measure.figures(self.score(late))

    def truth(self, weights: Array, topology: Topology, beta: float) -> GradientTruth | None:
        """The true gradient for `weights` (synapses,), of a task that can know it; else None.

        A task that has it is shown with it beside the rule's estimate. It is asked for a few
        times a second, by several threads. Raises ValueError where there is none for this
        network, and says why.
        """
        return None

    # What a learner starts from

    def topology(self, hidden: Sequence[int] | None = None) -> Topology:
        """The network for the task: feedforward, with the preset's hidden layers unless given."""
        own = self.hidden if self.preset.hidden is None else self.preset.hidden
        sizes = own if hidden is None else tuple(hidden)
        return feedforward(len(self.inputs), sizes, len(self.outputs), activity=self.activity)

    def initial_weights(self, draws: Array) -> Array:
        """Initial weights from uniform draws, both of shape (synapses,)."""
        return self.weight_range * (2.0 * draws - 1.0)


class CompiledTask(Task):
    """A task whose step is compiled too: the same functions, for all lanes at once.

    `answer` is a function compiled with the signature `signature.WORLD`. It must do what the
    methods of the task do, to the bit; the conformance suite compares them.

    There are no `clamps`, which compiled code does not ask for; a `Learner` refuses a task that has
    some. Whether rewards and inputs are finite is looked at after all the steps of a call. If one
    is not, TaskError is raised and the learner is where it was before the call; only an input that
    was not finite in between and is so at the end goes unseen.
    """

    answer: ClassVar[Any]

    def data(self) -> Array:
        """Constants that `answer` reads, shape (rows, columns)."""
        return np.zeros((1, 1))
