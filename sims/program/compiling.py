"""Compilation before a run starts, with an announcement if it takes long."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, Any

from numba.core import event

from hebbviz.sims.program.terminal import tell

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hebbviz.learner.learner import Learner


class _Announcement(event.Listener):
    def __init__(self, say: Callable[[], None]) -> None:
        self._say: Callable[[], None] | None = say

    def on_start(self, _: Any) -> None:
        if self._say is not None:
            self._say()
            self._say = None

    def on_end(self, _: Any) -> None:
        pass


@contextlib.contextmanager
def announced_compiling(say: Callable[[], None]) -> Iterator[None]:
    """Call `say` once if numba compiles something in this context; cached code is only loaded."""
    with event.install_listener("numba:compile", _Announcement(say)):
        yield


@contextlib.contextmanager
def announced_on_terminal() -> Iterator[None]:
    """Announce compilation on stderr, if that is a terminal."""

    def say() -> None:
        if sys.stderr.isatty():
            tell("compiling for this machine, only this first time")

    with announced_compiling(say):
        yield


def warm_up(learner: Learner) -> None:
    """Compile everything that a run of `learner` needs, without changing it."""
    twin = learner.twin()
    twin.skip(2)
    twin.advance(2)
    twin.frame()
