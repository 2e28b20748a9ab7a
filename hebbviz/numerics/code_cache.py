"""The compiler's cache on disk: it saves time and is never needed.

A file of it that is damaged is compiled again. Where none can be written, or there is no folder for
them, what is compiled is not kept. Either is told once, in one line on stderr.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import logging
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

from numba.core import caching

_told: set[str] = set()

_CHECKSUM_BYTES = 4


class _AtHome(caching.UserWideCacheLocator):
    """Where no home is known, numba would make a folder called ~."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        is_known = Path(cls(py_func, py_file).get_cache_path()).is_absolute()
        return super().from_function(py_func, py_file) if is_known else None


class _Code(caching.CompileResultCacheImpl):
    _locator_classes = [
        _AtHome if kind is caching.UserWideCacheLocator else kind
        for kind in caching.CompileResultCacheImpl._locator_classes  # noqa: SLF001
    ]


class _Files(caching.IndexDataCacheFile):
    """Each file ends with its checksum: damaged machine code would do anything."""

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        with super()._open_for_write(filepath) as file:
            content = io.BytesIO()
            yield content
            file.write(content.getvalue() + _checksum(content.getvalue()))

    def _load_index(self) -> Any:
        _check(self._index_path)
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        _check(self._data_path(name))
        return super()._load_data(name)


class _Cache(caching.FunctionCache):
    """Of one function, bound to a stamp of all that it is made of."""

    _impl_class = _Code

    def __init__(self, function: Callable[..., Any], stamp: tuple[Any, ...]) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._cache_path, f"{self._impl.filename_base}.checked", stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # whatever a damaged file makes of it
            _tell(
                self.cache_path, f"is damaged ({_why(error)}): it is compiled again; if this is "
                "said at each start, delete its files *.nbi and *.nbc",
            )  # fmt: skip
            with contextlib.suppress(Exception):  # told where it is to be written next
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _tell(
                self.cache_path, f"cannot be written ({_why(error)}): {_NOT_KEPT}; make room "
                "there, or name another folder by NUMBA_CACHE_DIR",
            )  # fmt: skip


_NOT_KEPT = "what is compiled is not kept, and each start takes longer"


def cache_of(function: Callable[..., Any], stamp: tuple[Any, ...]) -> Any:
    """The cache of a function; one that keeps nothing where there is no folder for it."""
    try:
        return _Cache(function, stamp)
    except Exception:
        _tell(
            str(Path(inspect.getfile(function)).with_name("__pycache__")),
            f"cannot be written, nor one in a home folder: {_NOT_KEPT}; name a folder by "
            "NUMBA_CACHE_DIR",
        )
        return caching.NullCache()


def _checksum(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CHECKSUM_BYTES, "little")


def _check(path: str) -> None:
    """Raise ValueError unless a file, if there is one, is as it was written."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return
    if _checksum(content[:-_CHECKSUM_BYTES]) != content[-_CHECKSUM_BYTES:]:
        raise ValueError(f"{Path(path).name} is not as it was written")


def _why(error: Exception) -> str:
    return cast(str, getattr(error, "strerror", None) or str(error) or type(error).__name__)


def _tell(folder: str, what: str) -> None:
    """Once for a folder. With no logging set up the line goes to stderr as it is."""
    if folder not in _told:
        _told.add(folder)
        logging.getLogger("hebbviz").warning(f"hebbviz: the compiler's cache in {folder} {what}")
