"""A batch: all lanes of a network, stored as one or more tiles."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.buffers import NOBODY
from hebbviz.engine.layout import Layout
from hebbviz.engine.tile import Tile
from hebbviz.numerics.compile import WIDTHS

Array = NDArray[np.float64]


class Tiles:
    """Lanes `first_lane` to `first_lane + lanes - 1` of a seed, in float32 or float64.

    They are divided into as few tiles as possible, of nearly equal size. Iteration yields each
    tile with the slice of its lanes.
    """

    def __init__(
        self, layout: Layout, *, seed: int, first_lane: int, lanes: int,
        dtype: type[np.floating[Any]], written: bool = False,
    ) -> None:  # fmt: skip
        self.layout, self.seed = layout, seed
        self.first_lane, self.lanes = first_lane, lanes
        ends = np.cumsum(_cut(lanes)).tolist()
        parts = [slice(start, end) for start, end in pairwise([0, *ends])]
        self._tiles = [
            Tile(layout, seed=seed, first_lane=first_lane + part.start,
                 lanes=part.stop - part.start, dtype=dtype, written=written)
            for part in parts
        ]  # fmt: skip
        self._cut = list(zip(self._tiles, parts, strict=True))

    def __iter__(self) -> Iterator[tuple[Tile, slice]]:
        return iter(self._cut)

    def place_of(self, lane: int) -> tuple[Tile, int]:
        """Return the tile that holds a lane, and the lane's index in it."""
        for tile, part in self:
            if lane < part.stop:
                return tile, lane - part.start
        raise IndexError(f"lane must be below {self.lanes}, got {lane}")

    def watched(self, lane: int) -> list[tuple[Tile, int]]:
        """Return each tile with the index of the watched lane in it, NOBODY if it has another."""
        return [
            (tile, lane - part.start if part.start <= lane < part.stop else NOBODY)
            for tile, part in self
        ]

    def joined(self, part: Callable[[Tile], Array]) -> Array:
        """Join the results of `part` for each tile, (rows, its lanes), to (rows, lanes)."""
        return np.concatenate([part(tile) for tile in self._tiles], axis=1)

    def read(self, name: str) -> Array:
        """Return a section of the state, (rows, lanes)."""
        return self.joined(lambda tile: tile.read(name))

    def put(self, name: str, values: Array | float) -> None:
        """Set a section to a number or to an array (rows, lanes)."""
        for tile, part in self:
            tile.put(name, values if np.ndim(values) == 0 else np.asarray(values)[:, part])

    # Going back

    def keep(self) -> None:
        """Store the present state for `back`."""
        for tile in self._tiles:
            tile.keep()

    def back(self) -> None:
        """Return to the state of the last `keep`."""
        for tile in self._tiles:
            tile.back()


def _cut(lanes: int) -> list[int]:
    """The number of lanes in each tile."""
    tiles = -(-lanes // WIDTHS[-1])
    return [len(part) for part in np.array_split(np.arange(lanes), tiles)]
