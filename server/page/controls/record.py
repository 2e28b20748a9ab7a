"""The folder that records a run into a file, and shows its progress."""

from __future__ import annotations

import html
import re
import time
from pathlib import Path

import viser

from hebbviz.server.live.commands import Command, StartRecording, StopRecording
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.page import status_text
from hebbviz.server.page.widgets import Widgets, assign
from hebbviz.server.recording.status import Status
from hebbviz.sims.figures import palette


class Record:
    """Name a file, start and stop its recording, and see what it holds."""

    def __init__(self, widgets: Widgets) -> None:
        self._ui, gui = widgets, widgets.gui
        self._offered_for: tuple[object, ...] = ()
        with gui.add_folder("Record", expand_by_default=False):
            self.name = gui.add_text("file", "", hint="a name, without a folder")
            self.button = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
            self.says = gui.add_markdown("")
        self._ui.press(self.button, self._toggle)

    def follow(self, snapshot: Snapshot) -> None:
        """Show what is recorded; offer a free name until one is typed."""
        on = snapshot.recording.is_on
        if on != (self.button.label != "Record"):
            self.button.label = "Stop recording" if on else "Record"
            self.button.icon = viser.Icon.PLAYER_STOP if on else viser.Icon.PLAYER_RECORD
            self.button.color = "red" if on else None
        assign(self.name, "disabled", on)
        offered_for = (snapshot.run.task_name, on)
        if offered_for != self._offered_for and not on:
            assign(
                self.name,
                "value",
                free_name(Path(snapshot.recording.folder), snapshot.run.task_name),
            )
        self._offered_for = offered_for
        assign(self.says, "content", said(snapshot))

    def _toggle(self) -> Command:
        if self._ui.snapshot.recording.is_on:
            return StopRecording()
        return StartRecording(self.name.value.strip())


def free_name(folder: Path, task: str) -> str:
    """An unused file name made of the task, the date and the time."""
    stem = f"{re.sub(r'[^A-Za-z0-9_-]', '-', task)}-{time.strftime('%Y-%m-%d-%H%M')}"
    names = (f"{stem}{end}.rrd" for end in ("", *(f"-{k}" for k in range(2, 100))))
    return next((name for name in names if not (folder / name).exists()), f"{stem}.rrd")


def said(snapshot: Snapshot) -> str:
    """The recording's place and size, and how to see it live."""
    lines = []
    if snapshot.recording.status is not None:
        lines.append(_status(snapshot.recording.status, on=snapshot.recording.is_on))
    else:
        lines.append(f"into the folder {_code(snapshot.recording.folder)}")
    if snapshot.recording.stream_url is not None:
        lines.append(
            f"see it live in rerun's viewer: {_code(f'rerun {snapshot.recording.stream_url}')}"
        )
    return "\n\n".join(lines)


def _status(status: Status, *, on: bool) -> str:
    if status.error is not None:
        red = palette.css(palette.PUNISHMENT)
        return f"<span style='color:{red}'>the recording failed: {html.escape(status.error)}</span>"
    state = "recording into" if on else "recorded in"
    return (
        f"{state} {_code(status.where)}  \n{status_text.clock(status.seconds)}, "
        f"{status_text.recorded(status)}"
        f"\n\n*{status.rule}*"
    )


def _code(text: str) -> str:
    """Text from outside, verbatim."""
    return "`" + text.replace("`", "'") + "`"
