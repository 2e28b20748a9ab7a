"""The page: one scene, panels and controls for all tabs; picks and camera for each.

The loop takes the worker's latest Picture and draws it; it may skip pictures, and it never touches
the learner. What a tab clicks or types becomes a command.
"""

from __future__ import annotations

import itertools
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from typing import Any

import viser

from server import camera, palette, style, words
from server.admission import TabButtons
from server.commands import Command, Probe, ShowBeginning
from server.controls import Controls
from server.guard import GuardedServer
from server.inspector import Inspector
from server.look import Looks, unit_names
from server.palette import THEMES
from server.panels import Panels, wanted_tabs
from server.panels.base import TABS, Place
from server.picture import Picture
from server.record import Record
from server.stage import Picks, Stage, half_apart
from server.travel import Forking, Rewind
from server.widgets import Widgets, assign
from server.worker import Worker

TEXT_SECONDS = 0.2
"""Words and numbers change no more often than this, so that they can be read."""
INSPECTORS_AT_ONCE = 8
COLUMN = 348
"""Width of the panels with the charts."""
NOTICE_SECONDS = 6.0
FAILED_SECONDS = 0.2
"""What fails to be drawn, picture after picture, must not take the machine."""
THEME_SECONDS = 0.6
"""A page takes a while to change its theme: all is made anew once it is over. For a page that takes
longer, each drawing of a chart makes its uPlot anew."""


class Page:
    """Draws a worker's run on a viser server until told to stop."""

    def __init__(self, server: GuardedServer) -> None:
        self._server = server
        self._notices: deque[str] = deque(maxlen=20)
        self._inspectors: dict[int, Inspector] = {}
        self._inspected = 0
        self._lock = threading.RLock()
        self._theme = THEMES["dark"]
        self._theme_changed = False
        self._built: tuple[object, ...] | None = None
        self._stages = itertools.count()
        self._stage: Stage | None = None
        self._other_stage: Stage | None = None
        self._panels: Panels | None = None
        self._cameras = camera.Cameras()
        self._text_at = 0.0
        self._failed: str | None = None
        self._theme_at = 0.0
        self._drawn_at: deque[float] = deque(maxlen=60)
        self._probes: tuple[int, ...] = ()
        self._worker: Worker | None = None

    def notify(self, text: str) -> None:
        """Show a notice on all tabs soon; from any thread."""
        self._notices.append(text)

    def run(self, worker: Worker, stop: threading.Event) -> None:
        """Draw pictures until `stop` is set."""
        self._worker = worker
        number = 0
        while not stop.is_set():
            picture = worker.wait_for(number, timeout=0.25)
            began = time.monotonic()
            if picture is not None:
                number = picture.number
                self._attempt("drawn", self._build if self._built is None else self._draw, picture)
            self._attempt("told its notices", self._say_notices)
            stop.wait(max(0.0, began + self._server.frame_seconds - time.monotonic()))

    def _attempt(self, what: str, draw: Callable[..., None], *given: Picture) -> None:
        """What cannot be drawn, such as a pose that a task of the user's own gets wrong, is said
        once, and the run goes on.
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

    def _build(self, picture: Picture) -> None:
        """Make the page; where that fails leave nothing of it, to be tried with another picture."""
        try:
            self._build_parts(picture)
        except Exception:
            self._built = self._stage = self._other_stage = self._panels = None
            self._server.gui.reset()
            self._server.scene.reset()
            raise
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._disconnected)

    def _build_parts(self, picture: Picture) -> None:
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
        self._build_controls(Widgets(gui, self._send, self.notify), picture.seed)
        self._build_view(gui)
        self._health = gui.add_markdown("")
        self._tabs = self._make_tabs(picture)
        self._rebuild(picture)

    def _make_tabs(self, picture: Picture) -> dict[str, Any]:
        """Two panels beside the scene, one below the other, and the tabs that are wanted."""
        upper, lower = self._beside = self._server.gui.add_panel(), self._server.gui.add_panel()
        made = {}
        for name in wanted_tabs(picture):
            tab = TABS[name]
            made[name] = (lower if tab.is_below else upper).add_tab(tab.title, tab.icon)
        upper.dock_left()
        lower.dock_below(upper)
        for panel in self._beside:  # the width of the one is lost at times as the other docks
            panel.set_width(COLUMN)
        return made

    def _remake_tabs(self, picture: Picture) -> None:
        """Other tabs, where the task asks for others."""
        if tuple(self._tabs) != wanted_tabs(picture):
            for panel in self._beside:
                panel.remove()
            self._tabs = self._make_tabs(picture)

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
                self._look_at(event.client, view.value)

        @theme.on_update
        def _(_: Any) -> None:
            with self._lock:
                self._theme, self._theme_changed = THEMES[theme.value], True

    def _rebuild(self, picture: Picture) -> None:
        """Make scene and panels for a task, network or theme."""
        for part in (self._stage, self._other_stage, self._panels):
            if part is not None:
                part.remove()
        self._remake_tabs(picture)
        task, topology, theme = picture.task, picture.live.topology, self._theme
        self._names = unit_names(topology, tuple(i.name for i in task.inputs))
        self._looks, self._other_stage = Looks(topology, theme), None
        self._stage = self._new_stage("this", picture, self._looks)
        self._panels = Panels(Place(self._server.gui, self._tabs, picture, theme))
        self._frame_camera(picture)
        self._key.content = words.key(task)
        assign(self._view, "options", camera.views(task))
        another = self._built is None or self._built[:2] != (task, topology)
        for client in self._server.get_clients().values():
            self._connected(client)
            if another:
                self._look_at(client, camera.OVERVIEW)
        self._built = self._identity(picture)

    def _new_stage(self, name: str, picture: Picture, looks: Looks) -> Stage:
        """One under a number of its own: a tab lets what is made anew under a name that it knows
        stand where the former stood.
        """
        picks = Picks(self._pick_unit, self._pick_synapse)
        root = f"/{name} {next(self._stages)}"
        return Stage(self._server.scene, root, picture, looks, picks)

    def _part_copies(self, picture: Picture) -> None:
        """With a fork two copies side by side, each with its name; without one the run alone."""
        stage, other = self._stage, picture.other
        if stage is None or (other is None) == (self._other_stage is None):
            return
        if other is None and self._other_stage is not None:
            self._other_stage.remove()
            self._other_stage = None
        elif other is not None:
            self._other_stage = self._new_stage("other", picture, self._looks.twin())
            self._other_stage.move(half_apart(picture))
            self._other_stage.name(f"other: {other.words}")
        stage.move(-half_apart(picture) if other is not None else 0.0)
        stage.name("this run" if other is not None else "")
        for client in self._server.get_clients().values():
            self._look_at(client, camera.OVERVIEW)

    def _identity(self, picture: Picture) -> tuple[object, ...]:
        live = picture.live
        return picture.task, live.topology, self._theme, type(live.rule), picture.lanes

    def _set_theme(self) -> None:
        self._server.gui.configure_theme(
            dark_mode=self._theme.name == "dark", show_logo=False, show_share_button=False,
            brand_color=palette.BRAND,
        )  # fmt: skip
        self._theme_changed = False

    # Tabs

    def _welcome(self, client: viser.ClientHandle) -> None:
        self._connected(client)
        if len(self._server.get_clients()) == 1 and not self._server.is_reader(client):
            self._send(ShowBeginning())
        if camera.aspect_of(client) < camera.WHOLE_ASPECT:
            client.gui.main_panel.minimize()
        self._look_at(client, camera.OVERVIEW)

    def _connected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            old = self._inspectors.pop(client.client_id, None)
            if old is not None:
                old.remove()
            if client.client_id not in self._server.get_clients():
                return  # it has left already
            picture = self._worker.latest if self._worker is not None else None
            if picture is not None and picture.live.topology == self._looks.topology:
                self._inspectors[client.client_id] = Inspector(
                    client, self._looks.topology, self._names
                )

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._inspectors.pop(client.client_id, None)
            self._cameras.forget(client)

    def _pick_unit(self, client: viser.ClientHandle, unit: int) -> None:
        with self._lock:
            if client.client_id in self._inspectors:
                self._inspectors[client.client_id].pick_unit(unit)

    def _pick_synapse(self, client: viser.ClientHandle, synapse: int) -> None:
        with self._lock:
            if client.client_id in self._inspectors:
                self._inspectors[client.client_id].pick_synapse(synapse)

    # Drawing

    def _draw(self, picture: Picture) -> None:
        with self._lock:
            if self._theme_changed:
                self._set_theme()
                self._theme_at = time.monotonic() + THEME_SECONDS
            if self._identity(picture) != self._built and time.monotonic() > self._theme_at:
                self._rebuild(picture)
            if picture.live.topology != self._looks.topology:
                return
            with self._server.atomic():
                self._part_copies(picture)
                self._draw_copies(picture)
                if self._panels is not None:
                    self._panels.draw(picture)
            self._drawn_at.append(time.monotonic())
            if time.monotonic() - self._text_at > TEXT_SECONDS:
                self._write(picture)

    def _draw_copies(self, picture: Picture) -> None:
        still = picture.paused and picture.excerpt is None
        shown = picture.shown
        beside = None if picture.other is None else picture.other.frame
        leaps = picture.leaps
        if self._stage is not None:
            self._stage.draw(shown, beside=beside, leaps=leaps, still=still)
        if self._other_stage is not None and beside is not None:
            self._other_stage.draw(beside, beside=shown, leaps=leaps, still=still)

    def _write(self, picture: Picture) -> None:
        """All that is read: a few times a second."""
        self._text_at = time.monotonic()
        for follower in self._followers:
            follower.follow(picture)
        pose = picture.task.pose(picture.shown.world)
        said = (*words.besides(picture), words.shown(picture), pose.words)
        self._status.content = "\n\n".join(filter(None, said))
        self._controls.say_speed(words.speed(picture))
        warning = words.warning(picture)
        self._warning.visible = warning is not None
        self._warning.content = f"⚠ **{warning}**" if warning else ""
        drawn = 0 if self._stage is None else self._stage.drawn
        self._scales.content = words.scales(self._looks, drawn)
        self._health.content = words.health(
            self._pictures_per_second(), time.monotonic() - picture.made_at,
            len(self._server.get_clients()),
        )  # fmt: skip
        self._draw_inspectors(picture)
        for client in self._server.get_clients().values():
            self._cameras.settle(client, picture)
        self._ask_probes()

    def _draw_inspectors(self, picture: Picture) -> None:
        """Each tab's own; where there are many, some of them in turn."""
        inspectors = tuple(self._inspectors.values())
        count = min(len(inspectors), INSPECTORS_AT_ONCE)
        for k in range(count):
            inspectors[(self._inspected + k) % len(inspectors)].draw(picture)
        self._inspected += count

    def _ask_probes(self) -> None:
        wanted = tuple(sorted({s for i in self._inspectors.values() for s in i.probes}))
        if wanted != self._probes:
            self._probes = wanted
            self._send(Probe(wanted))

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

    # Camera

    def _frame_camera(self, picture: Picture) -> None:
        position, target = camera.view_of(camera.OVERVIEW, picture)
        self._server.initial_camera.position = position
        self._server.initial_camera.look_at = target

    def _look_at(self, client: viser.ClientHandle, view: str) -> None:
        if self._worker is not None and self._worker.latest is not None:
            self._cameras.turn(client, view, self._worker.latest)
