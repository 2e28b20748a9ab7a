"""How large files, classes and parameter lists may grow; exceptions are listed with a reason."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST_LINES, MOST_METHODS, MOST_PARAMETERS = 400, 20, 10

LARGER_FILES = {
    "hebbviz/learner/learner.py": "one public class, most of it docstrings",
}
LARGER_CLASSES = {
    "Learner": "the public face of a run: half of it are properties of one line",
    "Task": "a contract, of which a task overrides what it needs",
    "Tile": "the one owner of the compiled state, row by row",
    "Run": "undo, reset and choices share the state that each of them replaces",
    "Writer": "one method for each kind of event that a recording holds",
    "Take": "one method for each kind of event that a recording holds",
    "Controls": "one method for each group of widgets",
}
LARGER_SIGNATURES = {
    "hebbviz/engine/loop.py": "compiled: numba passes arrays one by one",
    "hebbviz/learner/learner.py": "keyword-only options of the public constructor; see RunSettings",
}


def sources() -> dict[str, str]:
    files = (p for top in ("hebbviz", "sims", "server") for p in (ROOT / top).rglob("*.py"))
    plain = (p for p in files if not any(f.is_symlink() for f in p.parents if ROOT in f.parents))
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in plain}


def test_files_are_short() -> None:
    found = {file for file, text in sources().items() if text.count("\n") > MOST_LINES}
    assert found == set(LARGER_FILES)


def test_classes_have_few_methods() -> None:
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    found = {
        node.name
        for text in sources().values()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ClassDef)
        and sum(isinstance(part, kinds) for part in node.body) > MOST_METHODS
    }
    assert found == set(LARGER_CLASSES)


def test_functions_have_few_parameters() -> None:
    found = {
        file
        for file, text in sources().items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
        and len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs) > MOST_PARAMETERS
    }
    assert found == set(LARGER_SIGNATURES)
