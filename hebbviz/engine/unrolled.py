"""The rule written out for one network: `kernel` without loops over neurons and synapses.

Of a small network, every neuron and synapse can have statements of its own, all in one loop over
the lanes. A value that one statement computes and another needs then stays in a register, where
`kernel` goes through memory between its loops, and the compiler sees a whole step at once. The
equations, their order and so the results are those of `kernel`, to the bit.

The source is made from the layout's table, given as text (`plan_of`), when the function that calls
these is compiled; that text is a constant there, so numba keeps what it compiles for one table
apart from what it compiles for another. Left out is what only the last step of many must leave
behind, potentials, activities before and surprises, and what one rarely asks for, clamps, notes
and reward by hand: `loop` has those steps taken by `kernel`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from numba.extending import overload

from hebbviz.engine.kernel import (
    A_HELD,
    A_NEURON,
    A_PROJECTION,
    A_SYNAPSE,
    BETA,
    DECAY,
    GAIN,
    GAMMA,
    W_DRIVE,
    W_INPUT,
    X_SQUARED,
    Z_DRIVE,
    Z_INPUT,
    U,
    W,
    Z,
)
from hebbviz.engine.layout import BLOCK, COLUMNS, HEADER, Layout
from hebbviz.numerics.compile import INLINED, row
from hebbviz.numerics.counter_rng import SPIKES, four_words, unit
from hebbviz.numerics.logistic import sigmoid

MOST = 150
"""Neurons and synapses that are written out; beyond that the source takes long to compile."""

_NAMES = {"row": row, "sigmoid": sigmoid, "unit": unit, "SPIKES": SPIKES,
          "four_words": four_words}  # fmt: skip
"""Names that the generated source uses."""


def plan_of(layout: Layout) -> str | None:
    """The layout's table as text; None if the network is too large to be written out."""
    t = layout.topology
    each = sum(t.shape(p)[0] * (1 if t.is_held(p) else t.shape(p)[1]) for p in t.projections)
    return json.dumps(layout.table.tolist()) if t.neurons + each <= MOST else None


def respond(plan: Any, state: Any, width: Any, keys: Any, step: Any, low: Any, high: Any) -> Any:
    """`kernel.respond`, for the input of the step before and where nothing is clamped."""
    raise NotImplementedError("written.respond is for compiled code")


def reinforce(
    plan: Any, state: Any, width: Any, totals: Any, reward: Any, sent: Any, ended: Any
) -> Any:
    """Add to the totals what the task gave, what is broadcast and what ended;
    `kernel.reinforce`.
    """
    raise NotImplementedError("written.reinforce is for compiled code")


@overload(respond, jit_options=INLINED, prefer_literal=True)
def _respond_for(plan, state, width, keys, step, low, high):  # type: ignore[no-untyped-def]
    return _Network(plan.literal_value).respond()


@overload(reinforce, jit_options=INLINED, prefer_literal=True)
def _reinforce_for(plan, state, width, totals, reward, sent, ended):  # type: ignore[no-untyped-def]
    return _Network(plan.literal_value).reinforce()


class _Loop:
    """A loop over the lanes: what is said once before it, and statement by statement its body."""

    def __init__(self, *before: str) -> None:
        self._before, self._body = ["kind = state.dtype.type", *before], list[str]()
        self._rows = dict[int, str]()

    def say(self, statement: str) -> None:
        self._body.append(statement)

    def at(self, number: int) -> str:
        """The lane's entry of a row of the state."""
        self._rows[number] = f"row_{number} = row(state, {number}, width)"
        return f"row_{number}[lane]"

    def share(self, name: str, number: int) -> None:
        """Name the entry of a row that has the same in all lanes."""
        self._before.append(f"{name} = row(state, {number}, width)[0]")

    def function(self, parameters: str) -> Any:
        """Source for numba to compile."""
        head = [f"    {line}" for line in (*self._before, *self._rows.values())]
        body = [f"        {line}" for line in self._body]
        source = "\n".join(
            [f"def written({parameters}):", *head, "    for lane in range(width):", *body]
        )
        found: dict[str, Any] = {}
        exec(source, dict(_NAMES), found)  # numbers of the table, and words of ours
        return found["written"]


class _Projection:
    """A projection by its row of the table: first rows of records, and numbers of neurons."""

    def __init__(self, k: int, columns: Mapping[str, int], head: Mapping[str, int]) -> None:
        self.record = head["projection"] + k * A_PROJECTION
        self.is_held = bool(columns["is_held"])
        self._pre_size, self._held, self._synapse = (
            columns[name] for name in ("pre_size", "held", "synapse")
        )
        first_post, self.first_pre = (
            (columns[name] - head["neuron"]) // A_NEURON for name in ("post", "pre")
        )
        self.post = list(enumerate(range(first_post, first_post + columns["post_size"])))
        self.pre = range(0 if self.is_held else columns["pre_size"])
        self.beta, self.gamma = f"beta_{k}", f"gamma_{k}"

    def held(self, i: int) -> int:
        """Record of the held sums of its neuron i."""
        return self._held + i * A_HELD

    def synapse(self, i: int, j: int) -> int:
        return self._synapse + (i * self._pre_size + j) * A_SYNAPSE


class _Network:
    """A network by its table, and what `kernel` does with it, one statement after another."""

    def __init__(self, plan: str) -> None:
        head, *rows = json.loads(plan)
        self._head: dict[str, int] = dict(zip(HEADER, head, strict=False))
        named = (dict(zip(COLUMNS, row, strict=False)) for row in rows)
        self._projections = [_Projection(k, p, self._head) for k, p in enumerate(named)]

    def respond(self) -> Any:
        """One step, from the activities of the step before."""
        loop = _Loop(
            "seed, number = keys[0, 0], row(keys, 1, width)",
            "zero, one, silent, active = kind(0), kind(1), kind(low), kind(high)",
        )
        for n in range(self._head["neurons"]):
            loop.say(f"u_{n}, v_{n} = {loop.at(self._activity(n))}, zero")
        for p in self._projections:
            self._add_potentials(loop, p)
        self._fire(loop)
        for p in self._projections:
            self._remember(loop, p)
        return loop.function("plan, state, width, keys, step, low, high")

    def _activity(self, neuron: int) -> int:
        return self._head["neuron"] + neuron * A_NEURON + U

    def _add_potentials(self, loop: _Loop, p: _Projection) -> None:
        """Equation (potential): what a projection adds to its neurons."""
        for i, n in p.post:
            if p.is_held:
                gain, x_squared = loop.at(p.record + GAIN), loop.at(p.record + X_SQUARED)
                w_drive, z_drive = loop.at(p.held(i) + W_DRIVE), loop.at(p.held(i) + Z_DRIVE)
                w_input = loop.at(p.held(i) + W_INPUT)
                loop.say(f"v_{n} += {w_drive} + {gain} * {z_drive} + {w_input} * {x_squared}")
            for j in p.pre:
                loop.say(f"v_{n} += {loop.at(p.synapse(i, j) + W)} * u_{p.first_pre + j}")

    def _fire(self, loop: _Loop) -> None:
        """Equation (neuron) for every neuron."""
        for n in range(self._head["neurons"]):
            if n % BLOCK == 0:
                words = ", ".join(f"word_{n + k}" for k in range(BLOCK))
                loop.say(f"{words} = four_words(seed, number[lane], SPIKES, step, {n // BLOCK})")
            loop.say(f"expected = sigmoid(v_{n})")
            loop.say(f"fires = unit(word_{n}, zero) < expected")
            loop.say(f"surprise_{n} = (one if fires else zero) - expected")
            loop.say(f"{loop.at(self._activity(n))} = active if fires else silent")

    def _remember(self, loop: _Loop, p: _Projection) -> None:
        """Equation (neuron-zupdate) for every synapse of a projection."""
        loop.share(p.beta, p.record + BETA)
        if p.is_held:
            loop.say(f"{loop.at(p.record + DECAY)} *= {p.beta}")
        for i, n in p.post:
            if p.is_held:
                z = loop.at(p.held(i) + Z_INPUT)
                loop.say(f"{z} = {p.beta} * {z} + surprise_{n}")
            for j in p.pre:
                z = loop.at(p.synapse(i, j) + Z)
                loop.say(f"{z} = {p.beta} * {z} + surprise_{n} * u_{p.first_pre + j}")

    def reinforce(self) -> Any:
        """Equation (neuron-update) for every synapse."""
        loop = _Loop(
            "of_task, broadcast = row(totals, 0, width), row(totals, 1, width)",
            "ends = row(totals, 2, width)",
        )
        loop.say("of_task[lane] += reward[lane]")
        loop.say("broadcast[lane] += sent[lane]")
        loop.say("ends[lane] += ended[lane]")
        for p in self._projections:
            loop.share(p.gamma, p.record + GAMMA)
            loop.say(f"push = {p.gamma} * kind(sent[lane])")
            moved = [(p.synapse(i, j) + W, p.synapse(i, j) + Z) for i, _ in p.post for j in p.pre]
            if p.is_held:
                moved = [(p.record + GAIN, p.record + DECAY)]
                moved += [(p.held(i) + W_INPUT, p.held(i) + Z_INPUT) for i, _ in p.post]
            for weight, trace in moved:
                loop.say(f"{loop.at(weight)} += push * {loop.at(trace)}")
        return loop.function("plan, state, width, totals, reward, sent, ended")
