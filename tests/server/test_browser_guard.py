"""The guard in a real browser: what other pages can do with ours, and what ours can do."""

from __future__ import annotations

import contextlib
import html
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from browser import PATIENCE, eventually, press, shows_a_run, tab_at, text_of
from playwright.sync_api import Browser, ConsoleMessage, Page
from raw_client import wait_until

from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.server.live.commands import Choose, SetSpeed
from hebbviz.server.live.worker import Worker
from hebbviz.server.web.access import Access
from hebbviz.sims import TASKS
from hebbviz.sims.loading import make_task

# viser warns of what is sent to a tab in the moment in which it closes
pytestmark = pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection")

SPLATS = "Evaluating a string as JavaScript violates"
"""viser's sorter of Gaussian splats, of which there are none here, wants more than it may have."""


@contextlib.contextmanager
def shown(access: Access = Access()) -> Iterator[tuple[Site, Worker]]:  # noqa: B008
    """A page of the small task, and the worker behind it."""
    learner = Learner(make_task("synapse"))
    site = Site(learner, host="127.0.0.1", port=0, speed=50.0, task_name=None, access=access)
    stop = threading.Event()
    thread = threading.Thread(target=site.run, args=(stop,), kwargs={"open_browser": False})
    thread.start()
    try:
        wait_until(lambda: site._worker is not None and site._worker.latest is not None, 30.0)
        assert site._worker is not None
        yield site, site._worker
    finally:
        stop.set()
        thread.join()


@contextlib.contextmanager
def framing(address: list[str]) -> Iterator[str]:
    """The origin of a page on another port, which shows `address[0]` in a frame."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            framed = f'<iframe src="{html.escape(address[0])}" width="900" height="600"></iframe>'
            body = f"<!doctype html><title>other</title>{framed}".encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def open_framed(page: Page, origin: str) -> str:
    """Where the frame of the page at `origin` came to be."""
    page.goto(origin, wait_until="load")
    (frame,) = page.frames[1:]
    return str(frame.evaluate("location.href")) if frame.url else ""


@pytest.mark.slow
def test_a_page_on_another_port_cannot_frame_ours(browser: Browser) -> None:
    address = [""]
    with framing(address) as origin, shown() as (site, _):
        address[0] = site.address
        page = browser.new_page()
        assert open_framed(page, origin).startswith("chrome-error:")
        assert not page.frames[1].locator("canvas").count()
        page.close()


@pytest.mark.slow
def test_a_page_that_is_named_can_frame_ours_with_the_token(browser: Browser) -> None:
    address = [""]
    with (
        framing(address) as origin,
        shown(Access(token=True, frame_from=(origin,))) as (site, _),
        browser.new_context() as context,
    ):
        address[0] = site.link
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        assert open_framed(page, origin).startswith(site.address)
        shows_a_run(page.frames[1])


@pytest.mark.slow
def test_the_link_opens_the_page_and_the_cookie_keeps_it_open(browser: Browser) -> None:
    with shown(Access(token=True)) as (site, _), browser.new_context() as context:
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        answer = page.goto(site.address)
        assert answer is not None and answer.status == 403
        assert "open the link that was printed" in text_of(page)
        for link in (site._entrance.link_for_once(site.address), site.address):
            page.goto(link)
            shows_a_run(page)
        assert page.evaluate("document.cookie") == ""  # scripts cannot read it
        assert page.evaluate("document.referrer") == ""


@pytest.mark.slow
def test_no_task_s_page_wants_more_than_the_policy_gives(browser: Browser) -> None:
    said: list[str] = []
    asked: set[str] = set()

    def note(line: ConsoleMessage) -> None:
        # a picture that gave way to the next before it was loaded is no trouble
        if line.type == "error" and not line.location["url"].startswith("blob:"):
            said.append(line.text)

    def listen(page: Page) -> None:
        page.on("console", note)
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.add(request.url))

    with shown() as (site, worker):
        for task in TASKS.names:
            worker.send(Choose(task))
            worker.send(SetSpeed(50.0))
            wait_until(lambda task=task: worker.latest.run.task_name == task, 60.0)
            with tab_at(browser, site.address, width=1100, height=640, listen=listen) as page:
                for name in ("Reward, rates", "Synapses", "Spikes now"):
                    page.get_by_role("tab", name=name).click()
                eventually(page, lambda: page.locator("canvas").count() > 1)
                press(page, "overview")
    assert [line for line in said if SPLATS not in line] == []
    ours = (site.address, "data:", "blob:")
    assert [where[:80] for where in asked if not where.startswith(ours)] == []
