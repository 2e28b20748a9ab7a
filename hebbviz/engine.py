"""The closed loop, compiled once for every task and topology.

A step is: the network responds, the world answers with a reward and the next input, the rule
moves the weights, the input is set. A compiled world comes as a pointer to a function (`WORLD`);
a world that is stepped by Python uses `rule.respond` and then `settle`, which holds everything
that follows the world's answer. The rule is called directly: through pointers a step of one lane
took a quarter longer.
"""

from __future__ import annotations

import numpy as np
from numba import types

from hebbviz.compiled import compiled, inlined
from hebbviz.layout import HEADER
from hebbviz.rule import KEYS, STATE, at, hold, reinforce, respond
from hebbviz.rules import PER_LANE

WORLD = types.int64(STATE, STATE, STATE, KEYS, types.int64, STATE, PER_LANE, PER_LANE)
"""A compiled world's step: (world, action, data, keys, step, observation, reward, ended).

`world` (rows, lanes) is its state and is changed in place; `action` (outputs, lanes) holds the
outputs' activities; `data` the constants of the task. It writes `observation` (inputs, lanes),
`reward` (lanes) and `ended` (lanes; 1 where an episode ended) and returns 1 if any input changed,
else 0.
"""

_NEURONS, _OUTPUTS, _FIRST_OUTPUT = (
    HEADER.index(n) for n in ("neurons", "outputs", "first_output")
)
_INPUTS, _U, _V, _FIRED, _BY_HAND, _REWARD, _TALLY = (
    HEADER.index(n)
    for n in ("inputs", "activity", "potential", "fired", "by_hand", "reward", "tally")
)
_GAMMA = HEADER.index("gamma")

FALL_EVERY = 256
"""A γ that falls is set anew at the steps that are divisible by this."""


@inlined
def _broadcast(state, table, row, reward, modulated, ended, instead):  # type: ignore[no-untyped-def]
    """The reward pipeline: the task's r → the rule's m + reward given by hand → every synapse.

    Where `instead` has rows, its row is sent in place of m.
    """
    head = table[0]
    r, tally, by_hand = at(head, _REWARD), at(head, _TALLY), at(head, _BY_HAND)
    for lane in range(state.shape[1]):
        raw = reward[lane]
        m = instead[row] if instead.shape[0] > 0 else modulated[lane]
        sent = m + state[by_hand, lane]
        state[by_hand, lane] = 0.0
        state[r, lane] = raw
        state[r + 1, lane] = sent
        state[tally, lane] += raw
        state[tally + 1, lane] += sent
        state[tally + 2, lane] += ended[lane]


@inlined
def _fall(state, table, gamma, fall, step):  # type: ignore[no-untyped-def]
    """Put γ in force as it is from this step on: γ/(1 + t/T)."""
    first = at(table[0], _GAMMA)
    for k in range(gamma.shape[0]):
        for lane in range(gamma.shape[1]):
            state[first + k, lane] = gamma[k, lane] / (1.0 + step / fall)


@inlined
def _note(  # type: ignore[no-untyped-def]
    state, table, lane, row, ended, spikes, rewards, potentials, counts, extremes, probes
):
    """Write one step into the block and into the summary. A probe is five rows of the state."""
    head = table[0]
    neurons = at(head, _NEURONS)
    v, fired, r = at(head, _V), at(head, _FIRED), at(head, _REWARD)
    for i in range(neurons):
        potential, spike = state[v + i, lane], state[fired + i, lane]
        counts[i] += np.int64(spike)
        extremes[0, i] = min(extremes[0, i], potential)
        extremes[1, i] = max(extremes[1, i], potential)
        spikes[row, i] = np.uint8(spike)
        if potentials.shape[0] > 0:
            potentials[row, i] = potential
    for k in range(probes.shape[0]):
        z = state[probes[k, 0], lane]
        if probes[k, 1] >= 0:  # held input, see rule
            z *= state[probes[k, 1], lane]
            z += state[probes[k, 2], lane] * state[probes[k, 3], lane]
        extremes[0, neurons + k] = min(extremes[0, neurons + k], z)
        extremes[1, neurons + k] = max(extremes[1, neurons + k], z)
    rewards[row, 0] = state[r, lane]
    rewards[row, 1] = state[r + 1, lane]
    rewards[row, 2] = ended[lane]


@compiled
def settle(  # type: ignore[no-untyped-def]
    state, table, observation, modulate, memory, constants, modulated, reward, ended, instead,
    watch, row, spikes, rewards, potentials, counts, extremes, probes,
):  # fmt: skip
    """All that follows the answer of a world stepped by Python; see `run` for the arguments.

    Returns False, and changes nothing, if an observation or a reward is not finite.
    """
    if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
        return False
    if modulated.shape[0] > 0:
        modulate(memory, constants, reward, ended, modulated)
    else:
        modulated = reward
    _broadcast(state, table, row, reward, modulated, ended, instead)
    reinforce(state, table)
    if watch >= 0:
        _note(
            state, table, watch, row, ended, spikes, rewards, potentials, counts, extremes, probes
        )
    hold(state, table, observation)
    return True


@compiled
def run(  # type: ignore[no-untyped-def]
    n, start, answer, state, table, keys, low, high, world, data, observation, gamma, fall,
    modulate, memory, constants, modulated, instead, watch, spikes, rewards, potentials, worlds,
    counts, extremes, probes,
):  # fmt: skip
    """`n` steps of a compiled world, the first of them number `start`.

    `gamma` (projections, lanes; 0 while frozen) falls over `fall` steps, unless that is infinite.
    `modulate`, `memory` and `constants` are the rule's, see `rules.Rule`; `modulated` (lanes, or
    0 for the paper's rule, which is not called) is room for what it makes of the reward. `instead`
    (n or 0) is broadcast in its place. `watch` is the lane that is
    noted, or -1 for none. What is noted: `spikes` (n, neurons), `rewards` (n, 3: of the task, as
    broadcast, episode ended), if they have rows `potentials` (n, neurons) and `worlds`
    (n, numbers), and over all steps `counts` (neurons), `extremes` (2, neurons + probes: least
    and greatest v and z).
    """
    lanes = state.shape[1]
    outputs = at(table[0], _OUTPUTS)
    first = at(table[0], _U) + at(table[0], _INPUTS) + at(table[0], _FIRST_OUTPUT)
    action = np.empty((outputs, lanes))
    reward = np.empty(lanes)
    ended = np.empty(lanes)
    sent = modulated if modulated.shape[0] > 0 else reward
    for t in range(n):
        if fall < np.inf and (start + t) % FALL_EVERY == 0:
            _fall(state, table, gamma, fall, start + t)
        respond(state, table, keys, start + t, low, high)
        for i in range(outputs):
            for lane in range(lanes):
                action[i, lane] = state[first + i, lane]
        new_input = answer(world, action, data, keys, start + t, observation, reward, ended)
        if modulated.shape[0] > 0:
            modulate(memory, constants, reward, ended, modulated)
        _broadcast(state, table, t, reward, sent, ended, instead)
        reinforce(state, table)
        if watch >= 0:
            _note(
                state, table, watch, t, ended, spikes, rewards, potentials, counts, extremes, probes
            )
            if worlds.shape[0] > 0:
                worlds[t] = world[:, watch]
        if new_input:
            hold(state, table, observation)
