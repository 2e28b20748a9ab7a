"""Text for a mean time to an event: the estimate, the number of events, the 95 % interval."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hebbviz.task.base import Measure


def told(
    measure: Measure, estimate: tuple[float, float, float, float], write: Callable[[float], str]
) -> str:
    """An estimate (value, events, low, high) as text; `write` formats a time."""
    value, events, low, high = estimate
    if not events:
        return f"over {write(low)} (no {measure.event}, 95 %)"
    return f"{write(value)} ({count(measure, events)}; 95 %: {write(low)} to {write(high)})"


def count(measure: Measure, events: float) -> str:
    """1 fall, 2,345 falls."""
    return f"{events:,.0f} {measure.event}{'s' * (events != 1)}"


def lanes_without(measure: Measure, values: NDArray[np.float64]) -> str:
    """The number of lanes without an event, as text; `values` (lanes,) are their estimates."""
    none = int(np.isinf(values).sum())
    return f"no {measure.event} in {none} of {values.size} lanes" if none else ""
