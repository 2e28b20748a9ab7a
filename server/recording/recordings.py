"""The recordings of a program: one into a file, and one for viewers that connect."""

# ruff: noqa: PLC0415  # rerun is slow to import: only who records waits for it

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hebbviz.rules.base import Rule
from hebbviz.server.recording.header import check_recordable
from hebbviz.server.recording.status import Status
from hebbviz.server.run import thinning
from hebbviz.server.run.run import Run

if TYPE_CHECKING:
    from hebbviz.server.recording.recorder import Recorder
    from hebbviz.server.recording.targets import Target

DEFAULT_FOLDER = "hebbviz-recordings"


@dataclass(frozen=True)
class Options:
    """Options for recording from the start.

    `file` to record into, `stream` the port to serve viewers on, `budget` in bytes a minute,
    `folder` for recordings started on the page.
    """

    file: Path | None = None
    stream: int | None = None
    budget: int = thinning.DEFAULT_BUDGET
    detail: str = thinning.FULL
    folder: Path = Path(DEFAULT_FOLDER)


class Recordings:
    """Starts and stops recordings; those in the options start at once.

    Raises OSError; FileExistsError if the file exists.
    """

    def __init__(self, run: Run, options: Options, *, on_notice: Callable[[str], None]) -> None:
        self._run, self._options, self._notice = run, options, on_notice
        self.folder = options.folder
        self._begun: list[Recorder] = []
        self._file: Recorder | None = None
        self.stream_url: str | None = None
        if options.stream is not None:  # first: if its port is taken, no file is created
            self._start_stream(options.stream)
        if options.file is not None:
            self.start(options.file)

    def start(self, path: str | Path) -> None:
        """Record into a new file; raises OSError; FileExistsError if it exists.

        Raises ValueError while another recording is running.
        """
        if self.is_on:
            raise ValueError("a recording is already running: stop it first")
        self.stop()  # one that stopped by itself still follows the run
        from hebbviz.server.recording.targets import FileTarget

        self._file = self._begin(FileTarget(path))

    def start_named(self, name: str) -> None:
        """Record into the folder for recordings; a plain file name, as a page may give."""
        if not re.fullmatch(r"[\w][\w .+=-]{0,99}", name):
            raise ValueError(
                f"a recording's name has letters, digits, spaces or . + = - _, got {name[:40]!r}"
            )
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self.start(self.folder / name)
        except FileExistsError:
            raise ValueError(f"a recording {name!r} exists already: choose another name") from None
        except OSError as error:
            raise ValueError(
                f"cannot record in {self.folder}: {error.strerror or error}"
            ) from error

    def stop(self) -> None:
        """Finish the recording into a file."""
        if self._file is not None and self._file in self._run.followers:
            self._run.followers.remove(self._file)
            self._file.close(self._run)

    def close(self) -> bool:
        """Finish all; returns whether the disk still blocks one of their threads."""
        if not self._begun:
            return False
        from hebbviz.server.recording.segment import CLOSE_SECONDS

        going_on = [r for r in self._begun if r in self._run.followers]
        for recorder in going_on:
            self._run.followers.remove(recorder)
            recorder.leap(self._run, "it was stopped")
        for recorder in going_on:
            recorder.wait_until_begun()
        until = time.monotonic() + CLOSE_SECONDS
        for recorder in going_on:
            recorder.close(self._run, seconds=max(0.0, until - time.monotonic()))
        return any(r.is_stuck for r in self._begun)

    @property
    def is_on(self) -> bool:
        """Whether a recording into a file is running."""
        on = self._file is not None and self._file in self._run.followers
        return on and self.status is not None and self.status.error is None

    def check_rule(self, rule: Rule) -> None:
        """Raise ValueError if a recording is running that does not allow this rule."""
        if any(r in self._run.followers and r.status.error is None for r in self._begun):
            check_recordable(rule)

    @property
    def status(self) -> Status | None:
        """The status of the latest recording into a file."""
        return None if self._file is None else self._file.status

    def _start_stream(self, port: int) -> None:
        from hebbviz.server.recording.targets import StreamTarget

        target = StreamTarget(port, on_refused=self._notice)
        self._begin(target)
        self.stream_url = target.url

    def _begin(self, target: Target) -> Recorder:
        from hebbviz.server.recording.recorder import Recorder

        recorder = Recorder(
            target,
            self._run,
            budget=self._options.budget,
            detail=self._options.detail,
            on_notice=self._notice,
        )
        self._run.followers.append(recorder)
        goes_on = (r for r in self._begun if r in self._run.followers or r.is_stuck)
        self._begun = [*goes_on, recorder]
        return recorder
