"""The sonar task inside one training set, and with splits that are given: for nested selection.

In each split of the 208 patterns a setting is chosen by runs that see the split's training set
alone: they learn from three quarters of it, and the rest validates. Then a run with that setting
learns from all of it, and only that run meets the test set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hebbviz.numerics.counter_rng import Draws
from hebbviz.sims.worlds.sonar import TRAINING, Sonar

Array = NDArray[np.float64]

VALIDATION = 47
"""Patterns that validate a setting: a quarter of the training set, rounded."""


class Inner(Sonar):
    """Lane k learns from the first 140 patterns of the training set that lane k of `Sonar` has; the
    other 47 are held out. Its test set is never shown.
    """

    training = TRAINING - VALIDATION
    held_out = VALIDATION
    frozen_figures = ("training_error", "validation_error")


class Outer(Sonar):
    """Lane `first_lane` + k has the split of lane `splits[k]` of `Sonar`, all else being its own.

    Its setting was chosen without its test set, so what it does there is a test error.
    """

    def __init__(
        self, preset: str | None = None, *, first_lane: int = 0, splits: Sequence[int] = ()
    ) -> None:
        super().__init__(preset)
        self.frozen_figures = ("training_error", "test_error")
        self._first_lane, self._splits = first_lane, tuple(splits)

    def restart(self, draws: Callable[[int], Array]) -> Array:
        assert isinstance(draws, Draws)
        split = self._splits[draws.lane - self._first_lane]
        return super().restart(Draws(draws.seed, split, draws.step, draws.purpose))
