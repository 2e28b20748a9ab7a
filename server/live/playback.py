"""Plays a run back: any of its steps, recomputed from the nearest keyframe.

Playback from a file is checked: from each keyframe the run is recomputed up to the next one, and
must match it to the bit. If it does not, for example on another type of machine, stored data is
shown.
"""

from __future__ import annotations

import enum
import math
import time

import numpy as np

from hebbviz.learner.frames import Block, Frame
from hebbviz.server.live.recent_frames import STEPS, Trail
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Replay, Run

FRAMES_OF_LEAD = 64
"""Frames that cover the steps before a seek's target, for the plots."""
CHECK_SECONDS = 0.006
"""Share of each frame's time for comparing recomputed steps with the next keyframe."""
SEARCH_SECONDS = 0.4
"""Time limit of the search for the next reward."""
LONGEST_STRETCH = 2_000
FASTEST = 1e9
"""Steps per second that stand for full speed."""


class Check(enum.Enum):
    """Whether the steps that are shown are verified to be the recorded ones."""

    OWN = "recomputed by the program that made it"
    PENDING = "recomputed; being compared with the next keyframe"
    GOOD = "recomputed, and identical to the next keyframe to the bit"
    DIFFERS = "recomputing gives a different result: stored data is shown"


class Player:
    """Shows a run from `first` to `last` step; the run itself is paused meanwhile."""

    def __init__(self, run: Run) -> None:
        self._run, self._stored = run, run.stored
        self.first, self.last = run.tape.first, run.learner.step
        self.playing, self.loop = False, False
        self.trail = Trail()
        self.check = Check.OWN if run.stored is None else Check.PENDING
        self._good: set[int] = set()
        self._checker: tuple[Replay, Moment] | None = None
        self._owed = 0.0
        self._shown: int | None = None
        self.seek(self.last)

    @property
    def why(self) -> str | None:
        """Why recomputing gives a different result, if it does."""
        if self._stored is None or self.check is not Check.DIFFERS:
            return None
        return self._stored.other_now

    @property
    def cursor(self) -> int:
        """The step that is shown."""
        return self.replay.learner.step if self._shown is None else self._shown

    def seek(self, step: int) -> None:
        """Show a step; it is recomputed with some steps before it, and shown alone."""
        step = min(max(step, self.first), self.last)
        self.trail.clear()
        self._owed, self._shown = 0.0, None
        if self.check is Check.DIFFERS:
            self.replay, self._shown = self._run.replay(self._moment(step)), step
            self._keyframe = self.replay.learner.frame()
            self.trail.add(self._frame())
            return
        self.replay = self._run.replay(self._moment(max(self.first, step - STEPS)))
        self.replay.learner.probe(self._run.learner.probes)
        self.replay.go_to(step - STEPS)
        self.replay.learner.frame()
        each = max(1, math.ceil((step - self.cursor) / FRAMES_OF_LEAD))
        self._go(step - 1, each)
        self.trail.add(self.replay.learner.frame())
        self._go(step, 1)
        self._begin_check()

    def play(self, seconds: float, rate: float | None) -> Frame:
        """Advance for some seconds at `rate` steps per second; None is full speed."""
        if self.playing:
            rate = FASTEST if rate is None else rate
            self._owed = min(self._owed + rate * seconds, rate * 0.25 + 1.0)
            self._play_on(until=time.monotonic() + 0.7 * seconds)
        self._check_on()
        frame = self._frame()
        self.trail.add(frame)
        return frame

    def pause(self, paused: bool) -> None:
        """Pause or resume; at the end, resume from the beginning."""
        if not paused and self.cursor >= self.last:
            self.seek(self.first)
        self.playing = not paused

    def step(self, steps: int) -> None:
        """Advance by this many steps, and pause there."""
        self.playing = False
        self._go(min(self.cursor + steps, self.last), steps)

    def _frame(self) -> Frame:
        if self._shown is None or self._stored is None:
            return self.replay.learner.frame()
        frame = self._stored.frame(self._keyframe, self._shown)
        self.trail.recent = self._stored.recent(self._shown, STEPS)
        return frame

    def next_change(self, direction: int) -> int | None:
        """The step of the next change of the run, or of the previous one; None if there is none."""
        steps = sorted({c.step for c in self._run.log if self.first <= c.step <= self.last})
        ahead = [s for s in steps if (s - self.cursor) * direction > 0]
        return (ahead[0] if direction > 0 else ahead[-1]) if ahead else None

    def next_reward(self) -> int | None:
        """The step before the next unusual reward; None if none is found in time."""
        replay = self._run.replay(self.replay.moment())
        until = time.monotonic() + SEARCH_SECONDS
        usual: float | None = None
        while replay.learner.step < self.last and time.monotonic() < until:
            block = replay.advance(LONGEST_STRETCH)
            rewards = block.events(replay.learner.rule)
            usual = float(np.median(rewards)) if usual is None else usual
            unusual = np.flatnonzero((rewards != usual) | block.ended)
            if len(unusual):
                return int(block.start + unusual[0] + 1)
        return None

    # Inside

    def _moment(self, step: int) -> Moment:
        moment = self._run.tape.before(step)
        assert moment is not None, "a keyframe store has a first keyframe"
        return moment

    def _play_on(self, until: float) -> None:
        """Play the due steps, as far as time allows; at the end start again, or pause."""
        while self._owed >= 1.0 and time.monotonic() < until:
            steps = int(min(self._owed, LONGEST_STRETCH))
            made = self._go(min(self.cursor + steps, self.last), steps)
            self._owed -= made
            if self.cursor >= self.last:
                self.playing = self.loop
                if self.loop:
                    self.seek(self.first)
                return

    def _go(self, step: int, each: int) -> int:
        """Advance to a step, with a frame for the plots after every `each` steps; returns their
        number.
        """
        start = self.cursor
        if self._shown is not None:
            owed = self._owed
            self.seek(step)
            self._owed = owed
            return self.cursor - start
        while self.cursor < step:
            block = self.replay.advance(min(each, step - self.cursor))
            if not len(block.fired):
                break
            self._note(block, framed=self.cursor < step)
        return self.cursor - start

    def _note(self, block: Block, *, framed: bool) -> None:
        self.trail.note(block)
        if framed:
            self.trail.add(self.replay.learner.frame())

    # Checking

    def _begin_check(self) -> None:
        """Start to compare the chunk that is shown with the keyframe at its end, unless done
        already.
        """
        if self._stored is None:
            return
        start, end = self._moment(self.cursor), self._run.tape.after(self.cursor)
        known = end is None or end.step in self._good
        self.check = Check.GOOD if known else Check.PENDING
        self._checker = None if known or end is None else (self._run.replay(start, end), end)

    def _check_on(self) -> None:
        """Continue the comparison, within the time that a frame leaves."""
        if self._checker is None:
            if self.check is Check.GOOD and self._left_checked():
                self._begin_check()
            return
        replay, end = self._checker
        until = time.monotonic() + CHECK_SECONDS
        while replay.learner.step < end.step and time.monotonic() < until:
            replay.go_to(min(replay.learner.step + 500, end.step))
        if replay.learner.step < end.step:
            return
        self._checker = None
        if replay.moment().keyframe.digest() == end.keyframe.digest():
            self._good.add(end.step)
            self.check = Check.GOOD
        else:
            self.check = Check.DIFFERS
            self.seek(self.cursor)

    def _left_checked(self) -> bool:
        """Whether the cursor has moved into a chunk that was not compared."""
        end = self._run.tape.after(self.cursor)
        return end is not None and end.step not in self._good
