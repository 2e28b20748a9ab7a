"""Imports run one way: the rule knows no world, and no world knows the page."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "hebbviz": {"sims", "server", "viser", "pymunk", "rerun"},
    "sims": {"server", "viser", "rerun"},
}
FILES = [(p, path) for p in FORBIDDEN for path in sorted((ROOT / p).glob("**/*.py"))]


def imported(source):
    """The top-level packages that a source imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level)
    return names


@pytest.mark.parametrize(("package", "path"), FILES, ids=lambda x: getattr(x, "name", x))
def test_a_file_imports_nothing_from_above(package, path):
    assert not imported(path.read_text()) & (FORBIDDEN[package] | {".."})


def test_the_files_are_there():
    assert {"rule.py", "sonar.py"} <= {path.name for _, path in FILES}
    assert imported("def f():\n from viser.x import y\n import a.b as c, d\n") == {
        "viser",
        "a",
        "d",
    }


def test_hebbviz_alone_brings_in_no_world_and_no_page():
    paths = [path.relative_to(ROOT).with_suffix("") for p, path in FILES if p == "hebbviz"]
    modules = [".".join(path.parts) for path in paths]
    assert _loaded(modules) & FORBIDDEN["hebbviz"] == set()


def test_the_tasks_bring_in_no_page():
    names = ["sims.loading", "sims.pendulum", "sims.sonar", "sims.synapse", "sims.prediction",
             "sims.filtering", "sims.gradient"]  # fmt: skip
    loaded = _loaded(names)
    assert loaded & FORBIDDEN["sims"] == set()
    assert {"hebbviz", "pymunk"} <= loaded


def _loaded(modules):
    """Top-level packages in a fresh Python after importing these."""
    code = f"import sys, {', '.join(modules)}; print(*{{n.split('.')[0] for n in sys.modules}})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return set(done.stdout.split())
