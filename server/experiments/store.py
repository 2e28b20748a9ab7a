"""What was done of a plan, on disk: a folder a plan, a file a tile, each always whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hebbviz.files import BadFile, read_arrays, write_arrays
from hebbviz.moments import Keyframe
from hebbviz.rules.paper import PAPER
from server.experiments.plan import Plan
from server.experiments.share import Tile
from server.terminal import tell, writing

FORMAT = 2
PROGRAM = "hebbviz lanes"
_KEYFRAME = "keyframe "


class Store:
    """The tiles of a plan. Another plan, or another version, has another folder beside it."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._plan, self._digest = plan, plan.digest()
        self.folder = folder / f"{_class_name(plan.task)}-{self._digest}"

    def read(self) -> list[Tile]:
        """The tiles that were kept, by lane. Raises OSError.

        One that is damaged is as good as none: it is put aside, which is told.
        """
        tiles = []
        for path in sorted(self.folder.glob("lanes-*.npz")):
            try:
                tiles.append(self._read(path))
            except BadFile as error:
                path.replace(path.with_name(f"damaged-{path.name}"))
                tell(f"{error}: it is put aside, and what it held is run again")
        return sorted(tiles, key=lambda tile: tile.first_lane)

    def write(self, tile: Tile) -> None:
        """Keep a tile in place of what was kept of it. Raises InputError if it cannot be."""
        assert tile.keyframe is not None
        header = {
            "program": PROGRAM, "format": FORMAT, "plan": self._digest,
            "first_lane": tile.first_lane, "lanes": tile.lanes, "figures": list(tile.figures),
            "pending": tile.pending,
        }  # fmt: skip
        arrays = {_KEYFRAME + name: value for name, value in _numbers(tile.keyframe).items()}
        arrays |= {f"figure {k}": values for k, values in enumerate(tile.figures.values())}
        path = self.folder / f"lanes-{tile.first_lane}-{tile.end - 1}.npz"
        with writing(path):
            self.folder.mkdir(parents=True, exist_ok=True)
            write_arrays(path, header, arrays | {"totals": tile.totals})

    def _read(self, path: Path) -> Tile:
        header, arrays = read_arrays(path, PROGRAM, FORMAT, what="part of an experiment")
        if header["plan"] != self._digest:
            raise BadFile(f"{path} is of another experiment")
        first, lanes = int(header["first_lane"]), int(header["lanes"])
        kept: dict[str, Any] = {
            name.removeprefix(_KEYFRAME): array if array.ndim else array.item()
            for name, array in arrays.items()
            if name.startswith(_KEYFRAME)
        }
        keyframe = replace(self._plan.learner(first, lanes).keyframe(), rule=PAPER, **kept)
        figures = {name: arrays[f"figure {k}"] for k, name in enumerate(header["figures"])}
        return Tile(first, lanes, keyframe, arrays["totals"], figures, bool(header["pending"]))


def _numbers(keyframe: Keyframe) -> dict[str, Any]:
    """All of a keyframe but what its plan says."""
    return {
        name: value
        for name, value in vars(keyframe).items()
        if isinstance(value, (bool, int, float, np.ndarray))
    }


def _class_name(task: str) -> str:
    return task.rpartition(":")[2]
