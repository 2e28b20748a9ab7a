"""A network, a task and the rule in closed loop. It knows no clock, no queue and no screen.

The trajectory is a pure function of task, topology, parameters and seed, and of the commands given
(`set_beta`, `set_gamma`, `set_fall`, `set_rule`, `set_weights`, `freeze`, `give_reward`, `press`,
`place`, `advance` with a reward) with the steps they were given at.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from hebbviz.chance import (
    FIRST_EPISODE,
    INITIAL_WEIGHTS,
    LARGEST_SEED,
    NEXT_EPISODE,
    Draws,
    check_seed,
    uniforms,
)
from hebbviz.engine import FALL_EVERY
from hebbviz.layout import SECTIONS, Layout
from hebbviz.limits import (
    MOST_LANES,
    check_beta,
    check_dtype,
    check_fall,
    check_gamma,
    check_lane,
    check_reward,
    check_step,
    check_steps,
)
from hebbviz.moments import Block, Frame, Keyframe
from hebbviz.notes import NOBODY, Notes, Summing
from hebbviz.rules import Rule, make_rule
from hebbviz.task import CompiledTask, Tally, Task
from hebbviz.tile import Tile, cut
from hebbviz.topology import Topology

Array = NDArray[np.float64]

EVALUATION_STEP = 2**40
"""Frozen copies count their steps from here, so that they draw other numbers than the learner."""

_BELOW_1 = np.nextafter(1.0, 0.0)


class TaskError(Exception):
    """A task raised or broke its contract in mid-run. The learner is at the step before; where the
    task is compiled, at the step it was at before the call.
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
        self._check_fit()
        self.lanes, self.first_lane = lanes, first_lane
        self.watch = 0
        self.step = 0
        self.dtype, self._written_out = check_dtype(dtype), written_out
        self.layout = Layout(self.topology)
        self._tiles: list[Tile] = []
        for size in cut(lanes):
            first = first_lane + sum(t.lanes for t in self._tiles)
            self._tiles.append(
                Tile(self.layout, seed=seed, first_lane=first, lanes=size, dtype=self.dtype,
                     written=written_out)
            )  # fmt: skip
        self._gamma = np.zeros((len(self.topology.projections), lanes))
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

        Raises TaskError if the task fails; the learner is then at the end of the last good step,
        of a compiled task where it was before.
        """
        start = self.step
        notes = Notes.of(check_steps(steps), self.topology.neurons, self._numbers_if(closely))
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

    def _numbers_if(self, closely: bool) -> int | None:
        return len(self._lane_state(self.watch)) if closely else None

    def _run(self, steps: int, watch: int, notes: Notes, instead: Array) -> None:
        if isinstance(self.task, CompiledTask):
            self._keep()
            try:
                for tile in self._tiles:
                    tile.run(
                        steps, self.step, self.task.answer, self._data, instead=instead,
                        watch=self._seen_in(tile, watch), notes=notes, sums=self._since.sums,
                    )  # fmt: skip
            except BaseException as error:
                self._fail(error)
            self.step += steps
        else:
            for row in range(steps):
                self._step_python(row, watch, notes, instead)

    def _step_python(self, row: int, watch: int, notes: Notes, instead: Array) -> None:
        """One step of a world in Python."""
        self._keep()
        try:
            if self.step % FALL_EVERY == 0 and self._fall < math.inf:
                self._put_gamma()
            states = []
            for tile in self._tiles:
                action = tile.respond(self.step)
                states += [self._answer(tile, k, action[:, k]) for k in range(tile.lanes)]
            self._set_clamps(states)
            for tile, lanes in self._cut:
                tile.hear([self._see(state) for state in states[lanes]])
            for tile in self._tiles:
                tile.settle(
                    row, instead=instead, watch=self._seen_in(tile, watch), notes=notes,
                    sums=self._since.sums,
                )  # fmt: skip
        except BaseException as error:
            self._fail(error)
        if len(notes.worlds):
            notes.worlds[row] = states[watch]
        self._states = states
        self.step += 1

    def _keep(self) -> None:
        """Remember this moment."""
        for tile in self._tiles:
            tile.keep()
        self._since.keep()

    def _fail(self, error: BaseException) -> NoReturn:
        """Go back to the moment that was kept, and tell of what came after it."""
        for tile in self._tiles:
            tile.back()
        self._since.back()
        if not isinstance(error, Exception):  # Ctrl-C
            raise error
        raise _task_error(self.task, error) from error

    def _seen_in(self, tile: Tile, lane: int) -> int:
        """Which of a tile's lanes is the watched one, NOBODY if it is another's."""
        place = self.first_lane + lane - tile.first_lane
        return place if lane != NOBODY and 0 <= place < tile.lanes else NOBODY

    def _answer(self, tile: Tile, k: int, action: Array) -> Array:
        """Let a world in Python answer the outputs of lane k of a tile; returns its next state."""
        task, before = self.task, self._states[tile.first_lane - self.first_lane + k]
        draws = Draws(self.seed, tile.first_lane + k, self.step)
        state = _numbers(task.transition(before.copy(), action, draws))
        tile.reward[k] = task.reward(state)
        ended = task.ended(state)
        tile.ended[k] = ended
        if ended:
            state = _numbers(task.restart(Draws(self.seed, draws.lane, self.step, NEXT_EPISODE)))
        if state.shape != before.shape:
            raise ValueError(f"the state must keep its shape {before.shape}, got {state.shape}")
        return state

    def _see(self, state: Array) -> Array:
        """What a state shows, (inputs,)."""
        seen = np.asarray(self.task.observation(state), dtype=np.float64)
        if seen.shape != (self.topology.inputs,):
            raise ValueError(
                f"an observation must have shape ({self.topology.inputs},), got {seen.shape}"
            )
        return seen

    def _set_clamps(self, states: Sequence[Array]) -> None:
        if type(self.task).clamps is Task.clamps:
            return
        clamps = np.full((self.topology.neurons, self.lanes), np.nan)
        for lane, state in enumerate(states):
            wanted = self.task.clamps(state)
            if wanted is None:
                continue
            if wanted.shape != (self.topology.neurons,):
                raise ValueError(
                    f"clamps must have shape ({self.topology.neurons},), got {wanted.shape}"
                )
            clamps[:, lane] = wanted
        self._put("clamp", clamps)

    # Commands: each takes effect before the next step

    def set_beta(self, beta: float) -> None:
        """How long the traces remember: z fades by β each step. Resets nothing."""
        self._put("beta", check_beta(beta))

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
        for tile in self._tiles:
            tile.set_rule(rule)
        self._rule = rule

    def freeze(self, frozen: bool) -> None:
        """Stop the weights (γ in force 0) or let them go again; traces go on either way."""
        self._frozen = bool(frozen)
        self._put_gamma()

    def give_reward(self, reward: float) -> None:
        """Add to the reward of the next step, on top of what the task gives."""
        self._put("by_hand", self._read("by_hand") + check_reward(reward))

    def press(self, control: str) -> None:
        """Press one of the task's own buttons; raises ValueError for an unknown one."""
        known = [c.name for c in self.task.controls]
        if control not in known:
            raise ValueError(f"task {self.task.name!r} has no control {control!r}; it has {known}")
        try:
            pressed = [
                self.task.press(self._lane_state(lane), control) for lane in range(self.lanes)
            ]
            world = np.stack([_numbers(s) for s in pressed], axis=1)
        except Exception as error:
            raise _task_error(self.task, error) from error
        self.place(world)

    def place(self, world: Array) -> None:
        """Put the world into another state, (numbers, lanes); the network sees its input next.

        Raises TaskError if the task cannot be in that state; nothing has happened then.
        """
        states = [world[:, k].copy() for k in range(world.shape[1])]
        clamps = self._read("clamp")
        try:
            if world.shape != self.world.shape:
                raise ValueError(
                    f"the state must keep its shape {self.world.shape}, got {world.shape}"
                )
            seen = self._look(states)
            self._set_clamps(states)
        except Exception as error:
            self._put("clamp", clamps)
            raise _task_error(self.task, error) from error
        self._put_states(states)
        for tile, lanes in self._cut:
            tile.see(seen[:, lanes])

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
        return float(self._tiles[0].read_lane("beta", 0)[0])

    @property
    def gamma(self) -> float:
        """The step size that is set, in force unless it falls or learning is `frozen`."""
        return float(self._gamma.flat[0])

    @property
    def gamma_in_force(self) -> float:
        return float(self._tiles[0].read_lane("gamma", 0)[0])

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
        return np.concatenate([tile.memory for tile in self._tiles], axis=1)

    @property
    def frozen(self) -> bool:
        return self._frozen

    @property
    def nbytes(self) -> int:
        """Of a keyframe's network."""
        return 8 * int(self.layout.packed[SECTIONS[-1]].stop) * self.lanes

    @property
    def network(self) -> Array:
        """All numbers of the network in the order of `layout.SECTIONS`, (rows, lanes)."""
        return np.concatenate([tile.pack() for tile in self._tiles], axis=1)

    @property
    def weights(self) -> Array:
        """w of every synapse, (synapses, lanes), in the topology's order."""
        return np.concatenate([tile.synapses()[0] for tile in self._tiles], axis=1)

    @property
    def traces(self) -> Array:
        """z of every synapse, (synapses, lanes)."""
        return np.concatenate([tile.synapses()[1] for tile in self._tiles], axis=1)

    @property
    def potentials(self) -> Array:
        """v of every neuron at the last step, (neurons, lanes)."""
        return self._read("potential")

    @property
    def activities(self) -> Array:
        """u of every unit, inputs first, (units, lanes)."""
        return self._read("activity")

    @property
    def world(self) -> Array:
        """The state of the task, (numbers, lanes)."""
        if isinstance(self.task, CompiledTask):
            return np.concatenate([t.world[:, : t.lanes] for t in self._tiles], axis=1)
        return np.stack(self._states, axis=1)

    @property
    def totals(self) -> Array:
        """Reward of the task, reward broadcast, episodes ended since the start, (3, lanes)."""
        return np.concatenate([t.totals[:, : t.lanes] for t in self._tiles], axis=1)

    def tally(self, lane: int | None = None) -> Tally:
        """Totals since the start, of one lane (default the watched one)."""
        tile, k = self._place_of(self.watch if lane is None else lane)
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
        for tile, lanes in self._cut:
            tile.set_synapses(weights[:, lanes], tile.synapses()[1])

    def frame(self) -> Frame:
        """The watched lane now, and the summary since the last call."""
        tile, lane = self._place_of(self.watch)
        weight, trace = tile.synapses_of(lane)
        tally = self.tally()
        neurons = self.topology.neurons
        raw, broadcast = tile.read_lane("reward", lane)
        frame = Frame(
            step=self.step,
            topology=self.topology,
            weight=weight,
            trace=trace,
            step_size=self.gamma,
            fall=self._fall,
            frozen=self._frozen,
            rule=self._rule,
            memory=tile.memory[:, lane].copy(),
            world=self._lane_state(self.watch),
            reward=(float(raw), float(broadcast)),
            tally=tally,
            since=self._since.summary(weight, tally),
            **{
                name: tile.read_lane(name, lane)
                for name in ("activity", "before", "potential", "beta", "gamma")
            },
            **{name: rows[:neurons, lane] for name, rows in tile.spikes().items()},
        )  # fmt: skip
        self._new_summary()
        return frame

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
        self._check_keyframe(keyframe)
        self.set_rule(keyframe.rule)
        self.step = keyframe.step
        np.copyto(self._gamma, keyframe.gamma)
        self._frozen, self._fall = keyframe.frozen, keyframe.fall
        self._put_gamma()
        for tile, lanes in self._cut:
            tile.unpack(keyframe.network[:, lanes], self.step)
            np.copyto(tile.memory, keyframe.memory[:, lanes])
        self._put_states([keyframe.world[:, k].copy() for k in range(self.lanes)])
        self._new_summary()

    def twin(self, task: Task | None = None) -> Learner:
        """A second learner of the same making, at its start, with this one's lanes and seed.

        It shows the same lane.
        """
        twin = Learner(
            self.task if task is None else task, topology=self.topology, beta=self.beta,
            gamma=self.gamma, rule=self._rule, fall=self._fall, seed=self.seed, lanes=self.lanes,
            first_lane=self.first_lane, dtype=self.dtype, written_out=self._written_out,
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

    @cached_property
    def _cut(self) -> list[tuple[Tile, slice]]:
        """The tiles, and which lanes each has."""
        starts = [tile.first_lane - self.first_lane for tile in self._tiles]
        return [(t, slice(s, s + t.lanes)) for t, s in zip(self._tiles, starts, strict=True)]

    def _place_of(self, lane: int) -> tuple[Tile, int]:
        """The tile of a lane, and its number there."""
        for tile, lanes in self._cut:
            if lane < lanes.stop:
                return tile, lane - lanes.start
        raise IndexError(f"lane must be below {self.lanes}, got {lane}")

    def _read(self, name: str) -> Array:
        return np.concatenate([tile.read(name) for tile in self._tiles], axis=1)

    def _put(self, name: str, values: Array | float) -> None:
        for tile, lanes in self._cut:
            tile.put(name, values if np.ndim(values) == 0 else np.asarray(values)[:, lanes])

    def _check_keyframe(self, keyframe: Keyframe) -> None:
        remembered = (len(keyframe.rule.memory), self.lanes)
        for what, array, shape in (
            ("this network has", keyframe.network,
             (self.layout.packed[SECTIONS[-1]].stop, self.lanes)),
            ("this task has a world of", keyframe.world, self.world.shape),
            ("this network has γ of", keyframe.gamma, self._gamma.shape),
            (f"rule {keyframe.rule} has a memory of", keyframe.memory, remembered),
        ):  # fmt: skip
            if array.shape != shape:
                raise ValueError(f"a keyframe of {what} shape {shape}, got {array.shape}")
        check_step(keyframe.step)
        check_fall(keyframe.fall)
        in_force, beta = (keyframe.network[self.layout.packed[n]] for n in ("gamma", "beta"))
        for gamma in (keyframe.gamma, in_force):
            for extreme in (gamma.min(), gamma.max()):  # both are NaN if one is
                check_gamma(float(extreme))
        for extreme in (beta.min(), beta.max()):
            if extreme != self.dtype(_BELOW_1):  # which is 1 in float32
                check_beta(float(extreme))
        self.task.check_states(keyframe.world.T)

    def _check_fit(self) -> None:
        if isinstance(self.task, CompiledTask) and type(self.task).clamps is not Task.clamps:
            raise ValueError(
                f"task {self.task.name!r} is compiled, so its clamps are not asked for at each "
                "step: leave them out, or make it a Task"
            )
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
        weights = np.empty((self.topology.synapses, self.lanes))
        for lane in range(self.lanes):
            draws = uniforms(
                self.topology.synapses, seed=self.seed, lane=self.first_lane + lane,
                purpose=INITIAL_WEIGHTS,
            )  # fmt: skip
            try:
                weights[:, lane] = self.task.initial_weights(draws)
            except Exception as error:
                raise _task_error(self.task, error) from error
        self._put("weight", weights)

    def _start_world(self) -> None:
        try:
            states = [
                _numbers(self.task.restart(Draws(self.seed, self.first_lane + k, 0, FIRST_EPISODE)))
                for k in range(self.lanes)
            ]
            self._put_states(states)
            seen = self._look(states)
            self._set_clamps(states)
        except Exception as error:
            raise _task_error(self.task, error) from error
        for tile, lanes in self._cut:
            tile.see(seen[:, lanes])

    def _put_gamma(self) -> None:
        """Put γ in force, as it is at this step."""
        for tile, lanes in self._cut:
            gamma = np.zeros_like(self._gamma[:, lanes]) if self._frozen else self._gamma[:, lanes]
            tile.put_gamma(gamma, self.step, self._fall)

    def _look(self, states: Sequence[Array]) -> Array:
        """What the network would see of these states, (inputs, lanes)."""
        seen = np.stack([self._see(state) for state in states], axis=1)
        if not np.isfinite(seen).all():
            raise ValueError("an observation is not a finite number")
        return seen

    def _lane_state(self, lane: int) -> Array:
        """The state of the task in one lane, (numbers,)."""
        if isinstance(self.task, CompiledTask):
            tile, k = self._place_of(lane)
            return tile.world[:, k].copy()
        return self._states[lane].copy()

    def _put_states(self, states: Sequence[Array]) -> None:
        if isinstance(self.task, CompiledTask):
            for tile, lanes in self._cut:
                tile.put_world(np.stack(states[lanes], axis=1))
        else:
            self._states = list(states)

    def _new_summary(self) -> None:
        tile, lane = self._place_of(self.watch)
        weight, _ = tile.synapses_of(lane)
        self._since = Summing(self.layout, probes=self.probes, weight=weight, tally=self.tally())


def _numbers(state: Array) -> Array:
    """What a task returned as its state, in float64 and its own array, as a save will hold it."""
    return np.array(state, dtype=np.float64)


def _task_error(task: Task, error: Exception) -> TaskError:
    what = str(error).splitlines()[0] if str(error) else ""
    return TaskError(f"task {task.name!r} failed: {type(error).__name__}: {what}"[:400])
