"""A finite POMDP as a task, so that the exact gradient of a network that learns in it is known.

    observation y  →  row y of `vectors`, the activities of the input units
    control u      ←  the outputs' joint activity: output i, firing, adds 2^i

In the engine's order: the network answers with u, the world moves from x to x' by P(u), the reward
is r(x'), and the network sees y' ~ ν(x') next.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hebbviz.limits import check_places
from hebbviz.numerics.compile import called, compiled
from hebbviz.numerics.counter_rng import WORLD, four_uniforms
from hebbviz.task.base import CompiledTask, Input, Output
from hebbviz.task.presets import Preset
from hebbviz.task.signature import WORLD as WORLD_SIGNATURE
from hebbviz.theory.exact_gradient import GradientTruth
from hebbviz.theory.network_chain import ExactNetwork
from hebbviz.theory.pomdp import POMDP
from hebbviz.topology import SYMMETRIC, Activity, Topology

Array = NDArray[np.float64]

Whole = NDArray[np.int64]

_X, _Y, _PAST = range(3)
_STATES, _SIGHTS, _CONTROLS, _INPUTS, _PASTS = range(5)

NOTHING = -1
"""Marks times before the start in a history."""
LARGEST_PAST = 2**53
"""float64 holds integers exactly up to here."""


@compiled
def _drawn(data, row, count, draw):  # type: ignore[no-untyped-def]
    """The first index in a row of cumulative sums whose value exceeds the draw."""
    for k in range(count - 1):
        if data[row, k] > draw:
            return k
    return count - 1


@called(WORLD_SIGNATURE)
def answer(world, action, data, keys, step, observation, reward, ended):  # type: ignore[no-untyped-def]
    """Step the world in all lanes, see `signature.WORLD`; `data` is `FiniteWorld.data`."""
    states, sights = np.int64(data[0, _STATES]), np.int64(data[0, _SIGHTS])
    seen = 1 + states * np.int64(data[0, _CONTROLS])
    changed = 0
    for lane in range(world.shape[1]):
        control, power = 0, 1
        for i in range(action.shape[0]):
            if action[i, lane] > 0.0:
                control += power
            power *= 2
        x, y = np.int64(world[_X, lane]), np.int64(world[_Y, lane])
        if world.shape[0] > _PAST:
            longer = np.int64(world[_PAST, lane]) * (states * sights + 1) + x * sights + y + 1
            world[_PAST, lane] = longer % np.int64(data[0, _PASTS])
        of_state, of_sight, _, _ = four_uniforms(keys[0, lane], keys[1, lane], WORLD, step, 0)
        x = _drawn(data, 1 + control * states + x, states, of_state)
        sight = _drawn(data, seen + x, sights, of_sight)
        world[_X, lane], world[_Y, lane] = x, sight
        reward[lane] = data[seen + states + sights, x]
        ended[lane] = 0.0
        if sight != y:
            changed = 1
        for j in range(np.int64(data[0, _INPUTS])):
            observation[j, lane] = data[seen + states + sight, j]
    return changed


class FiniteWorld(CompiledTask):
    """A finite world, with state (x, y). A subclass defines `pomdp`, `vectors` and `outputs`.

    If `past` is not 0, one more number of the state encodes the `past` previous pairs (x, y), for
    display only: the world does not depend on it. `history` decodes it. Its digits, the latest
    last, are 1 + x·Y + y, and 0 before the start.

    `vectors` (Y, inputs) gives the input values of each observation; the inputs are numbered if
    the subclass does not name them. Episodes never end; the first x is uniform over the states.
    `finite_world` makes a task without a subclass.

    Raises
    ------
    ValueError
        If there is not one vector per observation, if inputs or outputs do not fit the world, or
        if the past does not fit into one number.
    """

    pomdp: ClassVar[POMDP]
    vectors: ClassVar[Array]
    past: ClassVar[int] = 0
    answer = answer

    def __init__(self, preset: str | None = None) -> None:
        super().__init__(preset)
        shape, sights, controls = self.vectors.shape, self.pomdp.sights, self.pomdp.controls
        if len(shape) != 2 or shape[0] != sights or not np.isfinite(self.vectors).all():
            raise ValueError(
                f"vectors must be finite and of shape ({sights} observations, inputs), got {shape}"
            )
        if 2 ** len(self.outputs) != controls:
            raise ValueError(
                f"{len(self.outputs)} outputs make {2 ** len(self.outputs)} controls, "
                f"the world has {controls}"
            )
        self.inputs = getattr(
            self, "inputs", tuple(Input(f"input {j + 1}") for j in range(shape[1]))
        )
        if len(self.inputs) != shape[1]:
            raise ValueError(f"{len(self.inputs)} inputs have names, vectors have {shape[1]}")
        self._base = self.pomdp.states * sights + 1
        if self._base**self.past > LARGEST_PAST:
            raise ValueError(
                f"a past of {self.past} steps of {self._base - 1} pairs is too long for one number"
            )
        self._exact: ExactNetwork | None = None
        self._next = self.pomdp.transitions.cumsum(axis=2)
        self._sight = self.pomdp.observations.cumsum(axis=1)

    def data(self) -> Array:
        """Rows for `answer`: sizes, cumulative sums of P(u) and of ν, vectors, rewards."""
        w = self.pomdp
        sizes = np.array(
            [[w.states, w.sights, w.controls, len(self.inputs), self._base**self.past]]
        )
        parts = (
            sizes,
            self._next.reshape(-1, w.states),
            self._sight,
            self.vectors,
            w.rewards[None],
        )
        columns = max(p.shape[1] for p in parts)
        return np.vstack([np.pad(p, ((0, 0), (0, columns - p.shape[1]))) for p in parts])

    def restart(self, draws: Callable[[int], Array]) -> Array:
        of_state, of_sight = draws(2)
        return self._state(int(of_state * self.pomdp.states), of_sight, 0)

    def transition(self, state: Array, action: Array, draws: Callable[[int], Array]) -> Array:
        of_state, of_sight = draws(2)
        control = sum(2**i for i, u in enumerate(action) if u > 0.0)
        x, past = int(state[_X]), 0
        if self.past:
            pair = x * self.pomdp.sights + int(state[_Y])
            past = (int(state[_PAST]) * self._base + pair + 1) % self._base**self.past
        return self._state(_first_above(self._next[control, x], of_state), of_sight, past)

    def observation(self, state: Array) -> Array:
        return np.array(self.vectors[int(state[_Y])], dtype=np.float64)

    def reward(self, state: Array) -> float:
        return float(self.pomdp.rewards[int(state[_X])])

    def check_states(self, states: Array) -> None:
        ends = (self.pomdp.states, self.pomdp.sights, self._base**self.past)
        for what, column, end in zip(("x", "y", "the past"), states.T, ends, strict=False):
            check_places(what, column, end)

    def history(self, states: Array) -> tuple[Whole, Whole]:
        """Return x and y of the `past` previous steps and of the present one, each (n, past + 1).

        `states` has shape (n, numbers). The last column is the present; steps before the start
        hold NOTHING.
        """
        x, y = states[:, [_X]].astype(np.int64), states[:, [_Y]].astype(np.int64)
        if not self.past:
            return x, y
        powers = self._base ** np.arange(self.past - 1, -1, -1, dtype=np.int64)
        pair = states[:, [_PAST]].astype(np.int64) // powers % self._base - 1
        x_before = np.where(pair < 0, NOTHING, pair // self.pomdp.sights)
        y_before = np.where(pair < 0, NOTHING, pair % self.pomdp.sights)
        return np.hstack([x_before, x]), np.hstack([y_before, y])

    def _state(self, x: int, of_sight: float, past: int) -> Array:
        y = _first_above(self._sight[x], of_sight)
        return np.array([x, y, past] if self.past else [x, y], dtype=np.float64)

    def truth(self, weights: Array, topology: Topology, beta: float) -> GradientTruth:
        """Return the gradient of the exact chain.

        Raises ValueError if the network is too large for an exact chain.
        """
        exact = self._exact
        if exact is None or exact.topology != topology:
            exact = self._exact = ExactNetwork(self.pomdp, self.vectors, topology)
        chain = exact.at(weights)
        return GradientTruth(
            chain.gradient,
            chain.biased_gradient(beta),
            chain.noise(beta),
            chain.average_reward,
            self.best_reward(topology),
        )

    def best_reward(self, topology: Topology) -> float | None:
        """Return the largest average reward of a network of this topology; None if unknown."""
        return None


def finite_world(
    pomdp: POMDP, vectors: Array, *, activity: Activity = SYMMETRIC, hidden: tuple[int, ...] = (2,)
) -> FiniteWorld:
    """Make a task of a POMDP; `vectors` (Y, inputs) gives the inputs of each observation.

    Raises ValueError if the number of controls is not a power of two.
    """
    outputs = tuple(
        Output(f"output {i + 1}", f"adds {2**i} to the control", "adds nothing")
        for i in range((pomdp.controls - 1).bit_length())
    )
    about = {
        "name": "finite world",
        "pomdp": pomdp,
        "vectors": np.array(vectors, dtype=np.float64),
        "outputs": outputs,
        "activity": activity,
        "hidden": hidden,
        "presets": {"only": Preset(0.9, 0.01, "not in the paper")},
    }
    made: FiniteWorld = type("FiniteWorldOf", (FiniteWorld,), about)()
    return made


def _first_above(cumulative: Array, draw: float) -> int:
    return int((cumulative[:-1] <= draw).sum())
