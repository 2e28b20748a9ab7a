"""Who does the shares: the threads of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass


@dataclass(frozen=True)
class Workers:
    """An executor, and how many shares it can do at once as things are now."""

    executor: Executor
    count: Callable[[], int]


@contextlib.contextmanager
def open_workers(scheduler: str | None = None) -> Iterator[Workers]:
    """All cores of this machine, or with the address of a Dask scheduler its workers.

    Compiled loops release the GIL, so that threads use all cores.
    """
    if scheduler is not None:
        raise NotImplementedError
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    executor = ThreadPoolExecutor(cores or 1, thread_name_prefix="hebbviz lanes")
    try:
        yield Workers(executor, lambda: cores or 1)
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
