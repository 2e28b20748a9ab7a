"""A real browser for the tests and the screenshots: Playwright's own Chromium, or the system's."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

import pytest
from playwright.sync_api import Browser, Frame, Locator, Page, Playwright, sync_playwright
from playwright.sync_api import TimeoutError as NoSign

SYSTEM_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-renderer-backgrounding",  # two tabs are looked at, of which one is in front
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
)
PATIENCE = 60_000.0
"""Milliseconds; software WebGL on a shared core is slow."""
_TRIES = 12
"""Of one thing, within PATIENCE."""

FEW_FRAMES = """
{
  const draw = requestAnimationFrame.bind(window), drop = cancelAnimationFrame.bind(window);
  const drawn = new Map();
  window.requestAnimationFrame = (then) => {
    const id = setTimeout(() => drawn.set(id, draw((now) => {
      drawn.delete(id);
      then(now);
    })), 60);
    return id;
  };
  window.cancelAnimationFrame = (id) => {
    clearTimeout(id);
    drop(drawn.get(id) ?? 0);
    drawn.delete(id);
  };
}
"""
"""The page draws some ten frames a second: they are what a machine without a GPU is busy with."""


class NoBrowser(RuntimeError):
    """There is no Chromium on this machine."""


@contextmanager
def open_browser() -> Iterator[Browser]:
    """A headless Chromium; raises NoBrowser where there is none."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find(playwright), args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def browser_or_skip() -> Iterator[Browser]:
    """As `open_browser`, but skips the test where there is no browser; in CI that is a failure."""
    try:
        with open_browser() as browser:
            yield browser
    except NoBrowser as error:
        _do_without(str(error))


def find(playwright: Playwright) -> str:
    """Path of a Chromium."""
    own = playwright.chromium.executable_path
    if Path(own).exists():
        return own
    for name in SYSTEM_BROWSERS:
        if (path := shutil.which(name)) is not None:
            return path
    raise NoBrowser("no Chromium: apt-get install chromium, or playwright install chromium")


def _do_without(reason: str) -> NoReturn:
    if os.environ.get("CI", "").lower() not in ("", "0", "false"):
        pytest.fail(f"{reason} (in CI the browser tests must run)")
    pytest.skip(reason)


# On the page


@contextmanager
def tab_at(
    browser: Browser,
    address: str,
    *,
    width: int,
    height: int,
    sharpness: float = 0.5,
    listen: Callable[[Page], object] = lambda _: None,
) -> Iterator[Page]:
    """A tab with the page, once it shows what runs and viser's notice of slow graphics is gone.

    It is closed in the end: all tabs of a browser are drawn by one process, and one that is
    forgotten makes those after it many times slower. `sharpness` is how many pixels of the scene
    are drawn for one of the screen: few are fast. `listen` gets the tab before it opens the page.
    """
    with browser.new_context(viewport={"width": width, "height": height}) as context:
        context.set_default_timeout(PATIENCE)
        context.add_init_script(FEW_FRAMES)
        page = context.new_page()
        listen(page)
        address, _, query = address.partition("/?")
        page.goto(f"{address}/?fixedDpr={sharpness}&{query}", wait_until="domcontentloaded")
        page.locator("canvas").first.wait_for()
        page.get_by_text(re.compile("hebbviz")).first.wait_for()
        shows_a_run(page)
        dismiss(page, "Software WebGL")
        yield page


def shows_a_run(page: Page | Frame) -> None:
    """Wait until a page says how fast its run goes. (The page's policy lets Playwright evaluate,
    but not wait for a function.)
    """
    page.get_by_text("steps/s").first.wait_for(timeout=PATIENCE)


def dismiss(page: Page, text: str) -> None:
    """Close the notices that say `text`."""
    notices = page.locator(".mantine-Notification-root", has_text=text)
    while notices.count():
        count = notices.count()
        notices.first.get_by_role("button").click()
        eventually(page, lambda count=count: notices.count() < count)


def row(page: Page, label: str) -> Locator:
    """The row of a widget: its label, and beside it what is set."""
    return page.locator(f"div.mantine-Flex-root:has(> div label:text-is('{label}'))")


def field(page: Page, label: str) -> Locator:
    """What is typed into."""
    return row(page, label).locator("input:not([type=hidden])").last


def enter(page: Page, label: str, text: str) -> None:
    """Type into a field, and press Enter."""
    field(page, label).fill(text)
    field(page, label).press("Enter")


def choose(page: Page, label: str, option: str) -> None:
    """Choose from a drop-down list; one that is drawn anew as it opens is opened again."""
    found = page.get_by_role("option", name=option, exact=True).locator("visible=true").first
    again(page, lambda: _open(page, label), found)
    found.click()


def _open(page: Page, label: str) -> None:
    page.keyboard.press("Escape")
    field(page, label).click()


def again(page: Page, action: Callable[[], object], sign: Locator) -> None:
    """Do it until there is a sign of it: a busy page loses a click now and then."""
    for _ in range(_TRIES):
        action()
        with suppress(NoSign):
            return sign.wait_for(timeout=PATIENCE / _TRIES)
    raise AssertionError(f"done again and again in vain; the page says:\n{text_of(page)}")


def slide(page: Page, label: str, key: str, times: int = 1) -> None:
    """Move a slider with an arrow key."""
    thumb = row(page, label).get_by_role("slider")
    for _ in range(times):
        thumb.press(key)


def press(page: Page, name: str) -> None:
    """Press a button whose name begins with `name`."""
    page.get_by_role("button", name=re.compile(f"^{re.escape(name)}")).first.click()


def still(page: Page, thing: Locator) -> Locator:
    """A widget once it stands still: folders open slowly, and what is aimed at moves away."""
    boxes: list[object] = [None]

    def stands() -> bool:
        boxes.append(thing.bounding_box())
        page.wait_for_timeout(150)
        return boxes[-1] is not None and boxes[-1] == boxes[-2]

    eventually(page, stands)
    return thing


def drag(page: Page, name: str, *shares: float) -> None:
    """Drag the slider of a name to shares of its rail, one after another.

    At each the hand waits for the thumb: the page notes only once a frame where the mouse is.
    """
    thumb = row(page, name).get_by_role("slider")
    thumb.scroll_into_view_if_needed()
    rail = still(page, row(page, name).locator(".mantine-Slider-trackContainer")).bounding_box()
    assert rail is not None
    y = rail["y"] + rail["height"] / 2

    def reach() -> float:
        """Where the middle of the thumb is, as a share of the rail."""
        box = thumb.bounding_box()
        assert box is not None
        return (box["x"] + box["width"] / 2 - rail["x"]) / rail["width"]

    page.mouse.move(rail["x"] + reach() * rail["width"], y)
    page.mouse.down()
    for share in shares:
        page.mouse.move(rail["x"] + share * rail["width"], y, steps=4)
        eventually(page, lambda share=share: abs(reach() - share) < 0.05)
    page.mouse.up()


def text_of(page: Page) -> str:
    """All that can be read on the page."""
    said: str = page.evaluate("document.body.innerText")
    return said


def eventually(page: Page, condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait until `condition` holds, while the page goes on."""
    for _ in range(round(seconds / 0.02)):
        if condition():
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"waited {seconds} s in vain; the page says:\n{text_of(page)}")
