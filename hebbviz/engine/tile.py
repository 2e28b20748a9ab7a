"""A tile: up to 64 lanes of a network that are stepped together, the arrays the engine works on.

A tile is as wide as one of `compile.WIDTHS`. Lanes that nobody asked for idle beside the others as
copies of the last one with random numbers of their own; from outside they are not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine import held_input
from hebbviz.engine.buffers import NOBODY, Notes, Sums
from hebbviz.engine.layout import NEURON, Layout, aligned, width_for
from hebbviz.engine.loop import (
    FALL_EVERY,
    are_finite,
    engine,
    gamma_in_force,
    probabilities,
    written_out,
)
from hebbviz.engine.unrolled import plan_of
from hebbviz.limits import LARGEST_BETA
from hebbviz.numerics.counter_rng import SPIKES, uniforms
from hebbviz.rules.base import Rule, RuleError
from hebbviz.rules.paper import PAPER

Array = NDArray[np.float64]

_LONG = 3
"""Steps of which the first and the last are not all."""


class Tile:
    """Lanes `first_lane` to `first_lane + lanes - 1` of a seed; float32 or float64.

    `unrolled`: run long stretches with code compiled for this network alone.
    """

    def __init__(
        self, layout: Layout, *, seed: int, first_lane: int, lanes: int,
        dtype: type[np.floating], written: bool = False,
    ) -> None:  # fmt: skip
        self.layout, self.first_lane, self.lanes = layout, first_lane, lanes
        plan = plan_of(layout) if written else None
        self.width = width_for(lanes, written_out=plan is not None)
        self._engine = engine(self.width)
        self._written_out = None if plan is None else written_out(self.width, plan)
        self.network: NDArray[Any] = layout.empty_state(self.width, dtype)
        numbers = (first_lane + np.arange(self.width)) % 2**32
        self._keys = np.stack([np.full(self.width, seed), numbers]).astype(np.uint32)
        self.totals = aligned(3, self.width)
        self.world = np.zeros((0, self.width))
        self._gamma, self._fall = np.zeros((len(layout.topology.projections), self.width)), np.inf
        self.reward, self.ended = np.zeros(self.width), np.zeros(self.width)
        self._observed = aligned(layout.topology.inputs, self.width)
        output = layout.where["activity"][layout.topology.units_of(layout.topology.output)]
        self._output = slice(output[0], output[-1] + 1, len(NEURON))
        self._stands_for = np.minimum(np.arange(self.width), lanes - 1)
        self._clamped = False
        self._responded: int | None = None
        self._was: tuple[bool, int | None] = (False, None)

    # The rule

    def set_rule(self, rule: Rule) -> None:
        """Another rule, its memory empty; raises ValueError if it fails or cannot be compiled."""
        self._rule = rule
        (self._modulate, self._modulate_now), self._constants = rule.compiled(), rule.constants
        self._modulated = np.zeros(0 if rule == PAPER else self.width)
        self.memory = np.zeros((len(rule.memory), self.lanes))
        self._make_room()

    # Its numbers

    def read(self, name: str) -> Array:
        """A section that the state holds, (rows, lanes)."""
        return self.layout.section(self.network, name)[:, : self.lanes].astype(np.float64)

    def read_lane(self, name: str, lane: int) -> Array:
        """The same of one lane, (rows,)."""
        return np.array(self.network[self.layout.where[name], lane], dtype=np.float64)

    def betas(self, lane: int) -> Array:
        """β of each projection, (projections,), as it can be set: below 1 where float32 is at 1."""
        return np.minimum(self.read_lane("beta", lane), LARGEST_BETA)

    def spikes(self) -> dict[str, Array]:
        """The sections `probability`, `draw` and `fired` of the last step, (rows, lanes)."""
        neurons = self.layout.topology.neurons
        if self._responded is None:
            nothing = np.zeros((neurons, self.lanes))
            none = np.zeros((self.layout.draws, self.lanes))
            return {"probability": nothing, "draw": none, "fired": nothing}
        potential = self.layout.section(self.network, "potential")[:, : self.lanes]
        activity = self.read("activity")[-neurons:]
        draws = [
            uniforms(self.layout.draws, seed=int(seed), lane=int(number), purpose=SPIKES,
                     step=self._responded)
            for seed, number in self._keys.T[: self.lanes]
        ]  # fmt: skip
        return {
            "probability": probabilities(potential).astype(np.float64),
            "draw": np.stack(draws, axis=1),
            "fired": (activity == self.layout.topology.activity[1]).astype(np.float64),
        }

    def put(self, name: str, values: Array | float) -> None:
        """Set a section: a number, or (rows, lanes)."""
        self.layout.put(self.network, name, self._to_width(values))
        if name == "clamp":
            self._clamped = not np.isnan(values).all()

    def synapses(self) -> tuple[Array, Array]:
        """w and z as they are now, each (synapses, lanes)."""
        lanes = self.network[:, : self.lanes].astype(np.float64)
        return held_input.unfolded(self.layout, lanes)

    def synapses_of(self, lane: int) -> tuple[Array, Array]:
        """w and z of one lane, each (synapses,)."""
        weight, trace = held_input.unfolded(
            self.layout, self.network[:, lane : lane + 1].astype(np.float64)
        )
        return weight[:, 0], trace[:, 0]

    def set_synapses(self, weights: Array, traces: Array) -> None:
        """Put (synapses, lanes) in place of what there is."""
        self.put("weight", weights)
        self.put("trace", traces)
        held_input.refold(self.layout, self.network)

    def pack(self) -> Array:
        """All of it in the order of `layout.SECTIONS`, (rows, lanes)."""
        absent = self.spikes() | {"tally": self.totals[:, : self.lanes]}
        return self.layout.pack(self.network[:, : self.lanes], absent)

    def unpack(self, packed: Array, step: int) -> None:
        """The inverse of `pack`, before the step of that number."""
        packed = self._to_width(packed)
        self.layout.unpack(packed, self.network)
        rows = self.layout.packed
        self.totals[:] = packed[rows["tally"]]
        self._clamped = not np.isnan(packed[rows["clamp"]]).all()
        self._responded = step - 1 if packed[rows["draw"]].any() else None
        self._look_again()

    def _look_again(self) -> None:
        self._observed[:] = self.network[self.layout.where["activity"][: len(self._observed)]]

    def _to_width(self, values: Array | float) -> Any:
        """For the lanes that idle, what the last one has."""
        return values if np.ndim(values) == 0 else np.take(values, self._stands_for, axis=1)

    # Steps

    def see(self, observation: Array) -> None:
        """Set the input values, (inputs, lanes)."""
        self._observed[:] = self._to_width(observation)
        self._engine.hold(self.network, self.layout.table, self._observed)

    def put_gamma(self, gamma: Array, step: int, fall: float) -> None:
        """Put γ (projections, lanes) in force as it is at this step, falling over `fall` steps."""
        self._gamma[:], self._fall = self._to_width(gamma), fall
        self._put_gamma(step)

    def _put_gamma(self, step: int) -> None:
        self.layout.put(self.network, "gamma", gamma_in_force(self._gamma, step, self._fall))

    def put_world(self, world: Array) -> None:
        """The state of a compiled world, (numbers, lanes)."""
        self.world = aligned(len(world), self.width)
        self.world[:] = self._to_width(world)
        self._make_room()

    def run(
        self, steps: int, start: int, answer: Any, data: Array, *, instead: Array, watch: int,
        notes: Notes, sums: Sums,
    ) -> None:  # fmt: skip
        """`steps` steps of a compiled world, the first of them number `start`.

        Raises ValueError if what the world answered is not finite, RuleError if what the rule made
        of it is not.
        """
        if self._written_out is None or watch != NOBODY or self._clamped or steps < _LONG:
            self._run(steps, start, answer, data, instead, watch, notes, sums)
        else:
            first, last = slice(0, 1), slice(steps - 1, steps)
            self._run(1, start, answer, data, instead[first], watch, notes, sums)
            self._run_written_out(steps - 2, start + 1, answer, data, instead[1:-1])
            self._run(1, start + steps - 1, answer, data, instead[last], watch, notes, sums)
        if steps > 0:
            self._responded = start + steps - 1
        self._check_answer(self.totals[0])
        self._check_rule(self.totals[1])

    def _run(
        self, steps: int, start: int, answer: Any, data: Array, instead: Array, watch: int,
        notes: Notes, sums: Sums,
    ) -> None:  # fmt: skip
        self._engine.run(
            steps, start, answer, self.network, self.layout.table, self._keys,
            *self.layout.topology.activity, self._clamped, self.totals, self.world, data,
            self._observed, self._gamma, self._fall, self._modulate, self.memory, self._constants,
            self._modulated, instead, watch, *notes, *sums,
        )  # fmt: skip

    def _run_written_out(
        self, steps: int, start: int, answer: Any, data: Array, instead: Array
    ) -> None:
        assert self._written_out is not None
        self._written_out(
            steps, start, answer, self.network, self.layout.table, self._keys,
            *self.layout.topology.activity, self.totals, self.world, data, self._observed,
            self._gamma, self._fall, self._modulate, self.memory, self._constants,
            self._modulated, instead,
        )  # fmt: skip

    def respond(self, step: int) -> Array:
        """Actions of the outputs at this step of a world in Python, (outputs, lanes)."""
        if self._fall < np.inf and step % FALL_EVERY == 0:
            self._put_gamma(step)
        self._engine.respond(
            self.network, self.layout.table, self._keys, step, *self.layout.topology.activity,
            self._clamped,
        )  # fmt: skip
        self._responded = step
        return self.network[self._output, : self.lanes].astype(np.float64)

    def hear(self, observation: Sequence[Array]) -> None:
        """Show each lane the next observation; `reward` and `ended` are the answer of the world.

        Raises ValueError if it is not finite.
        """
        for lane, seen in enumerate(observation):
            self._observed[:, lane] = seen
        self._check_answer(self.reward)

    def _check_answer(self, rewards: Array) -> None:
        """Raise ValueError unless what was seen and these rewards, or their sums, are finite."""
        if are_finite(self._observed, rewards, self.lanes):
            return
        for value in rewards[: self.lanes]:
            if not np.isfinite(value):
                raise ValueError(f"a reward, {value}, is not a finite number")
        (number, lane), *_ = np.argwhere(~np.isfinite(self._observed))
        value = self._observed[number, lane]
        raise ValueError(f"an observation, {value} of input {number}, is not a finite number")

    def _check_rule(self, sent: Array) -> None:
        """Raise RuleError unless what was sent, or the sums of it, and what is kept are finite."""
        for what, numbers in (("sent", sent[: self.lanes]), ("kept", self.memory)):
            if not np.isfinite(numbers).all():
                raise RuleError(f"rule {self._rule} {what} what is not a finite number")

    def settle(self, row: int, *, instead: Array, watch: int, notes: Notes, sums: Sums) -> None:
        """All that follows the world's answer; raises RuleError if the rule fails."""
        sent = self.reward
        if len(self._modulated):
            sent = self._modulated
            self._modulate_lanes()
        if len(instead):
            sent = np.full(self.width, instead[row])
        self._engine.settle(
            self.network, self.layout.table, self.layout.topology.activity[1], self.totals,
            self._observed, self.reward, sent, self.ended, watch, row, *notes[:3], *sums,
        )  # fmt: skip

    def _modulate_lanes(self) -> None:
        """Compute the broadcast of the rule from the rewards of the given lanes."""
        lanes = slice(self.lanes)
        try:
            self._modulate_now(
                self.memory, self._constants, self.reward[lanes], self.ended[lanes],
                self._modulated[lanes],
            )  # fmt: skip
        except Exception as error:
            raise RuleError(f"rule {self._rule}: {type(error).__name__}: {error}") from error
        self._check_rule(self._modulated)

    # Going back

    def keep(self) -> None:
        """Remember this moment."""
        for kept, now in self._kept:
            np.copyto(kept, now)
        self._was = self._clamped, self._responded

    def back(self) -> None:
        """As it was when it was last kept."""
        for kept, now in self._kept:
            np.copyto(now, kept)
        self._clamped, self._responded = self._was
        self._look_again()

    def _make_room(self) -> None:
        arrays = (self.network, self.totals, self.memory, self.world)
        self._kept = [(np.empty_like(array), array) for array in arrays if array.size]
