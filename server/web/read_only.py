"""Read-only visitors: the messages that they may send, and the notice if they try more.

A reader's tab has all widgets of the page, but none of them moves anything except what is the
tab's own: its camera and its picks. The notice, and the true value, go to that tab alone.
"""

from __future__ import annotations

import asyncio
from typing import Any

import viser
from viser import _gui_handles as gui
from viser import _messages as viser_messages

from hebbviz.server.web.admission import (
    FromPage,
    GuiUpdateMessage,
    SceneNodeClickMessage,
    TabButtons,
    ViewerCameraMessage,
)
from hebbviz.server.web.refusal import Refused

LINE = "this link is read-only: nothing was changed"
STANDING = "**Read-only.** *Camera and picks are yours; somebody else controls the run.*"
SETTLE_SECONDS = 1.0
NOTICE_SECONDS = 4.0


def check(message: FromPage, target: Any, *, own: bool) -> None:
    """Refuse a reader's message unless it is about something of the tab's `own`."""
    looks = isinstance(message, ViewerCameraMessage | SceneNodeClickMessage)
    if not (looks or own or isinstance(target, TabButtons)):
        widget = target if isinstance(message, GuiUpdateMessage) else None
        raise Refused("reader", LINE, widget)


class Reader:
    """One reader's tab; lives in the server's event loop."""

    def __init__(self) -> None:
        self._untrue: dict[str, Any] = {}
        self._told = False

    def refuse(self, refused: Refused, client: viser.ClientHandle) -> None:
        """Tell this tab alone, and a little later show it what holds; at most once a second."""
        widget = refused.widget
        if isinstance(widget, gui._GuiInputHandle):
            self._untrue[widget._impl.uuid] = widget
        if not self._told:
            self._told = True
            client.add_notification("hebbviz", refused.line, auto_close_seconds=NOTICE_SECONDS)
            asyncio.get_running_loop().call_later(SETTLE_SECONDS, self._settle, client)

    def _settle(self, client: viser.ClientHandle) -> None:
        self._told = False
        for uuid, widget in self._untrue.items():
            if not widget._impl.removed:
                update = viser_messages.GuiUpdateMessage(uuid, {"value": widget.value})
                client._websock_connection.queue_message(update)
        self._untrue.clear()


def welcome(client: viser.ClientHandle) -> None:
    """Show on a reader's panel that it is read-only."""
    client.gui.add_markdown(STANDING, order=-1.0)
