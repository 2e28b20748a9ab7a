"""Imports run one way: the rule knows no world, and no world knows the page."""

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "hebbviz": {"hebbviz.sims", "hebbviz.server", "viser", "pymunk", "rerun"},
    "sims": {"hebbviz.server", "viser", "rerun"},
}
"""Packages that may not be loaded. `tests/test_rooms.py` holds the order of our own modules."""
MAY_POINT_UP = {ROOT / "hebbviz/__init__.py", ROOT / "hebbviz/__main__.py"}
"""The public API and the command line, which import when they are used."""
FILES = [(p, path) for p in FORBIDDEN for path in sorted((ROOT / p).glob("**/*.py"))]


def imported(source):
    """The packages that a source imports, anywhere in it, and those that they are in."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add("." * node.level)
    parts = [name.split(".") for name in names if name.strip(".")]
    within = {".".join(p[:k]) for p in parts for k in range(1, len(p) + 1)}
    return within | {name for name in names if not name.strip(".")}


@pytest.mark.parametrize(("package", "path"), FILES, ids=lambda x: getattr(x, "name", x))
def test_a_file_imports_no_package_that_is_for_those_above(package, path):
    if path not in MAY_POINT_UP:
        assert not imported(path.read_text()) & FORBIDDEN[package]


def test_the_files_are_there():
    assert {"kernel.py", "sonar.py"} <= {path.name for _, path in FILES}
    found = imported("def f():\n from viser.x import y\n import a.b as c, d\n")
    assert found == {"viser", "viser.x", "viser.x.y", "a", "a.b", "d"}


def test_hebbviz_alone_brings_in_no_world_and_no_page():
    files = [path.relative_to(ROOT) for p, path in FILES if p == "hebbviz"]
    modules = [".".join(file.with_suffix("").parts) for file in files]
    assert _loaded(modules) & FORBIDDEN["hebbviz"] == set()


def test_the_tasks_bring_in_no_page():
    worlds = "pendulum", "sonar", "synapse", "prediction", "filtering", "gradient"
    names = ["hebbviz.sims.loading", *(f"hebbviz.sims.worlds.{world}" for world in worlds)]
    loaded = _loaded(names)
    assert loaded & FORBIDDEN["sims"] == set()
    assert {"hebbviz", "pymunk"} <= loaded


PAGE = """
import sys, threading
from hebbviz.learner.learner import Learner
from hebbviz.server.app import Site
from hebbviz.sims.loading import make_task

site = Site(Learner(make_task("synapse")), host="127.0.0.1", port=0, speed=None, task_name=None)
stop = threading.Event()
stop.set()
site.run(stop, open_browser=False)
print("rerun" in sys.modules)
"""


def test_a_page_that_recorded_nothing_ends_without_rerun():
    """Which takes half a second to import."""
    done = subprocess.run(
        [sys.executable, "-c", PAGE], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "False"


def _loaded(modules):
    """Packages in a fresh Python after importing these."""
    code = (
        f"import sys, {', '.join(modules)}; "
        "print(*{'.'.join(n.split('.')[:k]) for n in sys.modules for k in (1, 2)})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return set(done.stdout.split())


ELSEWHERE = {"rerun-sdk": "rerun", "pillow": "PIL"}
"""Packages that are imported by another name."""
INSIDE = {"rerun_bindings"}
"""Packages that come with another one."""


def declared(*extras):
    """What pyproject.toml declares for these: import name and bounds."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = list(project["dependencies"])
    for extra in extras:
        lines += project["optional-dependencies"][extra]
    found = [re.fullmatch(r"([a-z0-9-]+)(.*)", line) for line in lines]
    return {ELSEWHERE.get(m[1], m[1]): m[2] for m in found}


@pytest.mark.parametrize(
    ("folders", "extras"),
    [(("hebbviz", "sims", "server"), ("cluster",)), (("tests",), ("dev", "bench"))],
)
def test_what_is_imported_is_declared(folders, extras):
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    names = set().union(*(imported(path.read_text()) for path in files))
    names = {name for name in names if "." not in name.lstrip(".")}
    own = {path.stem for path in files} | {path.parent.name for path in files}
    own |= {"hebbviz", "sims", "server"}
    others = (
        names
        - own
        - INSIDE
        - {n for n in names if n.startswith(".")}
        - set(sys.stdlib_module_names)
    )
    assert others - set(declared(*extras)) == set()


def test_what_may_break_has_an_upper_bound():
    unbounded = {name for name, bounds in declared().items() if "<" not in bounds}
    assert unbounded == {"llvmlite"}  # numba bounds it
