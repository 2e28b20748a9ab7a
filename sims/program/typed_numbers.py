"""Numbers as people write them: 1e6 may be a whole one, and of a comma it is said what to do."""

from __future__ import annotations

import contextlib
import re
from decimal import Decimal, InvalidOperation

_LARGEST_POWER = 30
"""Of ten, in a whole number: beyond it nothing here goes, and 1e999999999 would take the memory."""


def whole(text: str) -> int:
    """A whole number, as 1000, 1e3 or 1.5e6; raises ValueError for anything else."""
    with contextlib.suppress(ValueError):
        return int(text)
    try:
        value = Decimal(text)
    except InvalidOperation as error:
        raise ValueError(f"{text!r} is no number") from error
    if not value.is_finite() or value.adjusted() > _LARGEST_POWER or value % 1:
        raise ValueError(f"{text!r} is no whole number")
    return int(value)


def about_commas(text: str) -> str:
    """What to do about a comma in what was to be one number, after a semicolon; else nothing."""
    if re.fullmatch(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*", text):
        return "; leave the commas out"
    if re.fullmatch(r"\s*[+-]?\d*,\d+(e[+-]?\d+)?\s*", text, re.IGNORECASE):
        return f"; use a point: {text.strip().replace(',', '.')}"
    return ""
