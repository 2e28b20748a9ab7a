"""Typed slowly in a real browser: a field acts on Enter or as it is left, never on a pause."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from browser import PATIENCE, enter, eventually, field, tab_at
from playwright.sync_api import Browser, Page, expect
from raw_client import wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.live.commands import Pause, Seek, SetWatch
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.run.changes import SetBeta
from hebbviz.sims.loading import make_task

expect.set_options(timeout=PATIENCE)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]
PAUSE = 1500
"""Milliseconds between two keys."""


@dataclass(frozen=True)
class Live:
    worker: Worker

    @property
    def snapshot(self) -> Snapshot:
        assert self.worker.latest is not None
        return self.worker.latest


@pytest.fixture
def live() -> Iterator[tuple[Live, str]]:
    learner = Learner(make_task("pendulum", "quick"), seed=0)
    site = Site(learner, host="127.0.0.1", port=0, speed=100.0, task_name=None)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    wait_until(lambda: site._worker is not None and site._worker.latest is not None, 30.0)
    assert site._worker is not None
    yield Live(site._worker), site.address
    stop.set()
    thread.join(10.0)


@pytest.fixture
def page(browser: Browser, live: tuple[Live, str]) -> Iterator[Page]:
    with tab_at(browser, live[1], width=1100, height=640) as page:
        yield page


def type_slowly(page: Page, label: str, text: str) -> None:
    page.evaluate("0")
    found = field(page, label)
    found.scroll_into_view_if_needed()
    found.click()
    found.select_text()
    found.press_sequentially(text, delay=PAUSE)
    page.wait_for_timeout(PAUSE)
    assert found.input_value() == text


def changes(live: Live) -> list[str]:
    return [str(c.change) for c in live.snapshot.run.changes]


def test_what_is_typed_slowly_is_one_change_on_enter(page: Page, live: tuple[Live, str]) -> None:
    shown, _ = live
    type_slowly(page, "β", "0.95")
    assert changes(shown) == []
    field(page, "β").press("Enter")
    eventually(page, lambda: changes(shown) == ["β 0.95"])
    type_slowly(page, "γ", "0.001")
    field(page, "γ").blur()
    eventually(page, lambda: changes(shown) == ["β 0.95", "γ 0.001"])
    assert shown.snapshot.run.number == 0


def test_a_seed_sizes_and_lanes_begin_one_run_each(page: Page, live: tuple[Live, str]) -> None:
    shown, _ = live
    type_slowly(page, "seed", "42")
    assert shown.snapshot.run.number == 0
    field(page, "seed").press("Enter")
    eventually(page, lambda: shown.snapshot.run.seed == 42)
    assert shown.snapshot.run.number == 1
    type_slowly(page, "hidden", "12")
    assert shown.snapshot.run.number == 1
    field(page, "hidden").press("Tab")
    eventually(page, lambda: shown.snapshot.run.live.topology.describe() == "8-12-2")
    assert shown.snapshot.run.number == 2
    type_slowly(page, "lanes", "12")
    field(page, "lanes").press("Enter")
    eventually(page, lambda: shown.snapshot.run.lanes == 12)
    assert shown.snapshot.run.number == 3


def test_a_refused_value_leaves_its_field_at_once(page: Page, live: tuple[Live, str]) -> None:
    shown, _ = live
    for label, text, held in ("β", "2", "0.98"), ("hidden", "1…2", "4"), ("β", "0,9", "0.98"):
        enter(page, label, text)
        expect(field(page, label)).to_have_value(held)
    assert changes(shown) == []
    assert shown.snapshot.run.number == 0


def test_nothing_moves_a_field_under_the_hand_that_types(
    page: Page, live: tuple[Live, str]
) -> None:
    """Neither another tab, nor a run that is played; what was typed and taken back shows them."""
    shown, _ = live
    page.evaluate("0")
    beta = field(page, "β")
    beta.press("End")
    beta.press("7")
    shown.worker.send(SetBeta(0.5))
    eventually(page, lambda: shown.snapshot.run.beta == 0.5)
    page.wait_for_timeout(PAUSE)
    assert beta.input_value() == "0.987"
    beta.press("Backspace")
    beta.blur()
    expect(beta).to_have_value("0.5")
    assert changes(shown) == ["β 0.5"]
    eventually(page, lambda: shown.snapshot.run.live.step > 300)
    shown.worker.send(SetWatch(on=False))
    shown.worker.send(Seek(0))
    shown.worker.send(Pause(paused=False))
    type_slowly(page, "at step", "250")
    field(page, "at step").press("Enter")
    eventually(
        page,
        lambda: shown.snapshot.view.past is not None and shown.snapshot.view.past.cursor >= 250,
    )
