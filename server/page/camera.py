"""The position of a tab's camera for a view of the whole, the network or the world."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.stage import half_apart
from hebbviz.server.scene.appearance import network_at, place
from hebbviz.task.base import Task

Array = NDArray[np.float64]

OVERVIEW, NETWORK, WORLD = "overview", "network", "world"
VIEWS = (OVERVIEW, NETWORK, WORLD)
WHOLE_ASPECT = 0.8
"""Width / height from which a window shows the whole view of one copy; in a narrower window the
camera is further away.
"""
LABELS = 1.4
"""Room for the labels at the left of a network."""
FURTHEST = 4.0
SHEET, WITH_SHEET = 0.42, 0.6
"""At this width / height or less, the panels are in a sheet that covers this share of the scene, at
the bottom.
"""
FURTHER_WITH_SHEET = 1.15
"""Room for the labels, which have the same size in windows of any width."""
NEAR_ENOUGH = 0.02
"""Tolerated distance of a camera from its target position, in scene units."""
SECONDS = 5.0
"""A tab's camera is corrected for this long, until it is at its target position."""


@dataclass
class _Told:
    """The view that a tab was turned to, and the width of its window when the camera arrived."""

    view: str
    until: float
    aspect: float | None = None


class Cameras:
    """Turns the tabs' cameras, and checks that they arrive.

    A tab that has just opened may reset to its initial camera once more, and its panels may make
    its window narrower. Once the camera has arrived, the user's own movements are left alone.
    """

    def __init__(self) -> None:
        self._told: dict[int, _Told] = {}

    def turn(self, client: viser.ClientHandle, view: str, snapshot: Snapshot) -> None:
        """Turn one tab's camera to a view, from further away where the window is narrow."""
        self._told[client.client_id] = _Told(view, time.monotonic() + SECONDS)
        look_at(client, view, snapshot)

    def forget(self, client: viser.ClientHandle) -> None:
        """Forget a tab that has left."""
        self._told.pop(client.client_id, None)

    def settle(self, client: viser.ClientHandle, snapshot: Snapshot) -> None:
        """Turn a camera once more if it was turned lately and has not arrived."""
        told = self._told.get(client.client_id)
        if told is None:
            return
        aspect = aspect_of(client)
        if time.monotonic() > told.until:
            del self._told[client.client_id]
        elif _stands_at(client, _pose(client, told.view, snapshot)):
            told.aspect = aspect
        elif told.aspect != aspect or _stands_at(client, view_of(OVERVIEW, snapshot)):
            look_at(client, told.view, snapshot)


def aspect_of(client: viser.ClientHandle) -> float:
    """Width / height of a tab's window; a hidden one, which has no size, counts as wide enough."""
    width, height = client.camera.image_width, client.camera.image_height
    return width / height if width and height else WHOLE_ASPECT


def look_at(client: viser.ClientHandle, view: str, snapshot: Snapshot) -> None:
    position, target = _pose(client, view, snapshot)
    with client.atomic():
        client.camera.position = position
        client.camera.look_at = target


def _pose(client: viser.ClientHandle, view: str, snapshot: Snapshot) -> tuple[Array, Array]:
    """The target position of a tab's camera, and the point that it looks at."""
    position, target = (np.array(p) for p in view_of(view, snapshot))
    wide = (
        WHOLE_ASPECT if snapshot.view.other is None else _wide_enough(client.camera.fov, snapshot)
    )
    aspect = aspect_of(client)
    back = float(np.clip(wide / aspect, 1.0, FURTHEST))
    away = back * (position - target)
    if aspect <= WITH_SHEET:  # the middle of the part above the sheet
        away = FURTHER_WITH_SHEET * away
        height = 2.0 * np.linalg.norm(away) * np.tan(client.camera.fov / 2)
        target = target - (0.0, 0.0, 0.4 * SHEET * height)
    return target + away, target


def _stands_at(client: viser.ClientHandle, pose: tuple[Array, Array]) -> bool:
    away = client.camera.position - pose[0], client.camera.look_at - pose[1]
    return bool(np.abs(away).max() < NEAR_ENOUGH)


def views(task: Task) -> tuple[str, ...]:
    """The views of a task; without a world they are all the same."""
    return VIEWS if task.props else (OVERVIEW,)


def view_of(view: str, snapshot: Snapshot) -> tuple[Array, Array]:
    """Camera position and target, for a window that is wide enough."""
    where = place(snapshot.run.live.topology)
    middle = where.middle + network_at(snapshot.run.task) + (0.0, 0.0, -0.1)
    if view == NETWORK or not snapshot.run.task.props:
        away = 1.3 + 0.8 * float(np.ptp(where.units, axis=0).max())
        return middle + (0.0, -away, 0.3), middle
    if view == WORLD:
        return np.array((0.0, -4.6, 2.9)), np.array((0.0, 0.0, 0.4))
    return np.array((0.0, -6.3, 3.5)), np.array((0.0, 0.4, 2.2))


def _wide_enough(fov: float, snapshot: Snapshot) -> float:
    """Width / height of a window that shows two copies side by side in full."""
    if snapshot.run.task.props:
        return 2 * WHOLE_ASPECT
    x = place(snapshot.run.live.topology).units[:, 0]
    position, target = view_of(OVERVIEW, snapshot)
    extent = half_apart(snapshot) + float(np.ptp(x)) / 2 + LABELS
    return float(extent / (np.linalg.norm(position - target) * np.tan(fov / 2)))
