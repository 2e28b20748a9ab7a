"""A recording as npz and CSV: its timelines as recorded, or every step recomputed."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import join
from hebbviz.server.recording.header import BadRecording, Header, entity
from hebbviz.server.recording.in_force import in_force
from hebbviz.server.recording.kept_steps import matrices_of, steps_of
from hebbviz.server.recording.reader import Recording
from hebbviz.server.recording.rows import SEEN
from hebbviz.server.recording.tables import Table, parallel, read_rows
from hebbviz.server.run.run import Replay, Run
from hebbviz.server.scene.appearance import endpoints, neuron_names, unit_names
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.whole_folder import whole_folder
from hebbviz.task.base import Task
from hebbviz.topology import Topology

Array = NDArray[Any]
Columns = dict[str, Array]
"""By name: (n,), or (n, k) with k columns in a CSV file."""
Names = dict[str, Sequence[str]]
"""Names of the columns of (n, k); by default they are numbered from 1."""

MOST_BYTES = 2_000_000_000
MOST_CSV_COLUMNS = 2_000
_TREES = tuple(
    f"/{tree}/**"
    for tree in ("spikes", "potentials", "reward", "weights", "traces", "hebbviz", "parameters")
    + ("episodes", "world", "events", SEEN)
)
_OF_NEURONS = ("fired", "potential", "spikes", "least_potential", "greatest_potential")
"""Columns with an entry for each neuron."""


def export_timelines(recording: Recording, folder: Path) -> list[Path]:
    """Write `timelines.npz`, and a CSV file for each group of columns; returns their paths.

    Spikes and rewards are exact, all else to float32 at least. Raises OSError and BadRecording.
    """
    topology, dt = recording.header.topology, recording.header.dt
    rows = read_rows(recording.path, _TREES)
    groups = {
        "steps": _with_in_force(recording, _steps(rows, topology)),
        "weights": _with_in_force(recording, _weights(rows, topology)),
        "sums": _records(rows.get("/hebbviz/aggregate")),
        "curve": _records(rows.get("/hebbviz/edge")),
        "parameters": _together(rows, {"beta": "/parameters/beta", "gamma": "/parameters/gamma"}),
        "episodes": _together(rows, {"length": "/episodes/length"}),
    }
    for path in (p for p in rows if p.startswith("/world/")):
        groups[path.strip("/").replace("/", "_")] = _together(rows, {"value": path})
    arrays = {f"{group}_{name}": a for group, c in groups.items() for name, a in c.items()}
    arrays |= {f"synapses_{name}": a for name, a in _synapses(topology).items()}
    with whole_folder(folder) as part:
        written = [_write_npz(part / "timelines.npz", arrays)]
        for name, columns in groups.items():
            if columns and len(columns["step"]):
                written.append(_write_csv(part / f"{name}.csv", columns, _names(topology), dt))
        written.append(_write_events(part / "events.csv", rows.get("/events"), dt))
    return [folder / path.name for path in written]


def export_steps(
    recording: Recording, folder: Path, first: int, end: int, task: Task
) -> list[Path]:
    """Recompute the steps from `first` up to, not including, `end`, and write everything of each,
    as npz and CSV, with a description of each column.

    Row n is the state after the n-th step. Raises ValueError if the recording does not hold these
    steps or they are too many, BadRecording if recomputing gives a different result.
    """
    header = recording.header
    low = header.step + 1
    if not low <= first < end <= recording.last_step + 1:
        raise ValueError(
            f"the recording holds steps {low}:{recording.last_step + 1}, got {first}:{end}"
        )
    run = recording.run(make_task, task)
    moment = run.tape.before(first - 1)
    assert moment is not None, "the first keyframe stands at the first step"
    t, numbers = header.topology, len(moment.keyframe.world)
    size = 2 * t.synapses + 2 * t.neurons + t.inputs + 2 * len(t.projections) + numbers + 4
    if 8 * size * (end - first) > MOST_BYTES:
        gigabytes = 8e-9 * size * (end - first)
        raise ValueError(f"that takes {gigabytes:.1f} GB: request fewer steps at a time")
    replay = run.replay(moment)
    replay.go_to(first - 1)
    columns = _each_step(replay, end - 1)
    _check_same_again(run, replay, header)
    units = unit_names(t, tuple(one.name for one in task.inputs))
    ends = [f"{units[pre]} → {units[post]}" for pre, post in zip(*endpoints(t), strict=True)]
    names = _names(t) | {"input": units[: t.inputs], "weight": ends, "trace": ends}
    with whole_folder(folder) as part:
        written = [
            _write_npz(part / "every-step.npz", columns | _synapses(t)),
            _write_csv(part / "every-step.csv", columns, names, header.dt),
            part / "every-step.txt",
        ]
        written[-1].write_text(_EVERY_STEP, encoding="utf-8")
    return [folder / path.name for path in written]


_EVERY_STEP = """\
Each row is one step. Row n is the state after the n-th step since the run began.

reward       r of the task
broadcast    the signal that every synapse received: after the rule, with manual rewards
ended        1 where an episode ended with this step
fired        1 where the neuron fired in this step
potential    v of each neuron
world        the task's state that the reward was given for. Where `ended` is 1, the state that
             ended the episode; the next row's step began from a new one, which is not shown
input        what the network saw in this step; v and z of this row depend on it
beta, gamma  of each projection, as they were in force in this step: gamma as it falls, 0 while
             learning is frozen
weight       w of each synapse after this step
trace        z of each synapse after this step

In the npz, `pre`, `post` and `projection` are each synapse's units and projection,
numbered from 0, inputs before neurons; `activity` is u of a silent neuron and of one
that fires. u of an input is its value. So, with u of the step before,

    z[n] = beta[n] z[n-1] + (fired[n] - 1 / (1 + exp(-potential[n]))) u
    w[n] = w[n-1] + gamma[n] broadcast[n] z[n]
"""


def _each_step(replay: Replay, end: int) -> Columns:
    """All data of the steps up to `end`, where the replay is afterwards."""
    blocks, frames = [], []
    while replay.learner.step < end:
        blocks.append(replay.advance(1, closely=True))
        frames.append(replay.learner.frame())
    whole, inputs = join(blocks), replay.learner.topology.inputs
    names = ("reward", "broadcast", "ended", "fired", "potential", "world")
    return {
        "step": np.arange(whole.start + 1, whole.end + 1),
        **{name: getattr(whole, name) for name in names},
        "input": np.array([f.before[:inputs] for f in frames]),
        **{
            name: np.array([getattr(f, name) for f in frames])
            for name in ("beta", "gamma", "weight", "trace")
        },
    }


def _check_same_again(run: Run, replay: Replay, header: Header) -> None:
    """Raise BadRecording unless the replay leads to the run's next keyframe."""
    following = run.tape.after(replay.learner.step)
    if following is None:
        return
    check = run.replay(replay.moment(), following)
    check.go_to(following.step)
    if check.moment().keyframe.digest() != following.keyframe.digest():
        why = header.other_now(run.learner.task)
        raise BadRecording(
            f"recomputing the run gives a different result: {why}; leave --every-step out to "
            "export the stored steps"
        )


def _synapses(topology: Topology) -> Columns:
    """Each synapse's units and projection; the values of activities."""
    pre, post = endpoints(topology)
    sizes = [math.prod(topology.shape(p)) for p in topology.projections]
    projection = np.repeat(np.arange(len(sizes)), sizes)
    activity = np.array(topology.activity)
    return {"pre": pre, "post": post, "projection": projection, "activity": activity}


# From rows to columns


def _names(topology: Topology) -> Names:
    """Names of the columns of neurons and projections."""
    projections = [p.name for p in topology.projections]
    neurons = dict.fromkeys(_OF_NEURONS, neuron_names(topology))
    return {**neurons, "beta": projections, "gamma": projections}


def _steps(rows: dict[str, Table], topology: Topology) -> Columns:
    """Of every step that was kept: rewards, who fired, potentials."""
    columns = steps_of(rows, topology)
    return columns if len(columns["step"]) else {}


def _weights(rows: dict[str, Table], topology: Topology) -> Columns:
    """Weights and traces, (n, synapses) in the topology's order, and inputs, where it has them."""
    step, found = matrices_of(rows, topology, ("weights", "traces"))
    if f"/{SEEN}" in rows:  # older recordings have none
        first = f"/weights/{entity(topology.projections[0].name)}"
        _, seen = parallel(rows, [first, f"/{SEEN}"])
        whole = min(len(step), len(seen))
        step, found = step[:whole], {name: x[:whole] for name, x in found.items()}
        found["input"] = seen.scalars[:whole]
    return {"step": step, **found} if len(step) else {}


def _with_in_force(recording: Recording, columns: Columns) -> Columns:
    """The columns, and β and γ with which their steps were made."""
    if not columns:
        return {}
    return columns | dict(zip(("beta", "gamma"), in_force(recording, columns["step"]), strict=True))


def _records(table: Table | None) -> Columns:
    if table is None:
        return {}
    columns = table.columns.items()
    return {"step": table.step, **{n: c if n in _OF_NEURONS else c[:, 0] for n, c in columns}}


def _together(rows: dict[str, Table], names: dict[str, str]) -> Columns:
    """Scalars that were written at the same steps."""
    first, *others = parallel(rows, list(names.values()))
    values = zip(names, (first, *others), strict=True)
    return (
        {"step": first.step, **{name: t.scalars[:, 0] for name, t in values}} if len(first) else {}
    )


# Files


def _write_npz(path: Path, arrays: Columns) -> Path:
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]  # its allow_pickle is none
    return path


def _write_csv(path: Path, columns: Columns, called: Names, dt: float | None) -> Path:
    """One line per step; wide columns that no table can hold are left to the npz."""
    names, parts = [], []
    for name, values in columns.items():
        if values.ndim == 1:
            names.append(name)
            parts.append(values.astype(np.int64) if values.dtype == bool else values)
            if name == "step" and dt is not None:
                names.append("sim_time")
                parts.append(values * dt)
        elif values.shape[1] <= MOST_CSV_COLUMNS:
            numbers = map(str, range(1, values.shape[1] + 1))
            names += [f"{name} {one}" for one in called.get(name, numbers)]
            parts += list(values.T)
    return _write_lines(path, names, zip(*(p.tolist() for p in parts), strict=True))


def _write_events(path: Path, table: Table | None, dt: float | None) -> Path:
    lines: list[tuple[Any, ...]] = []
    if table is not None:
        times = [step * dt if dt is not None else "" for step in table.step.tolist()]
        lines = list(
            zip(table.step.tolist(), times, table.columns["TextLog:text"].tolist(), strict=True)
        )
    return _write_lines(path, ["step", "sim_time", "event"], lines)


def _write_lines(path: Path, names: Sequence[str], lines: Iterable[Sequence[Any]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(lines)
    return path
