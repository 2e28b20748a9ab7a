"""The page's view of a task: objects of its scene, where they are, and buttons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prop:
    """A scene object of unit size: a 'box', 'sphere' or 'cylinder', which a `Pose` scales.

    `color` is red, green, blue in 0..1, or the name of a role in the page's palette: 'world',
    'world strong', 'accent', 'positive', 'negative'. `trail` draws the object's recent path.
    """

    name: str
    shape: str
    color: str | tuple[float, float, float] = "world"
    trail: bool = False


@dataclass(frozen=True)
class Pose:
    """Where the scene objects are: arrays in the order of `Task.props`, and a line of text.

    `position` (props, 3) in scene units, z up; `rotation` (props, 4) quaternions, w first;
    `scale` (props, 3) full extent along each axis.
    """

    position: Array
    rotation: Array
    scale: Array
    words: str = ""


@dataclass(frozen=True)
class Control:
    """A button that the page shows for the task; pressing it calls `Task.press` with its name."""

    name: str
    hint: str
    key: str | None = None
