"""Workers: threads or processes of this machine, or the workers of a Dask cluster."""

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
"""Duration of a work unit, which a kill may lose."""

CONNECT_SECONDS = 10.0
COUNT_SECONDS = 0.5
"""Interval between counts of a cluster's workers."""


class LostWorkers(WorkersFailed):
    """The workers are gone for good; completed work is saved."""


class Workers(Protocol):
    """Runs work units, through executors of `concurrent.futures`."""

    def count(self) -> int:
        """Return the number of work units that can run at once now."""

    def submit(self, plan: Plan, tile: Tile, digest: str) -> Future[Tile]:
        """Submit a work unit for a tile; it fails if the plan no longer has this digest."""

    def result(self, share: Future[Tile]) -> Tile:
        """Return the result of a completed work unit; raise its exception or LostWorkers."""

    def hurry(self, on: bool) -> None:
        """Make running work units end as soon as possible, or no longer, if that is possible."""


@contextlib.contextmanager
def open_workers(scheduler: str | None = None) -> Iterator[Workers]:
    """Open all cores of this machine, or the workers of the Dask scheduler at an address.

    Raises InputError if Dask is not installed, nothing answers at the address, or the scheduler has
    no workers.
    """
    workers = _Cores() if scheduler is None else _Cluster(scheduler)
    try:
        yield workers
    finally:
        workers.close()


class _Cores:
    """The cores of this machine.

    Compiled loops release the GIL, so threads use all cores. A world stepped by Python needs
    processes, which start only for such a world.
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
        stop = (self._stop,) if threads else ()  # a process gets it when it starts
        with contextlib.nullcontext() if threads else _signals_held():  # in new processes
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
            raise LostWorkers("a worker process died") from error

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
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Block signals while worker processes start, which then never receive them.

    A terminal sends Ctrl-C to all processes, and a service manager sends SIGTERM, but this process
    must stop the others. It receives blocked signals afterwards.
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
    """Kill the worker processes at once and release their semaphores; a work unit may be lost."""
    for process in list((executor._processes or {}).values()):  # noqa: SLF001  # kill_workers of 3.14
        process.kill()
    executor.shutdown(cancel_futures=True)


def _begin_process(stop: Stop) -> None:
    """Make this process end with its parent, however that ends, and never write to its stdout."""
    obey(stop)
    logging.getLogger("hebbviz").setLevel(logging.ERROR)  # the parent reports about its cache
    sys.stdout = sys.stderr = cast(TextIO, Stream(sys.stderr))
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


class _Cluster:
    """The workers of a Dask scheduler; they may come and go.

    Dask gives the work unit of a worker that died to another one.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise InputError('--scheduler needs Dask: pip install "hebbviz[cluster]"') from error
        if not _is_address(address):  # Dask's client would hang, and fail much later
            raise InputError(
                f"no Dask scheduler answers at {address}: that is not an address, give one as "
                "tcp://HOST:PORT"
            )
        self._address, self._killed = address, KilledWorker
        for name in ("distributed", "distributed.client"):  # errors arrive as exceptions
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client: Any = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as error:  # OSError: a TimeoutError too
            # The failed client closes itself when it is collected. If that happened while the next
            # one starts, both would wait for one of Dask's locks.
            traceback.clear_frames(error.__traceback__)
            gc.collect()
            raise InputError(
                f"no Dask scheduler answers at {address}: start one with 'dask scheduler', or "
                "correct the address"
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
                with tqdm.external_write_mode():  # a progress bar may be shown
                    tell(f"no workers left at {self._address}, waiting: start one, or Ctrl-C")
        return self._threads

    def submit(self, plan: Plan, tile: Tile, digest: str) -> Future[Tile]:
        return _submit(self._executor, plan, tile, digest)

    def result(self, share: Future[Tile]) -> Tile:
        try:
            return share.result()
        except CancelledError as error:
            raise self._lost() from error
        except self._killed as error:  # Dask gives up a unit at which several workers died
            raise LostWorkers(f"a part of the work failed: {error}") from error

    def hurry(self, on: bool) -> None:
        """Do nothing: workers of a cluster cannot be notified, but units last only seconds."""

    def _lost(self) -> LostWorkers:
        return LostWorkers(f"the Dask scheduler at {self._address} is gone")

    def close(self) -> None:
        self._client.close(timeout=CONNECT_SECONDS)


def _is_address(text: str) -> bool:
    """Whether the text is an address that Dask knows, with a host and a port."""
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
