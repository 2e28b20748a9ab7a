"""The last steps of a world as rows of things: one column a step, the newest at the right.

In each column of a row a thing of one of several colors is seen. Its props are one of each color
in every column, and none of them moves: those that are not meant have no extent. So a recording,
which writes what changed, writes little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hebbviz.task.scene import Prop

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
Poses = tuple[Array, Array, Array]
"""Positions, rotations and scales of many states, as `Task.poses` gives them."""

Color = str | tuple[float, float, float]

WIDTH = 4.2
"""Of all rows, in scene units."""


@dataclass(frozen=True)
class Row:
    """One row: its name, the shape and the colors of its things, how many columns, and where.

    `z` is the height of the middle of a thing of each color.
    """

    name: str
    shape: str
    colors: tuple[Color, ...]
    columns: int
    y: float
    z: tuple[float, ...]

    @property
    def props(self) -> tuple[Prop, ...]:
        return tuple(
            Prop(f"{self.name} {column + 1}.{kind + 1}", self.shape, color)
            for column in range(self.columns)
            for kind, color in enumerate(self.colors)
        )

    def poses(self, kind: Whole, size: Array) -> Poses:
        """Things of the colors `kind` (n, columns), nothing where it is negative.

        `size` (n, columns, 3) is their extent.
        """
        n, kinds = len(kind), len(self.colors)
        meant = kind[..., None] == np.arange(kinds)
        scale = np.where(meant[..., None], size[:, :, None], 0.0)
        position = np.empty_like(scale)
        x = WIDTH * ((np.arange(self.columns) + 0.5) / self.columns - 0.5)
        position[..., 0] = x[:, None]
        position[..., 1] = self.y
        position[..., 2] = self.z
        return upright(position.reshape(n, -1, 3), scale.reshape(n, -1, 3))


def upright(position: Array, scale: Array) -> Poses:
    """Props that are not turned, (n, props, 3) each."""
    return position, np.tile([1.0, 0.0, 0.0, 0.0], (*position.shape[:2], 1)), scale


def together(*parts: Poses) -> Poses:
    """The props of all parts, one after the other."""
    position, rotation, scale = (np.concatenate([p[k] for p in parts], axis=1) for k in range(3))
    return position, rotation, scale
