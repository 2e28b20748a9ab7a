"""Widgets that show a run's past, and that fork it."""

from __future__ import annotations

import viser

from hebbviz.server.live.commands import (
    BackToNow,
    Command,
    EndFork,
    Seek,
    SeekEvent,
    SetLoop,
    StartFork,
    TakeOver,
)
from hebbviz.server.live.fork import BETA, GAMMA, KINDS
from hebbviz.server.live.playback import Check
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.view_mode import Event
from hebbviz.server.page import status_text
from hebbviz.server.page.widgets import Widgets, assign
from hebbviz.server.web.admission import MovingSlider

EVENTS = {
    "◀ change": Event.CHANGE_BEFORE,
    "change ▶": Event.NEXT_CHANGE,
    "reward ▶": Event.NEXT_REWARD,
}
DRAGGED_SECONDS = 1.0
"""Once the slider has not been dragged for this long, it follows the step that is shown."""
TRY_IT = (
    "*Change β or γ, freeze, or give a reward: the run then continues from this step. "
    "Undo restores what came after.*"
)
SAME_CHANCE = "*Both copies draw the same random numbers; your changes apply to both.*"


class Rewind:
    """The folder that shows the past: the step, and the actions there."""

    def __init__(self, widgets: Widgets, *, order: float) -> None:
        self._ui, gui = widgets, widgets.gui
        with gui.add_folder("Rewind", order=order):
            self.slider = MovingSlider(
                gui.add_slider(
                    "go to",
                    0,
                    1,
                    1,
                    0,
                    marks=(),
                    hint="drag to any past step; the run pauses meanwhile",
                )
            )
            self.events = gui.add_button_group("jump to", tuple(EVENTS), hint="J, K: changes")
            self._build_past(gui)
        self._ui.when(self.slider, self._seek)
        self._ui.when(self.events, lambda v: self._jump(EVENTS[v]))
        self._ui.key("Take over here", "T", TakeOver)
        self._ui.key("Back to now", "B", self._back)
        self._ui.key("Previous change", "J", lambda: self._jump(Event.CHANGE_BEFORE))
        self._ui.key("Next change", "K", lambda: self._jump(Event.NEXT_CHANGE))

    def _build_past(self, gui: viser.GuiApi) -> None:
        """The widgets that exist only while the past is shown."""
        self.step = gui.add_number("at step", 0, min=0, step=1, hint="type a step to see it")
        self.time = gui.add_number(
            "at time (s)", 0.0, min=0.0, step=0.01, hint="type a simulated time to see it"
        )
        self.loop = gui.add_checkbox(
            "loop", False, hint="at the end, play from the beginning again"
        )
        self.take_over = gui.add_button(
            "Take over here",
            icon=viser.Icon.PLAYER_TRACK_NEXT,
            hint="T: the run continues from this step; undo restores what came after",
        )
        self.back = gui.add_button("Back to now", icon=viser.Icon.ARROW_FORWARD_UP, hint="B")
        advice = gui.add_markdown(TRY_IT)
        self._past = (self.step, self.loop, self.take_over, self.back, advice)
        self._ui.when(self.step, self._seek)
        self._ui.when(self.time, self._seek_time)
        self._ui.when(self.loop, lambda v: SetLoop(bool(v)))
        self._ui.press(self.take_over, TakeOver)
        self._ui.press(self.back, self._back)

    def follow(self, snapshot: Snapshot) -> None:
        """Show the position in the run."""
        past = snapshot.view.past
        at = snapshot.run.live.step if past is None else past.cursor
        assign(self.slider, "min", snapshot.run.first)
        assign(self.slider, "max", max(snapshot.run.live.step, snapshot.run.first + 1))
        self._ui.put(self.slider, at, quiet=DRAGGED_SECONDS)
        for handle in self._past:
            assign(handle, "visible", past is not None)
        assign(self.time, "visible", past is not None and snapshot.run.task.dt is not None)
        if past is None:
            return
        self._ui.put(self.step, at)
        if snapshot.run.task.dt is not None:
            self._ui.put(self.time, round(at * snapshot.run.task.dt, 6))
        self._ui.put(self.loop, past.loop)
        from_file = past.check is not Check.OWN
        assign(self.back, "label", "Continue from its end" if from_file else "Back to now")

    # Commands

    def _seek(self, step: int) -> Seek:
        """Show a step, or the nearest one available."""
        snapshot = self._ui.snapshot
        return Seek(min(max(int(step), snapshot.run.first), snapshot.run.live.step))

    def _seek_time(self, seconds: float) -> Seek:
        snapshot = self._ui.snapshot
        last = snapshot.run.live.step
        return self._seek(round(min(seconds / (snapshot.run.task.dt or 1.0), last)))

    def _jump(self, event: Event) -> SeekEvent:
        if self._ui.snapshot.view.past is None and event is not Event.CHANGE_BEFORE:
            raise ValueError(f"there is no {event.value} after the present: rewind first")
        return SeekEvent(event)

    def _back(self) -> Command | None:
        return None if self._ui.snapshot.view.past is None else BackToNow()


class Forking:
    """The folder that runs a copy beside the run."""

    def __init__(self, widgets: Widgets) -> None:
        self._ui, gui = widgets, widgets.gui
        with gui.add_folder("Fork: two copies side by side", expand_by_default=False):
            self.kind = gui.add_dropdown(
                "differ in", KINDS, hint="the one setting in which the copies differ"
            )
            self.value = gui.add_text("its value", "0.9", hint="β or γ of the other copy")
            self.fork = gui.add_button(
                "Fork here", icon=viser.Icon.GIT_FORK, hint="fork at the step that is shown"
            )
            self.says = gui.add_markdown("")
            self.keep = gui.add_button("Keep this run", icon=viser.Icon.CHECK)
            self.keep_other = gui.add_button(
                "Keep the other copy", icon=viser.Icon.SWITCH_HORIZONTAL
            )
        self._offered = BETA
        self._ui.press(self.fork, self._start)
        self._ui.press(self.keep, EndFork)
        self._ui.press(self.keep_other, lambda: EndFork(keep_other=True))

    def follow(self, snapshot: Snapshot) -> None:
        """Offer a fork, or the choice of the copy to keep."""
        other, kind = snapshot.view.other, self.kind.value
        for handle in (self.kind, self.fork):
            assign(handle, "visible", other is None)
        for shown in (self.says, self.keep, self.keep_other):
            assign(shown, "visible", other is not None)
        assign(self.value, "visible", other is None and kind in (BETA, GAMMA))
        if kind != self._offered:
            self._offered = kind
            offer = f"{snapshot.run.gamma / 10:.3g}" if kind == GAMMA else "0.9"
            assign(self.value, "value", offer)
        if other is not None:
            said = f"other: **{other.words}**, since step {status_text.count(other.start)}."
            assign(self.says, "content", f"{said}\n\n{SAME_CHANCE}")

    def _start(self) -> StartFork:
        kind, text = self.kind.value, self.value.value
        if kind not in (BETA, GAMMA):
            return StartFork(kind)
        try:
            return StartFork(kind, float(text))
        except ValueError:
            raise ValueError(f"{kind} must be a number such as 0.9, got {text[:40]!r}") from None
