"""Numbers as users type them: 1e6 may be a whole number, and errors explain commas."""

from __future__ import annotations

import contextlib
import re
from decimal import Decimal, InvalidOperation

_LARGEST_POWER = 30
"""Largest power of ten of a whole number; 1e999999999 would exhaust the memory."""


def whole(text: str) -> int:
    """Parse a whole number such as 1000, 1e3 or 1.5e6; raise ValueError for any other text."""
    with contextlib.suppress(ValueError):
        return int(text)
    try:
        value = Decimal(text)
    except InvalidOperation as error:
        raise ValueError(f"{text!r} is not a number") from error
    if not value.is_finite() or value.adjusted() > _LARGEST_POWER or value % 1:
        raise ValueError(f"{text!r} is not a whole number")
    return int(value)


def about_commas(text: str) -> str:
    """Return a hint about a comma in a number, after a semicolon; '' without a comma."""
    if re.fullmatch(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*", text):
        return "; leave the commas out"
    if re.fullmatch(r"\s*[+-]?\d*,\d+(e[+-]?\d+)?\s*", text, re.IGNORECASE):
        return f"; use a point: {text.strip().replace(',', '.')}"
    return ""
