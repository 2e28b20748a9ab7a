"""Specs of users' files: path.py:Name, for a rule optionally followed by :parameter=value,...

This module does not import the files.
"""

from __future__ import annotations

import ast
import contextlib
from collections.abc import Iterator
from pathlib import Path


def own_file(spec: str) -> tuple[Path | None, str]:
    """Split a spec into its file and the rest; for a plain name return None and the name."""
    path, own, rest = spec.partition(".py:")
    return (Path(f"{path}.py"), rest) if own else (None, spec)


def own_files(task: str | None, rule: str | None) -> dict[str, Path]:
    """Return the absolute paths by their specs: 'task my.py:Name', 'rule my.py:Name'."""
    found = {}
    for what, spec in (("task", task), ("rule", rule)):
        file, _ = own_file(spec or "")
        if file is not None:
            found[f"{what} {spec}"] = file.resolve()
    return found


def neighbours(file: Path) -> dict[str, Path]:
    """Return the modules in a file's folder that it imports, directly or indirectly, by name.

    A package is represented by its `__init__.py`.
    """
    found: dict[str, Path] = {}
    waiting = [file]
    while waiting:
        for name in _imported(waiting.pop()):
            beside = (file.with_name(f"{name}.py"), file.parent / name / "__init__.py")
            path = next((p for p in beside if p.is_file()), None)
            if path is not None and name not in found and path.resolve() != file.resolve():
                found[name] = path
                waiting.append(path)
    return found


def _imported(file: Path) -> Iterator[str]:
    """Yield the names of the modules that a file imports; none if it cannot be read."""
    tree = ast.Module([], [])
    with contextlib.suppress(OSError, SyntaxError, ValueError):
        tree = ast.parse(file.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]
