"""The digests of runs cover every task, preset and rule."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from hebbviz.rules.base import RULES
from hebbviz.sims import TASKS, task_class

LISTED = "name it in TASKS or RULES of tests/benchmarks/digest_cases.py"
SCRIPT = Path(__file__).parents[1] / "benchmarks" / "digests.py"


def test_every_task_preset_and_rule_has_a_case() -> None:
    words = [sys.executable, SCRIPT, "--list"]
    names = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    tasks = {tuple(name.split("/")[1:3]) for name in names if name.startswith("run/")}
    assert tasks == {(t, p) for t in TASKS.names for p in task_class(t).presets}, LISTED
    rules = {tuple(name.split("/")[1:3]) for name in names if name.startswith("rule/")}
    assert rules == {(rule, task) for rule in RULES.names for task in TASKS.names}, LISTED
