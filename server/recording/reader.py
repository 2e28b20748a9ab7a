"""Reading a recording: its description of the run, and the run itself, ready for replay."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hebbviz.learner.frames import Keyframe
from hebbviz.learner.learner import Learner
from hebbviz.rules.base import Rule
from hebbviz.rules.paper import PAPER
from hebbviz.server.recording import rrd_format
from hebbviz.server.recording.header import BadRecording, Header, change_from_json, known_rule
from hebbviz.server.recording.kept_steps import Stored
from hebbviz.server.recording.tables import Table, read, readable
from hebbviz.server.run.changes import Logged
from hebbviz.server.run.history import History, Totals
from hebbviz.server.run.keyframes import MOST_BYTES, Moment, Tape
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import MakeTask, make_task
from hebbviz.task.base import Tally, Task

Array = NDArray[np.float64]

RUN, KEYFRAMES, CHANGES = "/__properties/run", "/hebbviz/keyframe", "/hebbviz/change"
EDGES, SUMS, END = "/hebbviz/edge", "/hebbviz/aggregate", "/hebbviz/end"
MOST_AHEAD = 10**9
"""Most steps after the last keyframe: opening the recording recomputes them."""
SKELETON = (RUN, KEYFRAMES, CHANGES, EDGES, SUMS, END)


@dataclass(frozen=True)
class Recording:
    """A recording without its bulk data.

    `moments` are its keyframes, `log` the changes, `edges` the totals at the edges of the learning
    curve's windows, `last_step` the last step with any data, `ending` why the recording ended, None
    if it was interrupted; `is_cut`: a part of the file is missing.
    """

    path: Path
    header: Header
    moments: tuple[Moment, ...]
    log: tuple[Logged, ...]
    edges: tuple[Tally, ...]
    last_step: int
    ending: str | None
    is_cut: bool

    @property
    def notice(self) -> str | None:
        """A notice about an incomplete recording, or None."""
        if self.is_cut:
            return f"{self.path} is truncated: it is shown up to its last complete piece"
        if self.ending is None:
            return f"the recording in {self.path} was interrupted: it is shown up to its last step"
        return None

    def history(self) -> History:
        """The learning curve."""
        made = History.of(self.header.window, [Totals.of_one(t) for t in self.header.edges])
        for total in self.edges:
            made.add(Totals.of_one(total))
        return made

    def run(
        self,
        make_task: MakeTask = make_task,
        task: Task | None = None,
        task_name: str | None = None,
    ) -> Run:
        """The run at its last step, with everything needed to go back in it.

        `make_task` makes tasks by name and preset; `task` is the recorded one, by default made from
        the header. Raises BadRecording if the recording does not fit the task.
        """
        header = self.header
        task = make_task(header.task, header.preset) if task is None else task
        try:
            learner = Learner.of(task, header.settings)
            learner.restore(self.moments[-1].keyframe)
        except ValueError as error:
            raise BadRecording(f"{self.path} does not fit task {header.task!r}: {error}") from error
        self._go_to_end(learner)
        run = Run(learner, make_task, task_name or header.task)
        run.log, run.history = list(self.log), self.history()
        run.tape = Tape(self.moments, most_bytes=MOST_BYTES)
        run.stored = Stored(self.path, header.topology, header.other_now(task))
        return run

    def _go_to_end(self, learner: Learner) -> None:
        """Advance from the last keyframe to the last recorded step."""
        for logged in self.log[self.moments[-1].logged :]:
            learner.skip(max(0, logged.step - learner.step))
            logged.change.apply(learner)
        learner.skip(max(0, self.last_step - learner.step))


def open_recording(path: str | Path) -> Recording:
    """Read a recording, up to its last complete piece.

    Raises BadRecording, with one line, if the file is damaged or no recording, OSError if it cannot
    be read.
    """
    path = Path(path)
    return readable(path, lambda: _open(path))


def _open(path: Path) -> Recording:
    try:
        extent = rrd_format.extent(path)
    except ValueError as error:
        raise BadRecording(f"{error}: name a .rrd file that hebbviz recorded") from error
    tables = read(path, extent.size, SKELETON)
    header = _header(tables.get(RUN), may_follow=not extent.has_end)
    moments = _moments(tables.get(KEYFRAMES))
    if not moments:
        raise BadRecording("it was interrupted before its first keyframe")
    if not header.topology.fits_in(len(moments[-1].keyframe.network)):
        raise BadRecording("it is damaged (its keyframes do not fit its network)")
    log = (*header.log, *_changes(tables.get(CHANGES)))
    if any(m.logged > len(log) for m in moments):
        raise BadRecording("it is damaged (a change is missing)")
    edges = _edges(tables.get(EDGES))
    sums = tables.get(SUMS)
    last = max(moments[-1].step, int(sums.step[-1]) if sums else 0, *(c.step for c in log), 0)
    if last > moments[-1].step + MOST_AHEAD:
        raise BadRecording("it is damaged (it has steps far beyond its last keyframe)")
    end = tables.get(END)
    return Recording(
        path,
        header,
        moments,
        log,
        edges,
        last,
        str(end.columns["reason"][0]) if end else None,
        extent.is_cut,
    )


def _header(table: Table | None, *, may_follow: bool) -> Header:
    """`may_follow`: the file is incomplete, so a header may be in the missing part."""
    if table is None and may_follow:
        raise BadRecording(
            "it was truncated before its header, so nothing can be read: get the complete file "
            "again"
        )
    if table is None or "header" not in table.columns:
        raise BadRecording("it is a recording of another program, not of hebbviz")
    return Header.from_json(table.columns["header"][0])


def _moments(table: Table | None) -> tuple[Moment, ...]:
    """The keyframes, each checked against its checksum."""
    if table is None:
        return ()
    c = table.columns
    moments = []
    for k, step in enumerate(table.step.tolist()):
        network, world, gamma = (_lane(c[n][k]) for n in ("network", "world", "gamma"))
        rule: Rule = PAPER
        memory, fall = np.zeros((0, 1)), math.inf
        if "rule" in c:
            rule, memory = known_rule(c["rule"][k]), _lane(c["memory"][k])
            fall = float(c["fall"][k][0])
        keyframe = Keyframe(step, network, world, gamma, bool(c["frozen"][k]), rule, memory, fall)
        if keyframe.digest() != c["digest"][k]:
            raise BadRecording(f"its keyframe at step {step:,} was changed: its checksum is wrong")
        moments.append(Moment(keyframe, int(c["logged"][k][0])))
    return tuple({m.step: m for m in moments}.values())


def _lane(numbers: Any) -> Array:
    """The numbers of one lane, (numbers, 1)."""
    return np.array(numbers, dtype=np.float64)[:, None]


def _changes(table: Table | None) -> tuple[Logged, ...]:
    if table is None:
        return ()
    return tuple(change_from_json(json.loads(text)) for text in table.columns["json"])


def _edges(table: Table | None) -> tuple[Tally, ...]:
    if table is None:
        return ()
    totals = zip(*(table.columns[n][:, 0] for n in ("reward", "broadcast", "ended")), strict=True)
    return tuple(
        Tally(step, *map(float, total))
        for step, total in zip(table.step.tolist(), totals, strict=True)
    )
