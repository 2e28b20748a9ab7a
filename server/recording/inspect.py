"""A summary of a recording, as figures and as text."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from hebbviz.limits import fall_to_json
from hebbviz.rules.paper import PAPER
from hebbviz.server.recording.header import change_to_json
from hebbviz.server.recording.reader import Recording
from hebbviz.server.run.thinning import words as size_of
from hebbviz.sims.program.terminal import finite
from hebbviz.task.base import Tally

Figures = dict[str, Any]
"""By name, fit for strict JSON."""

MOST_CHANGES = 20


def figures(recording: Recording) -> Figures:
    """Everything that is known without recomputing the run."""
    header, last = recording.header, recording.moments[-1].keyframe
    steps = recording.last_step - header.step
    late = _late(recording)
    return {
        "file": str(recording.path),
        "bytes": recording.path.stat().st_size,
        "whole": recording.ending is not None and not recording.is_cut,
        "ending": recording.ending,
        "cut": recording.is_cut,
        "task": header.task,
        "preset": header.preset,
        "network": header.topology.describe(),
        "rule": header.rule,
        "seed": header.seed,
        "lane": header.first_lane,
        "first_step": header.step,
        "last_step": recording.last_step,
        "steps": steps,
        "seconds": steps * header.dt if header.dt else None,
        "beta": header.beta,
        "gamma": header.gamma,
        "fall": fall_to_json(header.fall),
        "frozen_at_the_end": last.frozen,
        "changes": [change_to_json(c) for c in recording.log if c.step >= header.step],
        "keyframes": len(recording.moments),
        "steps_between_keyframes": max(
            (b.step - a.step for a, b in pairwise(recording.moments)), default=0
        ),
        "detail": header.detail,
        "budget": header.budget,
        "thinning": header.thinning,
        "late_steps": late.steps,
        "late_average_reward": finite(late.average_reward) if late.steps else None,
        "late_episodes_ended": int(late.ended) if math.isfinite(late.ended) else None,
        "machine": header.machine,
        "versions": header.versions,
    }


def describe(found: Figures) -> str:
    """The figures as text to read."""
    seconds = f", {found['seconds']:,.2f} s of its own time" if found["seconds"] else ""
    whole = "complete" if found["whole"] else "truncated" if found["cut"] else "interrupted"
    lines = [
        f"{found['task']} {found['preset']}, {found['network']}, seed {found['seed']}"
        + (f", lane {found['lane']}" if found["lane"] else "")
        + f", β {found['beta']:.6g}, γ {found['gamma']:.3g}"
        + ("" if found["fall"] is None else f" falling over {found['fall']:.6g} steps")
        + ("" if found["rule"] == PAPER.name else f", rule {found['rule']}")
        + " at its start",
        f"steps {found['first_step']:,} to {found['last_step']:,}{seconds}",
        f"{size_of(found['bytes'])}, {whole}" + (f": {found['ending']}" if found["ending"] else ""),
        f"{found['keyframes']} keyframes, at most {found['steps_between_keyframes']:,} steps apart",
        f"kept: {found['thinning']}",
        _changes(found["changes"]),
    ]
    if found["late_steps"]:
        lines.append(
            f"average reward over the last {found['late_steps']:,} steps: "
            f"{found['late_average_reward']:.6g} a step; episodes ended: "
            f"{found['late_episodes_ended']}"
        )
    versions = ", ".join(f"{name} {number}" for name, number in found["versions"].items())
    return "\n".join((*lines, f"recorded on {found['machine']} with {versions}"))


def _changes(changes: list[dict[str, Any]]) -> str:
    if not changes:
        return "no changes"
    said = [
        f"{c['kind']} {', '.join(str(v) for k, v in c.items() if k not in ('kind', 'step'))} "
        f"at {c['step']:,}"
        for c in changes[:MOST_CHANGES]
    ]
    more = f" and {len(changes) - MOST_CHANGES} more" * (len(changes) > MOST_CHANGES)
    return f"{len(changes)} changes: {'; '.join(said)}{more}"


def _late(recording: Recording) -> Tally:
    """The totals of about the last fifth of the steps, to the nearest window's edge."""
    edges = (*recording.header.edges, *recording.edges)
    edges = tuple(e for e in edges if e.steps >= recording.header.step) or edges[-1:]
    first = edges[0].steps + (edges[-1].steps - edges[0].steps) * 4 / 5
    return edges[-1] - next(e for e in reversed(edges) if e.steps <= first)
