"""β and γ as they were in force at any step of a recording, from what it says of its changes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hebbviz.engine.loop import gamma_in_force
from hebbviz.server.recording.reader import Recording
from hebbviz.server.run.changes import Change, Freeze, Logged, SetBeta, SetFall, SetGamma

Array = NDArray[np.float64]


class _Set(NamedTuple):
    """The settings that β and γ in force follow from."""

    beta: float
    gamma: float
    fall: float = math.inf
    frozen: bool = False

    def after(self, change: Change) -> _Set:
        match change:
            case SetBeta(beta):
                return self._replace(beta=beta)
            case SetGamma(gamma):
                return self._replace(gamma=gamma)
            case SetFall(fall):
                return self._replace(fall=fall)
            case Freeze(frozen):
                return self._replace(frozen=frozen)
        return self


def in_force(recording: Recording, step: NDArray[np.int64]) -> tuple[Array, Array]:
    """β and γ, each (n,), with which the steps (n,) were made; γ is 0 while learning is frozen.

    Steps are numbered as in the recording, so a change before step k counts from row k + 1 on.
    """
    header, first = recording.header, recording.moments[0]
    begun = _Set(header.beta, header.gamma, header.fall, first.keyframe.frozen)
    log = recording.log[first.logged :]
    changed = np.array([logged.step for logged in log], dtype=np.int64)
    settings = np.array(_settings(begun, log), dtype=np.float64)
    beta, gamma, fall, frozen = settings[np.searchsorted(changed, step)].T
    made = np.maximum(step - 1, 0)
    return beta, np.where(frozen > 0, 0.0, gamma_in_force(gamma, made, fall))


def _settings(begun: _Set, log: Sequence[Logged]) -> list[_Set]:
    """The initial settings, and those after each change."""
    settings = [begun]
    for logged in log:
        settings.append(settings[-1].after(logged.change))
    return settings
