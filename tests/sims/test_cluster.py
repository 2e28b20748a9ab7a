"""A real Dask scheduler and two real workers on loopback, one of which is killed in mid-run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hebbviz.sims.experiments import Interrupted, Plan, open_workers, run, workers
from hebbviz.sims.program.terminal import InputError

ROOT = Path(__file__).parents[2]
PATIENCE = 60.0
PLAN = Plan(task="sonar", hidden=(3,), seed=7, lanes=6, segments=8, segment_steps=60_000)
LEVER = f"{ROOT / 'tests' / 'examples' / 'lever.py'}:Lever"


@pytest.fixture(autouse=True)
def _short_shares(monkeypatch):
    monkeypatch.setattr(workers, "SHARE_SECONDS", 0.3)
    monkeypatch.setattr(workers, "CONNECT_SECONDS", PATIENCE)


class Cluster:
    """A scheduler and its workers, each a process of its own with one thread."""

    def __init__(self, folder: Path, stack: contextlib.ExitStack) -> None:
        self._stack, self._log = stack, folder / "log"
        file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(file))
        self.address = _address(file)

    def worker(self) -> subprocess.Popen[bytes]:
        return self._start("worker", self.address, "--nthreads", "1", "--no-nanny")

    def _start(self, kind: str, *options: str) -> subprocess.Popen[bytes]:
        program = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--host", "127.0.0.1"]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        with self._log.open("ab") as log:
            process = subprocess.Popen(
                [*program, "--no-dashboard", *options],
                cwd=self._log.parent, env=environment, stdout=log, stderr=log,
            )  # fmt: skip
        self._stack.callback(_end, process)
        return process


def _address(file: Path) -> str:
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, ValueError):
            return json.loads(file.read_text())["address"]
        time.sleep(0.05)
    raise TimeoutError("the scheduler did not come up")


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait(PATIENCE)


@pytest.fixture
def cluster(tmp_path):
    with contextlib.ExitStack() as stack:
        yield Cluster(tmp_path, stack)


def _until(condition) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.05)


@pytest.mark.slow
def test_a_killed_worker_costs_its_share_and_nothing_else(cluster, tmp_path):
    with open_workers() as cores:
        local = run(PLAN, cores)
    both = [cluster.worker(), cluster.worker()]
    fractions = []

    def kill_later(fraction):
        fractions.append(fraction)
        if fraction > 0.2 and both[0].poll() is None:
            both[0].send_signal(signal.SIGKILL)
            both[0].wait(PATIENCE)

    with open_workers(cluster.address) as there:
        _until(lambda: there.count() == 2)
        remote = run(PLAN, there, folder=tmp_path, progress=kill_later)
        _until(lambda: there.count() == 1)
    assert both[0].returncode == -signal.SIGKILL
    assert max(f for f in fractions if f < 1.0) > 0.2, "it was killed in mid-run"
    assert fractions == sorted(fractions), "nothing that was done was lost"
    for name in ("end", "reward", "broadcast", "ended"):
        assert np.array_equal(getattr(remote, name), getattr(local, name)), name


@pytest.mark.slow
def test_a_scheduler_that_goes_away_ends_the_run_with_a_reason(cluster, tmp_path):
    plan = replace(PLAN, segments=400)
    stop = threading.Event()
    cluster.worker()

    def end(fraction):
        if fraction > 0.0:
            cluster.scheduler.kill()

    with pytest.raises(workers.LostWorkers), open_workers(cluster.address) as there:
        run(plan, there, folder=tmp_path, progress=end)
    stop.set()
    with pytest.raises(Interrupted), open_workers() as cores:
        run(plan, cores, folder=tmp_path, stop=stop, progress=(kept := []).append)
    assert kept[0] > 0.0, "what was done before is kept"


@pytest.mark.slow
def test_once_all_workers_are_gone_it_says_so_and_can_be_stopped(cluster, tmp_path, monkeypatch):
    """The shares that nobody will do are given up; a worker that came would have gone on."""
    plan, worker, stop, said = replace(PLAN, segments=400), cluster.worker(), threading.Event(), []
    monkeypatch.setattr(workers, "tell", lambda line: (said.append(line), stop.set()))
    ended = []

    def work():
        with open_workers(cluster.address) as there, pytest.raises(Interrupted):
            run(plan, there, folder=tmp_path, stop=stop, progress=kill_once_begun)
        ended.append(time.monotonic())

    def kill_once_begun(fraction):
        if fraction > 0.0 and worker.poll() is None:
            worker.kill()
            worker.wait(PATIENCE)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(PATIENCE)
    assert ended, "it still runs"
    assert said == [f"no workers left at {cluster.address}, waiting: start one, or Ctrl-C"]
    with pytest.raises(Interrupted), open_workers() as cores:
        run(plan, cores, folder=tmp_path, stop=stop, progress=(kept := []).append)
    assert 0.0 < kept[0] < 1.0


@pytest.mark.slow
def test_a_share_that_workers_die_of_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES", "0")
    deadly = tmp_path / "deadly.py"
    text = Path(LEVER.rpartition(":")[0]).read_text()
    deadly.write_text(text.replace("lamp = 1.0", "__import__('os')._exit(1)\n        lamp = 1.0"))
    plan = Plan(task=f"{deadly}:Lever", lanes=1, segments=1, segment_steps=300)
    with contextlib.ExitStack() as stack:
        cluster = Cluster(tmp_path, stack)
        cluster.worker()
        with (
            open_workers(cluster.address) as there,
            pytest.raises(workers.LostWorkers, match="a part of the work failed"),
        ):
            run(plan, there)


@pytest.mark.slow
def test_a_user_s_task_in_python_and_rule_are_found_there(cluster, tmp_path, monkeypatch):
    """Also by a path from the folder that only this process is in."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    text = (ROOT / "hebbviz" / "rules" / "baseline.py").read_text()
    Path("own.py").write_text(text.replace('name = "baseline"', 'name = "own"'))
    options = {"rule": "own.py:Baseline:time=50"}
    plan = Plan(task=LEVER, seed=2, lanes=2, segments=3, segment_steps=300, options=options)
    cluster.worker()
    with open_workers() as cores, open_workers(cluster.address) as there:
        assert np.array_equal(run(plan, there).reward, run(plan, cores).reward)


@pytest.mark.slow
def test_a_scheduler_without_workers_is_refused(cluster, monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_SECONDS", 10.0)  # to connect as well
    with pytest.raises(InputError, match="has no workers"), open_workers(cluster.address):
        pass


def test_where_no_scheduler_answers_it_says_so(monkeypatch):
    monkeypatch.setattr(workers, "CONNECT_SECONDS", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        for wrong in (address, "nowhere", "tcp://", "file:///x", ""):
            with pytest.raises(InputError, match="no Dask scheduler answers"), open_workers(wrong):
                pass


@pytest.mark.parametrize("wrong", ["nowhere", "tcp://127.0.0.1:abc", "tcp://h:0", "h:99999", ""])
def test_what_is_no_address_is_refused_before_dask_is_asked(wrong, monkeypatch):
    """Its client would hang on some of them, and complain once it is collected."""
    monkeypatch.setattr("distributed.Client", None)
    said = "that is not an address, give one as tcp://HOST:PORT"
    with pytest.raises(InputError, match=said), open_workers(wrong):
        pass


def test_without_dask_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install .hebbviz\[cluster\]"), open_workers("x:1"):
        pass
