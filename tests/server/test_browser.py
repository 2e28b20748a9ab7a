"""The page in a real browser: what is typed, dragged and pressed reaches the run, and is seen."""

from __future__ import annotations

import math
import re
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import (
    PATIENCE,
    again,
    choose,
    drag,
    enter,
    eventually,
    field,
    press,
    row,
    slide,
    tab_at,
    text_of,
)
from playwright.sync_api import Browser, ConsoleMessage, Page, expect
from raw_client import RawClient, wait_until
from viser.transforms import SO3

from hebbviz.learner.learner import Learner
from hebbviz.rules.baseline import Baseline
from hebbviz.rules.paper import PAPER
from hebbviz.server.app import Site
from hebbviz.server.live import session
from hebbviz.server.live.commands import Choose, Pause, Reset, SetSpeed, SetWatch, StepOnce
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.run.changes import Freeze, SetBeta
from hebbviz.server.scene.appearance import network_at, place
from hebbviz.sims.loading import make_task

expect.set_options(timeout=PATIENCE)

# viser warns of what is sent to a tab in the moment in which it closes
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection")

ROOT = Path(__file__).parents[2]
WIDTH, HEIGHT = 1100, 640
SPEED = 100.0
"""Steps per second: the steps are shown live, and leave the machine to the browser."""
KNOWN_NOISE = "Tried to update non-existent component"
"""viser's page says so of what is drawn and then removed, with its task, in one of its frames."""
CHARTS = "Object.keys(window.__viserTestpoints.uplots).length"


@dataclass(frozen=True)
class Live:
    """A server in this process, so that what arrives at its worker can be seen."""

    site: Site
    worker: Worker
    stop: Callable[[], None]

    @property
    def snapshot(self) -> Snapshot:
        snapshot = self.worker.latest
        assert snapshot is not None
        return snapshot


@pytest.fixture(scope="module")
def live() -> Iterator[Live]:
    learner = Learner(make_task("pendulum", "quick"), seed=0)
    site = Site(learner, host="127.0.0.1", port=0, speed=SPEED, task_name=None)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()

    def end() -> None:
        stop.set()
        thread.join(10.0)
        assert not thread.is_alive()

    wait_until(lambda: site._worker is not None and site._worker.latest is not None, 30.0)
    assert site._worker is not None
    yield Live(site, site._worker, end)
    end()


@pytest.fixture(scope="module")
def errors() -> list[str]:
    """What the pages print as errors."""
    return []


@pytest.fixture(scope="module")
def tab(browser: Browser, live: Live, errors: list[str]) -> Iterator[Page]:
    """The tab that most tests look at."""
    with tab_at(browser, live.site.address, width=WIDTH, height=HEIGHT) as page:
        listen(page, errors)
        yield page


@pytest.fixture
def page(tab: Page, live: Live) -> Page:
    """The tab, with the pendulum running slowly from the beginning."""
    run = live.snapshot.run.number
    send(live, Choose("pendulum", "quick"), Reset(seed=0), SetSpeed(SPEED), SetWatch(on=False))
    send(live, Pause(paused=False))
    wait_until(
        lambda: live.snapshot.run.number >= run + 2 and not live.snapshot.pacing.paused, 20.0
    )
    # a list that still waits to be told what holds would take back what a test chooses, and what
    # is typed before the page knows of the new run is forgotten
    wait_until(lambda: followed(live) == live.snapshot.run.number, 20.0)
    expect(field(tab, "task")).to_have_value("pendulum")
    expect(field(tab, "β")).to_have_value("0.98")
    expect(field(tab, "speed")).to_have_value("100")
    tab.get_by_role("button", name="Pause", exact=True).wait_for()
    return tab


def followed(live: Live) -> int:
    """Number of the run that the page's widgets show."""
    page = live.site._page
    assert page is not None
    return page._controls._ui.snapshot.run.number


def send(live: Live, *commands: Any) -> None:
    for command in commands:
        live.worker.send(command)


def listen(page: Page, errors: list[str]) -> None:
    def note(message: ConsoleMessage) -> None:
        if message.type == "error" and KNOWN_NOISE not in message.text:
            errors.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: errors.append(str(error)))


def step_shown(page: Page) -> int:
    """The step counter of the page."""
    found = re.search(r"(?:live,|paused at) step ([\d,]+)", text_of(page))
    assert found, text_of(page)
    return int(found[1].replace(",", ""))


def pause(page: Page, live: Live) -> int:
    """Pause without the page; at which step."""
    send(live, Pause(paused=True))
    eventually(page, lambda: live.snapshot.pacing.paused)
    page.get_by_role("button", name="Run", exact=True).wait_for()
    step = live.snapshot.run.live.step
    eventually(page, lambda: step_shown(page) == step)
    return step


def marks(page: Page) -> int:
    """How many plots show a mark for a change."""
    count: int = page.evaluate(
        "Object.values(window.__viserTestpoints.uplots).filter(p =>"
        " [...p.chart.data.at(-1)].some(y => y !== null && Number.isFinite(y))).length"
    )
    return count


# The run


def test_the_page_opens_and_runs(page: Page) -> None:
    expect(page.get_by_text("hebbviz", exact=True).first).to_be_visible()
    assert page.locator("canvas").first.is_visible()
    before = step_shown(page)
    eventually(page, lambda: step_shown(page) > before + 10)
    assert "1 tab" in text_of(page)


def test_pause_stops_the_counter_and_a_step_is_one_step(page: Page, live: Live) -> None:
    press(page, "Pause")
    eventually(page, lambda: live.snapshot.pacing.paused)
    step = live.snapshot.run.live.step
    eventually(page, lambda: step_shown(page) == step)
    press(page, "1 step")
    eventually(page, lambda: step_shown(page) == step + 1)
    page.keyboard.press("n")
    eventually(page, lambda: step_shown(page) == step + 2)
    press(page, "10")
    eventually(page, lambda: step_shown(page) == step + 12)
    assert live.snapshot.run.live.step == step + 12
    page.locator("body").press(" ")
    eventually(page, lambda: not live.snapshot.pacing.paused and step_shown(page) > step + 20)
    page.locator("body").press(" ")
    eventually(page, lambda: live.snapshot.pacing.paused)
    step = live.snapshot.run.live.step
    eventually(page, lambda: step_shown(page) == step)
    page.wait_for_timeout(300)
    assert step_shown(page) == live.snapshot.run.live.step == step


def test_a_reset_begins_again_with_the_set_beta(page: Page, live: Live) -> None:
    send(live, SetBeta(0.9))
    pause(page, live)
    page.keyboard.press("r")
    eventually(page, lambda: step_shown(page) == 0)
    assert live.snapshot.run.live.step == 0
    assert live.snapshot.run.beta == 0.9
    assert live.snapshot.run.seed == 0
    send(live, SetBeta(0.98))


def test_a_new_seed_begins_another_run(page: Page, live: Live) -> None:
    pause(page, live)
    run = live.snapshot.run.number
    press(page, "New seed")
    eventually(page, lambda: live.snapshot.run.number > run)
    assert live.snapshot.run.seed == 1
    assert live.snapshot.run.live.step == 0
    expect(field(page, "seed")).to_have_value("1")


# The learning


def test_beta_typed_reaches_the_worker_and_the_plots(page: Page, live: Live) -> None:
    enter(page, "β", "0.995")
    eventually(page, lambda: live.snapshot.run.beta == 0.995)
    eventually(page, lambda: "1/(1−β) = 200 steps = 4 s" in text_of(page))
    eventually(page, lambda: marks(page) > 0)
    expect(row(page, "β by memory").get_by_role("slider")).to_have_attribute("aria-valuenow", "2.3")
    assert live.snapshot.run.live.step > 0  # nothing began again


@pytest.mark.slow
def test_beta_typed_key_by_key_ends_at_what_was_typed(page: Page, live: Live) -> None:
    field(page, "β").select_text()
    field(page, "β").press_sequentially("0.9973", delay=40)
    field(page, "β").press("Enter")
    eventually(page, lambda: live.snapshot.run.beta == 0.9973)
    page.wait_for_timeout(1500)  # nothing that is late may take it back
    assert live.snapshot.run.beta == 0.9973
    expect(field(page, "β")).to_have_value("0.9973")


def test_the_memory_slider_is_moved_by_keys(page: Page, live: Live) -> None:
    expect(row(page, "β by memory").get_by_role("slider")).to_have_attribute("aria-valuenow", "1.7")
    slide(page, "β by memory", "ArrowRight", times=3)  # by 0.01 each
    eventually(page, lambda: math.isclose(live.snapshot.run.beta, 1 - 10**-1.73, abs_tol=2e-6))
    eventually(page, lambda: marks(page) > 0)
    eventually(page, lambda: "1/(1−β) = 53.7 steps" in text_of(page))


def test_an_arrow_key_on_a_slider_does_not_turn_the_camera(page: Page, live: Live) -> None:
    (client,) = live.site._server.get_clients().values()

    def azimuth() -> float:
        x, y, _ = client.camera.position - client.camera.look_at
        return math.degrees(math.atan2(y, x))

    before = azimuth()
    row(page, "β by memory").get_by_role("slider").focus()
    page.keyboard.down("ArrowRight")
    page.wait_for_timeout(1000)
    page.keyboard.up("ArrowRight")
    eventually(page, lambda: live.snapshot.run.beta > 0.98)
    page.wait_for_timeout(500)
    assert azimuth() == pytest.approx(before, abs=1.0)
    row(page, "β by memory").get_by_role("slider").blur()


def test_buttons_stay_where_they_are_whatever_the_status_says(page: Page, live: Live) -> None:
    reset = page.get_by_role("button", name="Reset", exact=True)
    eventually(page, lambda: "live, step" in text_of(page))
    place = reset.bounding_box()
    eventually(page, lambda: live.snapshot.run.live.tally.ended > 0)
    pause(page, live)
    assert reset.bounding_box() == place
    page.keyboard.press("l")
    eventually(page, lambda: "latest reward, slow motion" in text_of(page))
    assert reset.bounding_box() == place


@pytest.mark.slow
def test_the_memory_slider_is_dragged(
    page: Page, live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "SAME_GESTURE_SECONDS", 30.0)  # the machine may be busy
    drag(page, "β by memory", 0.6, 0.75)
    eventually(page, lambda: 0.9975 < live.snapshot.run.beta < 0.9995)  # 10³ steps, at 3 of 0..4
    press(page, "Undo: β")  # a drag is one change
    eventually(page, lambda: live.snapshot.run.beta == 0.98)


def test_gamma_is_typed_and_dragged(page: Page, live: Live) -> None:
    enter(page, "γ", "1e-3")
    eventually(page, lambda: live.snapshot.run.gamma == 1e-3)
    expect(row(page, "γ, step size").get_by_role("slider")).to_have_attribute("aria-valuenow", "-3")
    slide(page, "γ, step size", "ArrowLeft")  # by 0.05
    eventually(page, lambda: live.snapshot.run.gamma == 8.91e-4)
    slide(page, "γ, step size", "ArrowLeft")
    eventually(page, lambda: live.snapshot.run.gamma == 7.94e-4)
    expect(field(page, "γ")).to_have_value("0.000794")
    eventually(page, lambda: marks(page) > 0)


def test_freezing_remembers_gamma(page: Page, live: Live) -> None:
    row(page, "freeze learning").get_by_role("checkbox").check()
    eventually(page, lambda: live.snapshot.run.frozen)
    assert live.snapshot.run.gamma == 0.01
    step, weight = live.snapshot.run.live.step, live.snapshot.run.live.weight.copy()
    eventually(page, lambda: live.snapshot.run.live.step > step + 100)
    assert np.array_equal(live.snapshot.run.live.weight, weight)
    expect(field(page, "γ")).to_have_value("0.01")
    row(page, "freeze learning").get_by_role("checkbox").uncheck()
    eventually(page, lambda: not live.snapshot.run.frozen)
    assert live.snapshot.run.gamma == 0.01


def test_undo_returns_beta_and_the_step_before(page: Page, live: Live) -> None:
    step = pause(page, live)
    enter(page, "β", "0.5")
    eventually(page, lambda: live.snapshot.run.beta == 0.5)
    press(page, "100")
    eventually(page, lambda: step_shown(page) == step + 100)
    press(page, "Undo: β 0.5")
    eventually(page, lambda: step_shown(page) == step)
    assert live.snapshot.run.beta == 0.98
    assert live.snapshot.run.live.step == step
    expect(field(page, "β")).to_have_value("0.98")
    page.get_by_text(re.compile("undone: β 0.5, back at step")).first.wait_for()


def test_a_refused_value_shows_a_notice_and_changes_nothing(page: Page, live: Live) -> None:
    enter(page, "β", "2")
    page.get_by_text("β must be from 0 to 0.999999, got '2'").first.wait_for()
    assert live.snapshot.run.beta == 0.98
    expect(field(page, "β")).to_have_value("0.98")
    field(page, "hidden").scroll_into_view_if_needed()
    run = live.snapshot.run.number
    enter(page, "hidden", "8,x")
    page.get_by_text(re.compile(r"hidden.*8,x")).first.wait_for()
    assert live.snapshot.run.number == run
    assert live.snapshot.run.live.topology.describe() == "8-4-2"


# The worlds


def test_one_synapse_by_hand(page: Page, live: Live) -> None:
    choose(page, "task", "synapse")
    eventually(page, lambda: live.snapshot.run.task_name == "synapse")
    pause(page, live)
    weight = live.snapshot.run.live.weight[0]
    for button in ("Presynaptic spike", "Postsynaptic spike"):
        step, changes = live.snapshot.run.live.step, len(live.snapshot.run.changes)
        press(page, button)
        eventually(page, lambda changes=changes: len(live.snapshot.run.changes) > changes)
        press(page, "1 step")
        eventually(page, lambda step=step: live.snapshot.run.live.step == step + 1)
    assert live.snapshot.run.live.fired[1]
    trace = live.snapshot.run.live.trace[0]
    assert trace > 0
    assert live.snapshot.run.live.weight[0] == weight
    press(page, "+ reward")
    eventually(page, lambda: "reward" in str(live.snapshot.run.undo_words))
    press(page, "1 step")
    eventually(page, lambda: live.snapshot.run.live.weight[0] > weight)


def test_sonar_shows_the_class_and_the_prediction(page: Page, live: Live) -> None:
    choose(page, "task", "sonar")
    eventually(page, lambda: live.snapshot.run.task_name == "sonar")
    eventually(page, lambda: re.search(r"(rock|mine)", text_of(page), re.IGNORECASE))
    eventually(page, lambda: re.search(r"(predict|says|taken)", text_of(page), re.IGNORECASE))
    assert live.snapshot.run.live.topology.describe() == "60-8-1"
    assert "tilt" not in text_of(page)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("prediction", r"it is (red|amber|green), (as predicted|predicted was (red|amber|green))"),
        ("filtering", r"signal [+-]1, seen [+-]1, answer [+-]1: (right|wrong)"),
    ],
    ids=["prediction", "filtering"],
)
def test_a_small_task_tells_what_is_asked_and_answered(
    page: Page, live: Live, task: str, words: str
) -> None:
    choose(page, "task", task)
    eventually(page, lambda: live.snapshot.run.task_name == task)
    eventually(page, lambda: re.search(words, text_of(page)))


def angle_shown(page: Page) -> float | None:
    """The angle between the true gradient and the estimate, in degrees."""
    found = re.search(r"^(\d+\.\d)°$", text_of(page), re.MULTILINE)
    return None if found is None else float(found[1])


def test_the_estimate_goes_to_the_true_gradient(page: Page, live: Live) -> None:
    """Large after few steps, small after many; at β = 0 the hidden layer gets no estimate."""
    send(live, Choose("gradient", "still"), Pause(paused=True), StepOnce(100))
    eventually(page, lambda: "mean of 100 steps" in text_of(page))
    expect(page.get_by_role("tab", name="Gradient", exact=True)).to_be_visible()
    first = angle_shown(page)
    assert first is not None and first > 30.0
    send(live, SetSpeed("max"), Pause(paused=False))
    eventually(page, lambda: (angle_shown(page) or 180.0) < 12.0)
    assert "the bias of β 0.8" in text_of(page)
    for synapse in ("left lamp → hidden 1", "hidden 3 → output"):
        expect(page.get_by_text(synapse, exact=True).first).to_be_visible()
    send(live, SetBeta(0.0))
    eventually(page, lambda: 42.0 < (angle_shown(page) or 0.0) < 47.0)
    eventually(page, lambda: "The hidden layer is starved" in text_of(page))
    eventually(page, lambda: "before, β 0.8" in text_of(page))
    send(live, Freeze(frozen=True))
    eventually(page, lambda: "no estimate" in text_of(page))
    send(live, Choose("pendulum", "quick"))
    expect(page.get_by_role("tab", name="Gradient", exact=True)).to_have_count(0)


# Tabs and picks


def test_what_another_picks_is_not_picked_here(page: Page, live: Live) -> None:
    pause(page, live)
    choose(page, "from", "tilt x")
    page.get_by_text("tilt x → hidden 1").wait_for()
    with RawClient(int(live.site.address.rpartition(":")[2])) as other:
        other.send_value(other.find("from"), "tilt y")
        other.wait(
            lambda: [w for w in list(other.widgets.values()) if "tilt y → hidden 1" in str(w)]
        )
        step = step_shown(page)
        press(page, "1 step")
        eventually(page, lambda: step_shown(page) == step + 1)
        assert "tilt x → hidden 1" in text_of(page)
        assert "tilt y → hidden 1" not in text_of(page)


@pytest.mark.slow
def test_each_tab_follows_its_own_pick(
    page: Page, live: Live, browser: Browser, errors: list[str]
) -> None:
    pause(page, live)
    with tab_at(browser, live.site.address, width=WIDTH, height=HEIGHT) as other:
        listen(other, errors)
        choose(page, "from", "tilt x")
        page.get_by_text("tilt x → hidden 1").wait_for()
        choose(other, "pick", "hidden → output")
        choose(other, "to", "output 2")
        other.get_by_text("hidden 1 → output 2").wait_for()
        weight = live.snapshot.run.live.weight
        names = live.snapshot.run.live.topology
        assert f"{weight[4]:+.5f}" in text_of(page)  # from tilt x, the fifth input, to hidden 1
        assert f"{weight[names.synapses_of(1).start + 4]:+.5f}" in text_of(other)
        assert "hidden 1 → output 2" not in text_of(page)
        eventually(page, lambda: "2 tabs" in text_of(page))
    eventually(page, lambda: "1 tab" in text_of(page) and "2 tabs" not in text_of(page))
    assert "tilt x → hidden 1" in text_of(page)
    step = step_shown(page)
    press(page, "1 step")
    eventually(page, lambda: step_shown(page) == step + 1)


def test_a_click_on_a_neuron_picks_it(page: Page, live: Live) -> None:
    pause(page, live)
    unit = live.snapshot.run.live.topology.first_unit("hidden") + 2
    x, y = on_screen(page, live, unit)

    def click() -> None:
        page.mouse.move(x - 3, y - 3)
        page.mouse.click(x, y)

    again(page, click, page.get_by_text("σ(v), probability to fire"))
    assert "hidden 3" in text_of(page).partition("Inspect (this tab)")[2]


def on_screen(page: Page, live: Live, unit: int) -> tuple[float, float]:
    """Where a unit is seen on the page."""
    (client,) = live.site._server.get_clients().values()
    camera, canvas = client.camera, page.locator("canvas").first.bounding_box()
    assert canvas is not None
    where = place(live.snapshot.run.live.topology).units[unit] + network_at(live.snapshot.run.task)
    right, down, ahead = SO3(camera.wxyz).inverse() @ (where - camera.position)
    scale = canvas["height"] / 2 / math.tan(camera.fov / 2) / ahead
    return (
        canvas["x"] + canvas["width"] / 2 + scale * right,
        canvas["y"] + canvas["height"] / 2 + scale * down,
    )


# Many lanes


def band(page: Page) -> list[float]:
    """How wide the band of the learning curve is at each of its points."""
    widths: list[float] = page.evaluate(
        "() => { const plot = Object.values(window.__viserTestpoints.uplots)"
        ".map(p => p.chart).find(c => c.series.some(s => / of \\d+ lanes/.test(s.label)));"
        " if (!plot) return [];"
        " const [high, low] = plot.bands[0].series.map(k => plot.data[k]);"
        " return [...high].map((y, k) => y - low[k]).filter(Number.isFinite); }"
    )
    return widths


@pytest.mark.slow
def test_many_lanes_have_a_band_that_grows_while_one_is_watched(page: Page, live: Live) -> None:
    send(live, Choose("sonar", "quick"), SetSpeed(4000.0))
    expect(field(page, "task")).to_have_value("sonar")
    expect(field(page, "lanes")).to_have_value("1")
    expect(row(page, "lane")).to_have_count(0)
    assert band(page) == []
    enter(page, "lanes", "64")
    eventually(page, lambda: live.snapshot.run.lanes == 64)
    run = live.snapshot.run.number
    eventually(page, lambda: "64 lanes side by side, lane 0 watched" in text_of(page))
    eventually(page, lambda: len(band(page)) > 2)
    seen = band(page)
    eventually(page, lambda: len(band(page)) > len(seen) + 2)
    assert max(band(page)) > 1.0, "in %, of 64 lanes that differ"
    enter(page, "lane", "5")
    eventually(page, lambda: live.snapshot.run.lane == 5)
    field(page, "lane").blur()  # keys that are typed into a field are no commands
    page.keyboard.press("h")
    eventually(page, lambda: live.snapshot.run.lane == 6)
    eventually(page, lambda: "64 lanes side by side, lane 6 watched" in text_of(page))
    expect(field(page, "lane")).to_have_value("6")
    assert live.snapshot.run.number == run, "the run goes on as it is"
    assert "64 lanes = " in text_of(page)


# The look


def test_both_themes_draw_without_errors(page: Page, errors: list[str]) -> None:
    for theme in ("light", "dark"):
        choose(page, "theme", theme)
        page.locator(f"html[data-mantine-color-scheme={theme}]").wait_for(state="attached")
        step = step_shown(page)
        eventually(page, lambda step=step: step_shown(page) > step + 20)
        # charts come anew a moment after the theme, one after another
        eventually(page, lambda: page.evaluate(CHARTS) > 1)


def test_no_page_printed_an_error(page: Page, errors: list[str]) -> None:
    assert errors == []


# The server


def test_a_command_acts_at_once(live: Live) -> None:
    """Aim: 100 ms at full speed; the machine may be busy with other things."""
    send(live, Choose("pendulum", "quick"), SetSpeed("max"), Pause(paused=False))
    delays = []
    with RawClient(int(live.site.address.rpartition(":")[2])) as client:
        memory = client.find("β by memory")
        for k in range(9):
            value = round(1.0 + 0.1 * k, 2)
            time.sleep(0.05)
            began = time.monotonic()
            client.send_value(memory, value)
            wait_until(lambda value=value: live.snapshot.run.beta == round(1 - 10**-value, 6))
            delays.append(time.monotonic() - began)
    send(live, SetBeta(0.98), SetSpeed(SPEED), Pause(paused=True))  # and leave the machine alone
    assert statistics.median(delays) < 1.0


@pytest.mark.slow
def test_the_rule_is_chosen_and_its_baseline_shown(page: Page, live: Live) -> None:
    choose(page, "rule", "baseline")
    eventually(page, lambda: live.snapshot.run.live.rule == Baseline())
    page.get_by_text("the reward baseline").first.wait_for()
    typed = field(page, "time (steps)")
    typed.fill("250")
    typed.press("Enter")
    eventually(page, lambda: live.snapshot.run.live.rule == Baseline(time=250.0))
    typed = field(page, "γ falls over")
    typed.fill("2e4")
    typed.press("Enter")
    eventually(page, lambda: live.snapshot.run.live.fall == 2e4)
    page.get_by_text(re.compile("effective γ")).first.wait_for()
    page.get_by_role("tab", name="Reward, rates").click()
    page.get_by_text("memory of rule baseline").first.wait_for()
    for _ in range(3):
        before = live.snapshot.run.number
        press(page, "Undo")
        eventually(page, lambda n=before: live.snapshot.run.number > n)
    eventually(
        page,
        lambda: (live.snapshot.run.live.rule, live.snapshot.run.live.fall) == (PAPER, math.inf),
    )
    page.get_by_text("memory of rule baseline").first.wait_for(state="detached")
    page.get_by_role("tab", name="Learning").click()


def test_the_page_says_that_the_server_is_gone(page: Page, live: Live) -> None:
    """The last of these tests, for it ends what all of them look at."""
    gone = page.get_by_text(re.compile("connection to the server is lost", re.IGNORECASE))
    expect(gone).to_have_count(1)
    expect(gone).not_to_be_visible()
    live.stop()
    expect(gone).to_be_visible()
