"""All that `digests.py` takes from the Python source of a checkout.

A name is looked for in all modules, so what has moved is found. Where something was renamed, put
its new name beside the old one here: the same file must work with older checkouts.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

Parts = dict[str, Any]
"""Results of a case by name: arrays, numbers, strings, and lists and dicts of these."""

root = Path(__file__).resolve().parents[2]
"""The checkout that is looked at."""


def check_imported() -> None:
    """End the program if what is imported is not this checkout, but an installed one."""
    found = Path(importlib.import_module("hebbviz").__file__ or "")
    if root not in found.resolve().parents:
        raise SystemExit(f"{root} has no package hebbviz: name the folder of a checkout")


def find(*names: str, near: str = "") -> Any:
    """The class or function of one of these names, the first that some module defines.

    `near` is a pattern that the module's name must match, where a name is used twice.
    """
    for name in names:
        wanted = re.compile(rf"^(?:class|def) {name}\b", re.MULTILINE)
        for module, text in _modules().items():
            if wanted.search(text) and re.search(near, module):
                return getattr(importlib.import_module(module), name)
    raise LookupError(f"no module defines {' or '.join(names)}: add its new name to the adapter")


@cache
def _modules() -> dict[str, str]:
    """The text of every module of the product, by the name under which it is imported."""
    folders = {"hebbviz": root / "hebbviz"}
    for inner in ("server", "sims"):
        linked = root / "hebbviz" / inner
        folders |= {f"hebbviz.{inner}": linked} if linked.exists() else {inner: root / inner}
    found = {}
    for package, folder in folders.items():
        for file in sorted(folder.rglob("*.py")):
            parts = file.relative_to(folder).with_suffix("").parts
            name = ".".join((package, *(p for p in parts if p != "__init__")))
            found[name] = file.read_text(encoding="utf-8")
    return found


def first(thing: Any, *names: str) -> Any:
    """The first of these attributes that there is."""
    return getattr(thing, next((n for n in names if hasattr(thing, n)), names[0]))


def task_of(name: str, preset: str | None = None) -> Any:
    return find("make_task")(name, preset)


def learner_of(task: Any, *, rule: str | None = None, **options: Any) -> Any:
    """A learner; `rule` as the command line takes it."""
    given = {} if rule is None else {"rule": find("make_rule")(rule)}
    return find("Learner")(task, **given, **options)


def state_of(learner: Any) -> Parts:
    """All of a learner at this moment, in all lanes; β and γ are those of the first."""
    names = (
        *("step", "weights", "traces", "potentials", "activities", "world", "totals", "memory"),
        *("beta", "gamma", "gamma_in_force", "fall", "frozen"),
    )
    return {name: first(learner, name) for name in names}


def frame_of(learner: Any) -> Parts:
    """The watched lane, and the sums since this was called last."""
    frame = learner.frame()
    if hasattr(learner, "start_summary"):
        learner.start_summary()
    names = (
        *("step", "activity", "before", "potential", "probability", "draw", "fired", "weight"),
        *("trace", "beta", "gamma", "step_size", "fall", "frozen", "memory", "world", "reward"),
    )
    since = first(frame, "since")
    sums = ("steps", "spikes", "potential_range", "probe_range", "weight_change")
    tallies = {"tally": frame.tally, "sums": since.tally}
    return {
        **{name: first(frame, name) for name in names},
        **{f"since {name}": first(since, name) for name in sums},
        **{name: (t.steps, t.reward, t.broadcast, t.ended) for name, t in tallies.items()},
    }


def block_of(block: Any) -> Parts:
    """Every step of a stretch."""
    names = ("start", "fired", "reward", "broadcast", "ended", "potential", "world")
    return {name: first(block, name) for name in names}


def run_of(learner: Any, name: str) -> Any:
    """A run with its log, keyframes and undo."""
    return find("Run", near="run")(learner, find("make_task"), name)


def change(name: str, *values: Any) -> Any:
    return find(name, near="command|change")(*values)


def reset(run: Any, seed: int) -> None:
    """Start again from another seed; once `Run.reset` took the page's command."""
    by_seed = "seed" in inspect.signature(run.reset).parameters
    run.reset(seed=seed) if by_seed else run.reset(change("Reset", seed))


def keyframes_of(run: Any) -> Any:
    return first(run, "tape", "keyframes")


def fork_of(run: Any, kind: str, value: float | None) -> Any:
    return find("Fork")(run, find("Difference")(kind, value))


def recorder_of(run: Any, path: Path) -> Any:
    target = find("FileTarget")(path)
    recorder = find("Recorder")(target, run, on_notice=_refuse)
    run.followers.append(recorder)
    return recorder


def _refuse(notice: str) -> None:
    raise RuntimeError(notice)


def rows_of(path: Path) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Entity, steps and columns of every table of a recording but its header."""
    trees = (
        *("spikes", "potentials", "reward", "weights", "traces"),
        *("hebbviz", "parameters", "episodes", "world", "events"),
    )
    for name, table in find("read_rows")(path, tuple(f"/{t}/**" for t in trees)).items():
        yield name, table.step, table.columns


def save(learner: Any, path: Path) -> None:
    find("save", near="files|saves")(learner, path)


def load(path: Path) -> Any:
    return find("load", near="files|saves")(path, find("make_task"))


def in_lanes(task: Any) -> Any:
    """The compiled twin of a task that is stepped in Python."""
    return task.in_lanes() if hasattr(task, "in_lanes") else find("in_lanes", "compiled_twin")(task)
