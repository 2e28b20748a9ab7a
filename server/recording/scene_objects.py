"""A world's props in a recording: unit shapes written once, then their places, turns and sizes.

rerun keeps the latest value of each component, so only what changed is written. One exception
shapes this code: a row of `Transform3D` replaces the whole transform. So a prop's place and turn
are written together, and its size, which seldom changes, with the shape, as `InstancePoses3D`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hebbviz.server.recording.header import entity
from hebbviz.server.recording.rows import Columns, Rows, Steps
from hebbviz.server.scene import meshes
from hebbviz.server.scene.appearance import color_of
from hebbviz.sims.figures.palette import Theme
from hebbviz.task.base import Task
from hebbviz.task.scene import Prop

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

ROOT = "scene/world"
LEAST_EXTENT = 1e-4
"""A prop of no extent is drawn this thin: a mesh scaled to zero has no normals."""
LEAP = 0.4
"""A prop that moves further than this in one step was put there: its trail is interrupted."""
TRAIL_RADIUS = 0.014
_PLACE, _TURN, _SIZE = slice(0, 3), slice(3, 7), slice(7, 10)


class Props:
    """Writes the props of one task."""

    def __init__(self, stream: rr.RecordingStream, task: Task, rows: Rows, theme: Theme) -> None:
        self._task, self._rows = task, rows
        self._latest = np.zeros((0, len(task.props), 10), dtype=np.float32)
        self._latest_step = np.zeros(0, dtype=np.int64)
        for prop in task.props:
            color = packed(np.array([color_of(prop, theme)]))
            stream.log(f"{path_of(prop)}/shape", _mesh(prop, theme), static=True, strict=True)
            if prop.trail:
                line = rr.LineStrips3D.from_fields(colors=color, radii=[TRAIL_RADIUS])
                stream.log(trail_of(prop), line, static=True, strict=True)

    def add(self, steps: Steps, states: Array) -> None:
        """Where the props are after each of these steps: (n,), (n, numbers)."""
        if not len(steps) or not self._task.props:
            return
        now = self._numbers(states)
        before = self._latest if len(self._latest) else now[:1] + np.nan
        changed = np.diff(now, axis=0, prepend=before) != 0
        moved, resized = changed[..., :7].any(axis=-1), changed[..., _SIZE].any(axis=-1)
        for k, prop in enumerate(self._task.props):
            path, where, sized = path_of(prop), moved[:, k], resized[:, k]
            self._rows.add(path, steps[where], now[where, k, :7], _transforms)
            self._rows.add(f"{path}/shape", steps[sized], now[sized, k, _SIZE], _sizes)
            if prop.trail:
                self._add_trail(prop, steps, now[:, k, _PLACE], self._latest[:, k, _PLACE])
        self._latest, self._latest_step = now[-1:], steps[-1:]

    def _numbers(self, states: Array) -> Floats:
        """Place, turn (x, y, z, w) and size of each prop at each state: (n, props, 10)."""
        position, rotation, scale = self._task.poses(states)
        made = np.empty((len(states), len(self._task.props), 10), dtype=np.float32)
        made[..., _PLACE] = position
        made[..., _TURN] = rotation[..., [1, 2, 3, 0]]
        made[..., _SIZE] = np.maximum(scale, LEAST_EXTENT)
        return made

    def _add_trail(self, prop: Prop, steps: Steps, place: Floats, before: Floats) -> None:
        """A piece of line for every step that follows on the step before."""
        at = np.concatenate([before, place])
        step = np.concatenate([self._latest_step, steps])
        follows = (np.diff(step) == 1) & (np.linalg.norm(np.diff(at, axis=0), axis=1) < LEAP)
        pieces = np.stack([at[:-1], at[1:]], axis=1)
        self._rows.add(trail_of(prop), step[1:][follows], pieces[follows], _pieces)


def path_of(prop: Prop) -> str:
    """The entity of a prop's place and turn; below it is its shape, and how large that is."""
    return f"{ROOT}/{entity(prop.name)}"


def trail_of(prop: Prop) -> str:
    """The entity of a prop's trail."""
    return f"{ROOT}/trails/{entity(prop.name)}"


def packed(colors: NDArray[Any]) -> NDArray[np.uint32]:
    """(n, 3) bytes as rerun's 0xRRGGBBAA: (n,)."""
    r, g, b = colors.astype(np.uint32).T
    whole: NDArray[np.uint32] = r << 24 | g << 16 | b << 8 | 0xFF
    return whole


def _transforms(rows: NDArray[Any]) -> Columns:
    """(n, 7) places and turns; of a prop that stands upright, places alone."""
    if (rows[:, 6] == 1.0).all():
        return rr.Transform3D.columns(translation=rows[:, _PLACE])
    return rr.Transform3D.columns(translation=rows[:, _PLACE], quaternion=rows[:, _TURN])


def _sizes(rows: NDArray[Any]) -> Columns:
    return rr.InstancePoses3D.columns(scales=rows)


def _pieces(rows: NDArray[Any]) -> Columns:
    """(n, 2, 3) ends of a piece of line."""
    return rr.LineStrips3D.columns(strips=rows)


def _mesh(prop: Prop, theme: Theme) -> rr.Mesh3D:
    """A unit shape with a normal for every face, or for every vertex of a sphere."""
    mesh = meshes.SHAPES[prop.shape]()
    if prop.shape == "sphere":
        return rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.faces,
            vertex_normals=2 * mesh.vertices,
            albedo_factor=color_of(prop, theme),
        )
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        triangle_indices=np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3),
        albedo_factor=color_of(prop, theme),
    )
