"""A recording as npz and CSV: its timelines as they were recorded, or every step made again."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.task import Task
from hebbviz.topology import Topology
from server.look import neuron_names
from server.recording.chunks import Table, parallel, read_rows
from server.recording.header import BadRecording
from server.recording.reader import Recording
from server.recording.stored import matrices_of, steps_of
from server.whole import whole_folder
from sims.loading import make_task

Array = NDArray[Any]
Columns = dict[str, Array]
"""By name: (n,), or (n, k) with k columns in a CSV file."""

MOST_BYTES = 2_000_000_000
MOST_CSV_COLUMNS = 2_000
_OF_NEURONS = ("fired", "potential", "spikes", "least_potential", "greatest_potential")
"""Columns with an entry for each neuron."""


def export_timelines(recording: Recording, folder: Path) -> list[Path]:
    """Write `timelines.npz`, and a CSV file for each group of columns; returns their paths.

    Spikes and rewards are exact, all else to float32 at least. Raises OSError and BadRecording.
    """
    topology, dt = recording.header.topology, recording.header.dt
    rows = read_rows(recording.path, ("/**",))
    groups = {
        "steps": _steps(rows, topology),
        "weights": _weights(rows, topology),
        "sums": _records(rows.get("/hebbviz/aggregate")),
        "curve": _records(rows.get("/hebbviz/edge")),
        "parameters": _together(rows, {"beta": "/parameters/beta", "gamma": "/parameters/gamma"}),
        "episodes": _together(rows, {"length": "/episodes/length"}),
    }
    for path in (p for p in rows if p.startswith("/world/")):
        groups[path.strip("/").replace("/", "_")] = _together(rows, {"value": path})
    arrays = {f"{group}_{name}": a for group, c in groups.items() for name, a in c.items()}
    with whole_folder(folder) as part:
        written = [_write_npz(part / "timelines.npz", arrays)]
        for name, columns in groups.items():
            if columns and len(columns["step"]):
                written.append(_write_csv(part / f"{name}.csv", columns, topology, dt))
        written.append(_write_events(part / "events.csv", rows.get("/events"), dt))
    return [folder / path.name for path in written]


def export_steps(
    recording: Recording, folder: Path, first: int, end: int, task: Task
) -> list[Path]:
    """Make the steps from `first` on and before `end` again, and write all of each.

    What stands at step n is what was so after the n-th step. Raises ValueError if the recording
    does not hold these steps or they are too many, BadRecording if the recorded run does
    not come out the same again.
    """
    header = recording.header
    low = header.step + 1
    if not low <= first < end <= recording.last_step + 1:
        raise ValueError(
            f"the recording holds steps {low}:{recording.last_step + 1}, asked for {first}:{end}"
        )
    run = recording.run(make_task, task)
    moment = run.tape.before(first - 1)
    assert moment is not None, "the first keyframe stands at the first step"
    t, numbers = header.topology, len(moment.keyframe.world)
    size = 8 * (end - first) * (2 * t.synapses + 2 * t.neurons + numbers + 3)
    if size > MOST_BYTES:
        raise ValueError(f"that takes {size / 1e9:.1f} GB: ask for fewer steps at a time")
    replay = run.replay(moment)
    replay.go_to(first - 1)
    blocks, weights, traces = [], [], []
    while replay.learner.step < end - 1:
        blocks.append(replay.advance(1, closely=True))
        weights.append(replay.learner.weights[:, 0])
        traces.append(replay.learner.traces[:, 0])
    following = run.tape.after(replay.learner.step)
    if following is not None:
        check = run.replay(replay.moment(), following)
        check.go_to(following.step)
        if check.moment().keyframe.digest() != following.keyframe.digest():
            raise BadRecording(
                f"the run does not come out the same again: {header.other_now}; leave "
                "--every-step out, for what was stored"
            )
    columns: Columns = {
        "step": np.arange(first, end),
        **{
            name: np.concatenate([getattr(b, name) for b in blocks])
            for name in ("reward", "broadcast", "ended", "fired", "potential", "world")
        },
        "weight": np.array(weights),
        "trace": np.array(traces),
    }
    with whole_folder(folder) as part:
        written = [
            _write_npz(part / "every-step.npz", columns),
            _write_csv(part / "every-step.csv", columns, t, header.dt),
        ]
    return [folder / path.name for path in written]


# From rows to columns


def _steps(rows: dict[str, Table], topology: Topology) -> Columns:
    """Of every step that was kept: rewards, who fired, potentials."""
    columns = steps_of(rows, topology)
    return columns if len(columns["step"]) else {}


def _weights(rows: dict[str, Table], topology: Topology) -> Columns:
    """Weights and traces, (n, synapses) in the topology's order."""
    step, found = matrices_of(rows, topology, ("weights", "traces"))
    return {"step": step, **found} if len(step) else {}


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


def _write_csv(path: Path, columns: Columns, topology: Topology, dt: float | None) -> Path:
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
            names += _column_names(name, values.shape[1], topology)
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


def _column_names(name: str, count: int, topology: Topology) -> list[str]:
    if name in _OF_NEURONS:
        return [f"{name} {neuron}" for neuron in neuron_names(topology)]
    return [f"{name} {k + 1}" for k in range(count)]
