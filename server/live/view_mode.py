"""The view of a run: its present, an excerpt of it, a step of its past, or two copies."""

from __future__ import annotations

import enum
from collections.abc import Callable

from hebbviz.learner.frames import Block, Frame
from hebbviz.server.live.excerpts import Watch
from hebbviz.server.live.fork import Fork
from hebbviz.server.live.pacing import Tempo
from hebbviz.server.live.playback import Player
from hebbviz.server.live.recent_frames import Seen, Trail
from hebbviz.server.live.snapshot import Other, Past, View
from hebbviz.server.run.keyframes import Moment
from hebbviz.server.run.run import Run

NOTHING_TO_PLAY = (
    "the latest reward can be played only for a live run without a fork: go back to now, or "
    "end the fork"
)


class Event(enum.Enum):
    """Events that can be searched for from the step that is shown."""

    CHANGE_BEFORE = "previous change"
    NEXT_CHANGE = "next change"
    NEXT_REWARD = "next reward"


class Showing:
    """With a `player` the run is paused and its past is shown; with a `fork`, both copies are."""

    def __init__(self, run: Run, on_notice: Callable[[str], None]) -> None:
        self._run, self._notice = run, on_notice
        self.watch = Watch()
        self.player: Player | None = None
        self.fork: Fork | None = None
        self.live_trail, self._excerpt_trail = Trail(), Trail()
        self.seen = Seen()
        self._probes: tuple[int, ...] = ()

    def begin(self) -> None:
        """Show the present of a new run, alone."""
        self.player = self.fork = None
        self._probe()
        self.forget()

    def forget(self) -> None:
        """Forget the excerpts and the recent frames."""
        self.watch.clear()
        self._forget_pictures()

    def _forget_pictures(self) -> None:
        self.live_trail.clear()
        self._excerpt_trail.clear()
        self.seen.forget()

    def note(self, moment: Moment, block: Block) -> None:
        """Note the steps that the run just made from a keyframe."""
        self.watch.note(moment, block)
        self.live_trail.note(block)

    def view(self, live: Frame, seconds: float, tempo: Tempo) -> View:
        """The view after `seconds` more."""
        self.live_trail.add(live)
        shown, trail = self._play(live, seconds, tempo)
        frame = self.seen.see(shown)
        return View(
            frame=frame,
            leaps=self.seen.leaps,
            recent=trail.recent,
            trail=trail.frames,
            live_trail=self.live_trail.frames,
            excerpt=self.watch.excerpt(),
            watching=self.watch.on,
            watch_speed=self.watch.speed,
            past=self._past(),
            other=self._other(),
        )

    def _play(self, live: Frame, seconds: float, tempo: Tempo) -> tuple[Frame, Trail]:
        """The frame of the past; or the excerpt's, while one plays and the run is too fast to
        follow; otherwise `live`.
        """
        rate, go_on = tempo.rate, not tempo.paused
        is_alone = self.player is None and self.fork is None
        is_too_fast = rate is None or rate > 2 * self.watch.speed
        if is_alone and (self.watch.in_slow_motion or (is_too_fast and go_on)):
            played = self.watch.play(self._run, seconds, go_on=go_on)
            if played is not None:
                replay, block = played
                shown = replay.learner.frame()
                self._excerpt_trail.add(shown)
                if block is not None:
                    self._excerpt_trail.note(block)
                return shown, self._excerpt_trail
        self.watch.rest()
        if self.player is not None:
            return self.player.play(seconds, rate), self.player.trail
        return live, self.live_trail

    def _past(self) -> Past | None:
        player = self.player
        return (
            None if player is None else Past(player.cursor, player.loop, player.check, player.why)
        )

    def _other(self) -> Other | None:
        fork = self.fork
        if fork is None:
            return None
        return Other(str(fork.difference), fork.start, fork.frame(), fork.curve())

    def watch_excerpts(self, *, on: bool) -> None:
        """Play excerpts at a speed the eye can follow, while the run continues."""
        self.watch.on = on
        if not on:
            self.watch.clear()

    def show_beginning(self) -> None:
        """Play the first steps of the run, if excerpts are on."""
        self.watch.show_beginning(self._run)

    def back_to_now(self) -> None:
        """Leave the past."""
        self.player = None
        self.live_trail.clear()

    def probe(self, synapses: tuple[int, ...]) -> None:
        """Follow the traces of these synapses."""
        self._probes = synapses
        self._probe()

    def look_at_next(self, by: int) -> None:
        """Show the lane `by` positions later; wraps around."""
        self.look_at((self._run.learner.watch + by) % self._run.learner.lanes)

    def visit(self) -> Player:
        """Show the past of the run, which is paused meanwhile."""
        if self.player is None:
            if self.fork is not None:
                raise ValueError("end the fork first: the two copies have different pasts")
            self.player = Player(self._run)
        return self.player

    def seek_event(self, event: Event) -> None:
        """Show the next or previous event, or a notice that none was found."""
        player = self.visit()
        if event is Event.NEXT_REWARD:
            step = player.next_reward()
        else:
            step = player.next_change(1 if event is Event.NEXT_CHANGE else -1)
        if step is None:
            self._notice(f"found no {event.value} from step {player.cursor:,}")
        else:
            player.seek(step)

    def show_reward(self) -> None:
        """Play the latest reward in slow motion."""
        if self.player is not None or self.fork is not None:
            raise ValueError(NOTHING_TO_PLAY)
        if not self.watch.show_reward(self._run):
            self._notice("there has been no reward yet")

    def look_at(self, lane: int) -> None:
        """Show another lane: in the present, in excerpts, in the past, in both copies of a fork."""
        if lane == self._run.learner.watch:
            return
        self._run.look_at(lane)
        self.watch.look_at(lane)
        self._forget_pictures()
        if self.fork is not None:
            self.fork.look_at(lane)
        if self.player is not None:
            self.player.seek(self.player.cursor)

    def _probe(self) -> None:
        """Follow the requested synapses that exist in the network."""
        known = range(self._run.learner.topology.synapses)
        self._run.learner.probe([s for s in self._probes if s in known])
