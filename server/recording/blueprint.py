"""The layout of an opened recording: its views, with their titles and units.

The blueprint is embedded in the file and names every tree of its schema. Left: now, in 3D and as
maps. Middle: the latest few seconds up to the cursor, step by step. Right: the whole run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import rerun.blueprint as rrb
from rerun.blueprint.components import PlayState

from hebbviz.server.recording.header import entity
from hebbviz.server.recording.plots import ALL, in_title, plot, span_of, steps_of, up_to_cursor
from hebbviz.server.recording.scene import unlit
from hebbviz.server.recording.scene_objects import trail_of
from hebbviz.server.scene.appearance import network_at, place
from hebbviz.sims.figures import palette
from hebbviz.task.base import Measure, Reading, Task
from hebbviz.topology import Projection, Topology

TRAIL = 75
"""Length of a trail in steps."""
MOST_CURVES = 64
SIDE_BY_SIDE = 2
"""Most projections whose maps are shown together; with more, one at a time."""
LOG_GAMMA = "parameters/log10_gamma"
"""rerun's plots have no logarithmic axis, and a small γ beside 1 looks like zero."""
USUAL_HEIGHT = 3.1
"""Extent of a network of three layers, in scene units."""
WIDEST_TO_NARROWEST = 1.35
"""Least share of a map with few columns, so that its title fits."""


def blueprint(task: Task, topology: Topology, *, live: bool = False) -> rrb.Blueprint:
    """The page on which the recording of a run opens.

    It plays from the beginning, where every step is kept; with `live`, it follows the latest data.
    """
    play = PlayState.Following if live else PlayState.Playing
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene(task, topology), now(task, topology), row_shares=[3, 2]),
            latest(task, topology),
            whole_run(task, topology),
            column_shares=[38, 32, 30],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=timeline_of(task), play_state=play),
        auto_views=False,
    )


def timeline_of(task: Task) -> str:
    """The timeline on which the task's recordings open."""
    return "step" if task.dt is None else "sim_time"


def log_curve(measure: Measure) -> str:
    """The entity of a logarithmic measure's log₁₀: rerun's plots have no logarithmic axis."""
    return f"learning/log10_{measure.key}"


def curves_of(topology: Topology) -> tuple[Projection, ...]:
    """The projections with few enough synapses for a curve of each weight over time."""
    return tuple(p for p in topology.projections if math.prod(topology.shape(p)) <= MOST_CURVES)


# Left: now


def scene(task: Task, topology: Topology) -> rrb.Spatial3DView:
    """The network over its world, seen from where the page's camera stands."""
    where = place(topology)
    target = where.middle + network_at(task) + (0.0, 0.0, -0.1)
    eye = target + (0.0, -1.6 - 0.9 * float(np.ptp(where.units, axis=0).max()), 0.3)
    if task.props:
        taller = max(1.0, float(where.units[:, 2].max()) / USUAL_HEIGHT)
        target = np.array([0.0, 0.4, 2.05 * taller])
        eye = target + np.array([0.0, -7.9, 1.55]) * taller
    return rrb.Spatial3DView(
        origin="/scene",
        name="Now: synapses blue w > 0, orange w < 0; bars: traces z, green > 0, purple < 0",
        background=list(palette.DARK.background),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=tuple(eye), look_target=tuple(target), eye_up=(0, 0, 1)
        ),
        defaults=unlit(topology),
        overrides={
            trail_of(prop): rrb.VisibleTimeRanges(up_to_cursor(task, TRAIL))
            for prop in task.props
            if prop.trail
        },
    )


def now(task: Task, topology: Topology) -> rrb.Container:
    """Maps of weights and traces; for a single synapse, their curves."""
    if topology.synapses > 1:
        return maps(topology)
    span, window = span_of(task), up_to_cursor(task, steps_of(task))
    return rrb.Horizontal(
        plot(f"Weight w, {span}", "/curves/weights", window, legend=False),
        plot(f"Trace z, {span}", "/curves/traces", window, legend=False),
    )


def maps(topology: Topology) -> rrb.Container:
    """Weights above traces, the projections side by side; with many projections, one at a time."""
    projections = topology.projections
    rows = [
        [_map(f"/{tree}/{entity(p.name)}", f"{what} {_where(topology, p)}") for p in projections]
        for tree, what in (("weights", "Weights"), ("traces", "Traces"))
    ]
    if len(projections) > SIDE_BY_SIDE:
        pairs = zip(*rows, projections, strict=True)
        return rrb.Tabs(*(rrb.Vertical(w, z, name=p.name) for w, z, p in pairs))
    wide = [topology.shape(p)[1] ** 0.5 for p in projections]
    shares = [max(w, max(wide) / WIDEST_TO_NARROWEST) for w in wide]
    return rrb.Vertical(*(rrb.Horizontal(*row, column_shares=shares) for row in rows))


def _where(topology: Topology, projection: Projection) -> str:
    """A short name for the synapses, for a map's title."""
    others = [p for p in topology.projections if p.post == projection.post]
    return f"into {projection.post}" if len(others) == 1 else projection.name


def _map(path: str, name: str) -> rrb.TensorView:
    return rrb.TensorView(
        origin=path,
        name=name,
        scalar_mapping=rrb.TensorScalarMapping(colormap="CyanToYellow", mag_filter="nearest"),
        view_fit="fill",
    )


# Middle: the latest steps


def latest(task: Task, topology: Topology) -> rrb.Vertical:
    """Spikes, potentials, rewards and the world, step by step up to the cursor."""
    span, window = span_of(task), up_to_cursor(task, steps_of(task))
    lines = min(topology.neurons, 24)
    views: list[tuple[float, rrb.View]] = [
        (
            1.5 + 0.12 * lines,
            plot(
                f"Spikes by neuron, {span}",
                "/spikes",
                window,
                y=(-0.7, topology.neurons - 0.3),
                legend=False,
            ),
        ),
        (2.0, plot(f"Potentials v, {span}", "/potentials", window, legend=topology.neurons <= 2)),
        (
            1.2,
            plot(
                f"Reward at each step, {span}",
                "/reward",
                window,
                only=["raw", "broadcast"],
            ),
        ),
        *((1.4, _readings(unit, some, span, window)) for unit, some in _by_unit(task)),
    ]
    return rrb.Vertical(*(v for _, v in views), row_shares=[share for share, _ in views])


def _readings(
    unit: str, readings: Sequence[Reading], span: str, window: Sequence[rrb.VisibleTimeRange]
) -> rrb.View:
    names = " and ".join(_in_short([r.name for r in readings]))
    title = f"{names}{in_title(unit)}, {span}"
    only = [entity(r.name) for r in readings]
    return plot(title[0].upper() + title[1:], "/world", window, only=only, legend=len(only) > 1)


def _in_short(names: Sequence[str]) -> list[str]:
    """Names with their common first words only once: puck x and y."""
    first, *others = names
    head, _, _ = first.rpartition(" ")
    return [first, *(n.removeprefix(f"{head} ") for n in others)]


def _by_unit(task: Task) -> list[tuple[str, list[Reading]]]:
    units: dict[str, list[Reading]] = {}
    for reading in task.readings:
        units.setdefault(reading.unit, []).append(reading)
    return list(units.items())


# Right: the whole run


def whole_run(task: Task, topology: Topology) -> rrb.Vertical:
    """The learning curve, rewards, rates, weights and parameters over the whole run."""
    several = len(topology.neuron_groups) > 1
    parameters = rrb.Horizontal(
        plot("Trace decay β", "/parameters", only=["beta"], legend=False),
        plot(
            "Step size γ, log₁₀", "/parameters", only=[LOG_GAMMA.rpartition("/")[2]], legend=False
        ),
    )
    average = plot("Average reward per step", "/reward", only=["average", "kept/**"], legend=False)
    phases = rrb.StateTimelineView(
        origin="/phase", name="Learning or frozen", time_view=rrb.TimeAxis(view_range=ALL)
    )
    drawn = curves_of(topology)
    which = "" if drawn == topology.projections else ", " + ", ".join(p.name for p in drawn)
    weights = plot(f"Weights w over time{which}", "/curves/weights", legend=False)
    columns = rrb.TextLogColumns(
        timeline_columns=[timeline_of(task)], text_log_columns=["loglevel", "body"]
    )
    views: list[tuple[float, rrb.View | rrb.Container]] = [
        (2.4, _learning_curve(task.measure)),
        (1.8, average),
        (1.4, plot("Firing rates, spikes per step", "/rates", y=(0.0, 1.0), legend=several)),
        (2.0, weights),
        (1.6, parameters),
        (1.3, phases),
        (1.6, rrb.TextLogView(origin="/events", name="Events", columns=columns)),
    ]
    if task.measure.key == Task.measure.key:  # the average reward, already shown
        del views[0]
    if not drawn:
        views = [(share, view) for share, view in views if view is not weights]
    return rrb.Vertical(*(v for _, v in views), row_shares=[share for share, _ in views])


def _learning_curve(measure: Measure) -> rrb.View:
    name, unit, path, span = measure.name, in_title(measure.unit), measure.key, measure.span
    if measure.logarithmic:
        low, high = span or (1.0, 10.0)
        unit, span = f", log₁₀ of {measure.unit}", (math.log10(low), math.log10(high))
        path = log_curve(measure).removeprefix("learning/")
    title = name[0].upper() + name[1:] + unit
    return plot(title, "/learning", only=[path], y=span, legend=False)
