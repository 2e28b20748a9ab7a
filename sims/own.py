"""What a user's own file is given as: path.py:Name, of a rule with :parameter=value,... after it or
not. It is not looked into here.
"""

from __future__ import annotations

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
