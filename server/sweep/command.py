"""`hebbviz sweep`: run a map or go on with it, draw it, and save a learner of each point."""

from __future__ import annotations

import shlex
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hebbviz
from hebbviz import files
from server.experiments import Interrupted, finish, open_workers
from server.figures.command import prepare_folder, progress_bar
from server.figures.curves import setting
from server.figures.sheet import Origin, check_replaces, save
from server.sweep.grid import Sweep, learners_file
from server.sweep.heat_map import sheet
from server.sweep.outcome import outcome
from server.terminal import writing
from server.train import announced_on_terminal
from sims import TASKS

if TYPE_CHECKING:
    from server.experiments import Done
    from server.sweep.outcome import Outcome

NAME = "sweep"
"""Of the files."""
KEPT = "runs"
"""What was run stays in a folder of this name: a finer map goes on from it."""


def make(
    sweep: Sweep, out: Path, stop: threading.Event, *, scheduler: str | None = None
) -> dict[str, Any] | None:
    """Make the map in the folder `out`; returns what it comes to, fit for strict JSON.

    None once `stop` was set: what was done is kept. Raises InputError, ValueError, TaskError and
    OSError for what the user can mend.
    """
    about = setting(sweep.untrained)  # finds out whether it can be run at all
    prepare_folder(out)
    check_replaces(out, NAME, sweep.command_begins)
    task = sweep.untrained.make_task()
    began = time.perf_counter()
    try:
        done = _run(sweep, out / KEPT, stop, scheduler)
    except Interrupted:
        return None
    *points, untrained = (outcome(d, task) for d in done)
    more = [_openings(sweep, d, p, out) for d, p in zip(done[:-1], points, strict=True)]
    drawn = sheet(sweep, task, points, untrained, more)
    paths = save(drawn, out, NAME, Origin(sweep.command, sweep.seed))
    return {
        "files": [str(path) for path in paths], "command": sweep.command,
        "version": hebbviz.__version__, "seed": sweep.seed,
        "seconds": time.perf_counter() - began, "task": sweep.task,
        "preset": about["preset"], "network": about["network"], "lanes": sweep.lanes,
        "steps": sweep.untrained.steps, "measure": task.measure.key, "unit": task.measure.unit,
        **drawn.numbers,
    }  # fmt: skip


def _run(sweep: Sweep, folder: Path, stop: threading.Event, scheduler: str | None) -> list[Done]:
    with (
        announced_on_terminal(),
        open_workers(scheduler) as workers,
        progress_bar("sweep") as progress,
    ):
        return finish(sweep.plans(), workers, folder=folder, stop=stop, progress=progress)


def _openings(sweep: Sweep, done: Done, point: Outcome, out: Path) -> dict[str, Any]:
    """Save the learner of the median lane; the commands that open it, and its run, in the page."""
    beta, gamma = done.plan.beta, done.plan.gamma
    assert beta is not None
    assert gamma is not None
    path = learners_file(out, beta, gamma)
    with writing(path):
        path.parent.mkdir(exist_ok=True)
        files.save(done.learner(point.middle), path, task_name=sweep.task)
    own = [] if sweep.task in TASKS else ["--task", sweep.task]
    return {
        "lane": point.middle,
        "open": shlex.join(["hebbviz", "--load", str(path), *own]),
        "open_start": sweep.page(beta, gamma),
    }
