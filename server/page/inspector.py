"""The inspector: a synapse or a neuron, followed live. Each tab has its own."""

from __future__ import annotations

import numpy as np
import viser

from hebbviz.learner.frames import Frame, Summary
from hebbviz.server.live.recent_frames import alike
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page.charts import Chart, ChartStyle
from hebbviz.server.page.widgets import assign
from hebbviz.server.scene.appearance import endpoints
from hebbviz.sims.figures import palette
from hebbviz.topology import Topology

NEURON = "a neuron"


class Inspector:
    """A folder in one tab's panel that follows a unit or synapse chosen by click or from lists."""

    def __init__(
        self, client: viser.ClientHandle, topology: Topology, names: tuple[str, ...]
    ) -> None:
        self._topology, self._names = topology, names
        self._pre, self._post = endpoints(topology)
        self.synapse: int | None = 0 if topology.synapses else None
        self.neuron: int = topology.inputs
        gui = client.gui
        self._folder = gui.add_folder("Inspect (this tab)")
        with self._folder:
            kinds = (NEURON, *(p.name for p in topology.projections))
            self._kind = gui.add_dropdown("pick", kinds, initial_value=kinds[1 % len(kinds)])
            self._from = gui.add_dropdown("from", ("-",))
            self._to = gui.add_dropdown("to", ("-",))
            self._text = gui.add_markdown("*Click a neuron or a synapse, or choose one above.*")
        colors = {"z": palette.TRACE_POSITIVE, "w": palette.WEIGHT_POSITIVE}
        title = "z, its range, and w of the synapse"
        self._chart = Chart(gui, self._folder, title, colors, ChartStyle(banded=("z",)))
        self._offer()
        for handle in (self._kind, self._from, self._to):
            handle.on_update(lambda event: self._chosen() if event.client is not None else None)

    def remove(self) -> None:
        self._folder.remove()

    def pick_unit(self, unit: int) -> None:
        """Follow a neuron, or an input and its level."""
        if 0 <= unit < self._topology.units:
            self.synapse, self.neuron = None, unit
            assign(self._kind, "value", NEURON)
            self._offer()

    def pick_synapse(self, synapse: int) -> None:
        if 0 <= synapse < self._topology.synapses:
            self.synapse = synapse
            assign(self._kind, "value", self._topology.projections[self._projection()].name)
            self._offer()

    @property
    def probes(self) -> tuple[int, ...]:
        synapse = self.synapse
        return () if synapse is None else (synapse,)

    def draw(self, snapshot: Snapshot) -> None:
        """Show the numbers and the chart; a few times a second is enough."""
        frame, synapse = snapshot.view.frame, self.synapse  # the user may pick another meanwhile
        self._chart.show(synapse is not None)
        if synapse is None:
            self._text.content = self._neuron_words(frame)
            return
        frames = alike(snapshot.view.trail)
        since = frames[-1].since if frames else frame.since
        self._text.content = self._synapse_words(frame, since, synapse)
        if len(frames) > 1:
            x = np.array([f.step for f in frames], dtype=np.float64)
            z, low, high, w = np.array([_values(f, synapse) for f in frames]).T
            marks = [float(c.step) for c in snapshot.run.changes]
            bands = {"z": ((x, low), (x, high))}
            self._chart.draw({"z": (x, z), "w": (x, w)}, marks, bands=bands)

    # Choosing

    def _offer(self) -> None:
        """Fill the lists for the current pick."""
        if self._kind.value == NEURON:
            inputs, names = self._topology.inputs, self._names
            self._from.visible = False
            self._to.options = names
            assign(self._to, "value", names[self.neuron if self.neuron < len(names) else inputs])
            return
        p = self._topology.projections[self._projection_chosen()]
        self._from.visible = True
        self._from.options = self._names[self._topology.units_of(p.pre)]
        self._to.options = self._names[self._topology.units_of(p.post)]
        if self.synapse is not None and self._projection() == self._projection_chosen():
            assign(self._from, "value", self._names[self._pre[self.synapse]])
            assign(self._to, "value", self._names[self._post[self.synapse]])

    def _chosen(self) -> None:
        """The user changed a list."""
        if self._kind.value == NEURON:
            on_units = self._to.value in self._names and self._from.visible is False
            self.neuron = self._names.index(self._to.value) if on_units else self._topology.inputs
            self.synapse = None
        else:
            k = self._projection_chosen()
            p = self._topology.projections[k]
            pre = self._names[self._topology.units_of(p.pre)]
            post = self._names[self._topology.units_of(p.post)]
            i = post.index(self._to.value) if self._to.value in post else 0
            j = pre.index(self._from.value) if self._from.value in pre else 0
            self.synapse = self._topology.synapses_of(k).start + i * len(pre) + j
        self._offer()

    def _projection(self) -> int:
        """The projection that the picked synapse belongs to."""
        starts = [
            self._topology.synapses_of(k).start for k in range(len(self._topology.projections))
        ]
        return int(np.searchsorted(starts, self.synapse or 0, side="right")) - 1

    def _projection_chosen(self) -> int:
        return [p.name for p in self._topology.projections].index(self._kind.value)

    # Words

    def _synapse_words(self, frame: Frame, since: Summary, synapse: int) -> str:
        pre, post = int(self._pre[synapse]), int(self._post[synapse])
        neuron = post - self._topology.inputs
        u_pre, fired = float(frame.before[pre]), float(frame.fired[neuron])
        expected = float(frame.probability[neuron])
        change, steps = float(since.weight_change[synapse]), since.steps
        what_fired = "u·u_pre" if self._topology.activity[0] == 0 else "½(u+1)·u_pre"
        rows = (
            ("w, weight", f"{frame.weight[synapse]:+.5f}"),
            (f"Δw, last {steps} step{'s' * (steps != 1)}", f"{change:+.2e}"),
            ("z, eligibility trace", f"{frame.trace[synapse]:+.4f}"),
            (f"fired: {what_fired}", f"{fired * u_pre:+.4f}"),
            ("expected: −σ(v)·u_pre", f"{-expected * u_pre:+.4f}"),
            ("sum, added to z", f"{(fired - expected) * u_pre:+.4f}"),
            ("v, σ(v) of the neuron", f"{frame.potential[neuron]:+.3f}, {expected:.3f}"),
            ("u_pre, one step earlier", f"{u_pre:+.3f}"),
        )
        return f"**{self._names[pre]} → {self._names[post]}**\n\n" + _table(rows)

    def _neuron_words(self, frame: Frame) -> str:
        unit, name = self.neuron, self._names[self.neuron]
        k = unit - self._topology.inputs
        if k < 0:
            return f"**{name}** (an input)\n\n" + _table(
                (("value", f"{frame.activity[unit]:+.4f}"),)
            )
        steps = frame.since.steps
        rate = frame.since.spikes[k] / steps if steps else 0.0
        rows = (
            ("v, potential", f"{frame.potential[k]:+.4f}"),
            ("σ(v), probability to fire", f"{frame.probability[k]:.4f}"),
            ("drawn", f"{frame.draw[k]:.4f}"),
            (
                "u, activity",
                f"{frame.activity[unit]:+.0f}, {'fired' if frame.fired[k] else 'silent'}",
            ),
            ("fired − expected", f"{frame.fired[k] - frame.probability[k]:+.4f}"),
            (f"rate, last {steps} step{'s' * (steps != 1)}", f"{rate:.3f} per step"),
        )
        return f"**{name}**\n\n" + _table(rows)


def _values(frame: Frame, synapse: int) -> tuple[float, float, float, float]:
    """z at the end of a frame, its least and greatest value in the frame where probed, and w."""
    z = float(frame.trace[synapse])
    low = high = z
    if synapse in frame.since.probes:
        low, high = frame.since.probe_range[:, frame.since.probes.index(synapse)]
    return z, float(low), float(high), float(frame.weight[synapse])


def _table(rows: tuple[tuple[str, str], ...]) -> str:
    lines = [f"| {name} | `{value:>11}` |" for name, value in rows]
    return "\n".join(["| | |", "|:--|--:|", *lines])
