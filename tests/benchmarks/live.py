"""How fast the page is: first picture, pictures to many clients, steps/s with and without one.

    python tests/benchmarks/live.py            # a table; under three minutes
    python tests/benchmarks/live.py --json     # the same for programs

A picture counts as received when a websocket frame arrives that changes the network on the scene:
the page draws a picture in one atomic group, which viser sends in one frame, and of pictures that
wait for a slow client it sends one. Clients run in a
process of their own, as browsers do, and share the machine with the server.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from raw_client import RawClient, wait_until  # noqa: E402

CLIENTS = 8
STRETCH_SECONDS = 6.0
"""One measurement of steps/s or pictures/s."""
PAIRS = 3
"""Stretches without and with a client take turns, for the machine may do other things too."""
SETTLE_SECONDS = 1.5
COMMANDS = 20
TASKS = ("pendulum", "sonar")
SCENE = (b"SceneNodeUpdateMessage", b"/network/")
"""What is in a message that changes what is seen of the network."""


@dataclass(frozen=True)
class Bar:
    """A figure, and the bar it is to meet: at least, or at most."""

    name: str
    value: float
    unit: str
    bar: float | None = None
    at_least: bool = False

    @property
    def verdict(self) -> str:
        if self.bar is None:
            return ""
        met = self.value >= self.bar if self.at_least else self.value < self.bar
        sign = "≥" if self.at_least else "<"
        return f"{'met   ' if met else 'MISSED'} {sign} {self.bar:g}"


class PictureClient(RawClient):
    """Counts the pictures that arrive; it knows no widgets and costs little."""

    pictures = 0

    def _read(self, frame: bytes) -> None:
        size = int.from_bytes(frame[:8], "little")
        packed = int.from_bytes(frame[8:16], "little")
        inner = self._decompressor.decompress(frame[16 : 16 + packed], max_output_size=size)
        has_scene = False
        for raw in self._frame_decoder.decode(inner).messages:
            encoded = bytes(raw)
            self.messages += 1
            has_scene = has_scene or all(word in encoded for word in SCENE)
        self.pictures += has_scene


# The other processes: this file with other arguments


def serve_and_answer(task: str) -> None:
    """A server at full speed that answers on stdout: `step`, or `betas SECONDS`."""
    from hebbviz.learner.learner import Learner
    from hebbviz.server.app import Site
    from hebbviz.sims.loading import make_task

    learner = Learner(make_task(task), seed=0)
    site = Site(learner, host="127.0.0.1", port=0, speed="max", task_name=None)
    stop = threading.Event()
    thread = threading.Thread(target=lambda: site.run(stop, open_browser=False), daemon=True)
    thread.start()
    wait_until(lambda: site._worker is not None and site._worker.latest is not None, 60.0)
    worker = site._worker
    assert worker is not None
    _answer({"port": int(site.address.rpartition(":")[2])})
    for line in sys.stdin:
        question, *arguments = line.split()
        snapshot = worker.latest
        assert snapshot is not None
        if question == "step":
            _answer({"step": snapshot.run.live.step, "at": snapshot.made_at})
        if question == "betas":
            end, seen = time.monotonic() + float(arguments[0]), {}
            while time.monotonic() < end:
                newer = worker.wait_for(snapshot.number, 0.2)
                if newer is not None:
                    snapshot = newer
                    seen.setdefault(f"{snapshot.run.beta:.6f}", snapshot.made_at)
            _answer(seen)
    stop.set()
    thread.join(5.0)


def receive(port: int, clients: int, seconds: float) -> None:
    """Some clients for a while: how many pictures and bytes each got per second."""
    with contextlib.ExitStack() as stack:
        all_clients = [stack.enter_context(PictureClient(port)) for _ in range(clients)]
        for client in all_clients:
            wait_until(lambda client=client: client.pictures > 0, 30.0)
        time.sleep(SETTLE_SECONDS)
        began, before = time.monotonic(), [(c.pictures, c.bytes) for c in all_clients]
        _answer({"ready": True})
        time.sleep(seconds)
        took = time.monotonic() - began
        got = [
            ((c.pictures - n) / took, (c.bytes - size) / took)
            for c, (n, size) in zip(all_clients, before, strict=True)
        ]
    _answer({"pictures": [n for n, _ in got], "bytes": [size for _, size in got]})


def send_betas(port: int) -> None:
    """Set β again and again: at which time which."""
    sent = {}
    with RawClient(port) as client:
        memory = client.find("β by memory", timeout=30.0)
        for k in range(COMMANDS):
            value = round(1.0 + 0.01 * k, 2)
            sent[f"{1 - 10**-value:.6f}"] = time.monotonic()
            client.send_value(memory, value)
            time.sleep(0.15 + 0.007 * k)
    _answer(sent)


def _answer(what: dict[str, Any]) -> None:
    sys.stdout.write(f"@{json.dumps(what)}\n")
    sys.stdout.flush()


class Child:
    """Another process of this file."""

    def __init__(self, *arguments: object) -> None:
        command = [sys.executable, __file__, *map(str, arguments)]
        self._process = subprocess.Popen(
            command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def ask(self, question: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{question}\n")
        self._process.stdin.flush()

    def answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("@"):
                told: dict[str, Any] = json.loads(line[1:])
                return told
        raise RuntimeError("a process of the benchmark ended early")


# What is measured


def first_picture(*, cold: bool) -> Bar:
    """From the start of the program to the first picture at a client."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | ({"NUMBA_CACHE_DIR": folder} if cold else {})
        began = time.monotonic()
        with subprocess.Popen(
            [sys.executable, "-m", "hebbviz", "serve", "--no-browser", "--port", "0"],
            cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True,
        ) as server:  # fmt: skip
            assert server.stdout is not None
            try:
                line = ""
                while "hebbviz is at" not in line:
                    line = server.stdout.readline()
                    if not line:
                        raise RuntimeError("the server ended early")
                port = int(line.split()[3].rpartition(":")[2])
                with PictureClient(port) as client:
                    wait_until(lambda: client.pictures > 0, 60.0)
                    seconds = time.monotonic() - began
            finally:
                server.terminate()
                server.wait(10)
    kind, bar = ("cold", 30.0) if cold else ("warm", 5.0)
    return Bar(f"first picture, {kind}", seconds, "s", bar)


def steps_per_second(server: Child, seconds: float) -> float:
    """Of the run, over a stretch."""
    server.ask("step")
    first = server.answer()
    time.sleep(seconds)
    server.ask("step")
    last = server.answer()
    speed: float = (last["step"] - first["step"]) / (last["at"] - first["at"])
    return speed


def speeds(task: str) -> Iterator[Bar]:
    """All that is measured of one task at full speed."""
    with Child("--serve", task) as server:
        port = server.answer()["port"]
        time.sleep(SETTLE_SECONDS)
        alone, watched = [], []
        for _ in range(PAIRS):
            alone.append(steps_per_second(server, STRETCH_SECONDS))
            with Child("--receive", port, 1, STRETCH_SECONDS + 1.0) as client:
                client.answer()
                watched.append(steps_per_second(server, STRETCH_SECONDS))
                client.answer()
            time.sleep(SETTLE_SECONDS)
        yield Bar(f"{task}: no client", statistics.median(alone), "steps/s")
        yield Bar(f"{task}: one client", statistics.median(watched), "steps/s")
        ratios = [w / a for w, a in zip(watched, alone, strict=True)]
        yield Bar(f"{task}: one client / none", statistics.median(ratios), "", 0.8, at_least=True)
        with Child("--receive", port, CLIENTS, STRETCH_SECONDS) as clients:
            clients.answer()
            with_many = steps_per_second(server, STRETCH_SECONDS - 1.0)
            got = clients.answer()
        slowest, each = min(got["pictures"]), statistics.mean(got["bytes"]) / 1e6
        yield Bar(f"{task}: {CLIENTS} clients, slowest", slowest, "pictures/s", 30, at_least=True)
        yield Bar(f"{task}: {CLIENTS} clients, each", each, "MB/s")
        yield Bar(f"{task}: {CLIENTS} clients", with_many, "steps/s")
        with Child("--send", port) as client:
            server.ask("betas 7")
            sent, seen = client.answer(), server.answer()
        delays = [1000 * (seen[b] - at) for b, at in sent.items() if b in seen]
        yield Bar(f"{task}: β sent to seen, median", statistics.median(delays), "ms", 100.0)
        yield Bar(f"{task}: β sent to seen, slowest of {len(delays)}", max(delays), "ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--task", choices=TASKS, action="append", help="only this one")
    parser.add_argument("--no-start", action="store_true", help="do not measure the start")
    for name, values in (("--serve", 1), ("--receive", 3), ("--send", 1)):
        parser.add_argument(name, nargs=values, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        return serve_and_answer(args.serve[0])
    if args.receive:
        port, clients, seconds = args.receive
        return receive(int(port), int(clients), float(seconds))
    if args.send:
        return send_betas(int(args.send[0]))
    bars: list[Bar] = []

    def note(bar: Bar) -> None:
        bars.append(bar)
        if not args.json:
            sys.stdout.write(f"{bar.name:<38}{bar.value:>12,.4g} {bar.unit:<11}{bar.verdict}\n")
            sys.stdout.flush()

    if not args.no_start:
        note(first_picture(cold=True))
        first_picture(cold=False)  # this one may compile and write what the next one loads
        note(first_picture(cold=False))
    for task in args.task or TASKS:
        for bar in speeds(task):
            note(bar)
    if args.json:
        figures = [asdict(bar) | {"verdict": bar.verdict.split(" ")[0]} for bar in bars]
        sys.stdout.write(f"{json.dumps(figures, indent=1)}\n")
    return None


if __name__ == "__main__":
    main()
