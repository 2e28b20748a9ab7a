"""The public API: what `import hebbviz` gives."""

from __future__ import annotations

import inspect
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import hebbviz

ROOT = Path(__file__).parents[1]
HEAVY = ("viser", "rerun", "pymunk", "numba", "matplotlib", "numpy")


def test_importing_it_loads_nothing_heavy() -> None:
    code = f"import sys, hebbviz; print(*(set({HEAVY!r}) & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_every_name_is_there_and_documented() -> None:
    assert set(hebbviz.__all__) <= set(dir(hebbviz))
    for name in hebbviz.__all__:
        assert inspect.getdoc(getattr(hebbviz, name)), name
    with pytest.raises(AttributeError, match="has no attribute 'Learne'"):
        hebbviz.Learne  # noqa: B018


def test_public_methods_are_documented() -> None:
    classes = [c for n in hebbviz.__all__ if inspect.isclass(c := getattr(hebbviz, n))]
    missing = [
        f"{kind.__name__}.{name}"
        for kind in classes
        for name, member in vars(kind).items()
        if not name.startswith("_")
        and (inspect.isfunction(member) or isinstance(member, property))
        and not inspect.getdoc(getattr(kind, name))
    ]
    assert missing == []


def test_a_learner_is_saved_and_loaded(tmp_path: Path) -> None:
    learner = hebbviz.Learner(hebbviz.make_task("synapse"), seed=3)
    learner.advance(50)
    path = hebbviz.save(learner, tmp_path / "a.npz")
    again = hebbviz.load(path)
    assert again.step == 50
    assert np.array_equal(again.weights, learner.weights)


def test_a_page_is_served_beside_the_program() -> None:
    learner = hebbviz.Learner(hebbviz.make_task("synapse"))
    page = hebbviz.serve(learner, block=False, port=0)
    assert page is not None
    with page, urllib.request.urlopen(page.link, timeout=20) as answer:
        assert b"<html" in answer.read()
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(page.link, timeout=5)


def test_a_figure_is_made(tmp_path: Path) -> None:
    made = hebbviz.figure("synapse", tmp_path)
    assert {Path(file).suffix for file in made["files"]} == {".png", ".svg", ".csv"}
    with pytest.raises(Exception, match="there is no figure 'synaps'"):
        hebbviz.figure("synaps", tmp_path)
