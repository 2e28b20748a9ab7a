"""The page's text: what is shown, how the run is doing, whether it is stuck."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Frame
from hebbviz.server.live.playback import Check
from hebbviz.server.live.recent_frames import moved
from hebbviz.server.live.saturation import ENOUGH_STEPS, Sign, sign
from hebbviz.server.live.snapshot import Other, Past, Snapshot
from hebbviz.server.page import event_text
from hebbviz.server.recording.status import Status
from hebbviz.server.run.history import Curve
from hebbviz.server.run.lane_spread import middle_of
from hebbviz.server.run.thinning import words as size_of
from hebbviz.server.scene.appearance import Looks
from hebbviz.sims.figures import palette
from hebbviz.task.base import Measure, Score, Tally, Task

Array = NDArray[np.float64]

MOST_NAMED = 5
"""At most this many stuck lanes are listed."""


def count(n: float) -> str:
    """A whole number with thin groups, of a width that does not jump: 1,234,567."""
    return f"{n:,.0f}"


def steps(n: int) -> str:
    """1 step, 2,000 steps."""
    return f"{count(n)} step{'s' * (n != 1)}"


def short(x: float) -> str:
    """Three digits and a unit: 12.3 k, 4.56 M."""
    for limit, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(x) >= limit:
            return f"{x / limit:.3g} {unit}"
    return f"{x:.3g}"


def duration(seconds: float) -> str:
    """12.3 s, 4.5 min, 6.7 h, 8.9 d."""
    for limit, unit in ((86_400, "d"), (3_600, "h"), (60, "min")):
        if seconds >= limit:
            return f"{seconds / limit:.1f} {unit}"
    return f"{seconds:.3g} s"


def clock(seconds: float) -> str:
    """Tenths of a second, of a width that does not jump: 6.9 s, 4 min 06.9 s, 1 h 02 min 03.4 s."""
    tenths = round(10 * seconds)
    minutes, tenths = divmod(tenths, 600)
    if minutes == 0:
        return f"{tenths / 10:.1f} s"
    hours, minutes = divmod(minutes, 60)
    if hours == 0:
        return f"{minutes} min {tenths / 10:04.1f} s"
    return f"{hours:,} h {minutes:02} min {tenths / 10:04.1f} s"


def memory(beta: float, dt: float | None) -> str:
    """The time constant of the trace."""
    steps = 1.0 / (1.0 - beta)
    seconds = f" = {duration(steps * dt)}" if dt else ""
    return f"1/(1−β) = {steps:,.4g} steps{seconds}"


def score(value: Score, measure: Measure) -> str:
    """A measure over some steps; a mean time to an event with the number of events and its
    interval.
    """
    if not measure.event:
        return amount(value.value, measure)
    return estimate((value.value, value.events or 0, *value.interval), measure)


def estimate(told: tuple[float, float, float, float], measure: Measure) -> str:
    """The same from value, events, and both ends of the interval."""
    return event_text.told(measure, told, lambda time: amount(time, measure))


def middle(values: Array, measure: Measure) -> str:
    """The middle of lanes (lanes,), and the number of lanes without an event."""
    found = middle_of(values, measure)
    without = event_text.lanes_without(measure, values)
    if math.isinf(found):
        return f"unknown, {without}"
    return f"{amount(found, measure)}{without and f', {without}'}"


def amount(value: float, measure: Measure) -> str:
    """A number with the measure's unit."""
    return duration(value) if measure.unit == "s" else f"{value:.3g} {measure.unit}".strip()


def shown(snapshot: Snapshot) -> str:
    """The steps that are shown, the number of steps in a frame, and the meaning of the light."""
    lengths = [f.since.steps for f in moved(snapshot.view.trail)]
    each = max(lengths[-1 if snapshot.pacing.paused else -3 :], default=1)
    light = "spikes" if each <= 3 else "firing rate"
    scale = f"one frame = {steps(each)}, light = {light}"
    excerpt = snapshot.view.excerpt
    if snapshot.view.past is not None:
        return f"{_past(snapshot, snapshot.view.past)}{scale}"
    if excerpt is None:
        state = "paused at" if snapshot.pacing.paused else "live,"
        return f"**{state} step {count(snapshot.view.frame.step)}** · {scale}"
    kind = "latest reward, slow motion" if excerpt.is_reward else "excerpt"
    return (
        f"**{kind}: step {count(excerpt.now)}** of {count(excerpt.first)}–{count(excerpt.last)} "
        f"(run: {count(snapshot.run.live.step)}) · {scale}"
    )


def _past(snapshot: Snapshot, past: Past) -> str:
    """The position of the past step that is shown, and whether it was verified."""
    run, dt = snapshot.run, snapshot.run.task.dt
    time = f" · {clock(past.cursor * dt)}" if dt else ""
    state = "paused" if snapshot.pacing.paused else "playing"
    if past.check is Check.OWN:
        kind = "the run is paused meanwhile"
    else:
        kind = f"a recording, played back · *{past.check.value}*"
    return (
        f"**past: step {count(past.cursor)}** of {count(run.first)}–{count(run.live.step)}"
        f"{time}  \n{state} · {kind}  \n"
    )


def warning(snapshot: Snapshot) -> str | None:
    """A warning, or None if all is well."""
    if snapshot.pacing.preparing is not None:
        return f"{snapshot.pacing.preparing}."
    if snapshot.pacing.error is not None:
        return snapshot.pacing.error
    if snapshot.view.past is None:
        why = stuck(snapshot.view.live_trail)
        if snapshot.run.lanes == 1:
            return why
        told = (stuck_lanes(snapshot), f"Lane {snapshot.run.lane}: {why}" if why else None)
        return "  \n".join(filter(None, told)) or None
    past = snapshot.view.past
    return f"{past.check.value} ({past.why})." if past.check is Check.DIFFERS else None


def besides(snapshot: Snapshot) -> list[str]:
    """Other activity: other lanes, the other copy of a fork, a recording."""
    lines = []
    if snapshot.run.lanes > 1:
        lines.append(
            f"**{snapshot.run.lanes} lanes** side by side, **lane {snapshot.run.lane}** watched"
        )
    if snapshot.view.other is not None:
        other = snapshot.view.other
        lines.append(
            f"**two copies** since step {count(other.start)}: this run at the left, "
            f"the other at the right, **{other.words}**"
        )
    if snapshot.recording.is_on and snapshot.recording.status is not None:
        lines.append(f"{_dot(palette.PUNISHMENT)} recording")
    return lines


def compared(snapshot: Snapshot, other: Other) -> str:
    """Results of the two copies of a fork, over all whole windows since the fork."""
    curves = snapshot.run.curve, other.curve
    whole = [c.end - c.steps >= other.start for c in curves]
    if not all(w.any() for w in whole):
        return f"The comparison starts after {steps(snapshot.run.curve.window)}."
    said = [
        score(snapshot.run.task.score(_total(c, w)), snapshot.run.task.measure)
        for c, w in zip(curves, whole, strict=True)
    ]
    first = min((c.end - c.steps)[w][0] for c, w in zip(curves, whole, strict=True))
    return (
        f"Since step {count(first)}: this run **{said[0]}**, other, {other.words}: **{said[1]}**."
    )


def _total(curve: Curve, which: NDArray[np.bool_]) -> Tally:
    """The totals over some windows."""
    columns = (curve.steps, curve.reward, curve.broadcast, curve.ended)
    totals = [float(c[which].sum()) for c in columns]
    return Tally(int(totals[0]), *totals[1:])


def recorded(status: Status) -> str:
    """The size of the recording, and how it was thinned."""
    size = "" if status.size is None else f", {size_of(status.size)}"
    return f"{steps(status.steps)}{size}: {status.thinned}"


def time_of(task: Task, step: int) -> str:
    """Simulated time, for tasks that have one."""
    return f" · {duration(step * task.dt)} simulated" if task.dt else ""


def stuck_lanes(snapshot: Snapshot) -> str | None:
    """The number of stuck lanes, and which they are."""
    found = snapshot.findings.stuck
    if not found:
        return None
    named = ", ".join(map(str, found[:MOST_NAMED])) + ", …" * (len(found) > MOST_NAMED)
    is_one = len(found) == 1
    return (
        f"{len(found)} of {snapshot.run.lanes} lanes {'is' if is_one else 'are'} stuck: "
        f"lane{'s' * (not is_one)} {named}."
    )


def stuck(frames: Sequence[Frame]) -> str | None:
    """Why learning has stopped and what helps; None if the latest frames show no sign of it."""
    steps, spikes = 0, np.zeros(0)
    low, high = np.zeros(0), np.zeros(0)
    for frame in reversed(moved(frames)):
        since = frame.since
        if not steps:
            spikes = np.zeros(len(since.spikes))
            low, high = since.potential_range
        steps, spikes = steps + since.steps, spikes + since.spikes
        low = np.minimum(low, since.potential_range[0])
        high = np.maximum(high, since.potential_range[1])
        if steps >= ENOUGH_STEPS:
            return _stuck(frames[-1], spikes / steps, low, high, steps)
    return None


def _stuck(frame: Frame, rate: Array, low: Array, high: Array, steps: int) -> str | None:
    outputs = rate[frame.topology.neurons_of(frame.topology.output)]
    found = sign(bool(np.isfinite(frame.weight).all()), outputs, low, high)
    if found is Sign.GONE:
        return "The weights are no longer finite. Undo, or reset with a smaller γ."
    if found is Sign.CONSTANT:
        return (
            f"Stuck: all outputs have been constant over {count(steps)} steps, so their traces "
            "hold almost no information to learn from. Undo, or reset with a smaller γ or "
            "a shorter trace (smaller β)."
        )
    if found is Sign.SATURATED:
        return (
            "More than half of the neurons are saturated: their spikes are certain, so their "
            "traces do not change. Undo, or reset with a smaller γ."
        )
    return None


def health(pictures_per_second: float, age: float, tabs: int) -> str:
    """The line that shows the state of the page."""
    return (
        f"`{pictures_per_second:4.1f} fps` · `{1000 * age:3.0f} ms old` · "
        f"{tabs} tab{'s' * (tabs != 1)}"
    )


def speed(snapshot: Snapshot) -> str:
    """The speed reached; in the past, the playback speed."""
    if snapshot.view.past is not None:
        speed = snapshot.pacing.speed
        asked = speed if isinstance(speed, str) else f"{speed:g} steps/s"
        return f"playback at `{asked}`"
    reached = f"`{short(snapshot.pacing.steps_per_second)} steps/s`"
    lanes, of_all = snapshot.run.lanes, short(snapshot.pacing.steps_per_second * snapshot.run.lanes)
    all_lanes = f"; × {lanes} lanes = `{of_all} lane-steps/s`" if lanes > 1 else ""
    dt = snapshot.run.task.dt
    times = f" = {short(snapshot.pacing.steps_per_second * dt)} × real time" if dt else ""
    return (
        f"reached: {reached}{times}{time_of(snapshot.run.task, snapshot.run.live.step)}{all_lanes}"
    )


def key(task: Task) -> str:
    """The meaning of the colours."""
    p, dot = palette, _dot
    inputs = f" {dot(p.INPUT_POSITIVE)} {dot(p.INPUT_NEGATIVE)} input, a level"
    lines = (
        f"{dot(p.SPIKE)} spike, or firing rate{inputs if task.inputs else ''}",
        f"{dot(p.WEIGHT_POSITIVE)} w > 0 {dot(p.WEIGHT_NEGATIVE)} w < 0: its width is |w|",
        f"{dot(p.TRACE_POSITIVE)} z > 0 {dot(p.TRACE_NEGATIVE)} z < 0: trace, a bar on a synapse",
        f"{dot(p.REWARD)} reward {dot(p.PUNISHMENT)} punishment: its glow is Δw",
        task.legend,
    )
    return "  \n".join(filter(None, lines))


def scales(looks: Looks, drawn: int) -> str:
    """The scales of the scene, and the number of synapses that are drawn."""
    all_synapses = looks.topology.synapses
    some = f"; showing the {count(drawn)} largest of {count(all_synapses)} synapses"
    return f"{looks.legend()}{some if drawn < all_synapses else ''}"


def _dot(color: palette.Rgb) -> str:
    return f"<span style='color:{palette.css(color)}'>●</span>"
