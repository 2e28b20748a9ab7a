"""Imports go down only, from room to room, and in no circle; those that are only for types too."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

ROOMS = (
    "hebbviz", "hebbviz.limits", "hebbviz.numerics", "hebbviz.topology", "hebbviz.reference",
    "hebbviz.theory", "hebbviz.task", "hebbviz.rules", "hebbviz.engine", "hebbviz.learner",
    "hebbviz.conformance",
    "hebbviz.sims.worlds", "hebbviz.sims", "hebbviz.sims.program", "hebbviz.sims.experiments",
    "hebbviz.sims.figures", "hebbviz.sims.sweep",
    "hebbviz.server.web", "hebbviz.server.scene", "hebbviz.server.run", "hebbviz.server.recording",
    "hebbviz.server.live", "hebbviz.server.page", "hebbviz.server", "hebbviz.server.cli",
    "hebbviz.__main__",
)  # fmt: skip
"""From the lowest up. A module is in the room with the longest name that its own begins with."""

PUBLIC = "hebbviz"
"""The public API, which imports each of its names when it is first used: it alone may point up."""


def modules() -> dict[str, Path]:
    """All modules of ours by the name they are imported by."""
    found = {}
    for top in ("hebbviz", "sims", "server"):
        for path in sorted((ROOT / top).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            name = name if top == "hebbviz" else f"hebbviz.{name}"
            found[name.removesuffix(".__init__")] = path
    return found


def imports(source: str, known: set[str]) -> set[str]:
    """Modules out of `known` that a source imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert not node.level, "a relative import"
            names = (f"{node.module}.{alias.name}" for alias in node.names)
            found |= {name if name in known else str(node.module) for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & known


def room(module: str) -> int:
    """The place of a module's room in `ROOMS`."""
    names = [r for r in ROOMS if f"{module}.".startswith(f"{r}.")]
    return ROOMS.index(max(names, key=len))


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of nodes of which each can be reached from each other."""

    def reached(node: str) -> set[str]:
        seen: set[str] = set()
        waiting = [node]
        while waiting:
            for other in graph[waiting.pop()] - seen:
                seen.add(other)
                waiting.append(other)
        return seen

    reach = {node: reached(node) for node in graph}
    return {
        frozenset(other for other in reach[node] if node in reach[other])
        for node in graph
        if node in reach[node]
    }


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    files = modules()
    known = set(files)
    return {name: imports(path.read_text(), known) - {name} for name, path in files.items()}


def test_imports_go_down(graph: dict[str, set[str]]) -> None:
    below = graph.keys() - {PUBLIC}
    assert {(a, b) for a in below for b in graph[a] if room(b) > room(a)} == set()


def test_no_circle(graph: dict[str, set[str]]) -> None:
    """Modules import the package itself only for its version: that is not counted."""
    assert circles({a: graph[a] - {PUBLIC} for a in graph.keys() - {PUBLIC}}) == set()


def test_the_modules_are_found(graph: dict[str, set[str]]) -> None:
    assert {
        "hebbviz.server.page.page",
        "hebbviz.sims.worlds.sonar",
        "hebbviz.reference",
    } <= graph.keys()
    assert "hebbviz.server.live.worker" in graph["hebbviz.server.app"]
    source = "def f():\n from a.b import c, d\n import a\n"
    assert imports(source, {"a", "a.b", "a.b.c"}) == {"a", "a.b", "a.b.c"}
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"d"}}) == {
        frozenset("bc"), frozenset("d"),
    }  # fmt: skip


def test_one_name_is_installed() -> None:
    assert (distribution("hebbviz").read_text("top_level.txt") or "").split() == ["hebbviz"]


def test_a_server_and_sims_of_the_users_own_change_nothing(tmp_path: Path) -> None:
    for name in ("server.py", "sims.py"):
        (tmp_path / name).write_text("raise RuntimeError('a file of the user')\n")
    done = subprocess.run(
        [sys.executable, "-m", "hebbviz", "train", "--task", "synapse", "--steps", "5"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": f"{os.curdir}{os.pathsep}{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
