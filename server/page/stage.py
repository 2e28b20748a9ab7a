"""The scene: a run, or the two copies of a fork side by side; each a network over its world."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from hebbviz.learner.frames import Frame
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.scene.appearance import (
    MOST_SYNAPSES_DRAWN,
    Looks,
    largest_synapses,
    network_at,
    place,
    unit_names,
)
from hebbviz.server.scene.network import NetworkScene
from hebbviz.server.scene.reward_pulse import Pulse
from hebbviz.server.scene.world import WorldScene

RESELECT_SECONDS = 3.0
"""How often the largest synapses of a large network are selected again."""
BETWEEN_WORLDS, BETWEEN_NETWORKS = 2.75, 1.3
"""Half of the distance between two copies; without a world, half of their width is added."""

Spot = tuple[float, float, float]
Pick = Callable[[viser.ClientHandle, int], None]


@dataclass(frozen=True)
class Picks:
    """Callbacks for clicks on a unit and on a synapse."""

    unit: Pick
    synapse: Pick


class Stage:
    """Draws one copy's frames under the scene's `root`, centred until it is moved."""

    def __init__(
        self, scene: viser.SceneApi, root: str, snapshot: Snapshot, looks: Looks, picks: Picks
    ) -> None:
        self._scene, self._root, self.looks, self._picks = scene, root, looks, picks
        self._task, self._aside, self._title = snapshot.run.task, 0.0, ""
        self._names = unit_names(looks.topology, tuple(i.name for i in snapshot.run.task.inputs))
        self._pulse = Pulse(looks.topology.synapses)
        self._build_network(largest_synapses(snapshot.run.live.weight))
        self._world = WorldScene(scene, snapshot.run.task, looks.theme, root=f"{root}/world")

    def remove(self) -> None:
        self._scene.remove_by_name(self._root)

    def move(self, aside: float) -> None:
        """Move this far to the right of the centre."""
        self._aside = aside
        self._network.move(self._network_at())
        self._world.move((aside, 0.0, 0.0))

    def name(self, title: str) -> None:
        """The title over the network, which identifies this copy."""
        self._title = title
        self._network.name(title)

    @property
    def drawn(self) -> int:
        """How many synapses are drawn."""
        return len(self._network.drawn)

    def draw(self, frame: Frame, *, beside: Frame | None, leaps: int, still: bool) -> None:
        """Show a frame; `leaps` counts the discontinuities, and the scales fit the frame `beside`
        it too.
        """
        self._reselect(frame)
        self._network.draw(self.looks.look(frame, beside=beside, leaps=leaps))
        pose = self._task.pose(frame.world)
        alone = not self._task.props
        said = pose.words if alone else ""
        self._pulse.follow(frame, self._network, said, leaps=leaps, still=still)
        if not alone:
            self._world.draw(pose)

    def _build_network(self, drawn: np.ndarray[tuple[int], np.dtype[np.intp]]) -> None:
        self._selected_at = time.monotonic()
        self._network = NetworkScene(
            self._scene,
            self.looks.topology,
            self._names,
            self.looks.theme,
            drawn,
            root=f"{self._root}/network",
            offset=self._network_at(),
            on_unit=self._picks.unit,
            on_synapse=self._picks.synapse,
        )

    def _network_at(self) -> Spot:
        x, y, z = network_at(self._task)
        return x + self._aside, y, z

    def _reselect(self, frame: Frame) -> None:
        """In a large network, draw the synapses that are the largest now."""
        too_many = self.looks.topology.synapses > MOST_SYNAPSES_DRAWN
        if not too_many or time.monotonic() - self._selected_at < RESELECT_SECONDS:
            return
        self._selected_at = time.monotonic()
        largest = largest_synapses(frame.weight)
        if not np.array_equal(largest, self._network.drawn):
            self._network.remove()
            self._build_network(largest)
            self.name(self._title)


class Scene:
    """Everything that is drawn of a run."""

    def __init__(self, scene: viser.SceneApi, picks: Picks) -> None:
        self._scene, self._picks = scene, picks
        self._numbers = itertools.count()
        self._this: Stage | None = None
        self._other: Stage | None = None

    def build(self, snapshot: Snapshot, looks: Looks) -> None:
        """Build the scene for a task, network or theme, and replace the previous one."""
        for stage in (self._this, self._other):
            if stage is not None:
                stage.remove()
        self._other = None
        self._this = self._new_stage("this", snapshot, looks)

    def forget(self) -> None:
        """Forget the scene: everything was removed from the page."""
        self._this = self._other = None

    @property
    def drawn(self) -> int:
        """How many synapses are drawn."""
        return 0 if self._this is None else self._this.drawn

    def part_copies(self, snapshot: Snapshot) -> bool:
        """Show two named copies side by side during a fork, and the run alone without one. Returns
        whether that has changed.
        """
        stage, other = self._this, snapshot.view.other
        if stage is None or (other is None) == (self._other is None):
            return False
        if other is None and self._other is not None:
            self._other.remove()
            self._other = None
        elif other is not None:
            self._other = self._new_stage("other", snapshot, stage.looks.twin())
            self._other.move(half_apart(snapshot))
            self._other.name(f"other: {other.words}")
        stage.move(-half_apart(snapshot) if other is not None else 0.0)
        stage.name("this run" if other is not None else "")
        return True

    def draw(self, snapshot: Snapshot) -> None:
        """Show the frame of each copy."""
        still = snapshot.pacing.paused and snapshot.view.excerpt is None
        shown, leaps = snapshot.view.frame, snapshot.view.leaps
        beside = None if snapshot.view.other is None else snapshot.view.other.frame
        if self._this is not None:
            self._this.draw(shown, beside=beside, leaps=leaps, still=still)
        if self._other is not None and beside is not None:
            self._other.draw(beside, beside=shown, leaps=leaps, still=still)

    def _new_stage(self, name: str, snapshot: Snapshot, looks: Looks) -> Stage:
        """A stage with a new number: a tab draws an object with a known name at the place of the
        former one.
        """
        return Stage(self._scene, f"/{name} {next(self._numbers)}", snapshot, looks, self._picks)


def half_apart(snapshot: Snapshot) -> float:
    """The distance of each of two copies from the centre."""
    if snapshot.run.task.props:
        return BETWEEN_WORLDS
    return BETWEEN_NETWORKS + float(np.ptp(place(snapshot.run.live.topology).units[:, 0])) / 2
