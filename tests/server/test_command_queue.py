"""Commands come out in the order in which they came in, but for what waits and what is vain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hypothesis import given
from hypothesis import strategies as st

from hebbviz.server.live.command_queue import MOST_WAITING, SETTINGS, Inbox
from hebbviz.server.live.commands import Choose, Command, Pause, Reset, Seek, SetWatch
from hebbviz.server.run.changes import GiveReward, SetBeta, SetGamma

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
    st.builds(SetBeta, st.sampled_from([0.1, 0.2])),
    st.builds(SetGamma, st.sampled_from([0.1, 0.2])),
    st.sampled_from([Reset(), Choose("synapse")]),
)


def stretches(commands: list[Command]) -> list[list[Command]]:
    """Cut where something else than a setting of the same group comes."""
    cut: list[list[Command]] = []
    group: object = None
    for command in commands:
        of = next((g for g in SETTINGS if type(command) in g), None)
        if of is None or of is not group:
            cut.append([])
        cut[-1].append(command)
        group = of
    return cut


@given(st.lists(some))
def test_the_last_of_each_setting_wins_and_all_else_comes_out_in_order(
    commands: list[Command],
) -> None:
    left: list[Command] = []
    for stretch in stretches(commands):
        last = {type(c): k for k, c in enumerate(stretch)}
        left += [stretch[k] for k in sorted(last.values())]
    assert take(inbox(), *commands) == left


def test_settings_in_turn_leave_one_of_each_however_many_come() -> None:
    box = inbox()
    for k in range(100_000):
        box.put(SetBeta(k / 100_000))
        box.put(SetGamma(k / 100_000))
    assert len(box) == 2
    assert list(box.take(0.0)) == [SetBeta(0.99999), SetGamma(0.99999)]
    assert box.count_lost() == 0


def test_it_is_bounded_and_counts_what_was_lost() -> None:
    box = inbox()
    for _ in range(MOST_WAITING + 50):
        box.put(GiveReward(1.0))
    assert len(box) == MOST_WAITING
    assert list(box.take(0.0)) == [GiveReward(1.0)] * MOST_WAITING
    assert (box.count_lost(), box.count_lost()) == (50, 0)


def test_what_comes_after_one_that_waits_waits_too_but_for_pausing() -> None:
    begun: list[Compiling] = []

    def prepare(command: Command) -> Compiling | None:
        if isinstance(command, Choose):
            begun.append(Compiling(command))
            return begun[-1]
        return None

    box, pause = inbox(prepare), Pause(paused=True)
    first, second = Choose("synapse"), Choose("sonar")
    before, between, after = SetWatch(on=True), SetBeta(0.2), SetBeta(0.3)
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
