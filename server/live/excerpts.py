"""Excerpts of a fast run, recomputed at a speed the eye can follow.

While the run continues at full speed, a replay plays a few seconds from one of its latest
keyframes, then jumps to a newer one. Every step shown really happened. On request it plays the
latest reward in slow motion: the steps before it, its arrival, its effect.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from hebbviz.learner.frames import Block
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Replay, Run

EXCERPT_SECONDS = 6.0
LEAD, TAIL = 7, 4
"""Steps shown before and after a reward in slow motion."""
SLOW_STEPS_PER_SECOND = 2.5
HOLD_SECONDS = 1.5
"""How long the effect of a reward stays visible."""

DEFAULT_SPEED = 25.0


@dataclass(frozen=True)
class Excerpt:
    """The position of an excerpt in the run: steps `first` to `last`, and the current one."""

    first: int
    last: int
    now: int
    is_reward: bool
    reward_step: int | None = None


@dataclass(frozen=True)
class _Reward:
    """A reward at the end of `step`, and a keyframe before it."""

    moment: Moment
    step: int


class Watch:
    """Keeps keyframes of a run, and plays excerpts from them."""

    def __init__(self) -> None:
        self.on = False
        self.speed = DEFAULT_SPEED
        self._moments: deque[Moment] = deque(maxlen=8)
        self._latest_reward: _Reward | None = None
        self._beginning: Moment | None = None
        self._left_to_hold = 0.0
        self._replay: Replay | None = None
        self._excerpt = Excerpt(0, 0, 0, is_reward=False)
        self._owed = 0.0

    @property
    def in_slow_motion(self) -> bool:
        """Whether a reward is being played, also while the run is paused."""
        return self._replay is not None and self._excerpt.is_reward

    def clear(self) -> None:
        """Forget all keyframes: the run was replaced."""
        self._moments.clear()
        self._latest_reward = self._replay = self._beginning = None

    def look_at(self, lane: int) -> None:
        """Continue the excerpt with another lane; forget the latest reward, which was the other
        lane's.
        """
        self._latest_reward = None
        if self.in_slow_motion:
            self._replay = None
        if self._replay is not None:
            self._replay.learner.look_at(lane)

    def note(self, moment: Moment, block: Block) -> None:
        """Keep the keyframe at the start of a block of the run; look for rewards in the block."""
        if self._beginning is None:
            self._beginning = moment
        rewarded = np.flatnonzero(block.events(moment.keyframe.rule))
        if len(rewarded):
            step = block.start + int(rewarded[-1])
            before = [m for m in (*self._moments, moment) if m.step <= max(0, step - LEAD)]
            self._latest_reward = _Reward(before[-1] if before else moment, step)
        spacing = self._length() // 4  # so that the kept keyframes span two excerpts
        if not self._moments or moment.step - self._moments[-1].step >= spacing:
            self._moments.append(moment)

    def show_reward(self, run: Run) -> bool:
        """Start the slow motion of the latest reward; False if there was none yet."""
        reward = self._latest_reward
        if reward is None:
            return False
        replay = run.replay(reward.moment)
        while replay.learner.step < reward.step - LEAD:
            replay.advance(reward.step - LEAD - replay.learner.step)
        replay.learner.frame()
        first = replay.learner.step
        last = min(reward.step + TAIL, run.learner.step)
        self._start(replay, Excerpt(first, last, first, is_reward=True, reward_step=reward.step))
        return True

    def show_beginning(self, run: Run) -> None:
        """Play the first steps that are known of the run, if excerpts are on."""
        begun = self._beginning
        if self.on and begun is not None and begun.step + self._length() < run.learner.step:
            first, last = begun.step, begun.step + self._length()
            self._start(run.replay(begun), Excerpt(first, last, first, is_reward=False))

    def play(
        self, run: Run, seconds: float, *, go_on: bool = True
    ) -> tuple[Replay, Block | None] | None:
        """Advance the excerpt by some seconds; None if nothing is playing.

        At its end another one starts if `go_on`. Returns the replay and the block of its steps, if
        any.
        """
        if self._replay is not None and not self._replay.is_of(run):
            self.clear()
        if self._is_over() and self._left_to_hold > 0.0 and self._replay is not None:
            self._left_to_hold -= seconds
            return self._replay, None
        if self._is_over():
            self._replay = None
            if self.on and go_on and self._moments:
                self._leap(run)
        if self._replay is None:
            return None
        self._replay.learner.probe(run.learner.probes)
        speed = SLOW_STEPS_PER_SECOND if self._excerpt.is_reward else self.speed
        self._owed = min(self._owed + speed * seconds, max(1.0, speed))
        steps = min(int(self._owed), self._excerpt.last - self._replay.learner.step)
        if steps < 1:
            return self._replay, None
        block = self._replay.advance(steps)
        self._owed -= len(block.fired)
        return self._replay, block

    def rest(self) -> None:
        """Play nothing for now."""
        self._replay = None

    def excerpt(self) -> Excerpt | None:
        if self._replay is None:
            return None
        e = self._excerpt
        return Excerpt(e.first, e.last, self._replay.learner.step, e.is_reward, e.reward_step)

    def _is_over(self) -> bool:
        return self._replay is None or self._replay.learner.step >= self._excerpt.last

    def _leap(self, run: Run) -> None:
        """Start a new excerpt at the newest keyframe with enough steps after it."""
        length = self._length()
        fit = [m for m in self._moments if m.step + length <= run.learner.step]
        moment = fit[-1] if fit else self._moments[0]
        if moment.step == run.learner.step:
            return
        first, last = moment.step, moment.step + length  # the run gets there first, as it is faster
        self._start(run.replay(moment), Excerpt(first, last, first, is_reward=False))

    def _length(self) -> int:
        """Steps of an excerpt."""
        return max(2, round(self.speed * EXCERPT_SECONDS))

    def _start(self, replay: Replay, excerpt: Excerpt) -> None:
        self._replay, self._excerpt, self._owed = replay, excerpt, 0.0
        self._left_to_hold = HOLD_SECONDS if excerpt.is_reward else 0.0
