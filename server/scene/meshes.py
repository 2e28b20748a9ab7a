"""Meshes of unit size, and how to lay a tube between two points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Mesh(NamedTuple):
    """Vertices (V, 3) and faces (F, 3), extent 1 along each axis, centred."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


def _mesh(made: trimesh.Trimesh) -> Mesh:
    return Mesh(made.vertices.astype(np.float32), made.faces.astype(np.uint32))


def sphere(detail: int = 2) -> Mesh:
    return _mesh(trimesh.creation.icosphere(subdivisions=detail, radius=0.5))


def box() -> Mesh:
    return _mesh(trimesh.creation.box(extents=(1.0, 1.0, 1.0)))


def cylinder(sides: int = 24) -> Mesh:
    """Along z."""
    return _mesh(trimesh.creation.cylinder(radius=0.5, height=1.0, sections=sides))


def tube() -> Mesh:
    """A cylinder of few faces, for synapses."""
    return cylinder(7)


SHAPES = {"sphere": sphere, "box": box, "cylinder": cylinder}


def turns_to(directions: Array) -> Array:
    """Quaternions (n, 4), w first, that turn the z axis to the (n, 3) directions."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    half = np.stack([1.0 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))], axis=1)
    half[unit[:, 2] < -1 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    turned: Array = half / np.linalg.norm(half, axis=1, keepdims=True)
    return turned
