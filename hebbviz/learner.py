"""A network, a task and the rule in closed loop. It knows no clock, no queue and no screen.

The trajectory is a pure function of task, topology, parameters and seed, and of the commands given
(`set_beta`, `set_gamma`, `set_fall`, `set_rule`, `freeze`, `give_reward`, `press`) with the steps
they were given at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hebbviz import engine, held, rule
from hebbviz.chance import (
    FIRST_EPISODE,
    INITIAL_WEIGHTS,
    LARGEST_SEED,
    NEXT_EPISODE,
    Draws,
    check_seed,
    uniforms,
)
from hebbviz.layout import Layout
from hebbviz.limits import (
    MOST_LANES,
    check_beta,
    check_fall,
    check_gamma,
    check_lane,
    check_reward,
    check_steps,
)
from hebbviz.moments import Block, Frame, Keyframe, Summary
from hebbviz.rules import Rule, make_rule
from hebbviz.rules.paper import PAPER
from hebbviz.task import CompiledTask, Tally, Task
from hebbviz.topology import Topology

Array = NDArray[np.float64]

NOBODY = -1
"""In place of a watched lane: nothing is noted."""

EVALUATION_STEP = 2**40
"""Frozen copies count their steps from here, so that they draw other numbers than the learner."""


class TaskError(Exception):
    """A task raised or broke its contract in mid-run; the learner is at the step before."""


class _Notes(NamedTuple):
    """What `engine.run` writes of each step: fired, rewards, and if asked for v and the world."""

    fired: NDArray[np.uint8]
    rewards: Array
    potentials: Array
    worlds: Array

    @classmethod
    def of(cls, steps: int, neurons: int, numbers: int | None) -> _Notes:
        """Room for `steps`; `numbers` of the world's state, None if v and state are not asked."""
        near = 0 if numbers is None else steps
        return cls(
            np.zeros((steps, neurons), dtype=np.uint8), np.zeros((steps, 3)),
            np.zeros((near, neurons)), np.zeros((near, numbers or 0)),
        )  # fmt: skip


class Learner:
    """Lanes of one network learning one task; `watch` is the lane that Frames and Blocks show.

    Parameters
    ----------
    task : the world, at its preset; `beta`, `gamma`, `rule` and `fall` default to the preset's.
    hidden : sizes of the hidden layers, or `topology` for anything else; default the task's own.
    rule : what the reward is made into before it is sent to the synapses.
    fall : T in steps, γ in force at step t being γ T/(T + t); infinity for a γ that stays.
    seed : 0 to 2³² - 1. Lane k of a seed is the same run whatever lanes are beside it (unless the
        rule lets lanes touch each other).

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
    ) -> None:
        if not 1 <= lanes <= MOST_LANES:
            raise ValueError(f"lanes must be from 1 to {MOST_LANES}, got {lanes}")
        if not 0 <= first_lane <= LARGEST_SEED - lanes:
            raise ValueError(f"first_lane must be from 0 to 2³² - 1 - lanes, got {first_lane}")
        self.task = task
        self.seed = check_seed(seed)
        self.topology = topology or task.topology(hidden)
        self._check_fit()
        self.lanes, self.first_lane = lanes, first_lane
        self.watch = 0
        self.step = 0
        self.layout = Layout(self.topology)
        self.network = self.layout.empty_state(lanes)
        self._keys = np.array(
            [[self.seed] * lanes, range(first_lane, first_lane + lanes)], dtype=np.uint32
        )
        self._gamma = np.zeros_like(self._section("gamma"))
        self._frozen = False
        self.probes: tuple[int, ...] = ()
        self._data = np.array(task.data() if isinstance(task, CompiledTask) else [[0.0]])
        self._fall = check_fall(task.preset.fall if fall is None else fall)
        self.set_rule(make_rule(task.preset.rule) if rule is None else rule)
        self.set_beta(task.preset.beta if beta is None else beta)
        self.set_gamma(task.preset.gamma if gamma is None else gamma)
        self._start_weights()
        self._start_world()
        self._new_summary()

    # Moving on

    def advance(self, steps: int, *, closely: bool = False, reward: Array | None = None) -> Block:
        """Run `steps` steps and return what happened in each of them, in the watched lane.

        `closely`: potentials and the world's state of every step too. `reward` (steps,): what
        every synapse is sent in place of the task's reward, for controls and comparisons.

        Raises TaskError if the task fails; the learner is then at the end of the last good step.
        """
        start = self.step
        notes = _Notes.of(check_steps(steps), self.topology.neurons, self._numbers_if(closely))
        instead = np.zeros(0) if reward is None else np.array(reward, dtype=np.float64)
        if reward is not None and not (instead.shape == (steps,) and np.isfinite(instead).all()):
            raise ValueError(f"reward must be {steps} finite numbers, one for each step")
        try:
            self._run(steps, self.watch, notes, instead)
        finally:
            self._summed_steps += self.step - start
        r = notes.rewards
        return Block(
            start, notes.fired, r[:, 0], r[:, 1], r[:, 2] > 0, notes.potentials, notes.worlds
        )

    def skip(self, steps: int) -> None:
        """`advance` without notes: the same run, faster. The next Frame sums up from its end."""
        try:
            self._run(check_steps(steps), NOBODY, _Notes.of(0, 0, None), np.zeros(0))
        finally:
            self._new_summary()

    def skip_tallied(self, steps: int) -> list[Tally]:
        """`skip`, and the totals of each lane over these steps."""
        before = self.tallies()
        self.skip(steps)
        return [now - then for now, then in zip(self.tallies(), before, strict=True)]

    def _numbers_if(self, closely: bool) -> int | None:
        return len(self._lane_states()[self.watch]) if closely else None

    def _run(self, steps: int, watch: int, notes: _Notes, instead: Array) -> None:
        if isinstance(self.task, CompiledTask):
            self._run_compiled(self.task, steps, watch, notes, instead)
        else:
            for row in range(steps):
                self._step_python(row, watch, notes, instead)

    def _run_compiled(
        self, task: CompiledTask, steps: int, watch: int, notes: _Notes, instead: Array
    ) -> None:
        engine.run(
            steps, self.step, task.answer, self.network, self.layout.table, self._keys,
            *self.topology.activity, self._world, self._data, self._observed,
            self._step_size, self._fall, self._modulate, self._memory, self._constants,
            self._modulated, instead, watch, *notes, self._counts, self._extremes,
            self._probe_rows,
        )  # fmt: skip
        self.step += steps

    def _step_python(self, row: int, watch: int, notes: _Notes, instead: Array) -> None:
        """One step of a world in Python; if the world fails, nothing has happened."""
        if self.step % engine.FALL_EVERY == 0 and self._fall < math.inf:
            self._put_gamma()
        np.copyto(self._before, self.network)
        memory = self._memory.copy()
        rule.respond(
            self.network, self.layout.table, self._keys, self.step, *self.topology.activity
        )
        fired, rewards, potentials, worlds = notes
        try:
            states = [self._answer(lane) for lane in range(self.lanes)]
            self._set_clamps(states)
            accepted = engine.settle(
                self.network, self.layout.table, self._observed, self._modulate, self._memory,
                self._constants, self._modulated, self._reward, self._ended, instead, watch, row,
                fired, rewards, potentials, self._counts, self._extremes, self._probe_rows,
            )  # fmt: skip
            if not accepted:
                raise ValueError("an observation or a reward is not a finite number")
        except BaseException as error:
            np.copyto(self.network, self._before)
            np.copyto(self._memory, memory)
            if not isinstance(error, Exception):  # Ctrl-C
                raise
            raise _task_error(self.task, error) from error
        if len(worlds):
            worlds[row] = states[watch]
        self._states = states
        self.step += 1

    def _answer(self, lane: int) -> Array:
        """Let a world in Python answer the outputs; returns its next state."""
        task = self.task
        draws = Draws(self.seed, self.first_lane + lane, self.step)
        state = _numbers(
            task.transition(self._states[lane].copy(), self._output[:, lane].copy(), draws)
        )
        self._reward[lane] = task.reward(state)
        ended = task.ended(state)
        self._ended[lane] = ended
        if ended:
            state = _numbers(task.restart(Draws(self.seed, draws.lane, self.step, NEXT_EPISODE)))
        if state.shape != self._states[lane].shape:
            raise ValueError(
                f"the state must keep its shape {self._states[lane].shape}, got {state.shape}"
            )
        seen = np.asarray(task.observation(state))
        if seen.shape != (self.topology.inputs,):
            raise ValueError(
                f"an observation must have shape ({self.topology.inputs},), got {seen.shape}"
            )
        self._observed[:, lane] = seen
        return state

    def _set_clamps(self, states: Sequence[Array]) -> None:
        if type(self.task).clamps is Task.clamps:
            return
        for lane, state in enumerate(states):
            clamps = self.task.clamps(state)
            if clamps is not None and clamps.shape != (self.topology.neurons,):
                raise ValueError(
                    f"clamps must have shape ({self.topology.neurons},), got {clamps.shape}"
                )
            self._section("clamp")[:, lane] = np.nan if clamps is None else clamps

    # Commands: each takes effect before the next step

    def set_beta(self, beta: float) -> None:
        """How long the traces remember: z fades by β each step. Resets nothing."""
        self._section("beta")[:] = check_beta(beta)

    def set_gamma(self, gamma: float) -> None:
        """The step size γ. While learning is frozen it is only remembered."""
        self._gamma[:] = check_gamma(gamma)
        self._put_gamma()

    def set_fall(self, fall: float) -> None:
        """Let γ fall over T steps: in force at step t is γ/(1 + t/T), with t counted from the
        start of the run and rounded down to a multiple of engine.FALL_EVERY. Infinity: γ stays.
        """
        self._fall = check_fall(fall)
        self._put_gamma()

    def set_rule(self, rule: Rule) -> None:
        """Go on with another rule, or other parameters of it, its memory empty.

        Raises ValueError if it needs more lanes, or cannot be compiled; nothing has happened then.
        """
        if self.lanes < rule.least_lanes:
            raise ValueError(
                f"rule {rule.name} needs {rule.least_lanes} lanes or more, this learner has "
                f"{self.lanes}"
            )
        self._modulate, self._constants = rule.compiled(), rule.constants
        self._modulated = np.zeros(0 if rule == PAPER else self.lanes)
        self._rule, self._memory = rule, np.zeros((len(rule.memory), self.lanes))

    def freeze(self, frozen: bool) -> None:
        """Stop the weights (γ in force 0) or let them go again; traces go on either way."""
        self._frozen = bool(frozen)
        self._put_gamma()

    def give_reward(self, reward: float) -> None:
        """Add to the reward of the next step, on top of what the task gives."""
        self._section("by_hand")[:] += check_reward(reward)

    def press(self, control: str) -> None:
        """Press one of the task's own buttons; raises ValueError for an unknown one."""
        known = [c.name for c in self.task.controls]
        if control not in known:
            raise ValueError(f"task {self.task.name!r} has no control {control!r}; it has {known}")
        try:
            pressed = [self.task.press(s.copy(), control) for s in self._lane_states()]
            world = np.stack([_numbers(s) for s in pressed], axis=1)
        except Exception as error:
            raise _task_error(self.task, error) from error
        self.place(world)

    def place(self, world: Array) -> None:
        """Put the world into another state, (numbers, lanes); the network sees its input next.

        Raises TaskError if the task cannot be in that state; nothing has happened then.
        """
        states = [world[:, k].copy() for k in range(world.shape[1])]
        clamps = self._section("clamp").copy()
        try:
            if world.shape != self.world.shape:
                raise ValueError(
                    f"the state must keep its shape {self.world.shape}, got {world.shape}"
                )
            seen = self._look(states)
            self._set_clamps(states)
        except Exception as error:
            self._section("clamp")[:] = clamps
            raise _task_error(self.task, error) from error
        self._put_states(states)
        self._observed = seen
        rule.hold(self.network, self.layout.table, self._observed)

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
    def beta(self) -> float:
        return float(self._section("beta").flat[0])

    @property
    def gamma(self) -> float:
        """The step size that is set, in force unless it falls or learning is `frozen`."""
        return float(self._gamma.flat[0])

    @property
    def gamma_in_force(self) -> float:
        return float(self._section("gamma").flat[0])

    @property
    def fall(self) -> float:
        """The steps over which γ falls, infinity if it stays."""
        return self._fall

    @property
    def rule(self) -> Rule:
        return self._rule

    @property
    def memory(self) -> Array:
        """What the rule keeps, (rows of its memory, lanes)."""
        return self._memory.copy()

    @property
    def frozen(self) -> bool:
        return self._frozen

    @property
    def weights(self) -> Array:
        """w of every synapse, (synapses, lanes), in the topology's order."""
        return held.unfolded(self.layout, self.network)[0]

    @property
    def traces(self) -> Array:
        """z of every synapse, (synapses, lanes)."""
        return held.unfolded(self.layout, self.network)[1]

    @property
    def potentials(self) -> Array:
        """v of every neuron at the last step, (neurons, lanes)."""
        return self._section("potential").copy()

    @property
    def activities(self) -> Array:
        """u of every unit, inputs first, (units, lanes)."""
        return self._section("activity").copy()

    @property
    def world(self) -> Array:
        """The state of the task, (numbers, lanes)."""
        if isinstance(self.task, CompiledTask):
            return self._world.copy()
        return np.stack(self._states, axis=1)

    @property
    def totals(self) -> Array:
        """Reward of the task, reward broadcast, episodes ended since the start, (3, lanes)."""
        return self._section("tally").copy()

    def tally(self, lane: int | None = None) -> Tally:
        """Totals since the start, of one lane (default the watched one)."""
        totals = self._section("tally")[:, self.watch if lane is None else lane]
        return Tally(self.step, *(float(x) for x in totals))

    def tallies(self) -> list[Tally]:
        """Totals since the start, of each lane."""
        return [self.tally(lane) for lane in range(self.lanes)]

    def set_weights(self, weights: Array) -> None:
        """Put (synapses, lanes) weights in place of the present ones; traces stay."""
        traces = self.traces
        self._section("weight")[:] = weights
        self._section("trace")[:] = traces
        held.refold(self.layout, self.network)

    def frame(self) -> Frame:
        """The watched lane now, and the summary since the last call."""
        lane = self.watch
        weight, trace = self._watched_synapses()
        tally = self.tally()
        neurons = self.topology.neurons
        raw, broadcast = self._section("reward")[:, lane]
        since = Summary(
            steps=self._summed_steps,
            spikes=self._counts.copy(),
            potential_range=self._extremes[:, :neurons].copy(),
            probes=self._probes,
            probe_range=self._extremes[:, neurons:].copy(),
            weight_change=weight - self._summed_weight,
            tally=tally - self._summed_tally,
        )
        frame = Frame(
            step=self.step,
            topology=self.topology,
            weight=weight,
            trace=trace,
            step_size=self.gamma,
            fall=self._fall,
            frozen=self._frozen,
            rule=self._rule,
            memory=self._memory[:, lane].copy(),
            world=self._lane_states()[lane].copy(),
            reward=(float(raw), float(broadcast)),
            tally=tally,
            since=since,
            **{
                name: self._section(name)[: self._rows(name), lane].copy()
                for name in (
                    "activity", "before", "potential", "probability", "draw", "fired", "beta",
                    "gamma",
                )
            },
        )  # fmt: skip
        self._new_summary()
        return frame

    # Going back, and copies

    def keyframe(self) -> Keyframe:
        """This moment, from which the run can be made again."""
        return Keyframe(
            self.step, self.network.copy(), self.world, self._gamma.copy(), self._frozen,
            self._rule, self._memory.copy(), self._fall,
        )  # fmt: skip

    def restore(self, keyframe: Keyframe) -> None:
        """Go to a moment of this learner, or of one of the same task and topology, with its rule.

        Raises ValueError if the keyframe's arrays do not fit.
        """
        if keyframe.network.shape != self.network.shape:
            raise ValueError(
                f"a keyframe of this network has shape {self.network.shape}, "
                f"got {keyframe.network.shape}"
            )
        if keyframe.world.shape != self.world.shape:
            raise ValueError(
                f"a keyframe of this task has a world of shape {self.world.shape}, "
                f"got {keyframe.world.shape}"
            )
        remembered = (len(keyframe.rule.memory), self.lanes)
        if keyframe.memory.shape != remembered:
            raise ValueError(
                f"a keyframe of rule {keyframe.rule} has a memory of shape {remembered}, "
                f"got {keyframe.memory.shape}"
            )
        self.set_rule(keyframe.rule)
        np.copyto(self._memory, keyframe.memory)
        self.step = keyframe.step
        np.copyto(self.network, keyframe.network)
        np.copyto(self._gamma, keyframe.gamma)
        self._frozen, self._fall = keyframe.frozen, keyframe.fall
        self._step_size = self._gamma * (not self._frozen)
        self._put_states([keyframe.world[:, k].copy() for k in range(self.lanes)])
        self._observed[:] = self._section("activity")[: self.topology.inputs]
        self._new_summary()

    def twin(self, task: Task | None = None) -> Learner:
        """A second learner of the same making, at its start, with this one's lanes and seed.

        It shows the same lane.
        """
        twin = Learner(
            self.task if task is None else task, topology=self.topology, beta=self.beta,
            gamma=self.gamma, rule=self._rule, fall=self._fall, seed=self.seed, lanes=self.lanes,
            first_lane=self.first_lane,
        )  # fmt: skip
        twin.look_at(self.watch)
        return twin

    def frozen_copy(self, task: Task | None = None) -> Learner:
        """These weights, learning switched off, at the start of a run of their own."""
        copy = self.twin(task)
        copy.set_weights(self.weights)
        copy.freeze(True)
        copy.step = EVALUATION_STEP
        copy._new_summary()  # noqa: SLF001  # another of this class
        return copy

    # Inside

    def _section(self, name: str) -> Array:
        return self.layout.section(self.network, name)

    def _watched_synapses(self) -> tuple[Array, Array]:
        """w and z of the watched lane, each (synapses,)."""
        lane = self.network[:, self.watch : self.watch + 1]
        weight, trace = held.unfolded(self.layout, lane)
        return weight[:, 0], trace[:, 0]

    def _rows(self, name: str) -> int:
        return self.topology.neurons if name == "draw" else self.layout.sizes[name]

    def _check_fit(self) -> None:
        inputs, outputs = len(self.task.inputs), len(self.task.outputs)
        if self.topology.inputs != inputs:
            raise ValueError(
                f"task {self.task.name!r} has {inputs} inputs, the network {self.topology.inputs}"
            )
        size = self.topology.group(self.topology.output).size
        if size != outputs:
            raise ValueError(
                f"task {self.task.name!r} has {outputs} outputs, the network's group "
                f"{self.topology.output!r} has {size}"
            )

    def _start_weights(self) -> None:
        for lane in range(self.lanes):
            draws = uniforms(
                self.topology.synapses, seed=self.seed, lane=self.first_lane + lane,
                purpose=INITIAL_WEIGHTS,
            )  # fmt: skip
            try:
                self._section("weight")[:, lane] = self.task.initial_weights(draws)
            except Exception as error:
                raise _task_error(self.task, error) from error

    def _start_world(self) -> None:
        try:
            states = [
                _numbers(self.task.restart(Draws(self.seed, self.first_lane + k, 0, FIRST_EPISODE)))
                for k in range(self.lanes)
            ]
            self._put_states(states)
            self._observed = self._look(states)
            self._set_clamps(states)
        except Exception as error:
            raise _task_error(self.task, error) from error
        self._reward, self._ended = np.zeros(self.lanes), np.zeros(self.lanes)
        self._before = self.network.copy()
        first = self.topology.first_unit(self.topology.output)
        self._output = self.network[first : first + len(self.task.outputs)]
        rule.hold(self.network, self.layout.table, self._observed)

    def _put_gamma(self) -> None:
        """Put γ in force, as it is at this step."""
        self._step_size = self._gamma * (not self._frozen)
        since = self.step - self.step % engine.FALL_EVERY
        self._section("gamma")[:] = self._step_size / (1.0 + since / self._fall)

    def _look(self, states: Sequence[Array]) -> Array:
        """What the network would see of these states, (inputs, lanes)."""
        seen = np.array([self.task.observation(s) for s in states], dtype=np.float64).T.copy()
        if seen.shape != (self.topology.inputs, self.lanes):
            raise ValueError(
                f"an observation must have shape ({self.topology.inputs},), got {seen.shape[:-1]}"
            )
        if not np.isfinite(seen).all():
            raise ValueError("an observation is not a finite number")
        return seen

    def _lane_states(self) -> list[Array]:
        if isinstance(self.task, CompiledTask):
            return [self._world[:, k].copy() for k in range(self.lanes)]
        return self._states

    def _put_states(self, states: Sequence[Array]) -> None:
        if isinstance(self.task, CompiledTask):
            self._world = np.stack(states, axis=1)
        else:
            self._states = list(states)

    def _new_summary(self) -> None:
        self._summed_steps = 0
        self._summed_tally = self.tally()
        self._summed_weight = self._watched_synapses()[0]
        self._probes = self.probes
        self._probe_rows = np.array(
            [held.trace_rows(self.layout, s) for s in self._probes], dtype=np.int64
        ).reshape(-1, 4)
        neurons = self.topology.neurons
        self._counts = np.zeros(neurons, dtype=np.int64)
        self._extremes = np.empty((2, neurons + len(self._probes)))
        self._extremes[0], self._extremes[1] = np.inf, -np.inf


def _numbers(state: Array) -> Array:
    """What a task returned as its state, in float64 and its own array, as a save will hold it."""
    return np.array(state, dtype=np.float64)


def _task_error(task: Task, error: Exception) -> TaskError:
    what = str(error).splitlines()[0] if str(error) else ""
    return TaskError(f"task {task.name!r} failed: {type(error).__name__}: {what}"[:400])
