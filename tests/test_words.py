"""Identifiers and sentences are in the field's words, so that a reader need not translate."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import roomfit

SOURCE = Path(roomfit.__file__).parent
# docs/glossary.md has the terms that stand in their place
BANNED = {
    *("told", "untold", "tells", "heard", "hears", "seen", "hows", "spoiled", "looser", "softened"),
    *("begun", "renewed", "upwards", "beforehand", "knowledge", "held", "unmet", "smear"),
    *("smeared", "unfolding", "honest", "evident", "worn", "places"),
}
# that no docstring, comment or message may use either
BANNED_PROSE = ("told", "untold", "heard", "hows", "spoiled", "looser", "begun", "beforehand")
PART = re.compile(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])")


def identifiers(source: str) -> Iterator[str]:
    """Yield all that Python code names: definitions, variables, attributes, arguments."""
    for node in ast.walk(ast.parse(source)):
        for key in ("name", "id", "attr", "arg", "asname"):
            if isinstance(found := getattr(node, key, None), str):
                yield found


def private_words(source: str) -> set[str]:
    """Return the banned words that are parts of identifiers."""
    named = {part.lower() for name in identifiers(source) for part in PART.findall(name)}
    return named & BANNED


@pytest.mark.parametrize(
    ("source", "word"),
    [
        *(("told = 1", "told"), ("class HeardCandidates: ...", "heard")),
        *(("def f(n_held): ...", "held"), ("x.untold_sd", "untold"), ("f(places=1)", "places")),
        *(("import a as seen", "seen"), ("try: 1\nexcept A as unmet: 2", "unmet")),
    ],
)
def test_a_private_word_is_found_wherever_python_names_something(source: str, word: str) -> None:
    """Longer words that begin alike, strings and comments are left alone."""
    assert private_words(source) == {word}
    assert private_words(f'shelled = replaces("{word}")  # {word}') == set()


@pytest.mark.parametrize("file", sorted(SOURCE.rglob("*.py")), ids=lambda f: f.stem)
def test_no_identifier_and_no_sentence_uses_a_word_of_our_own(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert private_words(text) == set()
    assert re.findall(rf"\b({'|'.join(BANNED_PROSE)})\b", text, flags=re.IGNORECASE) == []
