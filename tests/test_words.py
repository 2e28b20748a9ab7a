"""Docstrings and messages avoid the worst habits of style; see PATTERNS."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

PATTERNS = {
    "headless 'What …' sentence": r"(?:\A|(?<=[.] )|(?<=\n\n))What (?![^.?]*\?)",
    "'told'": r"\btold\b",
    "'anew'": r"\banew\b",
    "bare 'so many'": r"\bso many\b(?! (?:as|that))",
}

PACKAGES = ("hebbviz", "sims", "server")


def strings(text: str) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def habits(text: str) -> list[str]:
    return [
        f"line {line}: {name}: {words[:70]!r}"
        for line, words in strings(text)
        for name, pattern in PATTERNS.items()
        if re.search(pattern, words)
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_and_messages_are_plain(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    found = [f"{file.relative_to(ROOT)}, {h}" for file in files for h in habits(file.read_text())]
    assert not found, "\n".join(found)


def test_each_habit_is_found_and_questions_are_not() -> None:
    assert len(habits("'What is kept is told anew, so many times.'")) == len(PATTERNS)
    assert not habits("'What is it? As so many as that.'")
