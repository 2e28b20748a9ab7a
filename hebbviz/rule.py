"""The paper's rule, compiled: Bartlett and Baxter (1999), section 4.

    v_t = Σ_j w_j u^j_{t−1}                          (potential)
    Pr(u_t = 1) = σ(v_t) = 1/(1 + e^{−v_t})          (neuron)
    z ← β z + (u_t − σ(v_t)) u^j_{t−1}               (neuron-zupdate)
    w ← w + γ r_t z                                  (neuron-update)

`respond` is the first three lines, `reinforce` the last; between them the world answers. All
groups update at once, each reading the activities of the step before. For activities ±1 the
first factor of the eligibility term is (u_t + 1)/2 − σ(v_t): in both cases 'fired' − 'expected'.

Held input. While the world shows the same input x, every synapse from it obeys

    z = decay·z₀ + z_input·x        w = w₀ + gain·z₀ + w_input·x

with one `decay` and `gain` per projection and one `z_input` and `w_input` per neuron, where w₀
and z₀ are what the synapse was when x came. So a step costs a few numbers per neuron instead of
one per synapse, and nothing is approximated. `hold` folds the sums back into w₀ and z₀, and does
so only when the input changes: rounding does not depend on pictures, blocks or saves.

Another rule is another file with these three functions.
No `fastmath`, and an exponential of our own: the results are the same to the bit whatever the
number of lanes, and with or without a vector mathematics library on the machine.
"""

from __future__ import annotations

import numpy as np
from numba import types

from hebbviz.chance import SPIKES, four_uniforms
from hebbviz.compiled import compiled, inlined
from hebbviz.layout import COLUMNS, HEADER

STATE = types.Array(types.float64, 2, "C")
KEYS = types.Array(types.uint32, 2, "C")


_INPUTS, _NEURONS, _PROJECTIONS = (HEADER.index(n) for n in ("inputs", "neurons", "projections"))
_U, _BEFORE, _V, _P, _DRAW, _FIRED, _SURPRISE, _CLAMP = (
    HEADER.index(n)
    for n in (
        "activity",
        "before",
        "potential",
        "probability",
        "draw",
        "fired",
        "surprise",
        "clamp",
    )
)
_W, _Z, _BETA, _GAMMA, _REWARD = (
    HEADER.index(n) for n in ("weight", "trace", "beta", "gamma", "reward")
)
_DECAY, _GAIN, _Z_INPUT, _W_INPUT, _W_DRIVE, _Z_DRIVE, _X_SQUARED = (
    HEADER.index(n)
    for n in ("decay", "gain", "z_input", "w_input", "w_drive", "z_drive", "x_squared")
)
_PRE, _PRE_SIZE, _POST, _POST_SIZE, _SYNAPSE, _HELD, _ROW = range(len(COLUMNS))

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5·2⁵²: adding it rounds to a whole number in the low bits
_ROUND_BITS = np.int64(0x4338000000000000)


@inlined
def at(row, column):  # type: ignore[no-untyped-def]  # compiled: int64
    """An entry of the table. Unsigned there, so that the compiler knows it is not negative."""
    return np.int64(row[column])


@inlined
def exp_of_negative(a):  # type: ignore[no-untyped-def]  # compiled: float64 to float64
    """e^a for a ≤ 0, to 1 unit in the last place; below −700 it stays at e^−700."""
    a = max(a, -700.0)
    shifted = a * _LOG2_E + _ROUND
    n = shifted - _ROUND
    x = (a - n * _LN2_HIGH) - n * _LN2_LOW
    x2 = x * x
    x4 = x2 * x2
    low = (1.0 + x) + x2 * (1 / 2 + x * (1 / 6))
    mid = (1 / 24 + x * (1 / 120)) + x2 * (1 / 720 + x * (1 / 5040))
    high = (1 / 40320 + x * (1 / 362880)) + x2 * (1 / 3628800 + x * (1 / 39916800))
    top = 1 / 479001600 + x * (1 / 6227020800)
    series = low + x4 * (mid + x4 * (high + x4 * top))
    exponent = np.float64(shifted).view(np.int64) - _ROUND_BITS
    return series * np.int64((exponent + 1023) << 52).view(np.float64)


@inlined
def sigmoid(v):  # type: ignore[no-untyped-def]  # compiled: float64 to float64
    """σ(v) = 1/(1 + e^{−v}), equation (neuron)."""
    e = exp_of_negative(-abs(v))
    return (1.0 if v >= 0.0 else e) / (1.0 + e)


@inlined
def _potentials(state, table, lanes):  # type: ignore[no-untyped-def]
    """Equation (potential) for every neuron."""
    head = table[0]
    first_v = at(head, _V)
    for row in range(first_v, first_v + at(head, _NEURONS)):
        for lane in range(lanes):
            state[row, lane] = 0.0
    for k in range(at(head, _PROJECTIONS)):
        p = table[k + 1]
        v, pre, pre_size = first_v + at(p, _POST), at(head, _U) + at(p, _PRE), at(p, _PRE_SIZE)
        if at(p, _HELD):
            row, gain, square = at(p, _ROW), at(head, _GAIN) + k, at(head, _X_SQUARED) + k
            w_drive, z_drive = at(head, _W_DRIVE) + row, at(head, _Z_DRIVE) + row
            w_input = at(head, _W_INPUT) + row
            for i in range(at(p, _POST_SIZE)):
                for lane in range(lanes):
                    state[v + i, lane] += (
                        state[w_drive + i, lane]
                        + state[gain, lane] * state[z_drive + i, lane]
                        + state[w_input + i, lane] * state[square, lane]
                    )
        else:
            w = at(head, _W) + at(p, _SYNAPSE)
            for i in range(at(p, _POST_SIZE)):
                for j in range(pre_size):
                    for lane in range(lanes):
                        state[v + i, lane] += state[w, lane] * state[pre + j, lane]
                    w += 1


@inlined
def _fire(state, table, lanes, keys, step):  # type: ignore[no-untyped-def]
    """Equation (neuron): draw who fires. One draw per neuron and step, clamped or not."""
    head = table[0]
    neurons, draw = at(head, _NEURONS), at(head, _DRAW)
    for block in range((neurons + 3) // 4):
        for lane in range(lanes):
            a, b, c, d = four_uniforms(keys[0, lane], keys[1, lane], SPIKES, step, block)
            state[draw + 4 * block, lane] = a
            state[draw + 4 * block + 1, lane] = b
            state[draw + 4 * block + 2, lane] = c
            state[draw + 4 * block + 3, lane] = d
    v, p, fired, surprise, clamp = (
        at(head, _V),
        at(head, _P),
        at(head, _FIRED),
        at(head, _SURPRISE),
        at(head, _CLAMP),
    )
    for i in range(neurons):
        for lane in range(lanes):
            expected = sigmoid(state[v + i, lane])
            fires = 1.0 if state[draw + i, lane] < expected else 0.0
            forced = state[clamp + i, lane]
            fires = fires if np.isnan(forced) else forced
            state[p + i, lane] = expected
            state[fired + i, lane] = fires
            state[surprise + i, lane] = fires - expected


@inlined
def _remember(state, table, lanes):  # type: ignore[no-untyped-def]
    """Equation (neuron-zupdate) for every synapse, from the activities of the step before."""
    head = table[0]
    for k in range(at(head, _PROJECTIONS)):
        p = table[k + 1]
        beta, pre, pre_size = at(head, _BETA) + k, at(head, _U) + at(p, _PRE), at(p, _PRE_SIZE)
        surprise = at(head, _SURPRISE) + at(p, _POST)
        if at(p, _HELD):
            decay, z_input = at(head, _DECAY) + k, at(head, _Z_INPUT) + at(p, _ROW)
            for lane in range(lanes):
                state[decay, lane] *= state[beta, lane]
            for i in range(at(p, _POST_SIZE)):
                for lane in range(lanes):
                    state[z_input + i, lane] = (
                        state[beta, lane] * state[z_input + i, lane] + state[surprise + i, lane]
                    )
        else:
            z = at(head, _Z) + at(p, _SYNAPSE)
            for i in range(at(p, _POST_SIZE)):
                for j in range(pre_size):
                    for lane in range(lanes):
                        state[z, lane] = (
                            state[beta, lane] * state[z, lane]
                            + state[surprise + i, lane] * state[pre + j, lane]
                        )
                    z += 1


@inlined
def _respond(state, table, lanes, keys, step, low, high):  # type: ignore[no-untyped-def]
    head = table[0]
    for row in range(at(head, _INPUTS) + at(head, _NEURONS)):
        for lane in range(lanes):
            state[at(head, _BEFORE) + row, lane] = state[at(head, _U) + row, lane]
    _potentials(state, table, lanes)
    _fire(state, table, lanes, keys, step)
    _remember(state, table, lanes)
    u, fired = at(head, _U) + at(head, _INPUTS), at(head, _FIRED)
    for i in range(at(head, _NEURONS)):
        for lane in range(lanes):
            state[u + i, lane] = low + state[fired + i, lane] * (high - low)


@compiled
def respond(state, table, keys, step, low, high):  # type: ignore[no-untyped-def]
    """Potentials, spikes and traces of one step, from the activities of the step before.

    `state` is (rows, lanes) in the layout's sections, `table` the layout's; `keys` (2, lanes)
    holds each lane's seed and number; `low` and `high` are the activities of a silent and of a
    firing neuron.
    """
    if state.shape[1] == 1:  # a constant lets the compiler drop the loops over lanes
        _respond(state, table, 1, keys, step, low, high)
    else:
        _respond(state, table, state.shape[1], keys, step, low, high)


@compiled
def reinforce(state, table):  # type: ignore[no-untyped-def]
    """Equation (neuron-update) for every synapse, with the broadcast reward of this step."""
    if state.shape[1] == 1:
        _reinforce(state, table, 1)
    else:
        _reinforce(state, table, state.shape[1])


@inlined
def _reinforce(state, table, lanes):  # type: ignore[no-untyped-def]
    head = table[0]
    reward = at(head, _REWARD) + 1
    for k in range(at(head, _PROJECTIONS)):
        p = table[k + 1]
        gamma = at(head, _GAMMA) + k
        if at(p, _HELD):
            gain, decay = at(head, _GAIN) + k, at(head, _DECAY) + k
            z_input, w_input = at(head, _Z_INPUT) + at(p, _ROW), at(head, _W_INPUT) + at(p, _ROW)
            for lane in range(lanes):
                state[gain, lane] += state[gamma, lane] * state[reward, lane] * state[decay, lane]
            for i in range(at(p, _POST_SIZE)):
                for lane in range(lanes):
                    state[w_input + i, lane] += (
                        state[gamma, lane] * state[reward, lane] * state[z_input + i, lane]
                    )
        else:
            w, z = at(head, _W) + at(p, _SYNAPSE), at(head, _Z) + at(p, _SYNAPSE)
            for s in range(at(p, _POST_SIZE) * at(p, _PRE_SIZE)):
                for lane in range(lanes):
                    state[w + s, lane] += (
                        state[gamma, lane] * state[reward, lane] * state[z + s, lane]
                    )


@inlined
def _changed(state, table, observation, lane):  # type: ignore[no-untyped-def]
    u = at(table[0], _U)
    for j in range(at(table[0], _INPUTS)):
        if state[u + j, lane] != observation[j, lane]:
            return True
    return False


@inlined
def _fold(state, table, observation, k, lane):  # type: ignore[no-untyped-def]
    """Put the sums of projection k back into its synapses, then start anew with the new x."""
    head = table[0]
    p = table[k + 1]
    pre, pre_size = at(p, _PRE), at(p, _PRE_SIZE)
    u = at(head, _U) + pre
    decay, gain = state[at(head, _DECAY) + k, lane], state[at(head, _GAIN) + k, lane]
    w, z = at(head, _W) + at(p, _SYNAPSE), at(head, _Z) + at(p, _SYNAPSE)
    for i in range(at(p, _POST_SIZE)):
        row = at(p, _ROW) + i
        z_input, w_input = (
            state[at(head, _Z_INPUT) + row, lane],
            state[at(head, _W_INPUT) + row, lane],
        )
        w_drive = z_drive = 0.0
        for j in range(pre_size):
            x = state[u + j, lane]
            z_old = state[z, lane]
            state[w, lane] += gain * z_old + w_input * x
            state[z, lane] = decay * z_old + z_input * x
            w_drive += state[w, lane] * observation[pre + j, lane]
            z_drive += state[z, lane] * observation[pre + j, lane]
            w += 1
            z += 1
        state[at(head, _Z_INPUT) + row, lane] = 0.0
        state[at(head, _W_INPUT) + row, lane] = 0.0
        state[at(head, _W_DRIVE) + row, lane] = w_drive
        state[at(head, _Z_DRIVE) + row, lane] = z_drive
    square = 0.0
    for j in range(pre_size):
        square += observation[pre + j, lane] * observation[pre + j, lane]
    state[at(head, _X_SQUARED) + k, lane] = square
    state[at(head, _DECAY) + k, lane] = 1.0
    state[at(head, _GAIN) + k, lane] = 0.0


@compiled
def hold(state, table, observation):  # type: ignore[no-untyped-def]
    """Set the input values to `observation` (inputs, lanes); fold the lanes where they changed."""
    for lane in range(state.shape[1]):
        if _changed(state, table, observation, lane):
            for k in range(at(table[0], _PROJECTIONS)):
                if at(table[k + 1], _HELD):
                    _fold(state, table, observation, k, lane)
            for j in range(at(table[0], _INPUTS)):
                state[at(table[0], _U) + j, lane] = observation[j, lane]
