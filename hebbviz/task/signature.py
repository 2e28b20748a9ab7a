"""The signature of a compiled world's step, `CompiledTask.answer`."""

from __future__ import annotations

from numba import types

PER_LANE = types.Array(types.float64, 1, "C")
STATE = types.Array(types.float64, 2, "C")
KEYS = types.Array(types.uint32, 2, "C")

WORLD = types.int64(STATE, STATE, STATE, KEYS, types.int64, STATE, PER_LANE, PER_LANE)
"""A compiled world's step: (world, action, data, keys, step, observation, reward, ended).

`world` (rows, lanes) is its state and is changed in place; `action` (outputs, lanes) holds the
outputs' activities; `data` the constants of the task. It writes `observation` (inputs, lanes),
`reward` (lanes) and `ended` (lanes; 1 where an episode ended), zeros at first, where they differ
from those of the step before, and returns 1 if any input changed, else 0.
"""
