"""The charts and pictures beside the scene: each is a class in a file of this package."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from hebbviz.registry import module_names
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.panels.base import TABS, Panel, Place


@cache
def panel_kinds() -> tuple[type[Panel], ...]:
    """All panels of this package, in ascending order."""
    modules = [import_module(f"{__name__}.{name}") for name in module_names(__name__)]
    kinds = [
        kind
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Panel) and kind.__module__ == module.__name__
    ]
    return tuple(sorted((k for k in kinds if k is not Panel), key=lambda kind: kind.order))


def wanted(snapshot: Snapshot) -> tuple[type[Panel], ...]:
    """The panels that have something to show."""
    return tuple(kind for kind in panel_kinds() if kind.wanted(snapshot))


def wanted_tabs(snapshot: Snapshot) -> tuple[str, ...]:
    """Names of their tabs, in the order of the tabs."""
    names = {name for kind in wanted(snapshot) for name in kind.tabs}
    return tuple(name for name in TABS if name in names)


class Panels:
    """The wanted panels; each call of `draw` redraws one of them."""

    def __init__(self, place: Place) -> None:
        self._panels = [kind(place) for kind in wanted(place.snapshot)]
        self._turn = 0

    def draw(self, snapshot: Snapshot) -> None:
        """Redraw the next panel in turn: each is redrawn several times a second."""
        self._panels[self._turn].draw(snapshot)
        self._turn = (self._turn + 1) % len(self._panels)

    def remove(self) -> None:
        for panel in self._panels:
            panel.remove()
