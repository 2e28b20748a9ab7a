"""The contract of a panel, the tabs, and data that several panels show."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import viser

from hebbviz.learner.frames import Frame
from hebbviz.server.live.recent_frames import alike
from hebbviz.server.live.snapshot import Other, Snapshot
from hebbviz.server.page.charts import Cursor
from hebbviz.server.run.history import Curve
from hebbviz.server.scene.appearance import neuron_names
from hebbviz.sims.figures import palette
from hebbviz.sims.figures.palette import Rgb, Theme
from hebbviz.topology import Topology


class Tab(NamedTuple):
    title: str
    icon: Any
    is_below: bool
    """In the lower of the two columns of tabs."""


TABS = {
    "gradient": Tab("Gradient", viser.Icon.COMPASS, is_below=False),
    "run": Tab("Learning", viser.Icon.CHART_LINE, is_below=False),
    "reward": Tab("Reward, rates", viser.Icon.ACTIVITY, is_below=False),
    "angle": Tab("Angle", viser.Icon.ANGLE, is_below=True),
    "now": Tab("Spikes now", viser.Icon.BOLT, is_below=True),
    "synapses": Tab("Synapses", viser.Icon.GRID_DOTS, is_below=True),
}
"""In the order of display. A tab is made only if a wanted panel is in it."""


@dataclass(frozen=True)
class Place:
    """Where panels are built: the tabs by name, and the state of the run at that time."""

    gui: viser.GuiApi
    tabs: Mapping[str, Any]
    snapshot: Snapshot
    theme: Theme

    @property
    def topology(self) -> Topology:
        return self.snapshot.run.live.topology


class Panel(ABC):
    """Charts, pictures and text in one or more tabs; each panel is a class in its own file.

    It is built for one task, network, rule, theme and number of lanes, and rebuilt for others.
    A subclass builds its widgets in `__init__` and keeps each with `hold`.
    """

    tabs: ClassVar[tuple[str, ...]]
    """Names of the tabs that contain it."""
    order: ClassVar[int]
    """Panels of a tab are in ascending order."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self._handles: list[Any] = []

    @staticmethod
    def wanted(snapshot: Snapshot) -> bool:
        """Whether the panel has something to show for this task, network and rule."""
        return True

    @abstractmethod
    def draw(self, snapshot: Snapshot) -> None:
        """Show the current state; called a few times a second."""

    def remove(self) -> None:
        """Remove all held widgets."""
        for handle in self._handles:
            handle.remove()

    def hold(self, handle: Any) -> Any:
        """Keep a widget, to be removed with the panel."""
        self._handles.append(handle)
        return handle


OTHER: Rgb = palette.SERIES[3]
"""Colour of the other copy of a fork."""


def marks(snapshot: Snapshot) -> list[float]:
    """The steps at which something was changed."""
    return [float(c.step) for c in snapshot.run.changes]


def cursor(snapshot: Snapshot) -> Cursor | None:
    """The position in the run of the past step that is shown; None in the present."""
    past = snapshot.view.past
    return None if past is None else Cursor(past.cursor, snapshot.run.first, snapshot.run.live.step)


def since(other: Other) -> Curve:
    """The other copy's curve from the fork on; there was only one run before it."""
    c, late = other.curve, other.curve.end > other.start
    return Curve(
        c.window, c.end[late], c.steps[late], c.reward[late], c.broadcast[late], c.ended[late]
    )


def others(snapshot: Snapshot) -> dict[str, Rgb]:
    """Name and colour of the other copy's curve, while there is one."""
    return {} if snapshot.view.other is None else {f"other: {snapshot.view.other.words}": OTHER}


MOST_CURVES = 8
"""With more neurons than this, charts show groups."""


def neuron_curves(topology: Topology) -> dict[str, slice]:
    """Name and neurons of each curve: single neurons, or groups if there are too many."""
    if topology.neurons > MOST_CURVES:
        return {g.name: topology.neurons_of(g.name) for g in topology.neuron_groups}
    return {name: slice(k, k + 1) for k, name in enumerate(neuron_names(topology))}


def colors(names: Iterable[str]) -> dict[str, Rgb]:
    return {name: palette.SERIES[k % len(palette.SERIES)] for k, name in enumerate(names)}


def latest_frames(snapshot: Snapshot) -> list[Frame]:
    """The latest frames of the run, or of the past that is shown; all of the same network."""
    return alike(snapshot.view.live_trail if snapshot.view.past is None else snapshot.view.trail)
