"""What is typed into the page becomes one command, of the whole. No browser: a client types."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
from raw_client import RawClient, wait_until

from hebbviz.learner import Learner
from server import controls, guard, widgets
from server.commands import Command, SetBeta, SetGamma, SetSpeed
from server.controls import Controls
from server.widgets import Widgets
from sims import TASKS
from sims.loading import make_task


class Timer:
    """One that goes off when it is told to."""

    daemon = False

    def __init__(self, _: float, act: Callable[[], None]) -> None:
        self.act = act
        self.is_cancelled = False

    def start(self) -> None:
        Panel.timers.append(self)

    def cancel(self) -> None:
        self.is_cancelled = True


@dataclass(frozen=True)
class Panel:
    """The controls of a run that stands still, and what came of what was done there."""

    timers: ClassVar[list[Timer]] = []
    controls: Controls
    widgets: Widgets
    client: RawClient
    sent: list[Command]
    notices: list[str]

    def type(self, label: str, text: str) -> None:
        """A key after the other, as a page sends them, and then nothing for a while."""
        widget = self.client.find(label)
        for keys in range(len(text) + 1):
            self.client.send_value(widget, text[:keys])
            wait_until(lambda keys=keys: len(self.timers) == keys + 1)
        assert self.sent == [] == self.notices, "not before it is whole"
        for timer in self.timers:
            if not timer.is_cancelled:
                timer.act()


@pytest.fixture
def panel(monkeypatch: pytest.MonkeyPatch) -> Iterator[Panel]:
    monkeypatch.setattr(widgets.threading, "Timer", Timer)
    Panel.timers.clear()
    server = guard.open_server("127.0.0.1", 0, on_refusal=pytest.fail)
    sent: list[Command] = []
    notices: list[str] = []
    ui = Widgets(server.gui, sent.append, notices.append)
    made = Controls(ui, seed=0)
    ui.follow(_picture())
    try:
        with RawClient(server.get_port()) as client:
            wait_until(server.get_clients)
            yield Panel(made, ui, client, sent, notices)
    finally:
        server.stop()


def _picture() -> Any:
    return SimpleNamespace(
        run_number=0, past=None, beta=0.98, gamma=0.01, frozen=False, seed=0, lanes=1
    )


@pytest.mark.parametrize(
    ("label", "text", "command"),
    [
        ("γ", "0.05", SetGamma(0.05)),
        ("γ", "1e-12", SetGamma(1e-12)),
        ("γ", "0", SetGamma(0.0)),
        ("β", "0.0025", SetBeta(0.0025)),
        ("β", "999e-3", SetBeta(0.999)),
        ("steps/s", "1e4", SetSpeed(1e4)),
        ("steps/s", "realtime", SetSpeed("realtime")),
    ],
)
def test_what_is_typed_is_one_command_of_the_whole(
    panel: Panel, label: str, text: str, command: Command
) -> None:
    panel.type(label, text)
    assert panel.sent == [command]
    assert panel.notices == []


@pytest.mark.parametrize(
    ("label", "text"), [("β", "0.980"), ("γ", "1e-2"), ("seed", "00"), ("γ", "")]
)
def test_what_holds_already_or_is_wiped_out_changes_nothing(
    panel: Panel, label: str, text: str
) -> None:
    panel.type(label, text)
    assert panel.sent == [] == panel.notices


@pytest.mark.parametrize(
    ("label", "text", "said"),
    [
        ("γ", "hello", "γ must be from 0 to 1000, got 'hello'"),
        ("β", "1", "β must be from 0 to 0.999999, got '1'"),
        ("β", "nan", "β must be from 0 to 0.999999, got 'nan'"),
        ("seed", "1e10", "seed must be a whole number from 0 to 4294967295, got '1e10'"),
        ("steps/s", "fast", "speed must be steps per second, realtime or max, got 'fast'"),
    ],
)
def test_what_is_refused_is_said_once_and_left_to_be_mended(
    panel: Panel, monkeypatch: pytest.MonkeyPatch, label: str, text: str, said: str
) -> None:
    monkeypatch.setattr(widgets, "MENDING_SECONDS", 1.0)
    panel.type(label, text)
    assert panel.notices == [said]
    assert panel.sent == []
    handle = {"γ": panel.controls.gamma, "β": panel.controls.beta}.get(label)
    if handle is not None:
        panel.widgets.put(handle, "0.5", quiet=0.0)
        assert handle.value == text, "it may be being mended"
        time.sleep(1.0)
        panel.widgets.put(handle, "0.5", quiet=0.0)
        assert handle.value == "0.5"


@pytest.mark.parametrize("name", TASKS)
def test_the_hidden_layers_shown_are_those_that_typed_would_make_the_network(name: str) -> None:
    task = make_task(name)
    live = Learner(task).frame()
    shown = controls._hidden(SimpleNamespace(task=task, live=live))  # type: ignore[arg-type]
    if name == "synapse":
        assert shown is None, "sizes make no single synapse"
    else:
        assert shown and task.topology(shown) == live.topology
