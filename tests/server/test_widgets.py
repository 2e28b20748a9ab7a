"""What is typed into the page becomes one command, of the whole. No browser: a client types."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
from raw_client import RawClient, wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.live.commands import Command, SetSpeed
from hebbviz.server.page.controls import controls
from hebbviz.server.page.controls.controls import Controls
from hebbviz.server.page.widgets import Widgets
from hebbviz.server.run.changes import SetBeta, SetGamma
from hebbviz.server.web import guard
from hebbviz.sims import TASKS
from hebbviz.sims.loading import make_task


@dataclass(frozen=True)
class Panel:
    """The controls of a run that stands still, and what came of what was done there."""

    controls: Controls
    widgets: Widgets
    client: RawClient
    sent: list[Command]
    notices: list[str]

    def type(self, label: str, text: str) -> None:
        """As a page sends it, once it is whole; returns when it is taken, or has left its field."""
        widget = self.client.find(label)
        widget.value = text
        self.client.send_value(widget, text)
        wait_until(lambda: self.sent or widget.value != text)


@pytest.fixture
def panel() -> Iterator[Panel]:
    server = guard.open_server("127.0.0.1", 0, on_refusal=pytest.fail)
    sent: list[Command] = []
    notices: list[str] = []
    ui = Widgets(server.gui, sent.append, notices.append)
    made = Controls(ui, seed=0)
    ui.follow(_snapshot())
    for handle, value in (
        (made.beta, "0.98"), (made.gamma, "0.01"), (made.seed, "0"), (made.typed_speed, "max"),
        (made.hidden, "4"),
    ):  # fmt: skip
        ui.put(handle, value)
    try:
        with RawClient(server.get_port()) as client:
            wait_until(server.get_clients)
            yield Panel(made, ui, client, sent, notices)
    finally:
        server.stop()


def _snapshot() -> Any:
    run = SimpleNamespace(number=0, beta=0.98, gamma=0.01, frozen=False, seed=0, lanes=1)
    return SimpleNamespace(run=run, view=SimpleNamespace(past=None))


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


@contextmanager
def busy(pool: Any) -> Iterator[None]:
    """A machine whose threads are all held up: no callback runs in here."""
    free = threading.Event()
    for _ in range(pool._max_workers):
        pool.submit(free.wait)
    try:
        yield
    finally:
        free.set()


@pytest.mark.parametrize("drawn", ["0.02", "0.01"])
def test_what_is_typed_is_not_lost_where_its_field_is_drawn_before_it_is_read(
    panel: Panel, drawn: str
) -> None:
    gamma = panel.controls.gamma
    panel.widgets.put(gamma, "0.03")
    with busy(panel.widgets.gui._thread_executor):
        panel.client.send_value(panel.client.find("γ"), "0.05")
        wait_until(lambda: gamma.value == "0.05")
        panel.widgets.put(gamma, drawn)
    wait_until(lambda: panel.sent)
    assert panel.sent == [SetGamma(0.05)]


@pytest.mark.parametrize(
    ("label", "text"), [("β", "0.980"), ("γ", "1e-2"), ("seed", "00"), ("γ", "")]
)
def test_what_holds_already_or_is_wiped_out_changes_nothing(
    panel: Panel, label: str, text: str
) -> None:
    panel.type(label, text)
    assert panel.sent == [] == panel.notices
    assert panel.client.find(label).value == {"β": "0.98", "γ": "0.01", "seed": "0"}[label]


@pytest.mark.parametrize(
    ("label", "text", "said"),
    [
        ("γ", "hello", "γ must be from 0 to 1000, got 'hello'"),
        ("β", "1", "β must be from 0 to 0.999999, got '1'"),
        ("β", "0,95", "β must be from 0 to 0.999999, got '0,95'; use a point: 0.95"),
        ("β", "nan", "β must be from 0 to 0.999999, got 'nan'"),
        ("seed", "1e10", "seed must be a whole number from 0 to 4294967295, got '1e10'"),
        ("steps/s", "fast", "speed must be steps per second, realtime or max, got 'fast'"),
        ("hidden", "1…2", "hidden must be sizes such as 16 or 8,8 (at most 8, from 1 to 4096 "
         "each), or none, got '1…2'"),
    ],
)  # fmt: skip
def test_what_is_refused_is_said_and_leaves_its_field(
    panel: Panel, label: str, text: str, said: str
) -> None:
    """On all pages, and again if it is typed again."""
    held = panel.client.find(label).value
    for times in (1, 2):
        panel.type(label, text)
        wait_until(lambda times=times: len(panel.notices) == times)
        assert panel.client.find(label).value == held
    assert panel.notices == [said, said]
    assert panel.sent == []


@pytest.mark.parametrize("name", TASKS.names)
def test_the_hidden_layers_shown_are_those_that_typed_would_make_the_network(name: str) -> None:
    task = make_task(name)
    live = Learner(task).frame()
    shown = controls._hidden(SimpleNamespace(run=SimpleNamespace(task=task, live=live)))  # type: ignore[arg-type]
    if name == "synapse":
        assert shown is None, "sizes make no single synapse"
    else:
        assert shown and task.topology(shown) == live.topology
