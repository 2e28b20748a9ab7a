"""The compiler's cache on disk, which saves time but is never required.

Code in a damaged file is compiled again. If files cannot be written, or there is no folder for
them, compiled code is not saved. Each case is reported once, in one line on stderr.
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
    """Rejects an unknown home folder, for which numba would make a folder called ~."""

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
    """Cache files that end with a checksum, because damaged machine code could do anything."""

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
    """The cache of one function, bound to its cache key."""

    _impl_class = _Code

    def __init__(self, function: Callable[..., Any], stamp: tuple[Any, ...]) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._cache_path, f"{self._impl.filename_base}.checked", stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # a damaged file can raise anything
            _tell(
                self.cache_path, f"is damaged ({_why(error)}): its code is compiled again; if this "
                "appears at each start, delete its files *.nbi and *.nbc",
            )  # fmt: skip
            with contextlib.suppress(Exception):  # the next write reports it
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _tell(
                self.cache_path, f"cannot be written ({_why(error)}): {_NOT_KEPT}; make room "
                "there, or set NUMBA_CACHE_DIR to another folder",
            )  # fmt: skip


_NOT_KEPT = "compiled code is not saved, and each start takes longer"


def cache_of(function: Callable[..., Any], stamp: tuple[Any, ...]) -> Any:
    """Return the cache of a function; without a folder for it, a cache that saves nothing."""
    try:
        return _Cache(function, stamp)
    except Exception:
        _tell(
            str(Path(inspect.getfile(function)).with_name("__pycache__")),
            f"cannot be written, nor one in a home folder: {_NOT_KEPT}; set NUMBA_CACHE_DIR to a "
            "folder",
        )
        return caching.NullCache()


def _checksum(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CHECKSUM_BYTES, "little")


def _check(path: str) -> None:
    """Raise ValueError if a file exists and does not match its checksum."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return
    if _checksum(content[:-_CHECKSUM_BYTES]) != content[-_CHECKSUM_BYTES:]:
        raise ValueError(f"{Path(path).name} does not match its checksum")


def _why(error: Exception) -> str:
    return cast(str, getattr(error, "strerror", None) or str(error) or type(error).__name__)


def _tell(folder: str, what: str) -> None:
    """Log a warning once per folder; if logging is not set up, it goes to stderr."""
    if folder not in _told:
        _told.add(folder)
        logging.getLogger("hebbviz").warning(f"hebbviz: the compiler's cache in {folder} {what}")
