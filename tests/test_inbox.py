"""Commands come out in the order in which they came in, but for what waits and what is in vain."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from server.commands import Choose, Command, Pause, Reset, Seek, SetBeta
from server.inbox import Inbox

if TYPE_CHECKING:
    from collections.abc import Callable


class Compiling:
    """Stands for a preparation: it goes on until it is done."""

    def __init__(self, command: Command) -> None:
        self.command, self.done = command, False

    def is_alive(self) -> bool:
        return not self.done


def inbox(prepare: Callable[[Command], Any] = lambda _: None) -> Inbox:
    return Inbox(prepare)


def take(box: Inbox, *commands: Command) -> list[Command]:
    for command in commands:
        box.put(command)
    return list(box.take(0.0))


some = st.one_of(
    st.builds(Seek, st.integers(0, 3)),
    st.builds(Pause, st.booleans()),
    st.sampled_from([SetBeta(0.5), Reset(), Choose("synapse")]),
)


@given(st.lists(some))
def test_all_but_a_seek_before_a_seek_come_out_in_order(commands: list[Command]) -> None:
    followed = pairwise([*commands, None])
    left = [a for a, b in followed if not (isinstance(a, Seek) and isinstance(b, Seek))]
    assert take(inbox(), *commands) == left


def test_what_comes_after_one_that_waits_waits_too_but_for_pausing() -> None:
    begun: list[Compiling] = []

    def prepare(command: Command) -> Compiling | None:
        if isinstance(command, Choose):
            begun.append(Compiling(command))
            return begun[-1]
        return None

    box, pause = inbox(prepare), Pause(paused=True)
    first, second = Choose("synapse"), Choose("sonar")
    before, between, after = SetBeta(0.1), SetBeta(0.2), SetBeta(0.3)
    assert take(box, before, first, between, pause, second, after) == [before, pause]
    assert take(box, pause, Reset()) == [pause]
    begun[0].done = True
    assert take(box) == [first, between]
    assert box.preparation is begun[1]
    begun[1].done = True
    assert take(box) == [second, after, Reset()]
    assert box.preparation is None


def test_each_is_carried_out_before_the_next_is_looked_at() -> None:
    seen: list[tuple[str, Command]] = []
    box = inbox(lambda command: seen.append(("asked", command)))
    commands = [Reset(), SetBeta(0.5), Pause(paused=True)]
    for command in commands:
        box.put(command)
    for command in box.take(0.0):
        seen.append(("done", command))  # noqa: PERF401
    assert seen == [(what, c) for c in commands for what in ("asked", "done")]


def test_one_that_breaks_loses_none_of_those_after_it() -> None:
    box = inbox()
    for command in (Reset(), SetBeta(0.5)):
        box.put(command)
    assert next(box.take(0.0)) == Reset()
    assert take(box) == [SetBeta(0.5)]


def test_an_empty_inbox_is_woken() -> None:
    box = inbox()
    box.wake()
    assert list(box.take(10.0)) == []
