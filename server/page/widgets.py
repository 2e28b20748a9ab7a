"""Shared by all controls: a widget sends a command, and follows the run's state.

One run serves all tabs, so a widget shows the run's state, whoever changed it. A callback only
makes a command; if a value is refused, a notice says so and the widget returns to the current
value.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser
from viser._messages import GuiUpdateMessage
from viser._threadpool_exceptions import print_threadpool_errors

from hebbviz.server.live.commands import Command
from hebbviz.server.live.snapshot import Snapshot

QUIET_SECONDS = 2.5
"""A widget that the user just moved is not reset to the run's value before this time."""

Send = Callable[[Command], None]
Notify = Callable[[str], None]


class Widgets:
    """Connects widgets of one panel to commands, and leaves widgets in use alone."""

    def __init__(self, gui: viser.GuiApi, send: Send, notify: Notify) -> None:
        self.gui, self._send, self._notify = gui, send, notify
        self._touched: dict[str, float] = {}
        self._put_before: dict[str, Any] = {}
        self._holds: dict[str, Any] = {}
        self._snapshot: Snapshot | None = None

    @property
    def snapshot(self) -> Snapshot:
        """The current snapshot; raises ValueError before there is one."""
        if self._snapshot is None:
            raise ValueError("the run is still starting: try again in a moment")
        return self._snapshot

    def follow(self, snapshot: Snapshot) -> None:
        """Store the current snapshot, before any widget is updated."""
        if self._snapshot is not None and self._snapshot.run.number != snapshot.run.number:
            self._touched.clear()  # an undo or a reset makes earlier input obsolete
        self._snapshot = snapshot

    def when(self, handle: Any, command: Callable[[Any], Command | None]) -> None:
        """Send the command that `command` makes from a widget's new value, when a page changed it.

        A page sends typed text on Enter or when the field loses focus (`style`). If a value is
        refused, empty or unchanged, the field returns to the current value.
        """
        key = _key(handle)

        def changed(value: Any) -> None:
            if value == "" or not self.attempt(lambda: command(value)):
                self._put_back(handle)

        def arrived(value: Any) -> None:
            self._touched[key] = time.monotonic()
            self._put_before.pop(key, None)
            self.gui._thread_executor.submit(changed, value).add_done_callback(  # noqa: SLF001
                print_threadpool_errors
            )

        _on_arrival(handle, arrived)

    def press(self, handle: Any, command: Callable[[], Command | None]) -> None:
        """Send a command when a button is pressed."""
        handle.on_click(lambda _: self.attempt(command))

    def key(self, label: str, key: Any, command: Callable[[], Command | None]) -> Any:
        """Send a command when a key is pressed, or its label chosen in the list of commands."""
        handle = self.gui.add_command(label, hotkey=key)

        def act(_: Any) -> None:
            self.attempt(command)

        handle.on_trigger(act)
        return handle

    def attempt(self, command: Callable[[], Command | None]) -> bool:
        """Make a command and send it; returns whether there is one. A refusal becomes a notice."""
        try:
            made = command()
        except ValueError as error:
            self._notify(str(error))
            return False
        if made is not None:
            self._send(made)
        return made is not None

    def _put_back(self, handle: Any) -> None:
        """Show the current value again, also on a page where another value was typed."""
        key = _key(handle)
        if key in self._holds:
            self._touched.pop(key, None)
            self._put_before[key] = self._holds[key]
            assign(handle, "value", self._holds[key])
            _tell_again(handle)

    def put(self, handle: Any, value: Any, *, quiet: float = QUIET_SECONDS) -> None:
        """Set a widget to the current value, if that has changed or the user touched the widget
        lately.

        A widget that merely differs is left alone: somebody may be using it.
        """
        key = _key(handle)
        self._holds[key] = value
        touched = self._touched.get(key)
        if touched is not None:
            if time.monotonic() - touched < quiet:
                return
            self._touched.pop(key, None)
            if handle.value == value:
                _tell_again(handle)
        elif self._put_before.get(key) == value:
            return
        self._put_before[key] = value
        assign(handle, "value", value)


def _key(handle: Any) -> str:
    """A key that no other widget ever has."""
    uuid: str = handle._impl.uuid  # noqa: SLF001
    return uuid


def _on_arrival(handle: Any, act: Callable[[Any], None]) -> None:
    """Call `act` with each value that a page sends, at once, in the thread of the server.

    viser's own callbacks run later in another thread, and read there what the widget has been set
    to meanwhile: what was typed would be lost.
    """
    impl = handle._impl  # noqa: SLF001
    sync = impl.sync_cb

    def arrived(client: Any, updates: dict[str, Any]) -> None:
        if sync is not None:
            sync(client, updates)
        if "value" in updates:
            act(updates["value"])

    impl.sync_cb = arrived


def _tell_again(handle: Any) -> None:
    """Send pages the value that a widget has here: the user's input may have crossed an earlier
    update, and viser does not send an unchanged value.
    """
    impl = handle._impl  # noqa: SLF001
    update = GuiUpdateMessage(impl.uuid, {"value": impl.value})
    impl.gui_api._websock_interface.queue_message(update)  # noqa: SLF001


def assign(handle: Any, name: str, value: Any) -> None:
    """Assign only what differs: each assignment is a message to every tab."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)
