"""Saved work of plans: one folder per plan, one file per tile, each always complete."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Keyframe
from hebbviz.learner.saves import BadFile, read_arrays, write_arrays
from hebbviz.rules.paper import PAPER
from hebbviz.sims.experiments.plan import Plan
from hebbviz.sims.experiments.work_unit import Tile
from hebbviz.sims.program.terminal import tell, writing

FORMAT = 2
PROGRAM = "hebbviz lanes"
_KEYFRAME = "keyframe "


class Store:
    """The saved tiles of a plan. Each plan and each version of the program has its own folder."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._plan, self._digest = plan, plan.digest()
        self.folder = folder / f"{_class_name(plan.task)}-{self._digest}"

    def read(self) -> list[Tile]:
        """Return the saved tiles in the order of their lanes. Raises OSError.

        A damaged file is renamed and reported, and its tile is left out.
        """
        tiles = []
        for path in sorted(self.folder.glob("lanes-*.npz")):
            try:
                tiles.append(self._read(path))
            except BadFile as error:
                path.replace(path.with_name(f"damaged-{path.name}"))
                tell(f"{error}: it is put aside, and its lanes are run again")
        return sorted(tiles, key=lambda tile: tile.first_lane)

    def write(self, tile: Tile) -> None:
        """Save a tile in place of its older version. Raises InputError if that fails."""
        assert tile.keyframe is not None
        header = {
            "program": PROGRAM,
            "format": FORMAT,
            "plan": self._digest,
            "first_lane": tile.first_lane,
            "lanes": tile.lanes,
            "figures": list(tile.figures),
            "pending": tile.pending,
        }
        arrays = {_KEYFRAME + name: getattr(tile.keyframe, name) for name in _NUMBERS}
        arrays |= {f"figure {k}": values for k, values in enumerate(tile.figures.values())}
        arrays |= {"totals": tile.totals}
        path = self.folder / f"lanes-{tile.first_lane}-{tile.end - 1}.npz"
        with writing(path):
            self.folder.mkdir(parents=True, exist_ok=True)
            write_arrays(path, header | {"sum": _checksum(header, arrays)}, arrays)

    def _read(self, path: Path) -> Tile:
        what = "part of an experiment"
        header, arrays = read_arrays(path, PROGRAM, FORMAT, what=what, names=_names)
        if header.get("plan") != self._digest:
            raise BadFile(f"{path} belongs to another experiment")
        try:
            if header.pop("sum") != _checksum(header, arrays):
                raise ValueError("its checksum is wrong")
            return self._tile(header, arrays)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise BadFile(f"{path} is damaged ({error})") from error

    def _tile(self, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Tile:
        """Make the tile; raise ValueError and other exceptions if it does not fit the plan."""
        if any(a.dtype != _KINDS.get(name, np.float64) for name, a in arrays.items()):
            raise ValueError("numbers of another kind")
        kept: dict[str, Any] = {name: arrays[_KEYFRAME + name] for name in _NUMBERS}
        kept |= {name: kept[name].item() for name in ("step", "frozen", "fall")}
        keyframe = Keyframe(rule=PAPER, **kept)
        figures = {name: arrays[f"figure {k}"] for k, name in enumerate(header["figures"])}
        tile = Tile(
            header["first_lane"],
            header["lanes"],
            keyframe,
            arrays["totals"],
            figures,
            header["pending"],
        )
        tile.check_fit(self._plan)
        return tile


_NUMBERS = ("network", "world", "gamma", "memory", "step", "frozen", "fall")
"""All of a keyframe except the rule, which the plan gives."""
_KINDS: dict[str, type] = {_KEYFRAME + "step": np.int64, _KEYFRAME + "frozen": np.bool_}
"""Types of arrays that are not float64."""


def _names(header: dict[str, Any]) -> list[str]:
    """Return the names of a tile's arrays."""
    figures = [f"figure {k}" for k in range(len(header["figures"]))]
    return [*(_KEYFRAME + name for name in _NUMBERS), "totals", *figures]


def _checksum(header: dict[str, Any], arrays: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a saved tile."""
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f" {name} {array.dtype.str} {array.shape} ".encode() + array.tobytes())
    return digest.hexdigest()


def _class_name(task: str) -> str:
    return task.rpartition(":")[2]
