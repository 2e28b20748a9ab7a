"""What a user's own file is given as: path.py:Name, of a rule with :parameter=value,... after it or
not. It is not looked into here.
"""

from __future__ import annotations

import ast
import contextlib
from collections.abc import Iterator
from pathlib import Path


def own_file(spec: str) -> tuple[Path | None, str]:
    """The file of a spec, and what stands after it; a name alone has none, and is all there is."""
    path, own, rest = spec.partition(".py:")
    return (Path(f"{path}.py"), rest) if own else (None, spec)


def own_files(task: str | None, rule: str | None) -> dict[str, Path]:
    """The whole paths by what they were given as: 'task my.py:Name', 'rule my.py:Name'."""
    found = {}
    for what, spec in (("task", task), ("rule", rule)):
        file, _ = own_file(spec or "")
        if file is not None:
            found[f"{what} {spec}"] = file.resolve()
    return found


def neighbours(file: Path) -> dict[str, Path]:
    """The modules beside a file that it imports, and those that they import, by name; a package
    is its `__init__.py`.
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
    """Names of the modules that a text imports; of one that cannot be read, none."""
    tree = ast.Module([], [])
    with contextlib.suppress(OSError, SyntaxError, ValueError):
        tree = ast.parse(file.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]
