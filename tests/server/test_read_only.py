"""Those who came in to look: they see all, have a camera and picks, and change nothing."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from raw_client import CAMERA, RawClient, Widget, wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.recording.recordings import Options
from hebbviz.server.web import read_only
from hebbviz.server.web.access import Access, Role
from hebbviz.server.web.admission import TabButtons
from hebbviz.server.web.guard import GuardedServer, open_server
from hebbviz.sims.loading import make_task

# viser warns of what is sent to a tab in the moment in which it closes
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection")


@contextlib.contextmanager
def opened() -> Iterator[tuple[GuardedServer, list[str]]]:
    refusals: list[str] = []
    server = open_server(port=0, access=Access(token=True), on_refusal=refusals.append)
    try:
        yield server, refusals
    finally:
        server.stop()


def came_in(server: GuardedServer, role: Role) -> RawClient:
    return RawClient(server.get_port(), path=server.entrance.link("", role))


_widths = itertools.count(900)


def settle(server: GuardedServer, client: RawClient) -> None:
    """Wait until the server has dealt with everything that `client` sent so far, and knows it.

    A page may turn a camera; how wide its window is is the tab's own.
    """
    width = next(_widths)
    client.send(CAMERA | {"image_width": width})
    clients = server.get_clients
    wait_until(lambda: any(c.camera.image_width == width for c in clients().values()))


def test_a_reader_moves_no_widget_and_is_told_alone() -> None:
    with opened() as (server, refusals):
        gui, told = server.gui, []
        slider = gui.add_slider("slider", 0.0, 1.0, 0.1, 0.5)
        button, group = gui.add_button("go"), gui.add_button_group("pace", ("slow", "fast"))
        command = gui.add_command("reset", hotkey="R")
        with gui.add_form("form") as form:
            gui.add_number("inside", 1)
        slider.on_update(lambda _: told.append("moved"))
        for handle in (button, group):
            handle.on_click(lambda _: told.append("pressed"))
        button.on_hold(lambda _: told.append("held"), callback_hz=10.0)
        command.on_trigger(lambda _: told.append("command"))
        form.on_submit(lambda _: told.append("form"))
        with came_in(server, Role.OWNER) as owner, came_in(server, Role.READER) as reader:
            settle(server, reader)
            seen = reader.find("slider")
            seen.value = 0.9  # as its page shows it
            reader.send_value(seen, 0.9)
            reader.send_updates(seen, {"max": 9})
            reader.press("go")
            reader.send_value("pace", "fast")
            reader.trigger("reset")
            for kind in ("GuiFormDirtyMessage", "GuiFormSubmitMessage"):
                reader.send({"type": kind, "uuid": reader.find("form").uuid})
            held = {"uuid": reader.find("go").uuid, "frequency": 10.0}
            reader.send({"type": "GuiButtonHoldMessage"} | held)
            reader.send_bytes(b"\xc1")
            settle(server, reader)
            assert told == [] and refusals == []
            assert (slider.value, slider.max, group.value) == (0.5, 1.0, "slow")
            reader.wait(lambda: seen.value == 0.5)
            reader.wait(lambda: reader.notices == [read_only.LINE])
            assert owner.notices == []
            settle(server, owner)
            owner.send_value("slider", 0.7)
            owner.press("go")
            owner.trigger("reset")
            wait_until(lambda: sorted(told) == ["command", "moved", "pressed"])


def test_a_reader_has_what_is_the_tab_s_own() -> None:
    with opened() as (server, _):
        told: list[Any] = []
        views = TabButtons(server.gui.add_button_group("camera", ("near", "far")))
        views.on_click(lambda event: told.append(("view", event.client.client_id)))
        ball = server.scene.add_icosphere("/ball")
        ball.on_click(lambda event: told.append(("click", event.client.client_id)))
        with came_in(server, Role.OWNER), came_in(server, Role.READER) as reader:
            settle(server, reader)
            (client,) = [c for c in server.get_clients().values() if server.is_reader(c)]
            own = client.gui.add_dropdown("pick", ("a", "b"))
            own.on_update(lambda event: told.append((own.value, event.client.client_id)))
            reader.send_value("pick", "b")
            reader.send_value("camera", "far")
            ray = {"ray_origin": [0, 0, 0], "ray_direction": [0, 0, 1.0], "screen_pos": [0.5, 0.5]}
            rest = {"name": "/ball", "instance_index": None, "modifier": None, "owner": ""}
            reader.send({"type": "SceneNodeClickMessage"} | ray | rest)
            number = client.client_id
            wait_until(lambda: sorted(told) == [("b", number), ("click", number), ("view", number)])
            assert reader.notices == []


def test_nobody_moves_what_is_another_tab_s_own() -> None:
    with (
        opened() as (server, refusals),
        came_in(server, Role.READER) as one,
        came_in(server, Role.OWNER) as other,
    ):
        settle(server, one)
        (client,) = [c for c in server.get_clients().values() if server.is_reader(c)]
        own = client.gui.add_dropdown("pick", ("a", "b"))
        other.send_updates(one.find("pick"), {"value": "b"})
        settle(server, other)
        assert own.value == "a"
        assert refusals == ["refused a message from a page: it is about no known widget"]


def test_a_reader_is_told_at_once_what_it_is() -> None:
    with (
        opened() as (server, _),
        came_in(server, Role.READER) as reader,
        came_in(server, Role.OWNER) as owner,
    ):
        reader.wait(lambda: read_only.STANDING in contents(reader))
        settle(server, owner)
        assert read_only.STANDING not in contents(owner)


def contents(client: RawClient) -> list[Any]:
    return [widget.props.get("_markdown") for widget in list(client.widgets.values())]


# The whole page


@contextlib.contextmanager
def shown(folder: Path) -> Iterator[Site]:
    learner, stop = Learner(make_task("pendulum"), seed=1), threading.Event()
    site = Site(
        learner, host="127.0.0.1", port=0, speed=200.0, task_name=None,
        recording=Options(folder=folder / "recordings"), access=Access(token=True),
    )  # fmt: skip
    thread = threading.Thread(target=site.run, args=(stop,), kwargs={"open_browser": False})
    thread.start()
    try:
        wait_until(lambda: site._page is not None and follows(site), 30.0)
        yield site
    finally:
        stop.set()
        thread.join()


def follows(site: Site) -> bool:
    """Whether the page's widgets show the run."""
    controls = getattr(site._page, "_controls", None)
    return controls is not None and controls._ui._snapshot is not None


def another(widget: Widget) -> Any:
    """A value that would fit, and is not the one that is set."""
    props = widget.props
    match widget.kind:
        case "GuiSliderMessage":
            return props["max"] if widget.value != props["max"] else props["min"]
        case "GuiNumberMessage":
            return widget.value + (1 if props.get("max") in (None, widget.value + 1) else 0)
        case "GuiCheckboxMessage":
            return not widget.value
        case "GuiDropdownMessage" | "GuiButtonGroupMessage":
            return props["options"][-1]
        case "GuiTextMessage":
            return "7"
        case "GuiButtonMessage":
            return True


def state(site: Site) -> tuple[Any, ...]:
    """All that a page could change of the run, its steps aside."""
    assert site._worker is not None
    snapshot = site._worker.latest
    assert snapshot is not None
    run, view, pacing = snapshot.run, snapshot.view, snapshot.pacing
    settings = (run.number, run.task, run.task_name, run.seed, run.lane, run.beta, run.gamma)
    log = (run.frozen, run.changes, run.undo_words, snapshot.findings.evaluations)
    shown = (view.watching, view.watch_speed, view.past, view.other, pacing.paused, pacing.speed)
    rest = site._page._theme, run.live.topology, snapshot.recording
    return (*settings, *log, *shown, *rest)


def test_whatever_a_reader_sends_the_run_goes_on_as_it_was(tmp_path: Path) -> None:
    with shown(tmp_path) as site, came_in(site._server, Role.READER) as reader:
        assert site._worker is not None
        settle(site._server, reader)
        reader.find("file")
        before = state(site)
        found = [w for w in list(reader.widgets.values()) if another(w) is not None]
        commands = [w for w in list(reader.widgets.values()) if "Command" in w.kind]
        assert len(found) > 20 and len(commands) > 10
        for widget in found:
            reader.send_value(widget, another(widget))
        for command in commands:
            reader.trigger(command)
        settle(site._server, reader)
        at = site._worker.latest
        assert at is not None
        wait_until(lambda: site._worker.latest.number > at.number + 3)
        assert state(site) == before
        assert site._run.learner.step > 0 and list(tmp_path.iterdir()) == []
        with came_in(site._server, Role.OWNER) as owner:
            settle(site._server, owner)
            owner.trigger("Freeze learning")
            wait_until(lambda: site._worker.latest.run.frozen)
