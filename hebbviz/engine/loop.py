"""The closed loop, compiled once for every task and topology, for each width of a tile of lanes.

A step is: the network responds, the world answers with a reward and the next input, the rule
moves the weights, the input is set. A compiled world comes as a pointer to a function
(`task.signature.WORLD`), and so does a rule other than the paper's (`rules.MODULATE`). A world that
is stepped by Python uses `respond` and then `settle`, which holds everything that follows the
world's answer.

The network may be of float32 or of float64; worlds, rewards and totals are float64 in both.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from hebbviz.engine import kernel, unrolled
from hebbviz.engine.kernel import A_NEURON, BY_HAND, FIRST_NEURON, FIRST_OUTPUT, REWARD, U, V, at
from hebbviz.engine.layout import BLOCK
from hebbviz.numerics.compile import compiled, inlined, row
from hebbviz.numerics.logistic import sigmoid

FALL_EVERY = 256
"""A decaying γ is updated at steps that are multiples of this."""


class Engine(NamedTuple):
    """The compiled functions for tiles of one width."""

    respond: Any
    settle: Any
    run: Any
    hold: Any


def gamma_in_force(gamma: Any, step: Any, fall: Any) -> Any:
    """γ as it decays over `fall` steps, at a step; numbers or arrays."""
    return gamma / (1.0 + (step - step % FALL_EVERY) / fall)


@inlined
def _broadcast(state, table, width, totals, reward, modulated, ended):  # type: ignore[no-untyped-def]
    """The reward pipeline: the task's r → the rule's m + reward given by hand → every synapse."""
    kind = state.dtype.type
    r, by_hand = at(table[0], REWARD), row(state, at(table[0], BY_HAND), width)
    raw, sent = row(state, r, width), row(state, r + 1, width)
    of_task, broadcast, ends = row(totals, 0, width), row(totals, 1, width), row(totals, 2, width)
    for lane in range(width):
        m = modulated[lane] + by_hand[lane]
        by_hand[lane] = 0.0
        raw[lane], sent[lane] = kind(reward[lane]), kind(m)
        of_task[lane] += reward[lane]
        broadcast[lane] += m
        ends[lane] += ended[lane]


@inlined
def _fall(state, table, width, gamma, fall, step):  # type: ignore[no-untyped-def]
    """Put γ in force as it is from this step on: γ/(1 + t/T)."""
    kind = state.dtype.type
    for k in range(at(table[0], kernel.PROJECTIONS)):
        q = at(table[0], kernel.FIRST_PROJECTION) + k * kernel.A_PROJECTION
        in_force, set_gamma = row(state, q + kernel.GAMMA, width), row(gamma, k, width)
        for lane in range(width):
            in_force[lane] = kind(set_gamma[lane] / (1.0 + step / fall))


@inlined
def _note(  # type: ignore[no-untyped-def]
    state, table, lane, step, high, ended, spikes, rewards, potentials, counts, extremes, probes
):
    """Write one step into the block and into the summary. A probe is four rows of the state."""
    neurons, r = at(table[0], kernel.NEURONS), at(table[0], REWARD)
    for i in range(neurons):
        n = at(table[0], FIRST_NEURON) + i * A_NEURON
        potential, spike = np.float64(state[n + V, lane]), state[n + U, lane] == high
        counts[i] += np.int64(spike)
        extremes[0, i] = min(extremes[0, i], potential)
        extremes[1, i] = max(extremes[1, i], potential)
        spikes[step, i] = np.uint8(spike)
        if potentials.shape[0] > 0:
            potentials[step, i] = potential
    for k in range(probes.shape[0]):
        z = np.float64(state[probes[k, 0], lane])
        if probes[k, 1] >= 0:  # held input, see rule
            z *= state[probes[k, 1], lane]
            z += state[probes[k, 2], lane] * state[probes[k, 3], lane]
        extremes[0, neurons + k] = min(extremes[0, neurons + k], z)
        extremes[1, neurons + k] = max(extremes[1, neurons + k], z)
    rewards[step, 0] = state[r, lane]
    rewards[step, 1] = state[r + 1, lane]
    rewards[step, 2] = ended[lane]


@inlined
def _act(state, table, width, action):  # type: ignore[no-untyped-def]
    """Read the actions of the outputs."""
    for i in range(at(table[0], kernel.OUTPUTS)):
        u = row(state, at(table[0], FIRST_OUTPUT) + i * A_NEURON + U, width)
        act = row(action, i, width)
        for lane in range(width):
            act[lane] = u[lane]


@inlined
def _modulate(call, memory, constants, reward, ended, modulated):  # type: ignore[no-untyped-def]
    """Compute the broadcast of the rule from the rewards of the given lanes."""
    lanes = memory.shape[1]
    call(memory, constants, reward[:lanes], ended[:lanes], modulated[:lanes])


@cache
def engine(width: int) -> Engine:
    """The engine for tiles of `width` lanes, compiled when it is first called.

    Every function takes a tile's `state` (rows, width), float32 or float64, and the layout's
    `table`. `modulate`, `memory` (rows, lanes) and `constants` are the rule's, see `rules.Rule`;
    `modulated` (width, or 0 for the paper's rule, which is not called) is room for what it makes
    of the reward; `instead` (steps, or 0) takes its place. `totals` (3, width) are
    the sums since the start of the rewards of the task, of those broadcast, and of the ends.
    `gamma` (projections, width; 0 while frozen) falls over `fall` steps, unless that is infinite.

    `watch` is the lane that is noted, or -1 for none. Its notes are `spikes` (n, neurons),
    `rewards` (n, 3: of the task, as broadcast, episode ended), if they have rows `potentials`
    (n, neurons) and `worlds` (n, numbers; where an episode ended, the beginning of the next), and
    over all steps `counts` (neurons) and `extremes` (2, neurons + probes: least and greatest v, z).
    """

    @compiled
    def respond(state, table, keys, step, low, high, clamped):  # type: ignore[no-untyped-def]
        """Potentials, spikes and traces of one step, see `rule`."""
        words = np.empty((2 * BLOCK, width), np.uint32)
        kernel.respond(state, table, width, words, keys, step, low, high, clamped, True)

    @compiled
    def hold(state, table, observation):  # type: ignore[no-untyped-def]
        """Set the input values to `observation` (inputs, width)."""
        kernel.hold(state, table, width, observation)

    @compiled
    def settle(  # type: ignore[no-untyped-def]
        state, table, high, totals, observation, reward, sent, ended, watch, step, spikes, rewards,
        potentials, counts, extremes, probes,
    ):  # fmt: skip
        """All that follows the answer of a world stepped by Python.

        `sent` (width) is what is broadcast of the reward.
        """
        _broadcast(state, table, width, totals, reward, sent, ended)
        kernel.reinforce(state, table, width)
        if watch >= 0:
            _note(
                state, table, watch, step, high, ended, spikes, rewards, potentials, counts,
                extremes, probes,
            )  # fmt: skip
        kernel.hold(state, table, width, observation)

    @compiled
    def run(  # type: ignore[no-untyped-def]
        n, start, answer, state, table, keys, low, high, clamped, totals, world, data, observation,
        gamma, fall, modulate, memory, constants, modulated, instead, watch, spikes, rewards,
        potentials, worlds, counts, extremes, probes,
    ):  # fmt: skip
        """`n` steps of a compiled world, the first of them number `start`."""
        action = np.empty((at(table[0], kernel.OUTPUTS), width))
        reward, ended, replaced = np.zeros(width), np.zeros(width), np.empty(width)
        words = np.empty((2 * BLOCK, width), np.uint32)
        sent = modulated if modulated.shape[0] > 0 else reward
        if instead.shape[0] > 0:
            sent = replaced
        new_input = 1
        for t in range(n):
            if fall < np.inf and (start + t) % FALL_EVERY == 0:
                _fall(state, table, width, gamma, fall, start + t)
            kernel.respond(
                state, table, width, words, keys, start + t, low, high, clamped, new_input != 0
            )
            _act(state, table, width, action)
            new_input = answer(world, action, data, keys, start + t, observation, reward, ended)
            if modulated.shape[0] > 0:
                _modulate(modulate, memory, constants, reward, ended, modulated)
            if instead.shape[0] > 0:
                replaced[:] = instead[t]
            _broadcast(state, table, width, totals, reward, sent, ended)
            kernel.reinforce(state, table, width)
            if watch >= 0:
                _note(
                    state, table, watch, t, high, ended, spikes, rewards, potentials, counts,
                    extremes, probes,
                )  # fmt: skip
                if worlds.shape[0] > 0:
                    for k in range(world.shape[0]):
                        worlds[t, k] = world[k, watch]
            if new_input:
                kernel.hold(state, table, width, observation)

    return Engine(respond, settle, run, hold)


@cache
def written_out(width: int, plan: str) -> Any:
    """`run` for tiles of `width` lanes of the one network that has this plan, see `unrolled`.

    Nothing is noted or clamped. The step before is `engine`'s, which takes in the input and the
    reward given by hand, and so is the one after, which leaves behind what this one leaves out.
    """

    @compiled
    def run(  # type: ignore[no-untyped-def]
        n, start, answer, state, table, keys, low, high, totals, world, data, observation, gamma,
        fall, modulate, memory, constants, modulated, instead,
    ):  # fmt: skip
        action = np.empty((at(table[0], kernel.OUTPUTS), width))
        reward, ended, replaced = np.zeros(width), np.zeros(width), np.empty(width)
        sent = modulated if modulated.shape[0] > 0 else reward
        if instead.shape[0] > 0:
            sent = replaced
        for t in range(n):
            if fall < np.inf and (start + t) % FALL_EVERY == 0:
                _fall(state, table, width, gamma, fall, start + t)
            unrolled.respond(plan, state, width, keys, start + t, low, high)
            _act(state, table, width, action)
            new_input = answer(world, action, data, keys, start + t, observation, reward, ended)
            if modulated.shape[0] > 0:
                _modulate(modulate, memory, constants, reward, ended, modulated)
            if instead.shape[0] > 0:
                replaced[:] = instead[t]
            unrolled.reinforce(plan, state, width, totals, reward, sent, ended)
            if new_input:
                kernel.hold(state, table, width, observation)

    return run


@compiled
def probabilities(potentials):  # type: ignore[no-untyped-def]
    """σ(v) of many potentials, (neurons, lanes)."""
    out = np.empty_like(potentials)
    for i in range(potentials.shape[0]):
        for k in range(potentials.shape[1]):
            out[i, k] = sigmoid(potentials[i, k])
    return out


@compiled
def are_finite(observation, reward, lanes):  # type: ignore[no-untyped-def]
    """Whether the first `lanes` of (inputs, width) and of (width,) are."""
    for lane in range(lanes):
        if not np.isfinite(reward[lane]):
            return False
    for i in range(observation.shape[0]):
        for lane in range(lanes):
            if not np.isfinite(observation[i, lane]):
                return False
    return True
