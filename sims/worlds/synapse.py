"""One synapse, played by hand or by the paper's script: the place to meet the rule.

A presynaptic and a postsynaptic neuron, activities {0, 1}. Both are clamped: buttons make either
fire at the next step, otherwise both are silent. Reward and punishment are given by hand, or all
of it by the script of the sequences (a)-(l) of the paper's figure of synaptic updates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.task.base import Output, Task
from hebbviz.task.presets import Preset
from hebbviz.task.scene import Control, Pose
from hebbviz.topology import BINARY, Group, Projection, Topology

Array = NDArray[np.float64]

BY_HAND, START = -1.0, -2.0
"""In place of a row of the script: only what the buttons ask for; about to play the first row."""

REWARD = 5.0
"""A reward large enough that one synapse is seen to move; the paper's figure gives no size."""

SCRIPT: tuple[tuple[str, bool, bool, float, str], ...] = (
    # letter, presynaptic spike, postsynaptic spike, reward, what is to be seen
    ("", True, False, 0.0, "before (a): a presynaptic spike"),
    ("", False, True, 0.0, "before (a): a postsynaptic spike follows, z rises above zero"),
    *((("", False, False, 0.0, "before (a): no spikes, z fades"),) * 5),
    ("a", False, False, 0.0, "no spikes: z fades"),
    ("b", False, False, 0.0, "no spikes: z fades on"),
    ("c", False, False, REWARD, "a reward arrives: z is small, the synapse hardly changes"),
    ("d", False, False, 0.0, "the synapse is nearly what it was"),
    ("e", True, False, 0.0, "a presynaptic spike"),
    ("f", False, False, 0.0, "no postsynaptic spike follows: z falls"),
    ("g", False, False, 0.0, "z is below zero"),
    ("h", False, False, REWARD, "a reward arrives: the synapse shrinks"),
    *((("", False, False, 0.0, "before (i): no spikes, z fades"),) * 5),
    ("i", True, False, 0.0, "a presynaptic spike"),
    ("j", False, True, 0.0, "a postsynaptic spike follows: z rises"),
    ("k", False, False, 0.0, "z is above zero"),
    ("l", False, False, REWARD, "a reward arrives: the synapse grows"),
)

_ROW, _PRE_NEXT, _POST_NEXT, _REWARD = range(4)


class Synapse(Task):
    """State: row of the script, or BY_HAND or START; whether either side fires next; reward.

    A postsynaptic spike answers the presynaptic one of the step before, as in the paper: to pair
    them, press the presynaptic button, see it fire, then press the postsynaptic one.
    """

    name = "synapse"
    summary = "one synapse by hand: fire either side, reward it, and watch z and w follow"
    inputs = ()
    outputs = (Output("postsynaptic", "a spike", "no spike"),)
    hidden = ()
    activity = BINARY
    natural_speed = 1.5
    hand_reward = REWARD
    presets = {
        "hand": Preset(0.8, 0.1, "the paper's rule; step size and rewards large, to be seen"),
        "script": Preset(
            0.8, 0.1, "sequences (a)-(l) of the paper's figure, over and over", {"plays": True}
        ),
    }
    controls = (
        Control("Presynaptic spike", "the presynaptic neuron fires at the next step", "1"),
        Control("Postsynaptic spike", "the postsynaptic neuron fires at the next step", "2"),
        Control("Play (a)-(l)", "the sequences of the paper's figure", "3"),
        Control("Stop playing", "leave it to your hands", "4"),
    )

    def topology(self, hidden: Sequence[int] | None = None) -> Topology:
        if hidden:
            raise ValueError(f"task 'synapse' is one synapse and has no hidden layer, got {hidden}")
        groups = (Group("presynaptic", 1), Group("postsynaptic", 1))
        synapse = Projection("presynaptic", "postsynaptic")
        return Topology(groups, (synapse,), "postsynaptic", self.activity)

    def restart(self, draws: Callable[[int], Array]) -> Array:
        return _start() if self.preset.options.get("plays") else _idle()

    def transition(self, state: Array, action: Array, draws: Callable[[int], Array]) -> Array:
        if state[_ROW] == BY_HAND:
            return _idle()
        if state[_ROW] == START:
            return _row(0)
        return _row((int(state[_ROW]) + 1) % len(SCRIPT))

    def observation(self, state: Array) -> Array:
        return np.zeros(0)

    def reward(self, state: Array) -> float:
        return float(state[_REWARD])

    def clamps(self, state: Array) -> Array:
        return state[[_PRE_NEXT, _POST_NEXT]]

    def press(self, state: Array, control: str) -> Array:
        if control.startswith("Play"):
            return _start()
        if control.startswith("Stop"):
            return _idle()
        after = state.copy() if state[_ROW] == BY_HAND else _idle()
        after[_PRE_NEXT if control.startswith("Pre") else _POST_NEXT] = 1.0
        return after

    def initial_weights(self, draws: Array) -> Array:
        return np.full_like(draws, 0.5)

    def pose(self, state: Array) -> Pose:
        nothing = super().pose(state)
        return Pose(nothing.position, nothing.rotation, nothing.scale, words=_words(state))


def _idle() -> Array:
    return np.array([BY_HAND, 0.0, 0.0, 0.0])


def _row(k: int) -> Array:
    """The state after row k was played: its reward, and the spikes of the row to come."""
    _, pre, post, _, _ = SCRIPT[(k + 1) % len(SCRIPT)]
    return np.array([k, pre, post, SCRIPT[k][3]], dtype=np.float64)


def _start() -> Array:
    """The state from which the script's first row is played next."""
    _, pre, post, _, _ = SCRIPT[0]
    return np.array([START, pre, post, 0.0])


def _words(state: Array) -> str:
    if state[_ROW] == BY_HAND:
        return "by hand: fire the presynaptic neuron, then the postsynaptic one, then reward"
    if state[_ROW] == START:
        return "the sequences (a)-(l) of the paper's figure begin"
    letter, _, _, _, what = SCRIPT[int(state[_ROW])]
    return f"({letter}) {what}" if letter else what
