"""What is compiled is compiled anew where anything it is made of has changed, and only then."""

import ast
import json
import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from hebbviz.numerics import cache_key

ROOT = Path(__file__).parents[2]

OTHER = """
from hebbviz.numerics.compile import compiled, inlined
@inlined
def halved(x):
    return x / 2.0
@compiled
def added(x):
    return halved(x) + 1.0
"""
MINE = """
from numba import types
import other
from hebbviz.numerics.counter_rng import WORLD, four_uniforms, uniforms
from hebbviz.numerics.compile import called, compiled
from factors import FACTOR

@compiled
def drawn(step):
    return four_uniforms(1, 2, WORLD, step, 0)[1]

@called(types.float64(types.int64))
def answer(step):
    return drawn(step) + FACTOR * other.added(step)

said = {"draw": uniforms(2, seed=1, lane=2, purpose=WORLD, step=5)[1]}
said |= {"answer": answer.ctypes(5), "kept": answer.cache_hits == 1}
"""
WORLDS = """
from hebbviz.task import finite as finite_world
from hebbviz.rules.baseline import Baseline
from hebbviz.sims.worlds.pendulum import compiled as pendulum_lanes
from hebbviz.sims.worlds import sonar
made = (finite_world.answer, sonar.answer, pendulum_lanes.answer, Baseline().compiled()[0])
said = {"kept": [one.cache_hits == 1 for one in made]}
"""


@pytest.fixture
def copy(tmp_path):
    """The package in a folder and with a cache of its own, to be changed."""
    ignored = shutil.ignore_patterns("__pycache__", "server")
    shutil.copytree(ROOT / "hebbviz", tmp_path / "hebbviz", ignore=ignored)
    (tmp_path / "other.py").write_text(OTHER)
    (tmp_path / "factors.py").write_text("FACTOR = 3.0\n")
    return tmp_path


def change(copy, name, old, new):
    text = (copy / name).read_text()
    assert text.count(old) == 1
    (copy / name).write_text(text.replace(old, new))


def run(copy, script):
    """What a process of its own says; no file is newer by its time alone."""
    (copy / "mine.py").write_text(f"{script}\nimport json\nprint(json.dumps(said))\n")
    settings = {"NUMBA_CACHE_DIR": str(copy / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "mine.py"], cwd=copy, env=os.environ | settings, check=True,
        capture_output=True, text=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def test_a_world_follows_the_kernels_and_all_that_it_takes_from_other_files(copy):
    first, again = run(copy, MINE), run(copy, MINE)
    assert first["answer"] == first["draw"] + 3.0 * 3.5
    assert again == first | {"kept": True}
    change(copy, "hebbviz/numerics/counter_rng.py", "_ROUNDS = 7", "_ROUNDS = 6")
    other_draw = run(copy, MINE)
    assert other_draw["draw"] != first["draw"]
    assert other_draw["answer"] == other_draw["draw"] + 3.0 * 3.5
    change(copy, "other.py", "x / 2.0", "x / 5.0")
    assert run(copy, MINE)["answer"] == other_draw["draw"] + 3.0 * 2.0
    change(copy, "factors.py", "3.0", "4.0")
    assert run(copy, MINE) == other_draw | {"answer": other_draw["draw"] + 4.0 * 2.0}


def test_the_kernels_take_no_number_and_no_compiled_function_from_another_file():
    """The key holds the kernel files whole, and not what they import from the other files."""
    files = [Path(file).relative_to(ROOT).with_suffix("") for file in cache_key._KERNELS]
    kernels = {".".join(file.parts) for file in files}
    assert "hebbviz.engine.kernel" in kernels
    for kernel in kernels:
        module = import_module(kernel)
        for node in ast.walk(ast.parse(Path(module.__file__).read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("hebbviz."):
                taken = {alias.name: getattr(module, alias.name, None) for alias in node.names}
                seen = (*cache_key._NUMBERS, Dispatcher)
                others = {name for name, value in taken.items() if isinstance(value, seen)}
                assert node.module in kernels or not others, f"{kernel} takes {others}"


@pytest.mark.slow
def test_worlds_and_rules_are_bound_to_the_kernels(copy):
    run(copy, WORLDS)
    assert run(copy, WORLDS) == {"kept": [True] * 4}
    change(copy, "hebbviz/numerics/counter_rng.py", "_ROUNDS = 7", "_ROUNDS = 6")
    assert run(copy, WORLDS) == {"kept": [False] * 4}
    change(
        copy,
        "hebbviz/sims/worlds/pendulum/physics.py",
        "gravity: float = 9.8",
        "gravity: float = 1.6",
    )
    assert run(copy, WORLDS) == {"kept": [True, True, False, True]}
