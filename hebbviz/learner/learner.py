"""A learner: network, task and rule in closed loop, independent of clocks, queues and screens.

The trajectory is a pure function of task, topology, parameters and seed, and of the commands
(`set_beta`, `set_gamma`, `set_fall`, `set_rule`, `set_weights`, `freeze`, `give_reward`, `press`,
`place`, `advance` with a reward) and the steps at which they were given.
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
"""First step of frozen copies, so that they draw other random numbers than the learner."""


class TaskError(Exception):
    """A task or a rule raised or broke its contract during a run.

    The learner is at the step before the failure, or for a compiled task at that before the call.
    """


class Learner:
    """Lanes of a network that learn a task; `watch` is the lane that Frames and Blocks show.

    Parameters
    ----------
    task : the world, at its preset; `beta`, `gamma`, `rule` and `fall` default to the preset's.
    hidden : sizes of the hidden layers, by default the preset's or the task's.
    topology : a network of any other shape, in place of `hidden`.
    rule : computes the broadcast reward from the task's reward.
    fall : decay time T of the step size, in steps: at step t, γ T/(T + t) is in force; infinite
        for a constant γ.
    dtype : type of weights, traces and potentials: float64, or float32 for higher speed. Worlds,
        rewards and totals are float64 in both cases.
    written_out : `skip` runs code compiled for this network alone. The run is the same. For small
        networks a step takes less time (a third less in 64 lanes of sonar in float32), but
        compiling takes about 15 s. Use it for long runs of many lanes of a compiled task.
    seed : 0 to 2³² - 1, common to all lanes.
    lanes, first_lane : number of parallel runs, and the number of the first. Lane k of a seed is
        the same run whatever the other lanes are, unless the rule couples lanes.

    Raises
    ------
    ValueError
        If a parameter is out of range; the message gives its name, its bounds and the value.
    TaskError
        If the task raises or breaks its contract.
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
        options = dict(vars(settings))
        frozen = options.pop("frozen")
        learner = cls(task, **options)
        learner.freeze(frozen)
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
            written_out=self._written_out,
            frozen=self._frozen,
        )

    # Running

    def advance(self, steps: int, *, closely: bool = False, reward: Array | None = None) -> Block:
        """Run `steps` steps and return the record of each of them in the watched lane.

        `closely` also records the potentials and the world's state of every step. `reward`
        (steps,) is broadcast in place of the rule's result, for controls and comparisons; manual
        reward (`give_reward`) is still added.

        Raises TaskError if the task fails; the learner is then at the end of the last good step,
        or for a compiled task where it was before the call.
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
        """Run `steps` steps without a record: the same run as `advance`, faster.

        The next Frame's summary starts at the end of these steps.
        """
        try:
            self._run(check_steps(steps), NOBODY, Notes.of(0, 0, None), np.zeros(0))
        finally:
            self._new_summary()

    def skip_tallied(self, steps: int) -> list[Tally]:
        """Run `skip` and return the totals of each lane over these steps."""
        before = self.tallies()
        self.skip(steps)
        return [now - then for now, then in zip(self.tallies(), before, strict=True)]

    def _run(self, steps: int, watch: int, notes: Notes, instead: Array) -> None:
        with _blamed(self.task):
            self._world.run(steps, instead=instead, watch=watch, notes=notes, since=self._since)

    # Commands: each takes effect before the next step

    def set_beta(self, beta: float) -> None:
        """Set β, by which z decays each step. The traces are not reset."""
        self._tiles.put("beta", check_beta(beta))

    def set_gamma(self, gamma: float) -> None:
        """Set the step size γ. While learning is frozen it is stored but not in force."""
        self._gamma[:] = check_gamma(gamma)
        self._put_gamma()

    def set_fall(self, fall: float) -> None:
        """Set the decay time T of the step size, in steps; infinity keeps γ constant.

        At step t, γ/(1 + t/T) is in force, with t counted from the start of the run and rounded
        down to a multiple of FALL_EVERY.
        """
        self._fall = check_fall(fall)
        self._put_gamma()

    def set_rule(self, rule: Rule) -> None:
        """Continue with another rule, or with other parameters, and an empty memory.

        Raises ValueError if the rule does not fit the number of lanes or cannot be compiled; then
        nothing changes.
        """
        rule.check_lanes(self.lanes)
        for tile, _ in self._tiles:
            tile.set_rule(rule)
        self._rule = rule

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning: while frozen, γ in force is 0. Traces continue either way."""
        self._frozen = bool(frozen)
        self._put_gamma()

    def give_reward(self, reward: float) -> None:
        """Add manual reward to the broadcast reward of the next step."""
        self._tiles.put("by_hand", self._tiles.read("by_hand") + check_reward(reward))

    def press(self, control: str) -> None:
        """Press one of the task's buttons; raise ValueError for an unknown one."""
        known = [c.name for c in self.task.controls]
        if control not in known:
            raise ValueError(f"task {self.task.name!r} has no control {control!r}; it has {known}")
        with _blamed(self.task):
            self._world.press(control)

    def place(self, world: Array) -> None:
        """Move the world to another state, (numbers, lanes), and show it to the network.

        Raises TaskError if the task rejects the state; then nothing changes.
        """
        with _blamed(self.task):
            self._world.place(world)

    def look_at(self, lane: int) -> None:
        """Choose the lane that Blocks and Frames show; the next Frame's summary starts now."""
        self.watch = check_lane(lane, self.lanes)
        self._new_summary()

    def probe(self, synapses: Sequence[int]) -> None:
        """Choose the synapses whose range of z Summaries report, starting with the next one."""
        for synapse in synapses:
            if not 0 <= synapse < self.topology.synapses:
                raise ValueError(f"synapse must be below {self.topology.synapses}, got {synapse}")
        self.probes = tuple(synapses)

    # State

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
        """The step size as set; in force unless it decays or learning is `frozen`."""
        return float(self._gamma.flat[0])

    @property
    def gamma_in_force(self) -> float:
        """Step size γ as decayed so far, in lane 0; 0 while learning is frozen."""
        tile, lane = self._tiles.place_of(0)
        return float(tile.read_lane("gamma", lane)[0])

    @property
    def fall(self) -> float:
        """The decay time of the step size in steps, infinite if γ is constant."""
        return self._fall

    @property
    def rule(self) -> Rule:
        """The learning rule."""
        return self._rule

    @property
    def memory(self) -> Array:
        """The rule's memory, (its rows, lanes)."""
        return self._tiles.joined(lambda tile: tile.memory)

    @property
    def frozen(self) -> bool:
        """Whether γ is held at 0."""
        return self._frozen

    @property
    def nbytes(self) -> int:
        """Size of a keyframe's network in bytes."""
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
    def seen(self) -> Array:
        """u of every input in the last step, (inputs, lanes)."""
        return self._tiles.read("before")[: self.topology.inputs]

    @property
    def world(self) -> Array:
        """The state of the task, (numbers, lanes)."""
        return self._world.states

    @property
    def totals(self) -> Array:
        """Reward of the task, reward broadcast, episodes ended since the start, (3, lanes)."""
        return self._tiles.joined(lambda tile: tile.totals[:, : tile.lanes])

    def tally(self, lane: int | None = None) -> Tally:
        """Return the totals since the start of one lane, by default the watched one."""
        tile, k = self._tiles.place_of(self.watch if lane is None else lane)
        return Tally(self.step, *(float(x) for x in tile.totals[:, k]))

    def tallies(self) -> list[Tally]:
        """Return the totals since the start of each lane."""
        return [self.tally(lane) for lane in range(self.lanes)]

    def set_weights(self, weights: Array) -> None:
        """Replace the weights by `weights` (synapses, lanes); traces stay."""
        if weights.shape != (self.topology.synapses, self.lanes):
            raise ValueError(
                f"weights must have shape ({self.topology.synapses}, {self.lanes}), "
                f"got {weights.shape}"
            )
        for tile, lanes in self._tiles:
            tile.set_synapses(weights[:, lanes], tile.synapses()[1])

    def frame(self) -> Frame:
        """Return the watched lane's present state and the summary since the last call."""
        frame = self.glance()
        self._new_summary()
        return frame

    def glance(self) -> Frame:
        """Return the same as `frame` without starting a new summary."""
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

    # Keyframes and copies

    def keyframe(self) -> Keyframe:
        """Return the present state, from which the run can be recomputed."""
        return Keyframe(
            self.step, self.network, self.world, self._gamma.copy(), self._frozen, self._rule,
            self.memory, self._fall,
        )  # fmt: skip

    def restore(self, keyframe: Keyframe) -> None:
        """Return to a keyframe of this learner, or of another one of the same task and topology.

        The keyframe's rule is restored too. Raises ValueError if its arrays do not fit, the task
        rejects its state, or a number is out of range; then nothing changes.
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
        """Return a new learner with the same settings, seed, lanes and watched lane, at step 0."""
        settings = replace(self.settings, frozen=False)
        twin = Learner.of(self.task if task is None else task, settings)
        twin.look_at(self.watch)
        return twin

    def frozen_copy(self, task: Task | None = None) -> Learner:
        """Return a learner with these weights and learning frozen, at the start of its own run."""
        copy = self.twin(task)
        copy.set_weights(self.weights)
        copy.freeze(True)
        copy._world.step = EVALUATION_STEP  # noqa: SLF001  # another of this class
        copy._new_summary()  # noqa: SLF001
        return copy

    # Internals

    def _first_weights(self) -> Array:
        """Return the task's initial weights, (synapses, lanes)."""
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
        """Set γ in force for the present step."""
        gamma = np.zeros_like(self._gamma) if self._frozen else self._gamma
        for tile, lanes in self._tiles:
            tile.put_gamma(gamma[:, lanes], self.step, self._fall)

    def _new_summary(self) -> None:
        tile, lane = self._tiles.place_of(self.watch)
        weight, _ = tile.synapses_of(lane)
        self._since = Summing(self.layout, probes=self.probes, weight=weight, tally=self.tally())


@contextmanager
def _blamed(task: Task) -> Iterator[None]:
    """Turn exceptions in this context into TaskError of the task or the rule."""
    try:
        yield
    except RuleError as error:
        raise TaskError(str(error)[:400]) from error
    except Exception as error:
        what = str(error).splitlines()[0] if str(error) else ""
        said = f"task {task.name!r} failed: {type(error).__name__}: {what}"
        raise TaskError(said[:400]) from error
