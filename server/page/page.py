"""The page: one scene, panels and controls for all tabs; picks and a camera for each tab.

The loop draws the worker's latest snapshot; it may skip snapshots, and it never touches the
learner. Clicks and typed values become commands.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

import viser

from hebbviz.server.live.commands import Command
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.page import camera, status_text, style
from hebbviz.server.page.controls.controls import Controls
from hebbviz.server.page.controls.past import Forking, Rewind
from hebbviz.server.page.controls.record import Record
from hebbviz.server.page.panels import Panels, wanted_tabs
from hebbviz.server.page.panels.base import TABS, Place
from hebbviz.server.page.stage import Picks, Scene
from hebbviz.server.page.visitors import Visitors
from hebbviz.server.page.widgets import Widgets, assign
from hebbviz.server.scene.appearance import Looks
from hebbviz.server.web.admission import TabButtons
from hebbviz.server.web.guard import GuardedServer
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import THEMES

TEXT_SECONDS = 0.2
"""Text and numbers change no more often than this, so that they can be read."""
COLUMN = 348
"""Width of the panels with the charts."""
NOTICE_SECONDS = 6.0
FAILED_SECONDS = 0.2
"""Pause after a failed drawing, so that repeated failures do not use up the CPU."""
THEME_SECONDS = 0.6
"""A browser takes a while to change its theme: everything is rebuilt after this time. If it takes
longer, each drawing of a chart still makes a new uPlot.
"""


class Page:
    """Draws a worker's run on a viser server until it is stopped."""

    def __init__(self, server: GuardedServer) -> None:
        self._server = server
        self._notices: deque[str] = deque(maxlen=20)
        self._lock = threading.RLock()
        self._visitors = Visitors(server, self._lock, self._send)
        self._theme = THEMES["dark"]
        self._theme_changed = False
        self._built: tuple[object, ...] | None = None
        self._scene = Scene(
            server.scene, Picks(self._visitors.pick_unit, self._visitors.pick_synapse)
        )
        self._panels: Panels | None = None
        self._text_at = 0.0
        self._failed: str | None = None
        self._theme_at = 0.0
        self._drawn_at: deque[float] = deque(maxlen=60)
        self._worker: Worker | None = None

    def notify(self, text: str) -> None:
        """Show a notice on all tabs soon; from any thread."""
        self._notices.append(text)

    def run(self, worker: Worker, stop: threading.Event) -> None:
        """Draw snapshots until `stop` is set."""
        self._worker = worker
        number = 0
        while not stop.is_set():
            snapshot = worker.wait_for(number, timeout=0.25)
            began = time.monotonic()
            if snapshot is not None:
                number, self._visitors.snapshot = snapshot.number, snapshot
                self._attempt("drawn", self._build if self._built is None else self._draw, snapshot)
            self._attempt("sent notices", self._say_notices)
            stop.wait(max(0.0, began + self._server.frame_seconds - time.monotonic()))

    def _attempt(self, what: str, draw: Callable[..., None], *given: Snapshot) -> None:
        """Draw; report an error once, such as a wrong pose of the user's own task, and let the run
        continue.
        """
        try:
            draw(*given)
        except Exception as error:
            said = f"the page cannot be {what}: {type(error).__name__}: {error}"
            if said != self._failed:
                traceback.print_exc()
                self.notify(said)
            self._failed = said
            time.sleep(FAILED_SECONDS)

    def _send(self, command: Command) -> None:
        if self._worker is not None:
            self._worker.send(command)

    def close(self) -> None:
        self._server.stop()

    # Building

    def _build(self, snapshot: Snapshot) -> None:
        """Make the page; if that fails, remove all of it, so that the next snapshot can retry."""
        try:
            self._build_parts(snapshot)
        except Exception:
            self._built = self._panels = None
            self._scene.forget()
            self._server.gui.reset()
            self._server.scene.reset()
            raise
        self._visitors.begin()

    def _build_parts(self, snapshot: Snapshot) -> None:
        server, gui = self._server, self._server.gui
        self._set_theme()
        gui.set_panel_label("hebbviz")
        server.scene.set_up_direction("+z")
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(enabled=False)
        server.scene.add_light_ambient("/light/all round", intensity=1.7)
        for name, place_of_light in (("left", (-4.0, -6.0, 9.0)), ("right", (6.0, -5.0, 3.0))):
            server.scene.add_light_directional(
                f"/light/{name}", intensity=1.1, position=place_of_light, cast_shadow=False
            )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(340)
        gui.add_html(style.PAGE)
        self._status = gui.add_markdown("")
        self._warning = gui.add_markdown("", visible=False)
        self._key = gui.add_markdown("")
        self._build_controls(Widgets(gui, self._send, self.notify), snapshot.run.seed)
        self._build_view(gui)
        self._health = gui.add_markdown("")
        self._tabs = self._make_tabs(snapshot)
        self._rebuild(snapshot)

    def _make_tabs(self, snapshot: Snapshot) -> dict[str, Any]:
        """Two panels beside the scene, one above the other, with the wanted tabs."""
        upper, lower = self._beside = self._server.gui.add_panel(), self._server.gui.add_panel()
        made = {}
        for name in wanted_tabs(snapshot):
            tab = TABS[name]
            made[name] = (lower if tab.is_below else upper).add_tab(tab.title, tab.icon)
        upper.dock_left()
        lower.dock_below(upper)
        for panel in self._beside:  # one panel sometimes loses its width when the other docks
            panel.set_width(COLUMN)
        return made

    def _remake_tabs(self, snapshot: Snapshot) -> None:
        """Rebuild the tabs if the task needs different ones."""
        if tuple(self._tabs) != wanted_tabs(snapshot):
            for panel in self._beside:
                panel.remove()
            self._tabs = self._make_tabs(snapshot)

    def _build_controls(self, widgets: Widgets, seed: int) -> None:
        controls = self._controls = Controls(widgets, seed)
        rewind = Rewind(widgets, order=controls.after_run)
        self._followers = (widgets, controls, rewind, Forking(widgets), Record(widgets))

    def _build_view(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("View"):
            self._view = view = TabButtons(gui.add_button_group("camera", camera.VIEWS))
            theme = gui.add_dropdown("theme", tuple(THEMES), initial_value=self._theme.name)
            self._scales = gui.add_markdown("")

        @view.on_click
        def _(event: Any) -> None:
            if event.client is not None:
                self._visitors.look_at(event.client, view.value)

        @theme.on_update
        def _(_: Any) -> None:
            with self._lock:
                self._theme, self._theme_changed = THEMES[theme.value], True

    def _rebuild(self, snapshot: Snapshot) -> None:
        """Make scene and panels for a task, network or theme."""
        if self._panels is not None:
            self._panels.remove()
        self._remake_tabs(snapshot)
        task, topology, theme = snapshot.run.task, snapshot.run.live.topology, self._theme
        self._looks = Looks(topology, theme)
        self._scene.build(snapshot, self._looks)
        self._panels = Panels(Place(self._server.gui, self._tabs, snapshot, theme))
        self._key.content = status_text.key(task)
        assign(self._view, "options", camera.views(task))
        another = self._built is None or self._built[:2] != (task, topology)
        self._visitors.follow(snapshot, look_again=another)
        self._built = self._identity(snapshot)

    def _identity(self, snapshot: Snapshot) -> tuple[object, ...]:
        live = snapshot.run.live
        return snapshot.run.task, live.topology, self._theme, type(live.rule), snapshot.run.lanes

    def _set_theme(self) -> None:
        self._server.gui.configure_theme(
            dark_mode=self._theme.name == "dark",
            show_logo=False,
            show_share_button=False,
            brand_color=palette.BRAND,
        )
        self._theme_changed = False

    # Drawing

    def _draw(self, snapshot: Snapshot) -> None:
        with self._lock:
            if self._theme_changed:
                self._set_theme()
                self._theme_at = time.monotonic() + THEME_SECONDS
            if self._identity(snapshot) != self._built and time.monotonic() > self._theme_at:
                self._rebuild(snapshot)
            if snapshot.run.live.topology != self._looks.topology:
                return
            with self._server.atomic():
                if self._scene.part_copies(snapshot):
                    self._visitors.look_again()
                self._scene.draw(snapshot)
                if self._panels is not None:
                    self._panels.draw(snapshot)
            self._drawn_at.append(time.monotonic())
            if time.monotonic() - self._text_at > TEXT_SECONDS:
                self._write(snapshot)

    def _write(self, snapshot: Snapshot) -> None:
        """Update all text, a few times a second."""
        self._text_at = time.monotonic()
        for follower in self._followers:
            follower.follow(snapshot)
        pose = snapshot.run.task.pose(snapshot.view.frame.world)
        said = (*status_text.besides(snapshot), status_text.shown(snapshot), pose.words)
        self._status.content = "\n\n".join(filter(None, said))
        self._controls.say_speed(status_text.speed(snapshot))
        warning = status_text.warning(snapshot)
        self._warning.visible = warning is not None
        self._warning.content = f"⚠ **{warning}**" if warning else ""
        self._scales.content = status_text.scales(self._looks, self._scene.drawn)
        self._health.content = status_text.health(
            self._pictures_per_second(),
            time.monotonic() - snapshot.made_at,
            len(self._server.get_clients()),
        )
        self._visitors.draw(snapshot)

    def _pictures_per_second(self) -> float:
        if len(self._drawn_at) < 2:
            return 0.0
        return (len(self._drawn_at) - 1) / (self._drawn_at[-1] - self._drawn_at[0])

    def _say_notices(self) -> None:
        while self._notices:
            text = self._notices.popleft()
            for client in self._server.get_clients().values():
                client.add_notification(
                    "hebbviz", text, auto_close_seconds=NOTICE_SECONDS, with_close_button=True
                )
