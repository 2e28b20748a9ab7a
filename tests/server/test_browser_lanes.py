"""Many lanes in a real browser: another task, a switch, another number of lanes, another theme."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from browser import choose, eventually, row, tab_at, text_of
from playwright.sync_api import Browser, Page
from raw_client import wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.live.commands import Choose, Pause, Reset
from hebbviz.server.live.snapshot import Snapshot
from hebbviz.server.live.worker import Worker
from hebbviz.server.page import camera
from hebbviz.server.scene.appearance import NETWORK_ALONE, NETWORK_OVER_WORLD
from hebbviz.sims.loading import make_task

pytestmark = [
    pytest.mark.slow, pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection")
]  # fmt: skip

AXES = """() => Object.values(window.__viserTestpoints.uplots).map(p => p.chart).map(c =>
  [c.root.querySelector('.u-title').textContent, c.scales.x.min, c.scales.x.max,
   c.data[0][0], c.data[0].at(-1)])"""
NETWORKS = """() => Object.entries(window.__viserMutable.nodeRefFromName)
  .filter(([name, node]) => name.endsWith('/network') && node)
  .map(([_, node]) => node.position.toArray())"""
EARLIER = """() => Object.values(window.__viserTestpoints.uplots).map(p => p.chart)
  .filter(c => c.series.some(s => s.label === 'earlier run'))
  .map(c => [...c.data[c.series.findIndex(s => s.label === 'earlier run')]]
    .filter(y => y !== null && Number.isFinite(y)).length)[0] ?? -1"""
"""Points of an earlier run that a chart shows; -1 where none has one."""
MARK_CHARTS = """() => Object.values(window.__viserTestpoints.uplots)
  .forEach(p => p.chart.root.dataset.before = 'yes')"""
MARKED_CHARTS = """() => Object.values(window.__viserTestpoints.uplots)
  .filter(p => p.chart.root.dataset.before).length"""


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    site = Site(
        Learner(make_task("pendulum"), seed=0), host="127.0.0.1", port=0, speed=None, task_name=None
    )
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    wait_until(lambda: site._worker is not None and site._worker.latest is not None, 60.0)
    yield site
    stop.set()
    thread.join(10.0)


def latest(site: Site) -> Snapshot:
    assert site._worker is not None and site._worker.latest is not None
    return site._worker.latest


def worker(site: Site) -> Worker:
    assert site._worker is not None
    return site._worker


def stands_at_the_overview(site: Site) -> bool:
    (client,) = site._server.get_clients().values()
    return camera._stands_at(client, camera._pose(client, camera.OVERVIEW, latest(site)))


def network_stands_at(page: Page) -> list[float]:
    """Where the only network in the scene stands."""
    places: list[list[float]] = page.evaluate(NETWORKS)
    return places[0] if len(places) == 1 else []


def axes_fit(page: Page) -> bool:
    """Whether every chart's axis of steps is the one of what it shows."""
    charts: list[Any] = page.evaluate(AXES)
    fits = [
        np.allclose((low, high), (first, last), rtol=1e-3, atol=1e-3)
        for _, low, high, first, last in charts
        if None not in (low, high, first, last)
    ]
    return len(fits) == len(charts) > 0 and all(fits)


def test_many_lanes_are_seen_whatever_is_chosen(site: Site, browser: Browser) -> None:
    with tab_at(browser, site.address, width=1100, height=640) as page:
        eventually(page, lambda: network_stands_at(page) == list(NETWORK_OVER_WORLD))
        worker(site).send(Choose("sonar"))  # a page that has just opened still moves its camera
        eventually(page, lambda: latest(site).run.task_name == "sonar")
        eventually(page, lambda: latest(site).run.live.step > 20_000)
        eventually(page, lambda: re.search(r"training error [\d.]{2,} %", text_of(page)))
        page.wait_for_timeout(1000 * camera.SECONDS)
        eventually(page, lambda: stands_at_the_overview(site))
        eventually(page, lambda: network_stands_at(page) == list(NETWORK_ALONE))

        box = row(page, "centred").get_by_role("checkbox")
        assert not box.is_checked()
        box.click()
        only_centred = {"centred": True, "scaled": False, "constant": False}
        eventually(page, lambda: latest(site).run.task.settings == only_centred)
        assert latest(site).run.task.preset_name == "quick:centred=yes"
        eventually(page, box.is_checked)
        row(page, "constant").get_by_role("checkbox").click()
        eventually(
            page, lambda: latest(site).run.task.preset_name == "quick:centred=yes,constant=yes"
        )
        eventually(page, lambda: latest(site).run.live.step > 20_000)

        worker(site).send(Reset(lanes=8))
        eventually(page, lambda: latest(site).run.lanes == 8 and "mean of 8 lanes" in text_of(page))
        assert latest(site).run.ghost is not None
        eventually(page, lambda: latest(site).run.live.step > 20_000)
        assert page.evaluate(EARLIER) < 1, "one lane is nothing beside the mean of many"
        worker(site).send(Reset())
        eventually(page, lambda: latest(site).run.live.step > 3_000 and page.evaluate(EARLIER) > 5)

        worker(site).send(Pause(paused=True))
        for theme in ("light", "dark"):
            page.evaluate(MARK_CHARTS)
            choose(page, "theme", theme)
            page.locator(f"html[data-mantine-color-scheme={theme}]").wait_for(state="attached")
            eventually(page, lambda: page.evaluate(MARKED_CHARTS) == 0)
            page.wait_for_timeout(6_000)
            eventually(page, lambda: axes_fit(page))
