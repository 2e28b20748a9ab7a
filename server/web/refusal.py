"""Refusals, and one-line representations of arbitrary values in them."""

from __future__ import annotations

import reprlib
from typing import Any

MAX_SHOWN = 40


class Refused(Exception):
    """Something that must not pass. `widget` is set where a widget's value is at stake."""

    def __init__(self, kind: str, line: str, widget: Any = None) -> None:
        super().__init__(line)
        self.kind, self.line, self.widget = kind, line, widget


_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = MAX_SHOWN


def shown(value: object) -> str:
    """The value on one line of at most 40 characters, however large or strange it is."""
    return _short.repr(value)[:MAX_SHOWN]
