"""`hebbviz figure`: run what a figure needs, or go on with it, and write its files."""

from __future__ import annotations

import contextlib
import hashlib
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from tqdm import tqdm  # type: ignore[import-untyped]

from hebbviz import __version__
from hebbviz.sims.experiments import Curves, Interrupted, Plan, open_workers, run_all
from hebbviz.sims.figures.request import KINDS, Order
from hebbviz.sims.figures.run_length import steps_of
from hebbviz.sims.figures.sheet import Origin, Sheet, check_replaces, save
from hebbviz.sims.loading import make_task
from hebbviz.sims.program.compiling import announced_on_terminal
from hebbviz.sims.program.terminal import InputError, check_writable, reason
from hebbviz.sims.program.whole_folder import made_folder

_BEGUN = "{desc} has begun"
_BAR = "{desc} {percentage:3.0f} %|{bar}| {elapsed} gone, {remaining} left"
_DONE = "{desc} {percentage:3.0f} %|{bar}|"
_REDRAW_SECONDS, _LOG_SECONDS = 0.2, 15.0
"""Between two states of the bar, on a terminal and in a file."""


@dataclass(frozen=True)
class Work:
    """The means to do a figure's runs: their workers, their folder, and the event that stops them.

    `folder` holds unfinished work; it is removed once the figure is complete.
    """

    folder: Path
    stop: threading.Event = field(default_factory=threading.Event)
    progress: Callable[[float], object] = lambda _: None
    scheduler: str | None = None

    def part(self, first: float, last: float) -> Work:
        """The same, for what brings the progress from one fraction to another."""
        return replace(self, progress=lambda done: self.progress(first + (last - first) * done))

    def curves(self, plans: Sequence[Plan]) -> list[Curves]:
        """Learning curves of the plans; raises `experiments.Interrupted` once `stop` is set."""
        with open_workers(self.scheduler) as workers:
            return run_all(
                plans, workers, folder=self.folder, stop=self.stop, progress=self.progress
            )


def figure(name: str, out: str | Path = ".", **options: Any) -> dict[str, Any]:
    """Make one of the paper's figures in the folder `out`: PNG, SVG and CSV.

    `name` is one of `request.KINDS`; `options` are those of `hebbviz figure`, such as quick=True or
    lanes=16. Returns the figure's numbers and the paths of its files. Raises InputError for an
    option that the figure does not take, ValueError for a value out of range.
    """
    if name not in KINDS:
        raise InputError(f"there is no figure {name!r}; choose from {', '.join(KINDS)}")
    made = make(Order(name=name, out=Path(out), **options), threading.Event())
    assert made is not None, "nobody stops it"
    return made


def make(order: Order, stop: threading.Event) -> dict[str, Any] | None:
    """Make the figure of an order; returns what it comes to, fit for strict JSON.

    None once `stop` was set: what was done is kept. Raises InputError, ValueError, TaskError and
    OSError for what the user can mend.
    """
    kind = KINDS[order.name]
    steps_of(order, make_task(order.task or kind.task, order.preset), least=kind.least)
    with results_in(order.out):
        return _made(order, stop)


def _made(order: Order, stop: threading.Event) -> dict[str, Any] | None:
    check_replaces(order.out, order.file, order.command)
    began = time.perf_counter()
    folder = unfinished(order)
    try:
        with progress_bar(f"figure {order.name}") as progress:
            sheet = draw(order, Work(folder, stop, progress, order.scheduler))
    except Interrupted:
        return None
    files = save(sheet, order.out, order.file, Origin(order.command, order.seed))
    shutil.rmtree(folder, ignore_errors=True)
    return {
        "figure": order.name,
        "files": [str(path) for path in files],
        "command": order.command,
        "version": __version__,
        "seed": order.seed,
        "quick": order.quick,
        "seconds": time.perf_counter() - began,
        **sheet.numbers,
    }


@contextlib.contextmanager
def results_in(folder: Path) -> Iterator[None]:
    """Make the folder for results, and take it away again if none came.

    Raises InputError if nothing can be written there.
    """
    with contextlib.ExitStack() as made:
        try:
            made.enter_context(made_folder(folder))
        except OSError as error:
            raise InputError(
                f"cannot make the folder {folder}: {reason(error)}; choose another for --out"
            ) from error
        check_writable(folder)
        yield


def draw(order: Order, work: Work) -> Sheet:
    """Run and draw it, and say on a terminal if that begins with a minute of compiling."""
    with announced_on_terminal():
        sheet: Sheet = import_module(f"hebbviz.sims.figures.{order.name}").make(order, work)
    return sheet


def unfinished(order: Order) -> Path:
    """The folder for what is done of it, beside the files to come."""
    digest = hashlib.sha256(order.command.encode()).hexdigest()[:8]
    return order.out / f"{order.name}-unfinished-{digest}"


@contextlib.contextmanager
def progress_bar(name: str) -> Iterator[Callable[[float], object]]:
    """A bar on stderr with the time left.

    Its clock starts at the second fraction reported: compiling is over by then, and its duration
    does not predict the rest.
    """
    bars: list[Any] = []
    seconds = _REDRAW_SECONDS if sys.stderr.isatty() else _LOG_SECONDS

    def bar(fraction: float, looks: str, *, leave: bool) -> Any:
        return tqdm(
            desc=name,
            total=1.0,
            initial=fraction,
            bar_format=looks,
            leave=leave,
            file=sys.stderr,
            mininterval=seconds,
        )

    def show(fraction: float) -> None:
        if not bars:
            bars.append(bar(fraction, _BEGUN, leave=False))
        elif len(bars) == 1:
            bars[0].close()
            bars.append(bar(fraction, _BAR if fraction < 1.0 else _DONE, leave=True))
        else:
            bars[1].update(fraction - bars[1].n)

    try:
        yield show
    finally:
        for shown in bars:
            shown.close()
