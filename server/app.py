"""The live program: one learner, one worker thread, one page for any number of tabs."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, TypedDict, Unpack

from hebbviz.server.live.commands import SetSpeed
from hebbviz.server.live.pacing import REALTIME, check_speed
from hebbviz.server.live.session import Session
from hebbviz.server.live.worker import Worker
from hebbviz.server.page import status_text
from hebbviz.server.page.page import Page
from hebbviz.server.recording.recordings import Options, Recordings
from hebbviz.server.run.run import Run
from hebbviz.server.web import guard
from hebbviz.server.web.access import EVERYWHERE, Access, Role
from hebbviz.server.web.browser_window import open_window
from hebbviz.sims.program.compiling import announced_compiling, warm_up
from hebbviz.sims.program.interrupts import Interrupts
from hebbviz.sims.program.learner_from_arguments import maker
from hebbviz.sims.program.output import Stream

if TYPE_CHECKING:
    from hebbviz.learner.learner import Learner
    from hebbviz.server.live.pacing import Speed
    from hebbviz.task.base import Task

DEFAULT_PORT = 8080
SHUTDOWN_SECONDS = 1.0
"""How long the worker may take to finish its last chunk of steps."""
COMPILING = "compiling for this machine: about 15 s, only this first time"


class AccessOptions(TypedDict, total=False):
    """Options that control access to the page, see `Access`."""

    allow_hosts: Sequence[str]
    token: bool | None
    frame_from: Sequence[str]


class Served:
    """A page served in a thread. Use it in a `with` statement, or call `stop`."""

    def __init__(self, site: Site) -> None:
        self._site, self._stop = site, threading.Event()
        self._thread = threading.Thread(
            target=lambda: site.run(self._stop, open_browser=False), name="hebbviz", daemon=True
        )
        self._thread.start()

    @property
    def link(self) -> str:
        """The address to open in a browser, with its token if it needs one."""
        return self._site.link

    def stop(self) -> None:
        """Stop the run, close the page and finish a recording."""
        self._stop.set()
        self._thread.join()

    def __enter__(self) -> Served:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def serve(
    learner: Learner,
    *,
    block: bool = True,
    host: str = "127.0.0.1",
    port: int | None = None,
    speed: Speed | None = None,
    open_browser: bool = False,
    task_name: str | None = None,
    recording: Options | None = None,
    stop: threading.Event | None = None,
    **access: Unpack[AccessOptions],
) -> Served | None:
    """Show `learner` on a page and let it run.

    Args:
        learner: The learner. Leave it alone while it is served.
        block: Return only after Ctrl-C, SIGTERM or `stop`. With False the page is served in a
            thread, and a `Served` with its link is returned.
        host: Address to listen on.
        port: Port to listen on (0: any free one); None: 8080 or the next free one above it.
        speed: Steps per second, 'realtime' or 'max'; None: a speed that suits the task.
        open_browser: Open the page in the default browser.
        task_name: Name of the task, if different from the task's own: `path.py:Name` for example.
        recording: What to record.
        stop: Event that stops the page, for programs that call this in a thread.
        allow_hosts: Other names, as NAME or NAME:PORT, under which the page may be reached.
        token: Whether the link must hold a token; None: only if other machines can reach the page.
        frame_from: Origins, such as http://localhost:8888, that may show the page in a frame (a
            notebook).

    Raises ValueError if a value is out of range or the task has no time step to run at 'realtime',
    OSError if the address cannot be listened on, and TaskError if the task fails in its first
    steps; later failures are shown on the page.
    """
    rights = Access(
        tuple(access.get("allow_hosts", ())),
        access.get("token"),
        tuple(access.get("frame_from", ())),
    )

    def prepare() -> Site:
        with announced_compiling(lambda: _say(COMPILING)):
            return Site(
                learner,
                host=host,
                port=port,
                speed=speed,
                task_name=task_name,
                recording=recording,
                access=rights,
            )

    if not block:
        return Served(prepare())
    with Interrupts(stop) as interrupts:
        site = interrupts.prepare(prepare)
        site.run(interrupts.stop, open_browser=open_browser)
    return None


class Site:
    """A learner ready to be shown; raises as `serve` does. It listens once it is constructed.

    With a `past`, which is a run read from a recording, it plays that run back.
    """

    def __init__(
        self,
        learner: Learner,
        *,
        host: str,
        port: int | None,
        speed: Speed | None,
        task_name: str | None,
        recording: Options | None = None,
        past: Run | None = None,
        access: Access = Access(),  # noqa: B008
    ) -> None:
        check_start(learner.task, speed)
        self._past = past is not None
        self.is_stuck = False
        self._options = recording or Options()
        self._recordings: Recordings | None = None
        self._host, self._asked_port, self._speed = host, port, speed
        self._page: Page | None = None
        self._worker: Worker | None = None
        self._run = past or Run(learner, maker(learner.task, task_name), task_name)
        self._server = guard.open_server(
            host,
            port,
            default_port=DEFAULT_PORT,
            access=access,
            on_refusal=self._notify,
            on_turned_away=self._say_notice,
        )
        self._entrance = self._server.entrance
        try:
            warm_up(learner)
            self._recordings = Recordings(self._run, self._options, on_notice=self._say_notice)
        except BaseException:
            self._server.stop()
            raise

    @property
    def address(self) -> str:
        """The address on this machine."""
        name = "localhost" if self._host in EVERYWHERE else self._host
        name = f"[{name}]" if ":" in name else name
        return f"http://{name}:{self._server.get_port()}"

    @property
    def link(self) -> str:
        """The link to open in a browser on this machine."""
        return self._entrance.link(self.address)

    def run(self, stop: threading.Event, *, open_browser: bool) -> None:
        """Show and step the run until `stop` is set; then close everything."""
        with warnings.catch_warnings():  # a tab may close at any time without harm
            warnings.filterwarnings("ignore", message=".*closed connection")
            self._show(stop, open_browser=open_browser)

    def _show(self, stop: threading.Event, *, open_browser: bool) -> None:
        try:
            page = self._page = Page(self._server)
            session = Session(
                self._run,
                on_notice=page.notify,
                recordings=self._recordings,
                in_the_past=self._past,
            )
            worker = self._worker = Worker(session)
            if self._speed is not None:
                worker.send(SetSpeed(self._speed))
            worker.start()
            self._announce()
            if open_browser:
                open_window(self._entrance.link_for_once(self.address))
            page.run(worker, stop)
        finally:
            self._close()

    def _announce(self) -> None:
        port = self._server.get_port()
        if self._asked_port is None and port != DEFAULT_PORT:
            _say(f"port {DEFAULT_PORT} is taken, using {port}")
        if self._options.file is not None and self._recordings is not None:
            status = self._recordings.status
            _say(f"recording into {status.where if status else self._options.file}")
        if self._recordings is not None and self._recordings.stream_url is not None:
            _say(f"see it live in rerun's viewer: rerun {self._recordings.stream_url}")
        self._announce_address()

    def _announce_address(self) -> None:
        entrance, address = self._entrance, self.address
        if entrance.needs_token:
            _say(f"read-only link: {entrance.link(address, Role.READER)}")
        if warning := entrance.warning(f"change the run and record into {self._options.folder}"):
            _say(warning)
        if entrance.needs_token and entrance.is_open:
            _say("on other machines, replace the host in the links with this machine's name there")
        _say(f"hebbviz is at {self.link} (stop it with Ctrl-C)")

    def _close(self) -> None:
        if self._worker is not None:
            self._worker.stop()
        if self._page is not None:
            self._page.close()
        self._server.stop()
        if self._worker is not None:
            self._worker.join(SHUTDOWN_SECONDS)
        if self._recordings is not None:  # save before printing
            self.is_stuck = self._recordings.close()  # by a disk that cannot be waited for
        self._say_end()

    def _say_end(self) -> None:
        if self._worker is not None:
            error = self._worker.latest and self._worker.latest.pacing.error
            _say(f"stopped at step {self._run.learner.step:,}{f': {error}' if error else ''}")
        status = None if self._recordings is None else self._recordings.status
        if status is not None and status.error is None:
            _say(f"recorded {status_text.recorded(status)} in {status.where}")

    def _say_notice(self, text: str) -> None:
        """Show a notice on the page and on the terminal."""
        stderr = Stream(sys.stderr)
        stderr.write(f"hebbviz: {text}\n")
        stderr.flush()
        self._notify(text)

    def _notify(self, text: str) -> None:
        """Show a notice of the guard, which listens before there is a page."""
        if self._page is not None:
            self._page.notify(text)


def check_start(task: Task, speed: Speed | None) -> None:
    """Raise ValueError if a task cannot run at a speed."""
    if speed is not None and check_speed(speed) == REALTIME and task.dt is None:
        raise ValueError(
            f"speed 'realtime' needs a task with a time step, but {task.name!r} has none: "
            "give max or steps per second"
        )


def _say(line: str) -> None:
    """Print a line, also in a user's program, whose stdout may be anything."""
    stdout = Stream(sys.stdout)
    stdout.write(f"{line}\n")
    stdout.flush()
