"""Tell a signal from noise: the paper's filtering problem, at its smallest.

A hidden signal is +1 or -1 and switches with probability 0.02 a step. The observation is wrong
with probability 0.2. The output says what the signal is now; the reward is 1 if it is right.

Who answers what is seen is right 0.8 of the time, which is the best without a memory and the
baseline here. Who remembers can do better: the exact Bayes filter, which weighs all that was ever
seen, is right 0.926 of the time (`bayes_filter`). The memory is the network's own: each hidden
neuron hears the hidden neurons of the step before, so that they can hold each other up when a
wrong observation comes. No past is given to it. As an answer through the hidden layer is a step
late, the signal may have switched in between: the Bayes filter a step late is right 0.909.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hebbviz.sims.worlds import strip_chart
from hebbviz.sims.worlds.strip_chart import Row
from hebbviz.task.base import Evaluable, Input, Measure, Output, Reading, Tally
from hebbviz.task.finite import NOTHING, FiniteWorld
from hebbviz.task.presets import Preset
from hebbviz.task.scene import Pose, Prop
from hebbviz.theory.pomdp import POMDP
from hebbviz.topology import Projection, Topology

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

SWITCH, NOISE = 0.02, 0.2
"""The chance that the signal switches at a step, and that what is seen is wrong."""
BASELINE = 1.0 - NOISE
"""How often an answer is right that is what is seen."""

COLUMNS = 17
_TILE, _SMALL, _DEEP = 0.2, 0.09, 0.1
"""Width and height of a tile, height of one that is wrong, and depth, in scene units."""
_SWING = 0.15
"""How far above or below the middle of its row a tile is."""
_BOARD, _BOARD_AT = (strip_chart.WIDTH, 0.06, 2.0), (0.0, 0.0, 1.0)
_ROWS = tuple(
    Row(name, "box", ("negative", "positive"), COLUMNS, -0.08, (z - _SWING, z + _SWING))
    for name, z in (("signal", 1.62), ("seen", 1.0), ("answer", 0.38))
)


def _world() -> POMDP:
    """State 2·signal + whether the last answer was right; control 1 says +1. A 0 is a -1."""
    moves = np.zeros((2, 2, 2, 2, 2))  # control, signal and right before, signal and right after
    for control in (0, 1):
        for signal in (0, 1):
            right = int(control == signal)
            moves[control, signal, :, 1 - signal, right] = SWITCH
            moves[control, signal, :, signal, right] = 1.0 - SWITCH
    sees = np.repeat([[1.0 - NOISE, NOISE], [NOISE, 1.0 - NOISE]], 2, axis=0)
    return POMDP(moves.reshape(2, 4, 4), sees, np.array([0.0, 1.0, 0.0, 1.0]))


class Filtering(FiniteWorld):
    """State: 2·signal + whether the last answer was right, what is seen of the signal, the past."""

    name = "filtering"
    summary = "tell a signal that seldom switches from noise"
    inputs = (Input("seen"),)
    outputs = (Output("signal", "+1", "−1"),)
    hidden = (6,)
    pomdp = _world()
    vectors = np.array([[-1.0], [1.0]])
    past = COLUMNS - 1
    presets = {
        "quick": Preset(
            0.8,
            3e-3,
            "the paper's rule; the task is not the paper's, and its hidden neurons hear each other",
        ),
    }
    measure = Measure("share of right answers", "right", span=(0.4, 1.0))
    frozen_figures = ("baseline", "best")
    watch_speed = 6.0
    readings = tuple(Reading(row.name, "+1 or −1", steps=True) for row in _ROWS)
    legend = "rows from the top: signal, seen, answers, thin where wrong"
    props = (Prop("board", "box", "world"), *(prop for row in _ROWS for prop in row.props))

    def topology(self, hidden: Sequence[int] | None = None) -> Topology:
        """Layers, each hidden one projecting to itself too; without one there is no memory."""
        layers = super().topology(hidden)
        loops = tuple(
            Projection(g.name, g.name) for g in layers.neuron_groups if g.name != layers.output
        )
        return replace(layers, projections=(*layers.projections, *loops))

    def evaluate(self, learner: Evaluable) -> dict[str, Array]:
        others = {name: np.full(learner.lanes, value) for name, value in _references().items()}
        return super().evaluate(learner) | others

    def results(self, learner: Evaluable, late: Tally) -> dict[str, float]:
        """Shares of right answers: of the learner, of what is seen, and of the Bayes filter."""
        return super().results(learner, late) | _references()

    def traces(self, states: Array) -> tuple[Whole, Whole, Whole]:
        """Signal, what was seen, and the answer given then, each (n, columns), 0 for a -1.

        The answer to the newest is still to come: NOTHING, as is what was before the start.
        """
        state, seen = self.history(states)
        signal, right = state >> 1, state & 1  # NOTHING stays NOTHING when halved
        answer = np.where(right[:, 1:] == 1, signal[:, :-1], 1 - signal[:, :-1])
        answer[signal[:, :-1] == NOTHING] = NOTHING
        return signal, seen, np.pad(answer, ((0, 0), (0, 1)), constant_values=NOTHING)

    def read(self, states: Array) -> Array:
        """Of the step that was judged last; 0 where there was none."""
        judged = np.stack([t[:, -2] for t in self.traces(states)], axis=1)
        return np.where(judged == NOTHING, 0.0, 2.0 * judged - 1.0)

    def pose(self, state: Array) -> Pose:
        position, rotation, scale = self.poses(state[None])
        return Pose(position[0], rotation[0], scale[0], words=self._words(state))

    def poses(self, states: Array) -> strip_chart.Poses:
        traces = self.traces(states)
        board = strip_chart.upright(*(np.tile(a, (len(states), 1, 1)) for a in (_BOARD_AT, _BOARD)))
        rows = [
            row.poses(sign, _sizes(sign == traces[0]))
            for row, sign in zip(_ROWS, traces, strict=True)
        ]
        return strip_chart.together(board, *rows)

    def _words(self, state: Array) -> str:
        signal, seen, answer = (int(x) for x in self.read(state[None])[0])
        if not answer:
            return "nothing is answered yet"
        verdict = "right" if answer == signal else "wrong"
        return f"signal `{signal:+d}`, seen `{seen:+d}`, answer `{answer:+d}`: {verdict}"


@cache
def bayes_filter(seen: int = 18) -> tuple[float, float]:
    """Between what two figures the exact Bayes filter's share of right answers lies.

    It answers the likelier signal given all that was ever seen. The last `seen` observations alone
    tell less than that; together with the signal at the first of them they tell more. Both are
    sums over all 2^seen sequences of observations, of the probability of the likelier signal.
    """
    switch = np.array([[1.0 - SWITCH, SWITCH], [SWITCH, 1.0 - SWITCH]])
    sees = np.array([[1.0 - NOISE, NOISE], [NOISE, 1.0 - NOISE]])
    joint = 0.5 * np.eye(2)[None]  # (sequences, signal at the first, signal now)
    for k in range(seen):
        now = joint @ switch if k else joint
        joint = np.concatenate([now * sees[:, y] for y in (0, 1)])
    return float(joint.sum(axis=1).max(axis=1).sum()), float(joint.max(axis=2).sum())


def _sizes(right: NDArray[np.bool_]) -> Array:
    """Extents of tiles, (n, columns, 3)."""
    size = np.empty((*right.shape, 3))
    size[...] = _TILE, _DEEP, _TILE
    size[~right, 2] = _SMALL
    return size


def _references() -> dict[str, float]:
    return {"baseline": BASELINE, "best": bayes_filter()[1]}
