"""`hebbviz sweep`: run a map or go on with it, draw it, and save a learner of each point."""

from __future__ import annotations

import shlex
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hebbviz
from hebbviz.learner import saves
from hebbviz.sims import TASKS
from hebbviz.sims.experiments import Interrupted, finish, open_workers
from hebbviz.sims.figures.curves import setting
from hebbviz.sims.figures.run_figure import progress_bar, results_in
from hebbviz.sims.figures.sheet import Origin, own_name, save
from hebbviz.sims.program.compiling import announced_on_terminal
from hebbviz.sims.program.terminal import tell, writing
from hebbviz.sims.program.whole_folder import whole_folder
from hebbviz.sims.sweep.grid import Sweep
from hebbviz.sims.sweep.heat_map import sheet
from hebbviz.sims.sweep.outcome import outcome
from hebbviz.sims.user_file import own_file

if TYPE_CHECKING:
    from hebbviz.sims.experiments import Done, Plan
    from hebbviz.sims.sweep.outcome import Outcome

_MOVES = 0.01
"""γ times steps, below which weights stay where they are: r and z are about 1 at most."""
KEPT = "runs"
"""Results stay in a folder of this name, so that a finer map continues from them."""


def make(
    sweep: Sweep, out: Path, stop: threading.Event, *, scheduler: str | None = None
) -> dict[str, Any] | None:
    """Make the map in the folder `out`; returns what it comes to, fit for strict JSON.

    None once `stop` was set: what was done is kept. Raises InputError, ValueError, TaskError and
    OSError for what the user can mend.
    """
    about = setting(sweep.untrained)  # finds out whether it can be run at all
    if 0.0 < max(sweep.gammas) * sweep.steps < _MOVES:
        tell(
            f"γ = {max(sweep.gammas):g} moves no weight in {sweep.steps:,} steps, so that nothing "
            "is learnt: name larger ones with --gamma"
        )
    with results_in(out):
        return _made(sweep, out, stop, scheduler, about)


def _made(
    sweep: Sweep, out: Path, stop: threading.Event, scheduler: str | None, about: dict[str, Any]
) -> dict[str, Any] | None:
    task = sweep.untrained.make_task()
    began = time.perf_counter()
    try:
        done = _run(sweep, out / KEPT, stop, scheduler)
    except Interrupted:
        return None
    *points, untrained = (outcome(d, task) for d in done)
    name = own_name(out, sweep.file, sweep.command)
    learners = out / f"{name}-learners"
    with writing(learners), whole_folder(learners) as part:
        for d, point in zip(done[:-1], points, strict=True):
            _save(sweep, d, point, part)
    more = [_openings(sweep, point, learners) for point in points]
    drawn = sheet(sweep, task, points, untrained, more)
    paths = save(drawn, out, name, Origin(sweep.command, sweep.seed))
    return {
        "files": [str(path) for path in paths],
        "command": sweep.command,
        "version": hebbviz.__version__,
        "seed": sweep.seed,
        "seconds": time.perf_counter() - began,
        "task": sweep.task,
        "preset": about["preset"],
        "network": about["network"],
        "lanes": sweep.lanes,
        "steps": sweep.untrained.steps,
        "measure": task.measure.key,
        "unit": task.measure.unit,
        **drawn.numbers,
    }


def _run(sweep: Sweep, folder: Path, stop: threading.Event, scheduler: str | None) -> list[Done]:
    with (
        announced_on_terminal(),
        open_workers(scheduler) as workers,
        progress_bar("sweep") as progress,
    ):
        return finish(sweep.plans(), workers, folder=folder, stop=stop, progress=progress)


def _names(plan: Plan) -> tuple[str, str]:
    """Of the files of a point's two learners: at the end, and at its start."""
    stem = f"beta-{plan.beta!r}-gamma-{plan.gamma!r}"
    return f"{stem}.npz", f"{stem}-start.npz"


def _save(sweep: Sweep, done: Done, point: Outcome, folder: Path) -> None:
    """Save the learner of the median lane as it was at the end and at its start."""
    learners = done.learner(point.middle), done.start(point.middle)
    for learner, name in zip(learners, _names(done.plan), strict=True):
        saves.save(learner, folder / name, task_name=sweep.task)


def _openings(sweep: Sweep, point: Outcome, folder: Path) -> dict[str, Any]:
    """The median lane, and the commands that open its two learners in the page."""
    end, start = (_opening(sweep, folder / name) for name in _names(point.plan))
    return {"lane": point.middle, "open": end, "open_start": start}


def _opening(sweep: Sweep, path: Path) -> str:
    own = [] if sweep.task in TASKS.names else ["--task", sweep.task]
    if sweep.rule is not None and own_file(sweep.rule)[0] is not None:
        own += ["--rule", sweep.rule]
    return shlex.join(["hebbviz", "--load", str(path), *own])
