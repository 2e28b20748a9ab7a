"""The page goes on, whatever tabs send and tasks do. No browser: a client that only speaks."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import viser
from raw_client import CAMERA, RawClient, wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.page import camera
from hebbviz.server.page.page import Page
from hebbviz.sims.loading import make_task
from hebbviz.task.base import Task
from hebbviz.task.scene import Pose
from tests.examples.lever import Lever

if TYPE_CHECKING:
    from hebbviz.server.live.snapshot import Snapshot


PATIENCE = 30.0
"""Seconds for what comes at once on a machine that does nothing else."""


class OutOfSight(Lever):
    """A world whose scene fails."""

    def pose(self, state: Any) -> Pose:
        raise IndexError("no scene")


@contextlib.contextmanager
def running(task: Task) -> Iterator[Site]:
    site = Site(Learner(task, seed=0), host="127.0.0.1", port=0, speed=None, task_name=None)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    try:
        wait_until(lambda: site._worker is not None and site._worker.latest is not None, 60.0)
        yield site
        assert thread.is_alive(), "the program goes on"
    finally:
        stop.set()
        thread.join(10.0)


def latest(site: Site) -> Snapshot:
    assert site._worker is not None and site._worker.latest is not None
    return site._worker.latest


def goes_on(site: Site, client: RawClient) -> None:
    """Steps are made, and the tab is told of what is drawn."""
    step, frames = latest(site).run.live.step, client.frames

    def moved() -> bool:
        return latest(site).run.live.step > step and client.frames > frames + 20

    client.wait(moved, PATIENCE)


def _size(window: viser.CameraHandle) -> tuple[int, int]:
    return window.image_width, window.image_height


@pytest.mark.parametrize("size", [(0, 0), (0, 600), (800, 0)], ids=str)
def test_a_window_without_a_size_is_nothing_to_fail_by(size: tuple[int, int]) -> None:
    width, height = size
    with running(make_task("pendulum")) as site, RawClient(site._server.get_port()) as client:
        client.send(CAMERA | {"image_width": width, "image_height": height})
        tabs = site._server.get_clients
        client.wait(lambda: [_size(tab.camera) for tab in tabs().values()] == [size], PATIENCE)
        assert camera.aspect_of(*tabs().values()) == camera.WHOLE_ASPECT
        goes_on(site, client)


def test_what_cannot_be_drawn_is_said_and_the_run_goes_on(capfd: Any) -> None:
    said: list[str] = []

    def times() -> int:
        said.append(capfd.readouterr().err)
        return "".join(said).count("IndexError: no scene")

    with running(OutOfSight()) as site:
        wait_until(times, PATIENCE)
        number, step = latest(site).number, latest(site).run.live.step
        wait_until(lambda: latest(site).number > number + 40, PATIENCE)
        assert latest(site).run.live.step > step
    assert times() == 1


def test_an_error_anywhere_in_the_drawing_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    """Such as the one that viser's buffer once raised, each as something is almost done."""
    parts = ["_build_parts", "_rebuild", "_draw", "_write", "_say_notices"]
    failed: list[str] = []

    def fail_once(part: str) -> None:
        whole = getattr(Page, part)

        def fails(page: Page, *given: Any) -> None:
            whole(page, *given)
            if part not in failed:
                failed.append(part)
                raise RuntimeError(f"deque mutated in {part}")

        monkeypatch.setattr(Page, part, fails)

    for part in parts:
        fail_once(part)
    with running(make_task("pendulum")) as site:
        wait_until(lambda: sorted(failed) == sorted(parts), PATIENCE)
        with RawClient(site._server.get_port()) as client:
            goes_on(site, client)
            labels = [w.label for w in client.widgets.values() if w.kind == "GuiButtonMessage"]
            assert labels.count("Reset") == 1
            site._notify("all is well")
            client.wait(lambda: not site._page._notices, PATIENCE)  # type: ignore[union-attr]
    told = capfd.readouterr().err
    assert [told.count(f"RuntimeError: deque mutated in {part}") for part in parts] == [1] * 5
