"""Where a tab's camera stands to see the whole, the network or the world."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from server.look import network_at, place
from server.picture import Picture
from server.stage import half_apart

Array = NDArray[np.float64]

OVERVIEW, NETWORK, WORLD = "overview", "network", "world"
VIEWS = (OVERVIEW, NETWORK, WORLD)
WHOLE_ASPECT = 0.8
"""Width by height of a window in which a view is whole, of one copy; a narrower one looks from
further away."""
LABELS = 1.4
"""Room for the labels at the left of a network."""
FURTHEST = 4.0


def look_at(client: viser.ClientHandle, view: str, picture: Picture) -> None:
    """Turn one tab's camera, from further away where the window is narrow."""
    position, target = (np.array(p) for p in view_of(view, picture))
    wide = WHOLE_ASPECT if picture.other is None else _wide_enough(client.camera.fov, picture)
    back = float(np.clip(wide / client.camera.aspect, 1.0, FURTHEST))
    with client.atomic():
        client.camera.position = target + back * (position - target)
        client.camera.look_at = target


def view_of(view: str, picture: Picture) -> tuple[Array, Array]:
    """Camera position and target, for a window that is wide enough."""
    where = place(picture.live.topology)
    middle = where.middle + network_at(picture.task) + (0.0, 0.0, -0.1)
    if view == NETWORK or not picture.task.props:
        away = 1.3 + 0.8 * float(np.ptp(where.units, axis=0).max())
        return middle + (0.0, -away, 0.3), middle
    if view == WORLD:
        return np.array((0.0, -4.6, 2.9)), np.array((0.0, 0.0, 0.4))
    return np.array((0.0, -6.3, 3.5)), np.array((0.0, 0.4, 2.2))


def _wide_enough(fov: float, picture: Picture) -> float:
    """Width by height of a window in which two copies side by side are whole."""
    if picture.task.props:
        return 2 * WHOLE_ASPECT
    x = place(picture.live.topology).units[:, 0]
    position, target = view_of(OVERVIEW, picture)
    extent = half_apart(picture) + float(np.ptp(x)) / 2 + LABELS
    return float(extent / (np.linalg.norm(position - target) * np.tan(fov / 2)))
