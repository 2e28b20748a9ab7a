"""The examples that the README shows in full match the files that it names."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def bare(text: str) -> str:
    """A program without docstrings and comments."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef)) and ast.get_docstring(node) is not None:
            del node.body[0]
    return ast.unparse(tree)


@pytest.mark.parametrize("file", ["tests/examples/lever.py", "hebbviz/rules/baseline.py"])
def test_an_example_is_complete(file: str) -> None:
    readme = (ROOT / "README.md").read_text()
    shown = re.search(rf"is complete \(`{file}`.*?```python\n(.*?)```", readme, re.DOTALL)
    assert shown is not None
    assert bare(shown[1]) == bare((ROOT / file).read_text())
