"""The arrival of a reward: a pulse through the network, and its weight changes."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.rules.paper import PAPER
from hebbviz.server.scene.appearance import THICKEST
from hebbviz.server.scene.network import NetworkScene
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb

Array = NDArray[np.float64]

PULSE_PICTURES = 14
"""Frames that the pulse takes through the network."""
AFTERGLOW_PICTURES = 26
"""Frames for which the weight changes stay visible."""
LONG_AGO = 10_000
QUIET_PICTURES = 25
"""Rewards closer together than this make no pulse each; their weight changes are shown."""
GLOW, FAINT_GLOW = 1.9, 0.7
"""Thickness of the largest weight change, in that of the thickest synapse."""
WORDS_SECONDS = 0.3
"""Words that change faster than this cannot be read."""
STANDS_OUT = 10.0
"""If a rule sends a signal at every step, a reward is this many times as large as the last one."""
FEW_STEPS = 25
"""With more steps in a frame, rewards are shown as a rate, not as events."""


class Pulse:
    """Follows the shown Frames and draws the latest reward on a NetworkScene."""

    def __init__(self, synapses: int) -> None:
        self._since_reward = LONG_AGO
        self._pulse_age = PULSE_PICTURES
        self._color: Rgb = palette.REWARD
        self._change = np.zeros(synapses)
        self._usual = math.inf
        self._followed: tuple[int, int] | None = None
        self._told = ""
        self._unsaid: tuple[str, str] | None = None
        self._alone = True
        self._said_at = 0.0
        self._hidden = True

    def follow(
        self, frame: Frame, scene: NetworkScene, world: str, *, leaps: int, still: bool
    ) -> None:
        """Advance by one picture; `world` is said over the network too.

        While nothing moves (`still`) the pulse ends, but what the reward changed stays to be seen;
        a leap ends it.
        """
        before, self._followed = self._followed, (leaps, frame.step)
        is_new = before != self._followed
        if before is None or before[0] != leaps:
            self._since_reward, self._pulse_age = LONG_AGO, PULSE_PICTURES
        arrives = is_new and 0 < frame.since.steps <= FEW_STEPS and self._is_event(frame)
        if arrives:
            self._arrive(frame)
        if is_new:
            self._unsaid = self._words(frame), world
        self._say(scene, at_once=still or (arrives and self._pulse_age == 0))
        self._pulse_age += 1
        if not still or self._since_reward < AFTERGLOW_PICTURES // 3:
            self._since_reward += 1
        self._draw(scene)

    def _is_event(self, frame: Frame) -> bool:
        """Whether a reward came. With a reward baseline m is hardly ever 0: then it is one of the
        task, or one by hand, which stands out from the picture before.
        """
        tally = frame.since.tally
        if frame.rule == PAPER:
            return tally.broadcast != 0.0
        sent = abs(tally.broadcast) / frame.since.steps
        usual, self._usual = self._usual, sent
        return tally.reward != 0.0 or sent > STANDS_OUT * usual

    def _arrive(self, frame: Frame) -> None:
        """Take in a reward; one that follows closely on another begins no pulse, and glows less."""
        self._alone = self._since_reward > QUIET_PICTURES
        if self._alone:
            self._pulse_age = 0
        positive = frame.since.tally.broadcast > 0
        self._color = palette.REWARD if positive else palette.PUNISHMENT
        self._since_reward = 0
        self._told = arrival(frame)
        self._change = frame.since.weight_change.copy()

    def _say(self, scene: NetworkScene, *, at_once: bool) -> None:
        """Words that follow one another too fast to be read are left out, but for the last ones."""
        now = time.monotonic()
        if self._unsaid is not None and (at_once or now - self._said_at > WORDS_SECONDS):
            self._said_at = now
            scene.say(*self._unsaid)
            self._unsaid = None

    def _draw(self, scene: NetworkScene) -> None:
        if self._since_reward > AFTERGLOW_PICTURES:
            if not self._hidden:
                scene.draw_change(np.zeros_like(self._change), self._change)
                scene.draw_pulse(0.0, self._color)
                self._hidden = True
            return
        self._hidden = False
        largest = np.abs(self._change).max(initial=0.0)
        size = np.abs(self._change) / largest if largest > 0 else np.zeros_like(self._change)
        fade = 1.0 - self._since_reward / (AFTERGLOW_PICTURES + 1)
        thick = (GLOW if self._alone else FAINT_GLOW) * THICKEST
        radius = np.where(size > 0.02, thick * size * fade, 0.0)
        scene.draw_change(radius, np.sign(self._change) * size)
        share = self._pulse_age / PULSE_PICTURES
        scene.draw_pulse(share if share < 1.0 else 0.0, self._color)

    def _words(self, frame: Frame) -> str:
        """The label over the network; empty if there is nothing to show."""
        since = frame.since
        if since.steps > FEW_STEPS:
            return f"r: {since.tally.reward / since.steps:+.3f} per step"
        return "" if self._since_reward > AFTERGLOW_PICTURES else self._told


def arrival(frame: Frame) -> str:
    """The reward of a frame of few steps and its effect: r, and m if the rule broadcasts another
    number; sums for several steps.
    """
    tally, sums = frame.since.tally, "Σ " * (frame.since.steps > 1)
    largest = float(np.abs(frame.since.weight_change).max(initial=0.0))
    if frame.rule == PAPER:  # what was given by hand is reward like any other
        return f"{sums}r = {tally.broadcast:+.3g}: Δw = {sums}γ r z, at most {largest:.1e}"
    came = f"{sums}r = {tally.reward:+.3g}, {sums}m = {tally.broadcast:+.3g}"
    return f"{came}: Δw = {sums}γ m z, at most {largest:.1e}"
