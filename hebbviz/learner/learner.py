"""A network, a task and the rule in closed loop. It knows no clock, no queue and no screen.

The trajectory is a pure function of task, topology, parameters and seed, and of the commands given
(`set_beta`, `set_gamma`, `set_fall`, `set_rule`, `set_weights`, `freeze`, `give_reward`, `press`,
`place`, `advance` with a reward) with the steps they were given at.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.batch import Tiles
from hebbviz.engine.buffers import NOBODY, Notes
from hebbviz.engine.layout import Layout
from hebbviz.learner.frames import Block, Frame, Keyframe
from hebbviz.learner.settings import RunSettings
from hebbviz.learner.summing import Summing
from hebbviz.learner.world import check_fit, world_of
from hebbviz.limits import (
    MOST_LANES,
    check_beta,
    check_dtype,
    check_fall,
    check_gamma,
    check_lane,
    check_reward,
    check_steps,
)
from hebbviz.numerics.counter_rng import INITIAL_WEIGHTS, LARGEST_SEED, check_seed, uniforms
from hebbviz.rules.base import Rule, RuleError, make_rule
from hebbviz.task.base import Tally, Task
from hebbviz.topology import Topology

Array = NDArray[np.float64]

EVALUATION_STEP = 2**40
"""Frozen copies count their steps from here, so that they draw other numbers than the learner."""


class TaskError(Exception):
    """A task or a rule raised or broke its contract in mid-run. The learner is at the step before;
    where the task is compiled, at the step it was at before the call.
    """


class Learner:
    """Lanes of one network learning one task; `watch` is the lane that Frames and Blocks show.

    Parameters
    ----------
    task : the world, at its preset; `beta`, `gamma`, `rule` and `fall` default to the preset's.
    hidden : sizes of the hidden layers, or `topology` for anything else; default the task's own.
    rule : what the reward is made into before it is sent to the synapses.
    fall : T in steps, γ in force at step t being γ T/(T + t); infinity for a γ that stays.
    dtype : of weights, traces and potentials: float64, or float32 for more lanes a second. Worlds,
        rewards and totals are float64 in both.
    written_out : whether `skip` is to run what is compiled for this network alone. The run is the
        same; if the network is small a step takes less time, a third less in 64 lanes of sonar in
        float32, once a quarter of a minute has been spent on compiling. For long runs of many
        lanes of a compiled task.
    seed : 0 to 2³² - 1, of all lanes.
    lanes, first_lane : how many runs side by side, from which number on. Lane k of a seed is the
        same run whatever lanes are beside it (unless the rule lets lanes touch each other).

    Raises
    ------
    ValueError
        For a parameter out of range; the message names it, its bound and the value.
    TaskError
        If the task raises or returns what its contract does not allow.
    """

    def __init__(
        self,
        task: Task,
        *,
        hidden: Sequence[int] | None = None,
        topology: Topology | None = None,
        beta: float | None = None,
        gamma: float | None = None,
        rule: Rule | None = None,
        fall: float | None = None,
        seed: int = 0,
        lanes: int = 1,
        first_lane: int = 0,
        dtype: type[np.floating[Any]] | str = np.float64,
        written_out: bool = False,
    ) -> None:
        if not 1 <= lanes <= MOST_LANES:
            raise ValueError(f"lanes must be from 1 to {MOST_LANES}, got {lanes}")
        if not 0 <= first_lane <= LARGEST_SEED - lanes:
            raise ValueError(f"first_lane must be from 0 to 2³² - 1 - lanes, got {first_lane}")
        self.task = task
        self.seed = check_seed(seed)
        self.topology = topology or task.topology(hidden)
        check_fit(task, self.topology)
        self.lanes, self.first_lane = lanes, first_lane
        self.watch = 0
        self.dtype, self._written_out = check_dtype(dtype), written_out
        self.layout = Layout(self.topology)
        self._tiles = Tiles(
            self.layout, seed=self.seed, first_lane=first_lane, lanes=lanes, dtype=self.dtype,
            written=written_out,
        )  # fmt: skip
        self._world = world_of(task, self._tiles)
        self._gamma = np.zeros((len(self.topology.projections), lanes))
        self._frozen = False
        self.probes: tuple[int, ...] = ()
        self._fall = check_fall(task.preset.fall if fall is None else fall)
        self.set_rule(make_rule(task.preset.rule) if rule is None else rule)
        self.set_beta(task.preset.beta if beta is None else beta)
        self.set_gamma(task.preset.gamma if gamma is None else gamma)
        self._tiles.put("weight", self._first_weights())
        with _blamed(task):
            self._world.start()
        self._new_summary()

    @classmethod
    def of(cls, task: Task, settings: RunSettings) -> Learner:
        """A learner with these settings, at its start; raises as `Learner` does."""
        learner = cls(
            task,
            topology=settings.topology,
            beta=settings.beta,
            gamma=settings.gamma,
            rule=settings.rule,
            fall=settings.fall,
            seed=settings.seed,
            lanes=settings.lanes,
            first_lane=settings.first_lane,
            dtype=settings.dtype,
            written_out=settings.unrolled,
        )
        learner.freeze(settings.frozen)
        return learner

    @property
    def settings(self) -> RunSettings:
        """The settings that make this run again, as they are now."""
        return RunSettings(
            topology=self.topology,
            beta=self.beta,
            gamma=self.gamma,
            fall=self._fall,
            rule=self._rule,
            seed=self.seed,
            lanes=self.lanes,
            first_lane=self.first_lane,
            dtype=self.dtype,
            unrolled=self._written_out,
            frozen=self._frozen,
        )

    # Moving on

    def advance(self, steps: int, *, closely: bool = False, reward: Array | None = None) -> Block:
        """Run `steps` steps and return what happened in each of them, in the watched lane.

        `closely`: potentials and the world's state of every step too. `reward` (steps,): sent to
        every synapse in place of what the rule makes of the task's reward, for controls and
        comparisons; what is given by hand (`give_reward`) is added to it, as always.

        Raises TaskError if the task fails; the learner is then at the end of the last good step,
        of a compiled task where it was before.
        """
        start = self.step
        numbers = len(self._world.state(self.watch)) if closely else None
        notes = Notes.of(check_steps(steps), self.topology.neurons, numbers)
        instead = np.zeros(0) if reward is None else np.array(reward, dtype=np.float64)
        if reward is not None and not (instead.shape == (steps,) and np.isfinite(instead).all()):
            raise ValueError(f"reward must be {steps} finite numbers, one for each step")
        self._run(steps, self.watch, notes, instead)
        r = notes.rewards
        return Block(
            start, notes.fired, r[:, 0], r[:, 1], r[:, 2] > 0, notes.potentials, notes.worlds
        )

    def skip(self, steps: int) -> None:
        """`advance` without notes: the same run, faster. The next Frame sums up from its end."""
        try:
            self._run(check_steps(steps), NOBODY, Notes.of(0, 0, None), np.zeros(0))
        finally:
            self._new_summary()

    def skip_tallied(self, steps: int) -> list[Tally]:
        """`skip`, and the totals of each lane over these steps."""
        before = self.tallies()
        self.skip(steps)
        return [now - then for now, then in zip(self.tallies(), before, strict=True)]

    def _run(self, steps: int, watch: int, notes: Notes, instead: Array) -> None:
        with _blamed(self.task):
            self._world.run(steps, instead=instead, watch=watch, notes=notes, since=self._since)

    # Commands: each takes effect before the next step

    def set_beta(self, beta: float) -> None:
        """How long the traces remember: z fades by β each step. Resets nothing."""
        self._tiles.put("beta", check_beta(beta))

    def set_gamma(self, gamma: float) -> None:
        """The step size γ. While learning is frozen it is only remembered."""
        self._gamma[:] = check_gamma(gamma)
        self._put_gamma()

    def set_fall(self, fall: float) -> None:
        """Let γ fall over T steps: in force at step t is γ/(1 + t/T), with t counted from the
        start of the run and rounded down to a multiple of FALL_EVERY. Infinity: γ stays.
        """
        self._fall = check_fall(fall)
        self._put_gamma()

    def set_rule(self, rule: Rule) -> None:
        """Go on with another rule, or other parameters of it, its memory empty.

        Raises ValueError if it needs more or fewer lanes, or cannot be compiled; nothing has
        happened then.
        """
        rule.check_lanes(self.lanes)
        for tile, _ in self._tiles:
            tile.set_rule(rule)
        self._rule = rule

    def freeze(self, frozen: bool) -> None:
        """Stop the weights (γ in force 0) or let them go again; traces go on either way."""
        self._frozen = bool(frozen)
        self._put_gamma()

    def give_reward(self, reward: float) -> None:
        """Add to the reward of the next step, on top of what the task gives."""
        self._tiles.put("by_hand", self._tiles.read("by_hand") + check_reward(reward))

    def press(self, control: str) -> None:
        """Press one of the task's own buttons; raises ValueError for an unknown one."""
        known = [c.name for c in self.task.controls]
        if control not in known:
            raise ValueError(f"task {self.task.name!r} has no control {control!r}; it has {known}")
        with _blamed(self.task):
            self._world.press(control)

    def place(self, world: Array) -> None:
        """Put the world into another state, (numbers, lanes); the network sees its input next.

        Raises TaskError if the task cannot be in that state; nothing has happened then.
        """
        with _blamed(self.task):
            self._world.place(world)

    def look_at(self, lane: int) -> None:
        """Choose the lane that Blocks and Frames show; the next Frame sums up from now."""
        self.watch = check_lane(lane, self.lanes)
        self._new_summary()

    def probe(self, synapses: Sequence[int]) -> None:
        """Choose the synapses whose least and greatest z Summaries tell, from the next one on."""
        for synapse in synapses:
            if not 0 <= synapse < self.topology.synapses:
                raise ValueError(f"synapse must be below {self.topology.synapses}, got {synapse}")
        self.probes = tuple(synapses)

    # What it knows

    @property
    def step(self) -> int:
        """The number of the step that comes next."""
        return self._world.step

    @property
    def beta(self) -> float:
        """Trace decay β of lane 0."""
        tile, lane = self._tiles.place_of(0)
        return float(tile.betas(lane)[0])

    @property
    def gamma(self) -> float:
        """The step size that is set, in force unless it falls or learning is `frozen`."""
        return float(self._gamma.flat[0])

    @property
    def gamma_in_force(self) -> float:
        """Step size γ as decayed so far, in lane 0; 0 while learning is frozen."""
        tile, lane = self._tiles.place_of(0)
        return float(tile.read_lane("gamma", lane)[0])

    @property
    def fall(self) -> float:
        """The steps over which γ falls, infinity if it stays."""
        return self._fall

    @property
    def rule(self) -> Rule:
        """The learning rule."""
        return self._rule

    @property
    def memory(self) -> Array:
        """What the rule keeps, (rows of its memory, lanes)."""
        return self._tiles.joined(lambda tile: tile.memory)

    @property
    def frozen(self) -> bool:
        """Whether γ is held at 0."""
        return self._frozen

    @property
    def nbytes(self) -> int:
        """Of a keyframe's network."""
        return 8 * self.layout.packed_rows * self.lanes

    @property
    def network(self) -> Array:
        """All numbers of the network in the order of `layout.SECTIONS`, (rows, lanes)."""
        return self._tiles.joined(lambda tile: tile.pack())

    @property
    def weights(self) -> Array:
        """w of every synapse, (synapses, lanes), in the topology's order."""
        return self._tiles.joined(lambda tile: tile.synapses()[0])

    @property
    def traces(self) -> Array:
        """z of every synapse, (synapses, lanes)."""
        return self._tiles.joined(lambda tile: tile.synapses()[1])

    @property
    def potentials(self) -> Array:
        """v of every neuron at the last step, (neurons, lanes)."""
        return self._tiles.read("potential")

    @property
    def activities(self) -> Array:
        """u of every unit, inputs first, (units, lanes)."""
        return self._tiles.read("activity")

    @property
    def world(self) -> Array:
        """The state of the task, (numbers, lanes)."""
        return self._world.states

    @property
    def totals(self) -> Array:
        """Reward of the task, reward broadcast, episodes ended since the start, (3, lanes)."""
        return self._tiles.joined(lambda tile: tile.totals[:, : tile.lanes])

    def tally(self, lane: int | None = None) -> Tally:
        """Totals since the start, of one lane (default the watched one)."""
        tile, k = self._tiles.place_of(self.watch if lane is None else lane)
        return Tally(self.step, *(float(x) for x in tile.totals[:, k]))

    def tallies(self) -> list[Tally]:
        """Totals since the start, of each lane."""
        return [self.tally(lane) for lane in range(self.lanes)]

    def set_weights(self, weights: Array) -> None:
        """Put (synapses, lanes) weights in place of the present ones; traces stay."""
        if weights.shape != (self.topology.synapses, self.lanes):
            raise ValueError(
                f"weights must have shape ({self.topology.synapses}, {self.lanes}), "
                f"got {weights.shape}"
            )
        for tile, lanes in self._tiles:
            tile.set_synapses(weights[:, lanes], tile.synapses()[1])

    def frame(self) -> Frame:
        """The watched lane now, and the summary since the last call."""
        frame = self.glance()
        self._new_summary()
        return frame

    def glance(self) -> Frame:
        """`frame`, and the next one sums up from where it would have."""
        tile, lane = self._tiles.place_of(self.watch)
        weight, trace = tile.synapses_of(lane)
        tally = self.tally()
        neurons = self.topology.neurons
        raw, broadcast = tile.read_lane("reward", lane)
        return Frame(
            step=self.step,
            topology=self.topology,
            weight=weight,
            trace=trace,
            step_size=self.gamma,
            fall=self._fall,
            frozen=self._frozen,
            rule=self._rule,
            memory=tile.memory[:, lane].copy(),
            world=self._world.state(self.watch),
            reward=(float(raw), float(broadcast)),
            tally=tally,
            since=self._since.summary(weight, tally),
            beta=tile.betas(lane),
            **{
                name: tile.read_lane(name, lane)
                for name in ("activity", "before", "potential", "gamma")
            },
            **{name: rows[:neurons, lane] for name, rows in tile.spikes().items()},
        )  # fmt: skip

    # Going back, and copies

    def keyframe(self) -> Keyframe:
        """This moment, from which the run can be made again."""
        return Keyframe(
            self.step, self.network, self.world, self._gamma.copy(), self._frozen, self._rule,
            self.memory, self._fall,
        )  # fmt: skip

    def restore(self, keyframe: Keyframe) -> None:
        """Go to a moment of this learner, or of one of the same task and topology, with its rule.

        Raises ValueError if the keyframe's arrays do not fit, the world cannot be in its state, or
        a number is out of range; nothing has happened then.
        """
        keyframe.check_fit(self.layout, self.world.shape, self.dtype)
        self.task.check_states(keyframe.world.T)
        self.set_rule(keyframe.rule)
        self._world.step = keyframe.step
        np.copyto(self._gamma, keyframe.gamma)
        self._frozen, self._fall = keyframe.frozen, keyframe.fall
        self._put_gamma()
        for tile, lanes in self._tiles:
            tile.unpack(keyframe.network[:, lanes], self.step)
            np.copyto(tile.memory, keyframe.memory[:, lanes])
        self._world.put([state.copy() for state in keyframe.world.T])
        self._new_summary()

    def twin(self, task: Task | None = None) -> Learner:
        """A second learner of the same making, at its start, with this one's lanes and seed.

        It shows the same lane.
        """
        settings = replace(self.settings, frozen=False)
        twin = Learner.of(self.task if task is None else task, settings)
        twin.look_at(self.watch)
        return twin

    def frozen_copy(self, task: Task | None = None) -> Learner:
        """These weights, learning switched off, at the start of a run of their own."""
        copy = self.twin(task)
        copy.set_weights(self.weights)
        copy.freeze(True)
        copy._world.step = EVALUATION_STEP  # noqa: SLF001  # another of this class
        copy._new_summary()  # noqa: SLF001
        return copy

    # Inside

    def _first_weights(self) -> Array:
        """(synapses, lanes)."""
        weights = np.empty((self.topology.synapses, self.lanes))
        for lane in range(self.lanes):
            draws = uniforms(
                self.topology.synapses, seed=self.seed, lane=self.first_lane + lane,
                purpose=INITIAL_WEIGHTS,
            )  # fmt: skip
            with _blamed(self.task):
                weights[:, lane] = self.task.initial_weights(draws)
        return weights

    def _put_gamma(self) -> None:
        """Put γ in force, as it is at this step."""
        gamma = np.zeros_like(self._gamma) if self._frozen else self._gamma
        for tile, lanes in self._tiles:
            tile.put_gamma(gamma[:, lanes], self.step, self._fall)

    def _new_summary(self) -> None:
        tile, lane = self._tiles.place_of(self.watch)
        weight, _ = tile.synapses_of(lane)
        self._since = Summing(self.layout, probes=self.probes, weight=weight, tally=self.tally())


@contextmanager
def _blamed(task: Task) -> Iterator[None]:
    """Whatever is raised here is the task's failure, or the rule's."""
    try:
        yield
    except RuleError as error:
        raise TaskError(str(error)[:400]) from error
    except Exception as error:
        what = str(error).splitlines()[0] if str(error) else ""
        said = f"task {task.name!r} failed: {type(error).__name__}: {what}"
        raise TaskError(said[:400]) from error
