"""The scene and the views of a recording: what is read back from a file is what was drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from hebbviz.learner.learner import Learner
from hebbviz.server.recording.blueprint import blueprint, log_curve
from hebbviz.server.recording.header import entity
from hebbviz.server.recording.rows import Rows
from hebbviz.server.recording.scene import ROOT, Scene
from hebbviz.server.recording.scene_objects import LEAP, LEAST_EXTENT, packed, path_of, trail_of
from hebbviz.server.scene.appearance import (
    MOST_SYNAPSES_DRAWN,
    NETWORK_OVER_WORLD,
    endpoints,
    place,
)
from hebbviz.sims.loading import make_task
from hebbviz.sims.worlds.synapse import Synapse
from hebbviz.task.base import Task
from hebbviz.task.scene import Pose, Prop
from hebbviz.topology import Topology

STEPS = 90


class Recorded:
    """A file, and what is in it."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(path)
        self.chunks = list(self.reader.stream())

    def rows(self, path: str, component: str) -> list[tuple[int, Any]]:
        """Steps and values of a component, in the order of steps; static ones have step -1."""
        found: dict[int, Any] = {}
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            if str(chunk.entity_path) == f"/{path}" and component in batch.schema.names:
                steps = [-1] if chunk.is_static else batch.column("step").to_pylist()
                found |= dict(zip(steps, batch.column(component).to_pylist(), strict=True))
        return sorted(found.items())

    def values(self, path: str, component: str) -> np.ndarray:
        return np.array([value for _, value in self.rows(path, component)])

    def views(self) -> set[str]:
        """What the views of the embedded blueprint show, as paths with wildcards."""
        (store,) = self.reader.blueprints()
        origin, query = {}, {}
        for chunk in self.reader.stream(store=store):
            batch = chunk.to_record_batch()
            view = str(chunk.entity_path).split("/")[2:3]
            for name, into in (
                ("ViewBlueprint:space_origin", origin), ("ViewContents:query", query)
            ):  # fmt: skip
                if name in batch.schema.names:
                    into[view[0]] = batch.column(name).to_pylist()[0]
        return {q.replace("$origin", origin[v][0]) for v, all_of in query.items() for q in all_of}


def record(
    folder: Path, task: Task, topology: Topology, draw: Callable[[Scene], object], **more: Any
) -> Recorded:
    """A file with a scene drawn into it."""
    path = folder / "a.rrd"
    stream = rr.RecordingStream("hebbviz tests", recording_id="a")
    stream.set_sinks(rr.FileSink(path), default_blueprint=blueprint(task, topology))
    rows = Rows(stream, task.dt)
    draw(Scene(stream, task, topology, rows, **more))
    rows.flush()
    stream.flush(timeout_sec=10.0)
    stream.disconnect()
    return Recorded(path)


def pendulum_states() -> tuple[Task, Topology, np.ndarray, np.ndarray]:
    """Steps and states of two stretches with a gap between them, falls among them."""
    learner = Learner(make_task("pendulum"), seed=3)
    first = learner.advance(STEPS, closely=True)
    learner.skip(50)
    second = learner.advance(STEPS, closely=True)
    assert first.ended.any()
    steps = np.concatenate([np.arange(b.start, b.end) + 1 for b in (first, second)])
    states = np.concatenate([first.world, second.world])
    return learner.task, learner.topology, steps, states


def latest(rows: Iterable[tuple[int, Any]], step: int) -> Any:
    """What rerun shows at a step."""
    return [value for at, value in rows if at <= step][-1][0]


def test_what_is_shown_at_every_step_is_the_tasks_pose(tmp_path: Path) -> None:
    task, topology, steps, states = pendulum_states()
    seen = record(tmp_path, task, topology, lambda scene: scene.poses(steps, states))
    for k, prop in enumerate(task.props):
        path = path_of(prop)
        places = seen.rows(path, "Transform3D:translation")
        turns = dict(seen.rows(path, "Transform3D:quaternion"))
        sizes = seen.rows(f"{path}/shape", "InstancePoses3D:scales")
        for step, state in zip(steps, states, strict=True):
            pose = task.pose(state)
            at = max(row for row, _ in places if row <= step)
            x, y, z, w = (turns.get(at) or [(0.0, 0.0, 0.0, 1.0)])[0]
            assert np.array_equal(latest(places, step), np.float32(pose.position[k]))
            assert np.array_equal((w, x, y, z), np.float32(pose.rotation[k]))
            size = np.maximum(pose.scale[k], LEAST_EXTENT)
            assert np.array_equal(latest(sizes, step), np.float32(size))


def test_what_stands_still_is_written_once(tmp_path: Path) -> None:
    task, topology, steps, states = pendulum_states()
    seen = record(tmp_path, task, topology, lambda scene: scene.poses(steps, states))
    for prop in task.props:
        places = seen.rows(path_of(prop), "Transform3D:translation")
        sizes = seen.rows(f"{path_of(prop)}/shape", "InstancePoses3D:scales")
        meshes = seen.rows(f"{path_of(prop)}/shape", "Mesh3D:vertex_positions")
        assert [step for step, _ in meshes] == [-1]
        if prop.name.startswith(("floor", "wall")):
            assert [step for step, _ in places] == [1] == [step for step, _ in sizes]
        elif not prop.name.startswith("thrust"):
            assert len(places) > STEPS and len(sizes) == 1
    assert not seen.rows(path_of(task.props[5]), "Transform3D:quaternion")  # the puck never turns


class Wheel(Synapse):
    """Turns in its place; the state's first number is the angle in rad."""

    props = (Prop("big wheel", "box"),)

    def pose(self, state: np.ndarray) -> Pose:
        turn = np.array([[np.cos(state[0] / 2), 0.0, 0.0, np.sin(state[0] / 2)]])
        return Pose(np.zeros((1, 3)), turn, np.ones((1, 3)))


def test_a_turn_alone_is_written_and_so_is_the_turn_back(tmp_path: Path) -> None:
    task, steps = Wheel(), np.arange(5)
    states = np.array([0.0, 0.0, 1.0, 1.0, 0.0])[:, None]
    seen = record(tmp_path, task, task.topology(), lambda scene: scene.poses(steps, states))
    turns = seen.rows(path_of(task.props[0]), "Transform3D:quaternion")
    assert [step for step, _ in turns] == [0, 2, 4]
    assert [turn[0][3] == 1.0 for _, turn in turns] == [True, False, True]


def test_it_does_not_matter_how_the_steps_are_handed_over(tmp_path: Path) -> None:
    task, topology, steps, states = pendulum_states()

    def one_by_one(scene: Scene) -> None:
        for k in range(len(steps)):
            scene.poses(steps[k : k + 1], states[k : k + 1])

    (tmp_path / "b").mkdir()
    whole = record(tmp_path, task, topology, lambda scene: scene.poses(steps, states))
    pieces = record(tmp_path / "b", task, topology, one_by_one)
    for prop in task.props:
        for path, component in (
            (path_of(prop), "Transform3D:translation"), (path_of(prop), "Transform3D:quaternion"),
            (f"{path_of(prop)}/shape", "InstancePoses3D:scales"),
            (trail_of(prop), "LineStrips3D:strips"),
        ):  # fmt: skip
            assert whole.rows(path, component) == pieces.rows(path, component)


def test_a_trail_joins_steps_that_follow_on_one_another(tmp_path: Path) -> None:
    task, topology, steps, states = pendulum_states()
    states[30:, 0] += 0.8  # as if put somewhere else
    seen = record(tmp_path, task, topology, lambda scene: scene.poses(steps, states))
    (k,) = (k for k, prop in enumerate(task.props) if prop.trail)
    where = {s: task.pose(x).position[k] for s, x in zip(steps, states, strict=True)}
    pieces = dict(seen.rows(trail_of(task.props[k]), "LineStrips3D:strips"))
    assert pieces.pop(-1, None) is None
    for step, ((start, end),) in pieces.items():
        assert np.array_equal(start, np.float32(where[step - 1]))
        assert np.array_equal(end, np.float32(where[step]))
    left_out = set(steps[1:].tolist()) - set(pieces)
    assert left_out >= {steps[STEPS], steps[30]}  # the first after the gap, and after the leap
    for step in left_out - {steps[STEPS]}:
        assert np.linalg.norm(where[step] - where[step - 1]) > LEAP * 0.999


@pytest.mark.parametrize("name", ["pendulum", "sonar", "synapse"])
def test_synapses_are_coloured_by_the_sign_of_w_and_as_thick_as_it_is_large(
    name: str, tmp_path: Path
) -> None:
    learner = Learner(make_task(name), seed=1)
    frames = [learner.advance(20) and learner.frame() for _ in range(3)]

    def draw(scene: Scene) -> None:
        for frame in frames:
            scene.look(frame)

    seen = record(tmp_path, learner.task, learner.topology, draw)
    colors = seen.values(f"{ROOT}/synapses", "LineStrips3D:colors")
    radii = seen.values(f"{ROOT}/synapses", "LineStrips3D:radii")
    assert colors.shape == radii.shape == (3, learner.topology.synapses)
    for frame, color, radius in zip(frames, colors, radii, strict=True):
        red, blue = color >> 24, color >> 8 & 0xFF
        w = frame.weight
        assert (blue > red)[w > 0].all() and (red > blue)[w < 0].all()
        order = np.argsort(np.abs(w))
        assert (np.diff(radius[order]) >= 0).all()


def test_a_trace_stands_up_or_hangs_down_by_its_sign(tmp_path: Path) -> None:
    learner = Learner(make_task("pendulum"), seed=1)
    learner.advance(30)
    frame = learner.frame()
    seen = record(tmp_path, learner.task, learner.topology, lambda scene: scene.look(frame))
    strips = seen.rows(f"{ROOT}/traces", "LineStrips3D:strips")[-1][1]
    foot, tip = np.array(strips).transpose(1, 0, 2)
    assert np.array_equal(np.sign(tip[:, 2] - foot[:, 2]), np.sign(frame.trace))
    assert np.array_equal(foot[:, :2], tip[:, :2])


def test_neurons_are_lit_by_their_rate(tmp_path: Path) -> None:
    learner = Learner(make_task("sonar"), seed=1)
    learner.advance(500)
    frame = learner.frame()
    seen = record(tmp_path, learner.task, learner.topology, lambda scene: scene.look(frame))
    red = seen.values(f"{ROOT}/neurons", "Points3D:colors")[0] >> 24
    order = np.argsort(frame.since.spikes)
    assert (np.diff(red[order].astype(int)) >= 0).all()


def test_a_spike_is_light_that_fades_within_a_few_steps(tmp_path: Path) -> None:
    learner = Learner(make_task("pendulum", "quick"), seed=1)
    fired = np.zeros((12, 6), dtype=np.uint8)
    fired[[0, 5], [1, 4]] = 1
    steps = np.arange(12)
    seen = record(tmp_path, learner.task, learner.topology, lambda s: s.spikes(steps, fired))
    rows = [row for row in seen.rows(f"{ROOT}/neurons", "Points3D:colors") if row[0] >= 0]
    red = np.array([colors for _, colors in rows]) >> 24
    lit = red > red.min()
    assert lit[:, 1].tolist() == [True] * 4 + [False] * 8
    assert lit[:, 4].tolist() == [False] * 5 + [True] * 4 + [False] * 3
    assert not lit[:, [0, 2, 3, 5]].any()
    assert (np.diff(red[5:10, 4].astype(int)) < 0).all()


def test_inputs_that_hold_still_are_not_written_again(tmp_path: Path) -> None:
    learner = Learner(make_task("sonar"), seed=1)
    frames = [learner.advance(100) and learner.frame() for _ in range(15)]
    shown = {f.activity[:60].tobytes() for f in frames}

    def draw(scene: Scene) -> None:
        for frame in frames:
            scene.look(frame)

    seen = record(tmp_path, learner.task, learner.topology, draw)
    assert len(seen.rows(f"{ROOT}/inputs", "Boxes3D:half_sizes")) == len(shown) == 2


def test_synapses_run_between_the_rims_of_their_units(tmp_path: Path) -> None:
    learner = Learner(make_task("pendulum"))
    seen = record(tmp_path, learner.task, learner.topology, lambda scene: None)
    ((_, strips),) = seen.rows(f"{ROOT}/synapses", "LineStrips3D:strips")
    where, (pre, post) = place(learner.topology), endpoints(learner.topology)
    start, end = np.array(strips).transpose(1, 0, 2)
    inset = np.where(np.arange(learner.topology.units) < 8, 0.0, where.radius)
    along = where.units[post] - where.units[pre]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert start == pytest.approx(where.units[pre] + inset[pre, None] * along, abs=1e-5)
    assert end == pytest.approx(where.units[post] - inset[post, None] * along, abs=1e-5)
    ((_, above),) = seen.rows(ROOT, "Transform3D:translation")
    assert np.array_equal(above[0], np.float32(NETWORK_OVER_WORLD))


def test_of_a_large_network_the_largest_synapses_are_drawn(tmp_path: Path) -> None:
    learner = Learner(make_task("sonar"), hidden=(40,))
    weight = learner.weights[:, 0]
    drawn: list[int] = []

    def draw(scene: Scene) -> None:
        drawn.extend(scene.drawn.tolist())
        scene.look(learner.frame())

    learner.advance(1)
    seen = record(tmp_path, learner.task, learner.topology, draw, weight=weight)
    assert len(drawn) == MOST_SYNAPSES_DRAWN
    assert np.abs(weight[drawn]).min() >= np.abs(np.delete(weight, drawn)).max()
    assert seen.values(f"{ROOT}/synapses", "LineStrips3D:radii").shape == (1, len(drawn))


@pytest.mark.parametrize(
    ("name", "hidden"), [("pendulum", None), ("pendulum", (4, 3)), ("sonar", None), ("sonar", ())]
)
def test_the_embedded_views_show_every_tree_of_the_schema(
    name: str, hidden: tuple[int, ...] | None, tmp_path: Path
) -> None:
    task = make_task(name)
    topology = task.topology(hidden)
    shown = record(tmp_path, task, topology, lambda scene: None).views()
    curve = log_curve(task.measure) if task.measure.logarithmic else f"learning/{task.measure.key}"
    expected = {
        "/scene/**", "/spikes/**", "/potentials/**", "/rates/**", "/curves/weights/**",
        "/reward/raw", "/reward/broadcast", "/reward/average", "/reward/kept/**",
        "/parameters/beta",
        "/parameters/log10_gamma", "/events/**", "/phase/**", f"/{curve}",
        *(f"/world/{entity(reading.name)}" for reading in task.readings),
        *(f"/{t}/{entity(p.name)}/**" for t in ("weights", "traces") for p in topology.projections),
    }  # fmt: skip
    assert shown == expected


def test_a_single_synapse_is_shown_by_what_became_of_it(tmp_path: Path) -> None:
    task = make_task("synapse")
    shown = record(tmp_path, task, task.topology(), lambda scene: None).views()
    assert {"/curves/weights/**", "/curves/traces/**", "/reward/average"} <= shown
    assert not any(path.startswith(("/weights", "/learning", "/world")) for path in shown)


def test_a_packed_colour_is_red_green_blue_and_opaque() -> None:
    assert packed(np.array([[1, 2, 3]], dtype=np.uint8)).tolist() == [0x010203FF]
