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

`state` is a tile's, (rows, width), and row(state, r, width) a view of its row r, all lanes of it;
`table` is the layout's. `width` is a constant wherever these functions are compiled. The innermost
loops run over the lanes, each loop within few records (see `layout`), and the compiler computes
several lanes at once. No `fastmath`: the results are the same to the bit whatever the width.
"""

from __future__ import annotations

import numpy as np

from hebbviz.engine.layout import BLOCK, COLUMNS, HEADER, HELD, NEURON, PROJECTION, SYNAPSE
from hebbviz.numerics.compile import WIDTHS, inlined, row
from hebbviz.numerics.counter_rng import SPIKES, eight_words, four_words, unit
from hebbviz.numerics.logistic import sigmoid

INPUTS, NEURONS, OUTPUTS, PROJECTIONS = range(4)
(
    INPUT, INPUT_BEFORE, FIRST_NEURON, FIRST_OUTPUT, FIRST_PROJECTION, BY_HAND, REWARD,
) = range(4, len(HEADER))  # fmt: skip
U, BEFORE, V, SURPRISE, CLAMP = range(len(NEURON))
BETA, GAMMA, DECAY, GAIN, X_SQUARED, PUSH = range(len(PROJECTION))
Z_INPUT, W_INPUT, W_DRIVE, Z_DRIVE = range(len(HELD))
W, Z = range(len(SYNAPSE))
WIDEST = WIDTHS[-1]
_PRE, _PRE_SIZE, _POST, _POST_SIZE, _SYNAPSE, _IS_HELD, _HELD, _IS_FIRST = range(len(COLUMNS))

A_NEURON, A_PROJECTION, A_HELD, A_SYNAPSE = (
    len(record) for record in (NEURON, PROJECTION, HELD, SYNAPSE)
)
"""Rows of a record."""


@inlined
def count(state, width):  # type: ignore[no-untyped-def]  # compiled: int64
    """`width` for loops over the lanes. Of a narrow tile the compiler is not to know it: it would
    write the lanes out one by one instead of computing several at once.
    """
    return width if width in (1, WIDEST) else state.shape[1]


@inlined
def at(row, column):  # type: ignore[no-untyped-def]  # compiled: int64
    """An entry of the table. Unsigned there, so that the compiler knows it is not negative."""
    return np.int64(row[column])


@inlined
def respond(state, table, width, words, keys, step, low, high, clamped, fresh):  # type: ignore[no-untyped-def]
    """Potentials, spikes and traces of one step, from the activities of the step before.

    `words` (8, width) is room for random numbers; `keys` (2, width) holds each lane's seed and
    number; `low` and `high` are the activities of a silent and of a firing neuron; `clamped` says
    that some may be clamped, `fresh` that the input may have changed since the step before.
    """
    head = table[0]
    if fresh:
        for j in range(at(head, INPUTS)):
            x, before = (
                row(state, at(head, INPUT) + j, width),
                row(state, at(head, INPUT_BEFORE) + j, width),
            )
            for lane in range(count(state, width)):
                before[lane] = x[lane]
    _potentials(state, table, width)
    _fire(state, table, width, words, keys, step, low, high, clamped)
    _remember(state, table, width)


@inlined
def _potentials(state, table, width):  # type: ignore[no-untyped-def]
    """Equation (potential) for every neuron."""
    for k in range(at(table[0], PROJECTIONS)):
        p, q = table[k + 1], at(table[0], FIRST_PROJECTION) + k * A_PROJECTION
        for i in range(at(p, _POST_SIZE)):
            v = row(state, at(p, _POST) + i * A_NEURON + V, width)
            if at(p, _IS_FIRST):
                for lane in range(count(state, width)):
                    v[lane] = 0.0
            if at(p, _IS_HELD):
                _add_held(state, width, v, q, at(p, _HELD) + i * A_HELD)
            else:
                y = at(p, _SYNAPSE) + i * at(p, _PRE_SIZE) * A_SYNAPSE
                _add_each(state, width, v, y, at(p, _PRE), at(p, _PRE_SIZE))


@inlined
def _add_held(state, width, v, q, h):  # type: ignore[no-untyped-def]
    """Add the contribution of the held input to the potential of a neuron."""
    gain, x_squared = row(state, q + GAIN, width), row(state, q + X_SQUARED, width)
    w_input = row(state, h + W_INPUT, width)
    w_drive, z_drive = row(state, h + W_DRIVE, width), row(state, h + Z_DRIVE, width)
    for lane in range(count(state, width)):
        v[lane] += w_drive[lane] + gain[lane] * z_drive[lane] + w_input[lane] * x_squared[lane]


@inlined
def _add_each(state, width, v, y, pre, pre_size):  # type: ignore[no-untyped-def]
    """Add the input of `pre_size` neurons from record `pre` on, by synapses from record y."""
    for j in range(0, pre_size - 1, 2):  # two at a time: half as many passes over the lanes
        s, n = y + j * A_SYNAPSE, pre + j * A_NEURON
        w0, u0 = row(state, s + W, width), row(state, n + U, width)
        w1, u1 = row(state, s + A_SYNAPSE + W, width), row(state, n + A_NEURON + U, width)
        for lane in range(count(state, width)):
            v[lane] = v[lane] + w0[lane] * u0[lane] + w1[lane] * u1[lane]
    if pre_size % 2:
        w = row(state, y + (pre_size - 1) * A_SYNAPSE + W, width)
        u = row(state, pre + (pre_size - 1) * A_NEURON + U, width)
        for lane in range(count(state, width)):
            v[lane] += w[lane] * u[lane]


@inlined
def _fire(state, table, width, words, keys, step, low, high, clamped):  # type: ignore[no-untyped-def]
    """Equation (neuron): who fires. One random number per neuron and step, clamped or not."""
    neurons, first = at(table[0], NEURONS), at(table[0], FIRST_NEURON)
    blocks = (neurons + BLOCK - 1) // BLOCK
    for block in range(0, blocks, 2):
        if block + 1 < blocks:
            _draw_two(state, words, width, keys, step, block)
        else:
            _draw_one(state, words, width, keys, step, block)
        for k in range(min(2 * BLOCK, neurons - BLOCK * block)):
            n = first + (BLOCK * block + k) * A_NEURON
            _spike(state, n, width, row(words, k, width), low, high)
            if clamped:
                _force(state, n, width, low, high)


@inlined
def _draw_one(state, words, width, keys, step, block):  # type: ignore[no-untyped-def]
    """A block of random numbers. All lanes have one seed."""
    seed, number = keys[0, 0], row(keys, 1, width)
    w0, w1 = row(words, 0, width), row(words, 1, width)
    w2, w3 = row(words, 2, width), row(words, 3, width)
    for lane in range(count(state, width)):
        w0[lane], w1[lane], w2[lane], w3[lane] = four_words(seed, number[lane], SPIKES, step, block)


@inlined
def _draw_two(state, words, width, keys, step, block):  # type: ignore[no-untyped-def]
    """Two blocks of random numbers."""
    seed, number = keys[0, 0], row(keys, 1, width)
    w0, w1 = row(words, 0, width), row(words, 1, width)
    w2, w3 = row(words, 2, width), row(words, 3, width)
    w4, w5 = row(words, 4, width), row(words, 5, width)
    w6, w7 = row(words, 6, width), row(words, 7, width)
    for lane in range(count(state, width)):
        first, second = eight_words(seed, number[lane], SPIKES, step, block)
        w0[lane], w1[lane], w2[lane], w3[lane] = first
        w4[lane], w5[lane], w6[lane], w7[lane] = second


@inlined
def _spike(state, n, width, word, low, high):  # type: ignore[no-untyped-def]
    """Let the neuron of record n fire with probability σ(v)."""
    kind = state.dtype.type
    silent, active, one, zero = kind(low), kind(high), kind(1), kind(0)
    u, before, v = row(state, n + U, width), row(state, n + BEFORE, width), row(state, n + V, width)
    surprise = row(state, n + SURPRISE, width)
    for lane in range(count(state, width)):
        expected = sigmoid(v[lane])
        fires = unit(word[lane], zero) < expected
        surprise[lane] = (one if fires else zero) - expected
        before[lane] = u[lane]
        u[lane] = active if fires else silent


@inlined
def _force(state, n, width, low, high):  # type: ignore[no-untyped-def]
    """Make it fire or not where it is clamped."""
    kind = state.dtype.type
    u, v, clamp = row(state, n + U, width), row(state, n + V, width), row(state, n + CLAMP, width)
    surprise = row(state, n + SURPRISE, width)
    for lane in range(count(state, width)):
        if not np.isnan(clamp[lane]):
            surprise[lane] = clamp[lane] - sigmoid(v[lane])
            u[lane] = kind(low) + clamp[lane] * kind(high - low)


@inlined
def _remember(state, table, width):  # type: ignore[no-untyped-def]
    """Equation (neuron-zupdate) for every synapse, from the activities of the step before."""
    for k in range(at(table[0], PROJECTIONS)):
        p, q = table[k + 1], at(table[0], FIRST_PROJECTION) + k * A_PROJECTION
        beta, decay = row(state, q + BETA, width)[0], row(state, q + DECAY, width)
        if at(p, _IS_HELD):
            for lane in range(count(state, width)):
                decay[lane] *= beta
        for i in range(at(p, _POST_SIZE)):
            surprise = row(state, at(p, _POST) + i * A_NEURON + SURPRISE, width)
            if at(p, _IS_HELD):
                z_input = row(state, at(p, _HELD) + i * A_HELD + Z_INPUT, width)
                for lane in range(count(state, width)):
                    z_input[lane] = beta * z_input[lane] + surprise[lane]
            else:
                for j in range(at(p, _PRE_SIZE)):
                    y = at(p, _SYNAPSE) + (i * at(p, _PRE_SIZE) + j) * A_SYNAPSE
                    z, u = (
                        row(state, y + Z, width),
                        row(state, at(p, _PRE) + j * A_NEURON + BEFORE, width),
                    )
                    for lane in range(count(state, width)):
                        z[lane] = beta * z[lane] + surprise[lane] * u[lane]


@inlined
def reinforce(state, table, width):  # type: ignore[no-untyped-def]
    """Equation (neuron-update) for every synapse, with the broadcast reward of this step."""
    reward = row(state, at(table[0], REWARD) + 1, width)
    for k in range(at(table[0], PROJECTIONS)):
        p, q = table[k + 1], at(table[0], FIRST_PROJECTION) + k * A_PROJECTION
        gamma, push = row(state, q + GAMMA, width)[0], row(state, q + PUSH, width)
        for lane in range(count(state, width)):
            push[lane] = gamma * reward[lane]
        if at(p, _IS_HELD):
            gain, decay = row(state, q + GAIN, width), row(state, q + DECAY, width)
            for lane in range(count(state, width)):
                gain[lane] += push[lane] * decay[lane]
            for i in range(at(p, _POST_SIZE)):
                h = at(p, _HELD) + i * A_HELD
                w_input, z_input = row(state, h + W_INPUT, width), row(state, h + Z_INPUT, width)
                for lane in range(count(state, width)):
                    w_input[lane] += push[lane] * z_input[lane]
        else:
            for i in range(at(p, _POST_SIZE) * at(p, _PRE_SIZE)):
                y = at(p, _SYNAPSE) + i * A_SYNAPSE
                w, z = row(state, y + W, width), row(state, y + Z, width)
                for lane in range(count(state, width)):
                    w[lane] += push[lane] * z[lane]


@inlined
def hold(state, table, width, observation):  # type: ignore[no-untyped-def]
    """Set the input values to `observation` (inputs, width); fold the lanes where they changed."""
    changed = 0
    for lane in range(count(state, width)):
        if _has_changed(state, table, width, observation, lane):
            changed += 1
    if changed == width:
        _take_in(state, table, width, observation, 0, count(state, width))
    elif changed > 0:
        for lane in range(count(state, width)):
            if _has_changed(state, table, width, observation, lane):
                _take_in(state, table, width, observation, lane, lane + 1)


@inlined
def _has_changed(state, table, width, observation, lane):  # type: ignore[no-untyped-def]
    kind = state.dtype.type
    for j in range(at(table[0], INPUTS)):
        seen = kind(row(observation, j, width)[lane])
        if row(state, at(table[0], INPUT) + j, width)[lane] != seen:
            return True
    return False


@inlined
def _take_in(state, table, width, observation, first, end):  # type: ignore[no-untyped-def]
    """New input in the lanes from `first` to before `end`."""
    for k in range(at(table[0], PROJECTIONS)):
        if at(table[k + 1], _IS_HELD):
            _fold(state, table, width, observation, k, first, end)
    for j in range(at(table[0], INPUTS)):
        x, new = row(state, at(table[0], INPUT) + j, width), row(observation, j, width)
        for lane in range(first, end):
            x[lane] = new[lane]


@inlined
def _fold(state, table, width, observation, k, first, end):  # type: ignore[no-untyped-def]
    """Put the sums of projection k back into its synapses, then restart them with the new x."""
    kind = state.dtype.type
    p, q = table[k + 1], at(table[0], FIRST_PROJECTION) + k * A_PROJECTION
    pre, first_x = at(p, _PRE_SIZE), at(p, _PRE)
    first_new = first_x - at(table[0], INPUT)
    decay, gain = row(state, q + DECAY, width), row(state, q + GAIN, width)
    x_squared = row(state, q + X_SQUARED, width)
    for i in range(at(p, _POST_SIZE)):
        h = at(p, _HELD) + i * A_HELD
        z_input, w_input = row(state, h + Z_INPUT, width), row(state, h + W_INPUT, width)
        w_drive, z_drive = row(state, h + W_DRIVE, width), row(state, h + Z_DRIVE, width)
        for lane in range(first, end):
            w_drive[lane] = z_drive[lane] = 0.0
        for j in range(pre):
            y = at(p, _SYNAPSE) + (i * pre + j) * A_SYNAPSE
            w, z = row(state, y + W, width), row(state, y + Z, width)
            x, new = row(state, first_x + j, width), row(observation, first_new + j, width)
            for lane in range(first, end):
                w[lane] += gain[lane] * z[lane] + w_input[lane] * x[lane]
            for lane in range(first, end):
                z[lane] = decay[lane] * z[lane] + z_input[lane] * x[lane]
            for lane in range(first, end):
                w_drive[lane] += w[lane] * kind(new[lane])
                z_drive[lane] += z[lane] * kind(new[lane])
        for lane in range(first, end):
            z_input[lane] = w_input[lane] = 0.0
    for lane in range(first, end):
        x_squared[lane] = gain[lane] = 0.0
        decay[lane] = 1.0
    for j in range(pre):
        new = row(observation, first_new + j, width)
        for lane in range(first, end):
            x_squared[lane] += new[lane] * kind(new[lane])
