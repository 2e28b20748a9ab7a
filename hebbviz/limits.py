"""Bounds of a learner's parameters, and checks whose errors name the value and the bound."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

LARGEST_BETA = math.nextafter(1.0, 0.0)
"""The largest β below 1. float32 rounds it, like every β within 3e-8 of 1, to 1."""
LARGEST_GAMMA = 1e3
LARGEST_FALL = 1e15
LARGEST_REWARD = 1e6
MOST_LANES = 4096
MOST_STEPS = 10**12
LAST_STEP = 2**62
"""Upper bound of step numbers, so that 64-bit counters never overflow."""


class CompilerOff(ImportError):
    """The compiler is disabled; no network runs without it."""


def check_beta(beta: float) -> float:
    """Return β as a float; raise ValueError unless it is a number in [0, 1)."""
    if not _is_number(beta) or not 0.0 <= beta < 1.0:
        raise ValueError(f"beta must be in [0, 1), got {beta!r}")
    return float(beta)


def check_gamma(gamma: float) -> float:
    """Return γ as a float; raise ValueError unless it is a number from 0 to LARGEST_GAMMA."""
    if not _is_number(gamma) or not 0.0 <= gamma <= LARGEST_GAMMA:
        raise ValueError(
            f"gamma (the step size) must be from 0 to {LARGEST_GAMMA:g}, got {gamma!r}"
        )
    return float(gamma)


def check_fall(fall: float) -> float:
    """Return the step-size decay time in steps.

    Raises ValueError unless it is from 1 to LARGEST_FALL, or infinite for no decay.
    """
    if fall != math.inf and not (_is_number(fall) and 1.0 <= fall <= LARGEST_FALL):
        raise ValueError(
            f"fall (the steps over which gamma falls) must be from 1 to {LARGEST_FALL:g}, or "
            f"infinity (never), got {fall!r}"
        )
    return float(fall)


def fall_to_json(fall: float) -> float | None:
    """Return the decay time for JSON, which has no infinity: None where γ is constant."""
    return None if math.isinf(fall) else fall


def fall_from_json(said: float | None) -> float:
    """Return the decay time that `fall_to_json` wrote."""
    return math.inf if said is None else said


def check_reward(reward: float) -> float:
    """Return the reward as a float; raise ValueError unless it is within ±LARGEST_REWARD."""
    if not _is_number(reward) or abs(reward) > LARGEST_REWARD:
        raise ValueError(f"reward must be a number within ±{LARGEST_REWARD:g}, got {reward!r}")
    return float(reward)


def check_lane(lane: int, lanes: int) -> int:
    """Return the lane; raise ValueError unless it is from 0 to `lanes` − 1."""
    if not 0 <= lane < lanes:
        raise ValueError(f"lane must be from 0 to {lanes - 1}, got {lane}")
    return lane


def check_places(what: str, places: Any, end: float) -> None:
    """Raise ValueError unless all places are whole numbers from 0 to below `end`."""
    values = np.asarray(places)
    if not ((values >= 0) & (values < end) & (values == np.floor(values))).all():
        raise ValueError(f"{what} must be a whole number from 0 to before {end:g}")


def check_step(step: int) -> int:
    """Return the step number; raise ValueError unless it is from 0 to below LAST_STEP."""
    if not 0 <= step < LAST_STEP:
        raise ValueError(f"step must be from 0 to before 2⁶², got {step}")
    return step


def check_dtype(dtype: Any) -> type[np.floating[Any]]:
    """Return np.float32 or np.float64 for a type or its name; raise ValueError otherwise."""
    for known in (np.float32, np.float64):
        if dtype in (known, known.__name__):
            return known
    raise ValueError(f"dtype must be float32 or float64, got {dtype!r}")


def check_steps(steps: int) -> int:
    """Return the number of steps; raise ValueError if it is negative."""
    if steps < 0:
        raise ValueError(f"steps must not be negative, got {steps}")
    return steps


def _is_number(value: object) -> bool:
    return (
        isinstance(value, (int, float, np.integer, np.floating))
        and not isinstance(value, bool)
        and math.isfinite(value)
    )
