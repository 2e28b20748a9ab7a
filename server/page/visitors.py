"""The tabs that show the page: each has its own picks, inspector and camera."""

from __future__ import annotations

import threading

import viser

from hebbviz.server.live.commands import Probe, ShowBeginning
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import camera
from hebbviz.server.page.inspector import Inspector
from hebbviz.server.page.widgets import Send
from hebbviz.server.scene.appearance import unit_names
from hebbviz.server.web.guard import GuardedServer

INSPECTORS_AT_ONCE = 8
"""With more inspectors than this, they are updated in turn."""


class Visitors:
    """The tabs that are open. `snapshot` is the latest one; `lock` is held while the page is
    drawn.
    """

    def __init__(self, server: GuardedServer, lock: threading.RLock, send: Send) -> None:
        self._server, self._lock, self._send = server, lock, send
        self.snapshot: Snapshot | None = None
        self._built: Snapshot | None = None
        self._inspectors: dict[int, Inspector] = {}
        self._inspected = 0
        self._cameras = camera.Cameras()
        self._probes: tuple[int, ...] = ()

    def begin(self) -> None:
        """Set up every tab that connects from now on."""
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._disconnected)

    def follow(self, snapshot: Snapshot, *, look_again: bool) -> None:
        """Follow a rebuilt page; the cameras return to their start if `look_again`."""
        self._built = snapshot
        position, target = camera.view_of(camera.OVERVIEW, snapshot)
        self._server.initial_camera.position = position
        self._server.initial_camera.look_at = target
        for client in self._server.get_clients().values():
            self._connected(client)
        if look_again:
            self.look_again()

    def look_again(self) -> None:
        """Return all cameras to their initial position."""
        for client in self._server.get_clients().values():
            self.look_at(client, camera.OVERVIEW)

    def look_at(self, client: viser.ClientHandle, view: str) -> None:
        """Turn a tab's camera."""
        if self.snapshot is not None:
            self._cameras.turn(client, view, self.snapshot)

    def draw(self, snapshot: Snapshot) -> None:
        """Update the inspectors, settle the cameras, and probe the inspected synapses."""
        inspectors = tuple(self._inspectors.values())
        count = min(len(inspectors), INSPECTORS_AT_ONCE)
        for k in range(count):
            inspectors[(self._inspected + k) % len(inspectors)].draw(snapshot)
        self._inspected += count
        for client in self._server.get_clients().values():
            self._cameras.settle(client, snapshot)
        self._ask_probes()

    def pick_unit(self, client: viser.ClientHandle, unit: int) -> None:
        """A tab clicked on a unit."""
        with self._lock:
            if client.client_id in self._inspectors:
                self._inspectors[client.client_id].pick_unit(unit)

    def pick_synapse(self, client: viser.ClientHandle, synapse: int) -> None:
        """A tab clicked on a synapse."""
        with self._lock:
            if client.client_id in self._inspectors:
                self._inspectors[client.client_id].pick_synapse(synapse)

    def _ask_probes(self) -> None:
        wanted = tuple(sorted({s for i in self._inspectors.values() for s in i.probes}))
        if wanted != self._probes:
            self._probes = wanted
            self._send(Probe(wanted))

    def _welcome(self, client: viser.ClientHandle) -> None:
        self._connected(client)
        if len(self._server.get_clients()) == 1 and not self._server.is_reader(client):
            self._send(ShowBeginning())
        if camera.aspect_of(client) < camera.WHOLE_ASPECT:
            client.gui.main_panel.minimize()
        self.look_at(client, camera.OVERVIEW)

    def _connected(self, client: viser.ClientHandle) -> None:
        """Give a tab an inspector, unless the page is about to be rebuilt."""
        with self._lock:
            old = self._inspectors.pop(client.client_id, None)
            if old is not None:
                old.remove()
            if client.client_id not in self._server.get_clients():
                return  # it has left already
            if self.snapshot is None or self._built is None:
                return
            built = self._built.run
            topology = built.live.topology
            if self.snapshot.run.live.topology != topology:
                return  # the page is about to be rebuilt
            names = unit_names(topology, tuple(i.name for i in built.task.inputs))
            inspector = Inspector(client, topology, names)
            self._inspectors[client.client_id] = inspector

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._inspectors.pop(client.client_id, None)
            self._cameras.forget(client)
