"""A run's blocks, frames, keyframes and changes as rows of a rerun stream.

Step n holds the state after the n-th step since the start. Entities under `hebbviz/` are for
programs, which recompute a run from them to the bit. All others are for viewing.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hebbviz.learner.frames import Block, Frame
from hebbviz.rules.base import make_rule
from hebbviz.server.recording import rows
from hebbviz.server.recording.blueprint import LOG_GAMMA, blueprint, curves_of, log_curve
from hebbviz.server.recording.header import Header, change_to_json, entity
from hebbviz.server.recording.rows import SEEN, Rows
from hebbviz.server.recording.scene import Scene
from hebbviz.server.recording.streams import Stream
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.keyframes import Moment
from hebbviz.sims.figures.palette import SERIES
from hebbviz.task.base import Tally, Task

Array = NDArray[np.float64]


class Writer:
    """Writes one run into a stream; `flush` sends what was gathered."""

    def __init__(
        self, stream: Stream, header: Header, task: Task, weight: Array, *, live: bool
    ) -> None:
        """`weight` (synapses,) selects the drawn synapses of a large network; `live` follows the
        end.
        """
        self._stream, self._header = stream, header
        self._task, self._topology = task, header.topology
        self._curves = curves_of(header.topology)
        self._rows = Rows(stream, header.dt)
        self._recorded: Counter[str] = Counter()
        self._ended_at = header.step
        self._last_readings: Array | None = None
        self._totals = header.edges[-1]
        stream.send_page(blueprint(task, header.topology, live=live))
        self._say_header()
        self._name_series()
        self._scene = Scene(stream, task, header.topology, self._rows, weight=weight)

    # Events of the run

    def block(self, block: Block, readings: Array) -> None:
        """Every step of a stretch, and the world's (n, readings)."""
        steps = np.arange(block.start + 1, block.end + 1)
        for group in self._topology.neuron_groups:
            where, name = self._topology.neurons_of(group.name), entity(group.name)
            row, neuron = np.nonzero(block.fired[:, where])
            self._add(f"spikes/{name}", steps[row], where.start + neuron.astype(np.float64))
            if len(block.potential):
                potential = block.potential[:, where].astype(np.float32).astype(np.float64)
                self._add(f"potentials/{name}", steps, potential)
        self._add("reward/raw", steps, block.reward)
        self._add("reward/broadcast", steps, block.broadcast)
        self._say_ends(steps[block.ended])
        self._read(steps, readings)
        self._scene.spikes(steps, block.fired)
        if len(block.world):
            self._scene.poses(steps, block.world)

    def thinning(self, step: int, every: int) -> None:
        """From this step on, one window in `every` is kept."""
        self._record("thinning", step, every=every)
        kept = "every step" if every == 1 else f"1 window in {every:,}"
        self.say(step, f"kept from here on: {kept}", "DEBUG")

    def frame(self, frame: Frame, *, world: bool) -> None:
        """The sums over all steps since the previous frame; and, if requested, the world now."""
        since, step = frame.since, frame.step
        low, high = since.potential_range.astype(np.float32)
        self._record(
            "aggregate",
            step,
            steps=since.steps,
            spikes=since.spikes,
            least_potential=low,
            greatest_potential=high,
            reward=since.tally.reward,
            broadcast=since.tally.broadcast,
            ended=since.tally.ended,
        )
        for reading, kept in zip(frame.rule.memory, frame.memory, strict=True):
            self._add(f"reward/kept/{entity(reading.name)}", _at(step), np.array([kept]))
        rates = since.spikes / since.steps
        for group in self._topology.neuron_groups:
            where = self._topology.neurons_of(group.name)
            self._add(f"rates/{entity(group.name)}", _at(step), rates[None, where].mean(axis=1))
        if world:
            self.world(step, frame.world)

    def world(self, step: int, state: Array) -> None:
        """The world in a state, (numbers,)."""
        self._read(_at(step), self._task.read(state[None]))
        self._scene.poses(_at(step), state[None])

    def look(self, frame: Frame) -> None:
        """The network as it is now: in 3D, weights, traces, inputs."""
        self._scene.look(frame)
        seen = frame.before[: self._topology.inputs]
        self.weights(frame.step, frame.weight, frame.trace, seen)

    def weights(self, step: int, weight: Array, trace: Array, seen: Array) -> None:
        """Weights and traces, (synapses,), and what was seen in this step, (inputs,)."""
        t = self._topology
        if t.inputs:
            self._add(SEEN, _at(step), seen[None])
        for k, p in enumerate(t.projections):
            where, shape, name = t.synapses_of(k), t.shape(p), entity(p.name)
            for kind, values in (("weights", weight), ("traces", trace)):
                matrix = values[where].reshape(1, *shape).astype(np.float32)
                self._rows.add(f"{kind}/{name}", _at(step), matrix, rows.tensors)
                if p in self._curves:
                    self._add(f"curves/{kind}/{name}", _at(step), values[None, where])

    def edge(self, total: Tally) -> None:
        """The totals at the edge of a window of the learning curve."""
        since, step = total - self._totals, _at(total.steps)
        self._totals = total
        self._record(
            "edge", total.steps, reward=total.reward, broadcast=total.broadcast, ended=total.ended
        )
        if since.steps > 0:
            self._add("reward/average", step, np.array([since.average_reward]))
            measure, score = self._task.measure, self._task.score(since).value
            self._add(f"learning/{measure.key}", step, np.array([score]))
            if measure.logarithmic and score > 0:
                self._add(log_curve(measure), step, np.array([math.log10(score)]))

    def change(self, logged: Logged) -> None:
        """A change, as it was made."""
        self._record("change", logged.step, json=json.dumps(change_to_json(logged)))
        self.say(logged.step, str(logged.change))

    def parameters(self, step: int, beta: float, gamma: float) -> None:
        """β, and the effective γ."""
        self._add("parameters/beta", _at(step), np.array([beta]))
        self._add("parameters/gamma", _at(step), np.array([gamma]))
        if gamma > 0.0:
            self._add(LOG_GAMMA, _at(step), np.array([math.log10(gamma)]))

    def phase(self, step: int, *, frozen: bool) -> None:
        """Whether the weights are learning."""
        phase = rows.objects(["weights frozen" if frozen else "learning"])
        self._rows.add("phase", _at(step), phase, rows.states)

    def keyframe(self, moment: Moment) -> None:
        """A keyframe, with its checksum."""
        k = moment.keyframe
        self._record(
            "keyframe",
            k.step,
            network=k.network,
            world=k.world,
            gamma=k.gamma,
            frozen=k.frozen,
            rule=str(k.rule),
            memory=k.memory,
            fall=k.fall,
            logged=moment.logged,
            digest=k.digest(),
        )

    def say(self, step: int, words: str, level: str = "INFO") -> None:
        """A line among the events."""
        line = np.array([[words, level]], dtype=object)
        self._rows.add("events", _at(step), line, rows.texts)

    def end(self, step: int, words: str) -> None:
        """The end of the recording; `words` is the reason."""
        self._record("end", step, reason=words)
        self.say(step, f"the recording ends: {words}")

    def flush(self) -> None:
        """Send all gathered rows; the stream may still keep some of them for a moment."""
        self._rows.flush()

    # Inside

    def _add(self, path: str, steps: rows.Steps, values: Array) -> None:
        self._rows.add(path, steps, values, rows.scalars)

    def _record(self, name: str, step: int, **values: Any) -> None:
        """A row for programs, with its number and checksum."""
        values[rows.NUMBER] = self._recorded[name]
        self._recorded[name] += 1
        values[rows.CHECKSUM] = rows.checksum(step, values)
        self._rows.add(f"hebbviz/{name}", _at(step), rows.objects([values]), rows.records)

    def _say_ends(self, steps: rows.Steps) -> None:
        """Episodes that ended, and how long they were."""
        if not len(steps):
            return
        lengths = np.diff(steps, prepend=self._ended_at)
        self._ended_at = int(steps[-1])
        dt = self._header.dt
        said = [
            f"an episode ended after {n * dt:.2f} s" if dt else f"an episode ended after {n} steps"
            for n in lengths
        ]
        self._add("episodes/length", steps, lengths * (dt or 1.0))
        lines = np.array([[words, "WARN"] for words in said], dtype=object)
        self._rows.add("events", steps, lines, rows.texts)

    def _read(self, steps: rows.Steps, readings: Array) -> None:
        """The world's readings; of those that jump, only the jumps."""
        if not len(readings):
            return
        values = readings.astype(np.float32).astype(np.float64)
        before = values[:1] + np.nan if self._last_readings is None else self._last_readings
        moved = np.vstack((before, values[:-1])) != values
        for k, reading in enumerate(self._task.readings):
            kept = moved[:, k] if reading.steps else slice(None)
            self._add(f"world/{entity(reading.name)}", steps[kept], values[kept, k])
        self._last_readings = values[-1:]

    def _say_header(self) -> None:
        header = self._header
        plain = ("task", "preset", "seed", "rule", "beta", "gamma", "detail", "thinning")
        self._stream.send_recording_name(f"{header.task} {header.preset}, seed {header.seed}")
        said = {name: getattr(header, name) for name in plain} | {
            "header": header.to_json(),
            "network": header.topology.describe(),
            "hebbviz": header.versions["hebbviz"],
        }
        said[rows.CHECKSUM] = rows.checksum(0, said)
        self._stream.send_property("run", rr.AnyValues(**said))

    def _name_series(self) -> None:
        """Colours and names of the curves, and steps where a value holds until it changes."""
        t = self._topology
        for k, group in enumerate(t.neuron_groups):
            color, name = SERIES[k % len(SERIES)], entity(group.name)
            dots = rr.SeriesPoints(colors=color, names=group.name, marker_sizes=1.5)
            self._static(f"spikes/{name}", dots)
            names = [f"{group.name} {n + 1}" for n in range(group.size)]
            self._static(f"potentials/{name}", rr.SeriesLines(names=names))
            self._static(f"rates/{name}", rr.SeriesLines(colors=color, names=group.name))
        for path, color, name in (
            ("parameters/beta", SERIES[3], "β"),
            ("parameters/gamma", SERIES[2], "γ"),
            (LOG_GAMMA, SERIES[2], "log₁₀ γ"),
        ):
            self._jumps(path, color, name)
        self._static("reward/raw", rr.SeriesLines(colors=SERIES[0], names="r of the task"))
        self._static("reward/broadcast", rr.SeriesLines(colors=SERIES[1], names="r as broadcast"))
        self._static("reward/average", rr.SeriesLines(colors=SERIES[4], names="average"))
        for reading in make_rule(self._header.rule).memory:
            kept = rr.SeriesLines(colors=SERIES[3], names=reading.name)
            self._static(f"reward/kept/{entity(reading.name)}", kept)
        measure = self._task.measure
        curve = rr.SeriesLines(colors=SERIES[2], names=measure.name)
        self._static(f"learning/{measure.key}", curve)
        for k, reading in enumerate(self._task.readings):
            unit = f" [{reading.unit}]" if reading.unit else ""
            path, color = f"world/{entity(reading.name)}", SERIES[k % len(SERIES)]
            if reading.steps:
                self._jumps(path, color, reading.name + unit)
            else:
                self._static(path, rr.SeriesLines(colors=color, names=reading.name + unit))

    def _jumps(self, path: str, color: Any, name: str) -> None:
        self._static(path, rr.SeriesLines(colors=color, names=name, interpolation_mode="StepAfter"))

    def _static(self, path: str, what: Any) -> None:
        self._stream.log(path, what, static=True)


def _at(step: int) -> rows.Steps:
    return np.array([step])
