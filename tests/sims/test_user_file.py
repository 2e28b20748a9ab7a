"""A task or a rule of the user's own may import what stands beside its file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hebbviz.server.cli.main import main
from hebbviz.sims.experiments.plan import Plan
from hebbviz.sims.loading import load_rule, make_task

ROOT = Path(__file__).parents[2]
LEVER = (ROOT / "tests" / "examples" / "lever.py").read_text()
TASK = LEVER.replace("class Lever", "from pull import JUST\n\n\nclass Lever").replace(
    "        return state[1]\n",
    "        from later import again\n\n        return again(JUST * state[1])\n",
)
RULE = """
from dataclasses import dataclass

from factors import FACTOR

from hebbviz.rules import Rule


@dataclass(frozen=True)
class Twice(Rule):
    name = "twice"

    @staticmethod
    def modulate(memory, constants, reward, ended, sent):
        for lane in range(len(reward)):
            sent[lane] = FACTOR * reward[lane]
"""


def write(folder: Path, just: float) -> str:
    """A task whose file imports its neighbours, one of which imports another."""
    folder.mkdir(exist_ok=True)
    (folder / "mine.py").write_text(TASK)
    (folder / "pull.py").write_text("from deeper import JUST\n")
    (folder / "deeper.py").write_text(f"JUST = {just}\n")
    (folder / "later.py").write_text("def again(x):\n    return x\n")
    (folder / "rule.py").write_text(RULE)
    (folder / "factors.py").write_text("FACTOR = 2.0\n")
    return f"{folder}/mine.py:Lever"


def test_each_file_has_its_own_neighbours(tmp_path: Path) -> None:
    before = list(sys.path)
    for folder, just in ("one", 3.0), ("two", 5.0), ("one", 3.0):
        task = make_task(write(tmp_path / folder, just))
        assert task.reward([0.0, 1.0]) == just
    assert sys.path[: len(before)] == before, "nothing of the user's goes before what is installed"
    sys.path[:] = before


def test_the_text_of_a_neighbour_belongs_to_a_plan(tmp_path: Path) -> None:
    """So that what was run with another text of it is not gone on with."""
    plan = Plan(task=write(tmp_path, 1.0), segments=1, segment_steps=1)
    first = plan.digest()
    assert plan.digest() == first
    (tmp_path / "later.py").write_text("def again(x):\n    return 2.0 * x\n")
    later = plan.digest()
    (tmp_path / "deeper.py").write_text("JUST = 2.0\n")
    assert len({first, later, plan.digest()}) == 3


def test_a_rule_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path, 1.0)
    before = list(sys.path)
    assert load_rule(f"{tmp_path}/rule.py:Twice").name == "twice"
    sys.path[:] = before


@pytest.mark.slow
def test_in_worker_processes_and_from_another_folder(tmp_path: Path) -> None:
    write(tmp_path, 1.0)
    given = ["--task", "mine.py:Lever", "--rule", "rule.py:Twice", "--lanes", "2"]
    done = subprocess.run(
        [sys.executable, "-m", "hebbviz", "figure", "learning", *given, "--steps", "200", "--out",
         "out"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["rule"] == "twice"


def test_a_neighbour_that_is_missing_is_told_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = write(tmp_path, 1.0)
    (tmp_path / "mine.py").write_text(TASK.replace("from pull", "from nowhere_at_all"))
    assert main(["train", "--steps", "5", "--task", task]) == 2
    assert "No module named 'nowhere_at_all' (mine.py, line 8)" in capsys.readouterr().err
