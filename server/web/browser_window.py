"""Opening the user's browser, where there is one to open."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import webbrowser


def open_window(address: str) -> None:
    """Show an address in the user's browser; it may take its time, and nothing waits for it."""
    if has_display():
        threading.Thread(target=_open, args=(address,), daemon=True).start()


def has_display() -> bool:
    """Whether a browser window could be opened."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _open(address: str) -> None:
    with contextlib.suppress(Exception):  # the address is on the terminal
        webbrowser.open(address)
