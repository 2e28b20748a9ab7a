"""Who does the shares: threads or processes of this machine, or the workers of a Dask cluster."""

# ruff: noqa: PLC0415  # Dask is an extra, and heavy

from __future__ import annotations

import contextlib
import gc
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from typing import Any, Protocol, TextIO, cast

from tqdm import tqdm  # type: ignore[import-untyped]

import hebbviz
from hebbviz.sims.experiments.plan import Plan
from hebbviz.sims.experiments.work_unit import Stop, Tile, bring_on, obey
from hebbviz.sims.program.interrupts import SIGNALS
from hebbviz.sims.program.output import Stream
from hebbviz.sims.program.terminal import InputError, WorkersFailed, tell
from hebbviz.task.base import CompiledTask

SHARE_SECONDS = 3.0
"""How long a worker is busy with a share: what a kill may cost."""

CONNECT_SECONDS = 10.0
COUNT_SECONDS = 0.5
"""The workers of a cluster are counted so often."""


class LostWorkers(WorkersFailed):
    """The workers are gone for good; what was done is kept."""


class Workers(Protocol):
    """Those who do shares, through executors of `concurrent.futures`."""

    def count(self) -> int:
        """How many shares can be done at once, as things are now."""

    def submit(self, plan: Plan, tile: Tile, digest: str) -> Future[Tile]:
        """Have a tile brought on by a share, if the plan is still what it was by this digest."""

    def result(self, share: Future[Tile]) -> Tile:
        """What came of a share that is done; raises what it raised, and LostWorkers."""

    def hurry(self, on: bool) -> None:
        """Have shares end as soon as they can, where they can be told so, or no longer."""


@contextlib.contextmanager
def open_workers(scheduler: str | None = None) -> Iterator[Workers]:
    """All cores of this machine, or the workers of the Dask scheduler at an address.

    Raises InputError if Dask is not installed, nothing answers there, or no worker is to be had.
    """
    workers = _Cores() if scheduler is None else _Cluster(scheduler)
    try:
        yield workers
    finally:
        workers.close()


class _Cores:
    """The cores of this machine.

    Compiled loops release the GIL, so that threads use all cores; a world that is stepped by
    Python gets processes, which start only if there is one.
    """

    def __init__(self) -> None:
        self._cores = core_count()
        self._executors: dict[bool, Executor] = {}
        self._stop = multiprocessing.get_context("spawn").Event()

    def count(self) -> int:
        return self._cores

    def submit(self, plan: Plan, tile: Tile, digest: str) -> Future[Tile]:
        threads = isinstance(plan.make_task(), CompiledTask)
        if threads not in self._executors:
            self._executors[threads] = self._threads() if threads else self._processes()
        stop = (self._stop,) if threads else ()  # a process has it from its beginning
        with contextlib.nullcontext() if threads else _signals_held():  # by those that start here
            return _submit(self._executors[threads], plan, tile, digest, *stop)

    def hurry(self, on: bool) -> None:
        if on:
            self._stop.set()
        else:
            self._stop.clear()

    def result(self, share: Future[Tile]) -> Tile:
        try:
            return share.result()
        except BrokenExecutor as error:
            raise LostWorkers("a process that did a share of the work died") from error

    def close(self) -> None:
        for executor in self._executors.values():
            if isinstance(executor, ProcessPoolExecutor):
                _end_processes(executor)
            executor.shutdown(wait=False, cancel_futures=True)

    def _threads(self) -> Executor:
        return ThreadPoolExecutor(self._cores, thread_name_prefix="hebbviz lanes")

    def _processes(self) -> Executor:
        return ProcessPoolExecutor(
            self._cores,
            multiprocessing.get_context("spawn"),
            initializer=_begin_process,
            initargs=(self._stop,),
        )


def core_count() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """A terminal sends Ctrl-C to all processes, and who ends a service SIGTERM, but it is for this
    one to stop the others. Those that start in here never take them; this one takes them after.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_processes(executor: ProcessPoolExecutor) -> None:
    """At once, whatever they do: nothing hangs on a share, and its semaphores are given back."""
    for process in list((executor._processes or {}).values()):  # noqa: SLF001  # kill_workers of 3.14
        process.kill()
    executor.shutdown(cancel_futures=True)


def _begin_process(stop: Stop) -> None:
    """End with the program that began this process, however it ends, whose stdout is not ours."""
    obey(stop)
    logging.getLogger("hebbviz").setLevel(logging.ERROR)  # of its cache the first process tells
    sys.stdout = sys.stderr = cast(TextIO, Stream(sys.stderr))
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


class _Cluster:
    """The workers of a Dask scheduler; they may come and go.

    Dask gives the share of a worker that died to another one.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise InputError('--scheduler needs Dask: pip install "hebbviz[cluster]"') from error
        if not _is_address(address):  # Dask's client would hang, and say so much later
            raise InputError(
                f"no Dask scheduler answers at {address}: that is no address, give one as "
                "tcp://HOST:PORT"
            )
        self._address, self._killed = address, KilledWorker
        for name in ("distributed", "distributed.client"):  # what matters comes as an exception
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client: Any = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as error:  # OSError: a TimeoutError too
            # The client that failed closes itself when it is collected. Were that left to chance,
            # it could be while the next one starts, and both would wait for one lock of Dask's.
            traceback.clear_frames(error.__traceback__)
            gc.collect()
            raise InputError(
                f"no Dask scheduler answers at {address}: start one with 'dask scheduler', or "
                "mend the address"
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_SECONDS)
        except OSError as error:
            self.close()
            raise InputError(
                f"the scheduler at {address} has no workers: start some with "
                f"'dask worker {address}'"
            ) from error
        self._threads, self._counted_at = 0, -COUNT_SECONDS
        self._executor = self._client.get_executor(pure=False)

    def count(self) -> int:
        if time.monotonic() - self._counted_at > COUNT_SECONDS:
            before = self._threads
            try:
                self._threads = sum(self._client.nthreads().values())
            except OSError as error:
                raise self._lost() from error
            self._counted_at = time.monotonic()
            if before and not self._threads:
                with tqdm.external_write_mode():  # there may be a bar
                    tell(f"no workers left at {self._address}, waiting: start one, or Ctrl-C")
        return self._threads

    def submit(self, plan: Plan, tile: Tile, digest: str) -> Future[Tile]:
        return _submit(self._executor, plan, tile, digest)

    def result(self, share: Future[Tile]) -> Tile:
        try:
            return share.result()
        except CancelledError as error:
            raise self._lost() from error
        except self._killed as error:  # Dask gives a share up that several died at
            raise LostWorkers(f"a share of the work failed: {error}") from error

    def hurry(self, on: bool) -> None:
        """They cannot be told so: their shares are over after a few seconds."""

    def _lost(self) -> LostWorkers:
        return LostWorkers(f"the Dask scheduler at {self._address} is gone")

    def close(self) -> None:
        self._client.close(timeout=CONNECT_SECONDS)


def _is_address(text: str) -> bool:
    """Whether Dask knows such addresses, of a host and a port."""
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.registry import get_backend

    try:
        scheme, place = parse_address(text)
        get_backend(scheme)
        host, port = parse_host_port(place)
    except ValueError:
        return False
    return bool(host.strip()) and 0 < port < 2**16


def _submit(executor: Executor, plan: Plan, tile: Tile, digest: str, *stop: Stop) -> Future[Tile]:
    return executor.submit(bring_on, plan, tile, SHARE_SECONDS, hebbviz.__version__, digest, *stop)
