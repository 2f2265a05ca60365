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


@pytest.mark.parametrize("file", sorted(SOURCE.rglob("*.py")), ids=lambda f: f.stem)
def test_no_identifier_and_no_sentence_uses_a_word_of_our_own(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    named = {part.lower() for name in identifiers(text) for part in PART.findall(name)}
    assert named & BANNED == set()
    assert re.findall(rf"\b({'|'.join(BANNED_PROSE)})\b", text, flags=re.IGNORECASE) == []
