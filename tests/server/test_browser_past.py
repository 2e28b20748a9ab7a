"""The past in a real browser: recorded, played back, rewound, taken over, forked."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import (
    PATIENCE,
    choose,
    drag,
    enter,
    eventually,
    field,
    press,
    row,
    still,
    tab_at,
    text_of,
)
from playwright.sync_api import Browser, Page, expect
from raw_client import RawClient, wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.live.commands import (
    BackToNow,
    EndFork,
    Pause,
    Reset,
    SetSpeed,
    SetWatch,
    StepOnce,
)
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.recording.reader import open_recording
from hebbviz.server.recording.recorder import Recorder
from hebbviz.server.recording.recordings import Options
from hebbviz.server.recording.targets import FileTarget
from hebbviz.server.run.changes import SetBeta, SetGamma
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task

expect.set_options(timeout=PATIENCE)

# viser warns of what is sent to a tab in the moment in which it closes
pytestmark = [
    pytest.mark.slow, pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection")
]  # fmt: skip

WIDTH, HEIGHT = 1100, 700
STEPS, CHANGED_AT = 2_000, 900
"""Length of the run that is looked at, and where β was changed in it."""
FORK = "Fork: two copies side by side"


@dataclass(frozen=True)
class Live:
    """A server in this process, so that what arrives at its worker can be seen."""

    site: Site
    worker: Worker

    @property
    def snapshot(self) -> Snapshot:
        snapshot = self.worker.latest
        assert snapshot is not None
        return snapshot

    def send(self, *commands: Any) -> None:
        for command in commands:
            self.worker.send(command)


@contextmanager
def shown(site: Site) -> Iterator[Live]:
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    try:
        wait_until(lambda: site._worker is not None and site._worker.latest is not None, 30.0)
        assert site._worker is not None
        yield Live(site, site._worker)
    finally:
        stop.set()
        thread.join(10.0)
    assert not thread.is_alive()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="module")
def live(folder: Path) -> Iterator[Live]:
    learner = Learner(make_task("pendulum", "quick"), seed=0)
    site = Site(
        learner, host="127.0.0.1", port=0, speed=100.0, task_name=None,
        recording=Options(folder=folder),
    )  # fmt: skip
    with shown(site) as live:
        yield live


@pytest.fixture(scope="module")
def tab(browser: Browser, live: Live) -> Iterator[Page]:
    with tab_at(browser, live.site.address, width=WIDTH, height=HEIGHT) as page:
        yield page


@pytest.fixture
def page(tab: Page, live: Live) -> Page:
    """The tab, with a run at rest that is STEPS long and has one change of β."""
    if live.snapshot.view.other is not None:
        live.send(EndFork())
    live.send(BackToNow(), Pause(paused=True), SetWatch(on=False), SetSpeed(50.0), SetBeta(0.98))
    live.send(SetGamma(0.01), Reset(seed=0), StepOnce(CHANGED_AT))
    wait_until(lambda: live.snapshot.run.live.step == CHANGED_AT, 20.0)
    live.send(SetBeta(0.9), StepOnce(STEPS - CHANGED_AT))
    wait_until(
        lambda: live.snapshot.run.live.step == STEPS and live.snapshot.view.past is None, 20.0
    )
    controls = live.site._page._controls  # type: ignore[union-attr]
    wait_until(lambda: controls._ui.snapshot.run.number == live.snapshot.run.number, 20.0)
    expect(field(tab, "β")).to_have_value("0.9")
    tab.get_by_role("button", name="Run", exact=True).wait_for()
    eventually(tab, lambda: slider_at(tab) == STEPS)
    return tab


def slider_at(page: Page) -> int:
    return int(str(row(page, "go to").get_by_role("slider").get_attribute("aria-valuenow")))


def past_shown(page: Page) -> int | None:
    """The step of the past that the page says it shows."""
    found = re.search(r"past: step ([\d,]+)", text_of(page))
    return int(found[1].replace(",", "")) if found else None


def cursor(live: Live) -> int | None:
    past = live.snapshot.view.past
    return None if past is None else past.cursor


def see(page: Page, live: Live, step: int) -> None:
    """Wait until a step of the past is shown."""
    eventually(page, lambda: cursor(live) == step == past_shown(page))


def go_to(page: Page, live: Live, step: int) -> None:
    """Type a step of the past; the field is there once the past is shown."""
    if cursor(live) is None:
        press(page, "◀ change")
        see(page, live, CHANGED_AT)
    enter(page, "at step", str(step))
    field(page, "at step").blur()  # what is typed into takes no keys for commands
    see(page, live, step)


def networks(page: Page) -> set[str]:
    """Roots of the networks that are in the scene."""
    nodes = page.evaluate("Object.keys(window.__viserSceneTree.getState())")
    return {m[1] for n in nodes if (m := re.fullmatch(r"/(\w+) \d+/network/neurons", n))}


# Rewinding a live run


def test_dragging_shows_the_past_and_the_run_rests(page: Page, live: Live) -> None:
    live.send(Pause(paused=False))
    eventually(page, lambda: live.snapshot.run.live.step > STEPS + 20)
    drag(page, "go to", 0.7, 0.5)
    end = live.snapshot.run.live.step
    eventually(page, lambda: 0.45 * end < (past_shown(page) or 0) < 0.55 * end)
    eventually(page, lambda: slider_at(page) == past_shown(page) == cursor(live))
    assert "the run is paused meanwhile" in text_of(page)
    press(page, "Back to now")
    eventually(page, lambda: live.snapshot.run.live.step > end + 20)
    eventually(page, lambda: past_shown(page) is None)


def test_the_past_is_played_and_paused_and_stepped(page: Page, live: Live) -> None:
    go_to(page, live, 500)
    press(page, "Play")
    eventually(page, lambda: (past_shown(page) or 0) > 520)
    press(page, "Pause")
    eventually(page, lambda: live.snapshot.pacing.paused)
    at = cursor(live)
    assert at is not None
    press(page, "1 step")
    see(page, live, at + 1)
    eventually(page, lambda: slider_at(page) == at + 1)
    assert live.snapshot.run.live.step == STEPS


def test_keys_and_buttons_jump_to_changes(page: Page, live: Live) -> None:
    go_to(page, live, CHANGED_AT - 100)
    expect(field(page, "β")).to_have_value("0.98")  # the one that held then
    press(page, "change ▶")
    see(page, live, CHANGED_AT)
    press(page, "1 step")
    expect(field(page, "β")).to_have_value("0.9")
    page.keyboard.press("j")
    see(page, live, CHANGED_AT)
    press(page, "reward ▶")
    eventually(page, lambda: (cursor(live) or 0) > CHANGED_AT)
    page.keyboard.press("b")
    eventually(page, lambda: cursor(live) is None and "past: step" not in text_of(page))


def test_a_time_is_typed(page: Page, live: Live) -> None:
    go_to(page, live, 500)
    enter(page, "at time (s)", "14.5")
    see(page, live, 725)
    eventually(page, lambda: "14.5 s" in text_of(page))
    enter(page, "at time (s)", "99999")  # beyond the end: the end
    see(page, live, STEPS)


def test_what_is_beyond_the_ends_is_taken_to_them(page: Page, live: Live) -> None:
    with RawClient(int(live.site.address.rpartition(":")[2])) as client:
        client.send_value(client.find("go to"), 10 * STEPS)
        see(page, live, STEPS)
    assert "refused" not in text_of(page)
    eventually(page, lambda: slider_at(page) == STEPS)


def test_taking_over_goes_on_from_there_and_undo_brings_back(page: Page, live: Live) -> None:
    weight = live.snapshot.run.live.weight.copy()
    go_to(page, live, 600)
    press(page, "Take over here")
    eventually(page, lambda: live.snapshot.view.past is None and live.snapshot.run.live.step > 610)
    live.send(Pause(paused=True))
    eventually(page, lambda: live.snapshot.pacing.paused)
    assert live.snapshot.run.live.step < STEPS
    press(page, "Undo: taking over at step 600")
    eventually(page, lambda: live.snapshot.run.live.step >= STEPS)
    snapshot = live.snapshot
    assert snapshot.run.live.step == STEPS, "it rests as before the undo"
    assert [c.step for c in snapshot.run.changes] == [CHANGED_AT]
    assert np.array_equal(snapshot.run.live.weight, weight)


def test_another_beta_in_the_past_takes_over(page: Page, live: Live) -> None:
    go_to(page, live, 600)
    enter(page, "β", "0.5")
    eventually(page, lambda: live.snapshot.view.past is None and live.snapshot.run.beta == 0.5)
    assert [c.step for c in live.snapshot.run.changes] == [600]


def test_the_charts_show_where_the_past_is(page: Page, live: Live) -> None:
    go_to(page, live, 1500)
    eventually(page, lambda: upright(page) == 1)  # the chart of the learning is in front
    page.keyboard.press("b")
    eventually(page, lambda: upright(page) == 0)


def upright(page: Page) -> int:
    """How many charts have an upright line at the step that is shown."""
    count: int = page.evaluate(
        "Object.values(window.__viserTestpoints.uplots).filter(p =>"
        " p.chart.series.some(s => s.label === 'shown')).length"
    )
    return count


# Forks


def test_a_fork_shows_two_networks_until_it_ends(page: Page, live: Live) -> None:
    assert networks(page) == {"this"}
    if not page.get_by_role("button", name="Fork here").is_visible():
        page.get_by_text(FORK, exact=True).click()
    choose(page, "differ in", "another γ")
    expect(field(page, "its value")).to_have_value("0.001")
    press(page, "Fork here")
    eventually(page, lambda: live.snapshot.view.other is not None)
    other = live.snapshot.view.other
    assert other is not None and other.words == "γ 0.001"
    eventually(page, lambda: networks(page) == {"this", "other"})
    live.send(Pause(paused=False), SetSpeed(1000.0))
    eventually(page, lambda: re.search(r"this run .* other, γ 0.001: ", text_of(page)))
    live.send(Pause(paused=True))
    press(page, "Keep the other copy")
    eventually(page, lambda: live.snapshot.view.other is None and networks(page) == {"this"})
    assert live.snapshot.run.gamma == 0.001
    page.get_by_role("button", name="Fork here").wait_for()


def test_a_wrong_value_is_refused_in_words(page: Page, live: Live) -> None:
    if not page.get_by_role("button", name="Fork here").is_visible():
        page.get_by_text(FORK, exact=True).click()
    choose(page, "differ in", "another β")
    expect(field(page, "its value")).to_have_value("0.9")
    enter(page, "its value", "1.5")
    press(page, "Fork here")
    page.get_by_text(re.compile(r"beta must be .*got 1.5")).first.wait_for()
    assert live.snapshot.view.other is None


# Recording


def test_a_recording_is_made_from_the_page(page: Page, live: Live, folder: Path) -> None:
    page.get_by_text("Record", exact=True).first.click()
    assert re.fullmatch(r"pendulum-[\d-]+\.rrd", field(page, "file").input_value())
    enter(page, "file", "mine.rrd")
    still(page, page.get_by_role("button", name="Record", exact=True)).click()
    page.get_by_role("button", name="Stop recording").wait_for()
    live.send(Pause(paused=False), SetSpeed(1000.0))
    eventually(page, lambda: live.snapshot.run.live.step > STEPS + 500)
    assert "● recording" in text_of(page)
    assert "every step is kept" in text_of(page)
    assert "windows of 500 steps at regular intervals" in text_of(page)
    live.send(Pause(paused=True))
    press(page, "Stop recording")
    page.get_by_role("button", name="Record", exact=True).wait_for()
    eventually(page, lambda: "recorded in" in text_of(page))
    recording = open_recording(folder / "mine.rrd")
    assert recording.last_step > STEPS + 500
    expect(field(page, "file")).not_to_have_value("mine.rrd")  # another name is offered


# A recording, played back


@pytest.fixture(scope="module")
def replayed(browser: Browser, folder: Path) -> Iterator[tuple[Page, Live]]:
    """A page on a recording of STEPS steps with a change of β."""
    path = folder / "replayed.rrd"
    record(path)
    run = open_recording(path).run(make_task, make_task("pendulum", "quick"))
    site = Site(
        run.learner, host="127.0.0.1", port=0, speed=None, task_name=None, past=run,
        recording=Options(folder=folder),
    )  # fmt: skip
    with (
        shown(site) as live,
        tab_at(browser, live.site.address, width=WIDTH, height=HEIGHT) as page,
    ):
        yield page, live


def record(path: Path) -> None:
    run = Run(Learner(make_task("pendulum", "quick"), seed=0), make_task)
    recorder = Recorder(FileTarget(path), run, on_notice=pytest.fail)
    run.followers.append(recorder)
    while run.learner.step < STEPS:
        run.advance(100)
        run.frame()
        if run.learner.step % 500 == 0:
            run.keep()
        if run.learner.step == CHANGED_AT:
            run.change(SetBeta(0.9))
    recorder.close(run)


def test_a_recording_opens_in_its_past_and_is_checked(replayed: tuple[Page, Live]) -> None:
    page, live = replayed
    see(page, live, 0)
    assert f"of 0–{STEPS:,}" in text_of(page)
    go_to(page, live, 1200)
    eventually(page, lambda: "identical to the next keyframe to the bit" in text_of(page))
    assert "a recording, played back" in text_of(page)
    assert page.get_by_role("button", name="Continue from its end").is_visible()


def test_a_recording_is_scrubbed_and_played(replayed: tuple[Page, Live]) -> None:
    page, live = replayed
    drag(page, "go to", 0.45, 0.25)
    eventually(page, lambda: 0.2 * STEPS < (past_shown(page) or 0) < 0.3 * STEPS)
    press(page, "change ▶")
    see(page, live, CHANGED_AT)
    press(page, "Play")
    eventually(page, lambda: (past_shown(page) or 0) > CHANGED_AT + 10)
    press(page, "Pause")
    eventually(page, lambda: live.snapshot.pacing.paused)


def test_a_recording_goes_on_where_it_is_taken_over(replayed: tuple[Page, Live]) -> None:
    page, live = replayed
    go_to(page, live, 1300)
    page.keyboard.press("t")
    eventually(page, lambda: live.snapshot.view.past is None and live.snapshot.run.live.step > 1310)
    page.keyboard.press("u")
    eventually(page, lambda: live.snapshot.run.live.step >= STEPS)
