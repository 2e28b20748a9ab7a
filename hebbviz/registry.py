"""Built-in rules and tasks, found by scanning a package: each module is called what it defines."""

from __future__ import annotations

import pkgutil
from collections.abc import Collection
from functools import cache
from importlib import import_module
from typing import Any


class Registry:
    """The classes of one kind in a package: each has a `name`, and its module has it too.

    Args:
        package: Where they are.
        first: Name of the one that is listed first; the others follow in alphabetical order.
        besides: Modules of the package that define none.
    """

    def __init__(self, package: str, *, first: str, besides: Collection[str] = ()) -> None:
        self._package, self._first, self._besides = package, first, frozenset(besides)

    @property
    def names(self) -> tuple[str, ...]:
        """All names; nothing but the package is imported for them."""
        names = set(module_names(self._package)) - self._besides
        return tuple(sorted(names, key=lambda name: (name != self._first, name)))

    def find(self, name: str) -> Any:
        """The class of that name, which must be one of `names`."""
        module = import_module(f"{self._package}.{name}")
        kinds = (k for k in vars(module).values() if isinstance(k, type))
        return next(k for k in kinds if vars(k).get("name") == name)


@cache
def module_names(package: str) -> tuple[str, ...]:
    """Names of the modules of a package; only the package itself is imported."""
    return tuple(m.name for m in pkgutil.iter_modules(import_module(package).__path__))
