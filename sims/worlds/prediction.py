"""Say which symbol comes next: the paper's time-series prediction, at its smallest.

A traffic light goes red, amber, green, amber, red, …, and at each step stays as it is with
probability 0.05. The two outputs say which light comes next; the reward is 1 if they are right.

The light after amber depends on the one before it, so the present light is not enough.
Shares of right predictions, exact:

    the same as now                     STAYS = 0.05
    amber, the most frequent            0.5
    the best from the present light     0.75 (1 − STAYS) = 0.7125, the baseline here
    the best from all that was seen     1 − STAYS = 0.95

The past reaches the outputs by way of the hidden neurons: what these say of a light arrives a
step after the light itself, which goes to the outputs too. With the present light and the one
before, a prediction can be right (1 − STAYS)(1 − STAYS/4) = 0.938 of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

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

STAYS = 0.05
"""The chance that the light does not change at a step."""

LIGHTS = ("red", "amber", "green")
RED, AMBER, GREEN = range(3)
CYCLE = (RED, AMBER, GREEN, AMBER)
SAYS = (GREEN, AMBER, RED, AMBER)
"""The light that each control predicts: 1 if the first output fires, and 2 more if the second."""

SAME, FREQUENT, BASELINE, BEST = STAYS, 0.5, 0.75 - 0.75 * STAYS, 1.0 - STAYS
"""Shares of right predictions, as above."""

COLUMNS = 11
_COLORS = ((0.86, 0.15, 0.16), (0.98, 0.68, 0.12), (0.16, 0.68, 0.36))
_BALL, _SMALL, _LAMP = 0.34, 0.14, 0.36
"""Diameters: of a light that was and of a right prediction, of a wrong one, of a lamp."""
_WAS, _SAID = (
    Row(name, "sphere", _COLORS, COLUMNS, y, 3 * (_BALL / 2,))
    for name, y in (("light", -0.35), ("said", -1.0))
)
_FLOOR, _POST = (strip_chart.WIDTH, 2.7, 0.04), (0.56, 0.3, 1.5)
_STANDING_AT = np.array(
    [(0.0, 0.0, -0.02), (0.0, 0.75, 0.75), *((0.0, 0.6, z) for z in (1.22, 0.76, 0.3))]
)
"""Floor, post and lamps."""


def _world() -> POMDP:
    """State 3·place in the cycle + what was predicted for it; the light at the place is seen."""
    moves = np.zeros((4, 4, 3, 4, 3))  # control, place and said before, place and said after
    for control, says in enumerate(SAYS):
        for place in range(4):
            moves[control, place, :, place, says] = STAYS
            moves[control, place, :, (place + 1) % 4, says] = 1.0 - STAYS
    light, said = np.repeat(CYCLE, 3), np.tile(range(3), 4)
    right = (light == said).astype(np.float64)
    return POMDP(moves.reshape(4, 12, 12), np.eye(3)[light], right)


class Prediction(FiniteWorld):
    """State: 3·place in the cycle + the light that was predicted, the light, the past."""

    name = "prediction"
    summary = "say which light comes next: after amber it depends on the past"
    inputs = tuple(Input(light) for light in LIGHTS)
    outputs = (
        Output("amber next", "amber is next", "red or green is next"),
        Output("red, not green", "of these two, red", "of these two, green"),
    )
    hidden = (4,)
    pomdp = _world()
    vectors = np.eye(3)
    past = COLUMNS - 1
    presets = {
        "quick": Preset(
            0.8,
            1e-2,
            "the paper's rule; the task is not the paper's, and its inputs also reach the outputs "
            "directly",
        ),
    }
    measure = Measure("share of right predictions", "right", span=(0.0, 1.0))
    frozen_figures = ("baseline", "best")
    watch_speed = 3.0
    readings = (
        Reading("light", "0 red, 1 amber, 2 green", steps=True),
        Reading("predicted", "0 red, 1 amber, 2 green", steps=True),
        Reading("right", "1 right, 0 wrong", steps=True),
    )
    legend = "rows from the back: lights, predictions, small where wrong"
    props = (
        Prop("floor", "box", "world"),
        Prop("post", "box", "world strong"),
        *(Prop(f"{light} off", "sphere", "world") for light in LIGHTS),
        *(Prop(f"{n} on", "sphere", c) for n, c in zip(LIGHTS, _COLORS, strict=True)),
        *_WAS.props,
        *_SAID.props,
    )

    def topology(self, hidden: Sequence[int] | None = None) -> Topology:
        """Layers, and the inputs project to the outputs too."""
        layers = super().topology(hidden)
        direct = Projection("input", layers.output)
        if direct in layers.projections:
            return layers
        return replace(layers, projections=(*layers.projections, direct))

    def evaluate(self, learner: Evaluable) -> dict[str, Array]:
        others = {name: np.full(learner.lanes, value) for name, value in _references().items()}
        return super().evaluate(learner) | others

    def results(self, learner: Evaluable, late: Tally) -> dict[str, float]:
        """Shares of right predictions: of the learner, and those of the docstring."""
        others = {"same_as_now": SAME, "most_frequent": FREQUENT}
        return super().results(learner, late) | others | _references()

    def symbols(self, states: Array) -> tuple[Whole, Whole]:
        """The lights and what was predicted for each, (n, columns); NOTHING before the start."""
        state, light = self.history(states)
        said = np.where(state == NOTHING, NOTHING, state % 3)
        first = (state[:, 1:] != NOTHING) & (state[:, :-1] == NOTHING)
        said[:, 1:][first] = NOTHING
        return light, said

    def read(self, states: Array) -> Array:
        """The present light, what was predicted for it (-1 at the start), whether it is that."""
        light, said = (symbols[:, -1] for symbols in self.symbols(states))
        return np.column_stack((light, said, light == said)).astype(np.float64)

    def pose(self, state: Array) -> Pose:
        position, rotation, scale = self.poses(state[None])
        light, said, right = (int(x) for x in self.read(state[None])[0])
        verdict = "as predicted" if right else f"predicted was {LIGHTS[said]}"
        words = f"it is **{LIGHTS[light]}**{f', {verdict}' if said != NOTHING else ''}"
        return Pose(position[0], rotation[0], scale[0], words)

    def poses(self, states: Array) -> strip_chart.Poses:
        light, said = self.symbols(states)
        size = np.where(light == said, _BALL, _SMALL)[..., None]
        return strip_chart.together(
            _traffic_light(light[:, -1]),
            _WAS.poses(light, np.full((*light.shape, 3), _BALL)),
            _SAID.poses(said, np.repeat(size, 3, axis=-1)),
        )


def _traffic_light(light: Whole) -> strip_chart.Poses:
    """The floor, the post, three dark lamps, and three lit ones, of which one (n,) is seen."""
    lamps = _STANDING_AT[2:]
    scale = np.full((len(light), 8, 3), 0.9 * _LAMP)
    scale[:, 0], scale[:, 1] = _FLOOR, _POST
    scale[:, 5:] = np.where(light[:, None] == range(3), _LAMP, 0.0)[..., None]
    position = np.tile(np.vstack([_STANDING_AT, lamps]), (len(light), 1, 1))
    return strip_chart.upright(position, scale)


def _references() -> dict[str, float]:
    return {"baseline": BASELINE, "best": BEST}
