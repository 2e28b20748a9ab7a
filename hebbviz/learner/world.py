"""The closed loop of a task and a network in all lanes, stepped by Python or by compiled code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.batch import Tiles
from hebbviz.engine.buffers import Notes
from hebbviz.engine.tile import Tile
from hebbviz.learner.pieces import Pieces, tell
from hebbviz.learner.summing import Summing
from hebbviz.numerics.counter_rng import FIRST_EPISODE, NEXT_EPISODE, Draws
from hebbviz.task.base import CompiledTask, Task
from hebbviz.topology import Topology

Array = NDArray[np.float64]


def world_of(task: Task, tiles: Tiles) -> World:
    """Make the world of a task for these lanes. It has no state until `start`."""
    return (
        CompiledWorld(task, tiles) if isinstance(task, CompiledTask) else PythonWorld(task, tiles)
    )


class World:
    """A task in all lanes of a network. Exceptions of the task pass through.

    The state of a lane has shape (numbers,). The two subclasses store the states differently.
    """

    def __init__(self, task: Task, tiles: Tiles) -> None:
        self._task, self._tiles = task, tiles
        self.step = 0
        """The number of the step that comes next."""

    # Defined by each subclass

    @property
    def states(self) -> Array:
        """The states of all lanes, (numbers, lanes)."""
        raise NotImplementedError

    def state(self, lane: int) -> Array:
        """Return the state of one lane, (numbers,)."""
        raise NotImplementedError

    def put(self, states: Sequence[Array]) -> None:
        """Set the state of each lane; the network's inputs and clamps stay."""
        raise NotImplementedError

    def run(self, steps: int, *, instead: Array, watch: int, notes: Notes, since: Summing) -> None:
        """Run `steps` steps.

        `instead` (steps,) replaces the rule's broadcast reward unless it is empty; `notes` and
        `since` record the lane `watch`, unless it is NOBODY. If a step fails, `step`, network,
        states and sums return to their values before it, or for a compiled task to those before
        the call.
        """
        raise NotImplementedError

    # Common to both subclasses

    def start(self) -> None:
        """Begin the first episode of each lane."""
        lanes = range(self._tiles.first_lane, self._tiles.first_lane + self._tiles.lanes)
        draws = [Draws(self._tiles.seed, lane, 0, FIRST_EPISODE) for lane in lanes]
        self._enter([_numbers(self._task.restart(d)) for d in draws])

    def press(self, control: str) -> None:
        """Press one of the task's buttons, in every lane."""
        lanes = range(self._tiles.lanes)
        pressed = [_numbers(self._task.press(self.state(lane), control)) for lane in lanes]
        self.place(np.stack(pressed, axis=1))

    def place(self, states: Array) -> None:
        """Move to other states, (numbers, lanes), and show them to the network."""
        if states.shape != self.states.shape:
            raise ValueError(
                f"the state must keep its shape {self.states.shape}, got {states.shape}"
            )
        self._enter([state.copy() for state in states.T])

    def _enter(self, states: Sequence[Array]) -> None:
        """Set these states and show them to the network; a failure changes nothing."""
        seen = np.stack([self._see(state) for state in states], axis=1)
        if not np.isfinite(seen).all():
            raise ValueError("an observation is not a finite number")
        self._clamp(states)
        self.put(states)
        for tile, lanes in self._tiles:
            tile.see(seen[:, lanes])

    def _see(self, state: Array) -> Array:
        """Return the observation of a state, (inputs,)."""
        inputs = self._tiles.layout.topology.inputs
        seen = np.asarray(self._task.observation(state), dtype=np.float64)
        if seen.shape != (inputs,):
            raise ValueError(f"an observation must have shape ({inputs},), got {seen.shape}")
        return seen

    def _clamp(self, states: Sequence[Array]) -> None:
        """Set the task's clamps for the next step."""
        if type(self._task).clamps is Task.clamps:
            return
        neurons = self._tiles.layout.topology.neurons
        clamps = np.full((neurons, self._tiles.lanes), np.nan)
        for lane, state in enumerate(states):
            wanted = self._task.clamps(state)
            if wanted is None:
                continue
            if wanted.shape != (neurons,):
                raise ValueError(f"clamps must have shape ({neurons},), got {wanted.shape}")
            clamps[:, lane] = wanted
        self._tiles.put("clamp", clamps)


class PythonWorld(World):
    """A task whose methods are called at each step. A failed step is undone alone."""

    _states: list[Array]

    @property
    def states(self) -> Array:
        return np.stack(self._states, axis=1)

    def state(self, lane: int) -> Array:
        return self._states[lane].copy()

    def put(self, states: Sequence[Array]) -> None:
        self._states = list(states)

    def run(self, steps: int, *, instead: Array, watch: int, notes: Notes, since: Summing) -> None:
        watched = self._tiles.watched(watch)
        for row in range(steps):
            self._tiles.keep()
            since.keep()
            try:
                reached, states = self._act()
                for tile, lane in watched:
                    tile.settle(row, instead=instead, watch=lane, notes=notes, sums=since.sums)
            except BaseException:
                self._tiles.back()
                since.back()
                raise
            if len(notes.worlds):
                notes.worlds[row] = reached[watch]
            self._states = states
            self.step += 1
            tell(row + 1, steps)

    def _act(self) -> tuple[list[Array], list[Array]]:
        """Step the network and the task once.

        Returns the states that were reached, and the next ones: the same, or the first of a new
        episode where one ended.
        """
        reached: list[Array] = []
        states: list[Array] = []
        for tile, lanes in self._tiles:
            action = tile.respond(self.step)
            for k, before in enumerate(self._states[lanes]):
                reached.append(self._answer(tile, k, before, action[:, k]))
                states.append(self._following(tile, k, reached[-1]))
        self._clamp(states)
        for tile, lanes in self._tiles:
            tile.hear([self._see(state) for state in states[lanes]])
        return reached, states

    def _answer(self, tile: Tile, k: int, before: Array, action: Array) -> Array:
        """Return the state after `before` in lane k of a tile; set the tile's reward and end."""
        draws = Draws(self._tiles.seed, tile.first_lane + k, self.step)
        state = _kept_shape(self._task.transition(before.copy(), action, draws), before)
        tile.reward[k] = _number(self._task.reward(state))
        tile.ended[k] = self._task.ended(state)
        return state

    def _following(self, tile: Tile, k: int, state: Array) -> Array:
        """Return the state, or the first one of the next episode if this one ended."""
        if not tile.ended[k]:
            return state
        draws = Draws(self._tiles.seed, tile.first_lane + k, self.step, NEXT_EPISODE)
        return _kept_shape(self._task.restart(draws), state)


class CompiledWorld(World):
    """A compiled task that the engine calls; the tiles hold its states. A failed call is undone."""

    def __init__(self, task: CompiledTask, tiles: Tiles) -> None:
        super().__init__(task, tiles)
        self._answer, self._data = task.answer, np.array(task.data())
        self._pieces = Pieces()

    @property
    def states(self) -> Array:
        return self._tiles.joined(lambda tile: tile.world[:, : tile.lanes])

    def state(self, lane: int) -> Array:
        tile, k = self._tiles.place_of(lane)
        return tile.world[:, k].copy()

    def put(self, states: Sequence[Array]) -> None:
        for tile, lanes in self._tiles:
            tile.put_world(np.stack(states[lanes], axis=1))

    def run(self, steps: int, *, instead: Array, watch: int, notes: Notes, since: Summing) -> None:
        self._tiles.keep()
        since.keep()
        before = self.state(watch) if len(notes.worlds) else np.zeros(0)
        try:
            for piece in self._pieces.of(steps):
                self._run(piece, instead, watch, notes, since)
            if len(notes.worlds):
                self._note_ends(before, watch, notes)
        except BaseException:
            self._tiles.back()
            since.back()
            raise
        self.step += steps

    def _run(self, piece: slice, instead: Array, watch: int, notes: Notes, since: Summing) -> None:
        """Run the steps of one piece."""
        for tile, lane in self._tiles.watched(watch):
            tile.run(
                piece.stop - piece.start, self.step + piece.start, self._answer, self._data,
                instead=instead[piece], watch=lane, notes=notes.part(piece), sums=since.sums,
            )  # fmt: skip

    def _note_ends(self, before: Array, watch: int, notes: Notes) -> None:
        """Note the state that ended an episode; compiled code left the first of the next one.

        The task's methods recompute it; they agree with compiled code to the bit.
        """
        topology = self._tiles.layout.topology
        actions = np.array(topology.activity)[notes.fired[:, topology.neurons_of(topology.output)]]
        began = np.concatenate((before[None], notes.worlds[:-1]))
        for row in np.flatnonzero(notes.rewards[:, 2]).tolist():
            draws = Draws(self._tiles.seed, self._tiles.first_lane + watch, self.step + row)
            notes.worlds[row] = self._task.transition(began[row].copy(), actions[row], draws)


def check_fit(task: Task, topology: Topology) -> None:
    """Raise ValueError unless the network's inputs and outputs fit the task."""
    if isinstance(task, CompiledTask) and type(task).clamps is not Task.clamps:
        raise ValueError(
            f"task {task.name!r} is compiled, so its clamps would never be called: leave them "
            "out, or make it a Task"
        )
    inputs, outputs = len(task.inputs), len(task.outputs)
    if topology.inputs != inputs:
        raise ValueError(f"task {task.name!r} has {inputs} inputs, the network {topology.inputs}")
    size = topology.group(topology.output).size
    if size != outputs:
        raise ValueError(
            f"task {task.name!r} has {outputs} outputs, the network's group "
            f"{topology.output!r} has {size}"
        )


def _number(reward: object) -> float:
    try:
        return float(reward)  # type: ignore[arg-type]  # the error says what is wrong
    except (TypeError, ValueError) as error:
        raise TypeError(f"reward must return a number, got {reward!r:.60}") from error


def _kept_shape(state: Array, before: Array) -> Array:
    """Return a state as numbers; raise ValueError if its shape differs from `before`."""
    state = _numbers(state)
    if state.shape != before.shape:
        raise ValueError(f"the state must keep its shape {before.shape}, got {state.shape}")
    return state


def _numbers(state: Array) -> Array:
    """Copy the state that a task returned to float64, as a save will hold it."""
    return np.array(state, dtype=np.float64)
