"""The task's world in 3D: its props where its pose puts them, and the paths they took."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from hebbviz.server.scene import meshes
from hebbviz.server.scene.appearance import color_of
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Theme
from hebbviz.task.base import Task
from hebbviz.task.scene import Pose, Prop

Array = NDArray[np.float64]

TRAIL = 90
"""Pictures that a trail goes back."""
LEAP = 0.4
"""A prop that moves further than this between two pictures was put there: its trail ends."""


class WorldScene:
    """Draws the props of a task, those of one shape in one batch."""

    def __init__(self, scene: viser.SceneApi, task: Task, theme: Theme, *, root: str) -> None:
        self._scene, self._props = scene, tuple(task.props)
        self._root = root
        self._frame = scene.add_frame(root, show_axes=False)
        self._of_shape: dict[str, list[int]] = {}
        for k, prop in enumerate(self._props):
            self._of_shape.setdefault(prop.shape, []).append(k)
        self._batches = {
            shape: self._batch(shape, [self._props[k] for k in members], theme)
            for shape, members in self._of_shape.items()
        }
        self._trails = {
            k: _Trail(scene, root, prop, theme) for k, prop in enumerate(self._props) if prop.trail
        }

    def move(self, offset: tuple[float, float, float]) -> None:
        self._frame.position = offset

    def draw(self, pose: Pose) -> None:
        for shape, members in self._of_shape.items():
            batch = self._batches[shape]
            batch.batched_positions = pose.position[members].astype(np.float32)
            batch.batched_wxyzs = pose.rotation[members].astype(np.float32)
            batch.batched_scales = np.maximum(pose.scale[members], 1e-4).astype(np.float32)
        for k, trail in self._trails.items():
            trail.draw(pose.position[k])

    def _batch(self, shape: str, props: list[Prop], theme: Theme) -> Any:
        mesh, n = meshes.SHAPES[shape](), len(props)
        return self._scene.add_batched_meshes_simple(
            f"{self._root}/{shape}",
            mesh.vertices,
            mesh.faces,
            np.tile(np.array([1, 0, 0, 0], dtype=np.float32), (n, 1)),
            np.zeros((n, 3), dtype=np.float32),
            batched_scales=np.full((n, 3), 1e-4, dtype=np.float32),
            batched_colors=palette.linear(np.array([color_of(p, theme) for p in props])),
            lod="off",
            flat_shading=shape == "box",
        )


class _Trail:
    """The latest positions of a prop, as a line that fades."""

    def __init__(self, scene: viser.SceneApi, root: str, prop: Prop, theme: Theme) -> None:
        self._places: deque[Array] = deque(maxlen=TRAIL + 1)
        fade = np.linspace(0.0, 1.0, TRAIL)
        colors = palette.blend(fade, theme.world, color_of(prop, theme))
        self._line = scene.add_line_segments(
            f"{root}/trail {prop.name}",
            np.zeros((TRAIL, 2, 3), dtype=np.float32),
            np.repeat(colors[:, None], 2, axis=1),
            thickness=0.03,
        )

    def draw(self, place: Array) -> None:
        if self._places and np.linalg.norm(place - self._places[-1]) > LEAP:
            self._places.clear()
        self._places.append(place.copy())
        path = np.array(self._places)
        path = np.concatenate([np.repeat(path[:1], TRAIL + 1 - len(path), axis=0), path])
        self._line.points = np.stack([path[:-1], path[1:]], axis=1).astype(np.float32)
