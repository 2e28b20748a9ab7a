"""Pictures of the page, made by a real browser.

python tests/support/screenshots.py  # docs/page.png, lanes.png, gradient.png, recording.png
python tests/support/screenshots.py --only gradient
python tests/support/screenshots.py --all FOLDER   # each task, light and dark, wide and narrow
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from browser import choose, dismiss, field, open_browser, tab_at  # noqa: E402
from raw_client import wait_until  # noqa: E402

from hebbviz.learner.learner import Learner  # noqa: E402
from hebbviz.server.app import Site  # noqa: E402
from hebbviz.server.cli.training import Recorded, train  # noqa: E402
from hebbviz.server.live.commands import Choose, Command, Pause, Reset  # noqa: E402
from hebbviz.server.live.snapshot import Snapshot  # noqa: E402
from hebbviz.server.live.worker import Worker  # noqa: E402
from hebbviz.server.recording.recordings import Options  # noqa: E402
from hebbviz.server.recording.viewer import Viewer  # noqa: E402
from hebbviz.server.run.changes import Press, SetBeta  # noqa: E402
from hebbviz.sims import TASKS  # noqa: E402
from hebbviz.sims.loading import make_task  # noqa: E402

DOCS = ROOT / "docs"
WIDE, NARROW = (1600, 900), (390, 844)
LEARNING_SECONDS = 25.0
"""After so long the pendulum mostly stands, and its curve has a shape."""
GRADIENT_PLAN: tuple[tuple[int, Command], ...] = (
    (0, SetBeta(0.0)), (120_000, SetBeta(0.8)), (600_000, Pause(paused=True)),
)  # fmt: skip
"""Commands, each at about a step."""
LANES, LANES_STEPS = 64, 1_500_000
"""So many lanes of sonar, until their band has come down."""
RECORDED_STEPS = 120_000
VIEWER_SECONDS = 20.0
"""rerun's web viewer takes so long to load a recording without a graphics card."""
TIME_LINE = (1240, 886)
"""Where in the viewer's window its time line is, well into the run."""
DRAWN_SECONDS = 2.0
"""A browser without a graphics card needs so long to show what has just changed."""


@contextmanager
def serving(task: str, lanes: int = 1) -> Iterator[tuple[str, Worker]]:
    """A page of a task that runs from step 0: its address, and the worker."""
    learner = Learner(make_task(task), seed=0, lanes=lanes)
    site = Site(learner, host="127.0.0.1", port=0, speed=None, task_name=None)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    try:
        wait_until(lambda: site._worker is not None and site._worker.latest is not None, 60.0)
        assert site._worker is not None
        yield site.address, site._worker
    finally:
        stop.set()
        thread.join(10.0)


@contextmanager
def shown(task: str, lanes: int = 1) -> Iterator[tuple[Page, Worker]]:
    """The same in a wide tab of a browser."""
    with (
        serving(task, lanes) as (address, worker),
        open_browser() as browser,
        tab_at(browser, address, width=WIDE[0], height=WIDE[1], sharpness=1.0) as page,
    ):
        yield page, worker


def snapshot(worker: Worker) -> Snapshot:
    latest = worker.latest
    assert latest is not None
    return latest


def is_clear(latest: Snapshot) -> bool:
    """The pole leans a little, all is well within the arena, and both kinds of neuron are seen."""
    x, y, *_ = latest.view.frame.world
    fired = latest.view.frame.fired
    return abs(x) < 0.6 and abs(y) < 0.6 and 0 < fired.sum() < len(fired)


def wait_for_a_clear_moment(worker: Worker, seconds: float = 15.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and not is_clear(snapshot(worker)):
        time.sleep(0.02)


def tidy(page: Page) -> None:
    """Lists scrolled up, the mouse aside, no notices."""
    dismiss(page, "Software WebGL")
    page.mouse.move(5, 5)
    page.evaluate("document.querySelectorAll('*').forEach(e => { e.scrollTop = 0 })")


def shoot(page: Page, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=path)
    sys.stdout.write(f"{path}\n")
    sys.stdout.flush()


def with_few_colors(path: Path) -> None:
    """Write a picture again with a palette: one of many fine lines is half as large then."""
    Image.open(path).convert("RGB").quantize(256).save(path, optimize=True)


def make_page_picture() -> None:
    """The pendulum after a while of learning, with Watch on."""
    with shown("pendulum") as (page, worker):
        began = time.monotonic()
        tidy(page)
        page.wait_for_timeout(max(0.0, 1000 * (LEARNING_SECONDS - time.monotonic() + began)))
        wait_for_a_clear_moment(worker)
        shoot(page, DOCS / "page.png")


def make_lanes_picture() -> None:
    """Many lanes of sonar, one of them watched: the mean of them all and the band around it."""
    with shown("sonar", LANES) as (page, worker):
        tidy(page)
        while snapshot(worker).live.step < LANES_STEPS:  # the page must go on meanwhile
            page.wait_for_timeout(200)
        page.wait_for_timeout(1000 * DRAWN_SECONDS)
        shoot(page, DOCS / "lanes.png")
    with_few_colors(DOCS / "lanes.png")


def make_gradient_picture() -> None:
    """The exact gradient beside the rule's estimate, at β 0 first and then at β 0.8."""
    with shown("gradient") as (page, worker):
        worker.send(Reset())
        wait_until(lambda: snapshot(worker).live.step < GRADIENT_PLAN[1][0], 20.0)
        for steps, command in GRADIENT_PLAN:
            wait_until(lambda steps=steps: snapshot(worker).live.step >= steps, 180.0)
            worker.send(command)
        tidy(page)
        page.wait_for_timeout(1000 * DRAWN_SECONDS)
        shoot(page, DOCS / "gradient.png")


def make_recording_picture() -> None:
    """A recording of the pendulum in rerun's web viewer, well into the run."""
    with tempfile.TemporaryDirectory() as folder, open_browser() as browser:
        file = Path(folder) / "pendulum.rrd"
        learner = Learner(make_task("pendulum"), seed=2)
        options = Options(file=file, budget=10**9)
        with Recorded(learner, "pendulum", options, on_notice=print) as recorded:
            train(recorded, RECORDED_STEPS)
        viewer = Viewer(file)
        stop = threading.Event()
        thread = threading.Thread(
            target=lambda: viewer.run(stop, open_browser=False), daemon=True
        )  # fmt: skip
        thread.start()
        try:
            page = browser.new_page(
                viewport={"width": WIDE[0], "height": WIDE[1]}, color_scheme="dark"
            )
            page.goto(viewer.address)
            page.wait_for_timeout(1000 * VIEWER_SECONDS)
            page.mouse.click(*TIME_LINE)  # the viewer is a canvas: its time line has no name
            page.keyboard.press("Space")
            page.wait_for_timeout(1000 * VIEWER_SECONDS)
            shoot(page, DOCS / "recording.png")
        finally:
            stop.set()
            thread.join(10.0)


def something_to_see(task: str) -> list[Command]:
    """What makes a task show something by itself."""
    return [Press("Play (a)-(l)")] if task == "synapse" else []


def make_all(folder: Path) -> None:
    """Each task in both themes and both sizes."""
    with serving("pendulum") as (address, worker), open_browser() as browser:
        for size, (width, height) in (("wide", WIDE), ("narrow", NARROW)):
            with tab_at(browser, address, width=width, height=height, sharpness=1.0) as page:
                for task in TASKS.names:
                    for command in (Choose(task), *something_to_see(task), Pause(paused=False)):
                        worker.send(command)
                    wait_until(lambda task=task: snapshot(worker).run.task_name == task, 20.0)
                    page.wait_for_timeout(8000)
                    for theme in ("light", "dark"):
                        set_theme(page, theme)
                        tidy(page)
                        page.wait_for_timeout(1000 * DRAWN_SECONDS)
                        shoot(page, folder / f"{task}-{theme}-{size}.png")


def set_theme(page: Page, theme: str) -> None:
    choice = field(page, "theme")
    if choice.count() and choice.input_value() != theme:
        choose(page, "theme", theme)
    page.locator(f"html[data-mantine-color-scheme={theme}]").wait_for(state="attached")
    page.locator("canvas").first.wait_for()


PICTURES = {
    "page": make_page_picture, "lanes": make_lanes_picture, "gradient": make_gradient_picture,
    "recording": make_recording_picture,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description="Make pictures of the page.")
    parser.add_argument("--all", type=Path, metavar="FOLDER", help="each task, theme and width")
    parser.add_argument("--only", choices=PICTURES, help="only this one of the README's")
    args = parser.parse_args()
    if args.all is not None:
        make_all(args.all)
        return
    for name in PICTURES if args.only is None else (args.only,):
        PICTURES[name]()


if __name__ == "__main__":
    main()
