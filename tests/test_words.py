"""Identifiers are in the field's words: a reader of its journals need not translate."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import roomfit

SOURCE = Path(roomfit.__file__).parent
# Each with what the field says instead. docs/glossary.md explains the terms.
BANNED = {
    "told": "specified, prior, reported",
    "untold": "unspecified, default, prior-only",
    "tells": "specifies, determines",
    "heard": "observed",
    "hears": "is reached by",
    "seen": "observed, visited",
    "hows": "directivities",
    "spoiled": "outlier",
    "looser": "inflated",
    "softened": "inflated variance",
    "begun": "initialise",
    "renewed": "rebuild",
    "upwards": "forward pass",
    "beforehand": "prior",
    "knowledge": "prior",
    "held": "fixed, covered",
    "unmet": "unreached",
    "smear": "spreading",
    "smeared": "spreading",
    "unfolding": "image transform",
    "honest": "robust",
    "evident": "marginal likelihood",
    "worn": "degenerate weights",
    "places": "positions, indices",
}
# What a contract of files or the command line fixes stays: name of a file's key or of a command.
CONTRACT: frozenset[str] = frozenset()
PART = re.compile(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])")


def parts(identifier: str) -> set[str]:
    """Return the words of an identifier, in lower case.

    >>> sorted(parts("_UNTOLD_SD_M")), sorted(parts("MaterialPrior"))
    (['m', 'sd', 'untold'], ['material', 'prior'])
    """
    return {part.lower() for part in PART.findall(identifier)}


def identifiers(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and name of all that Python code names: definitions, variables, attributes."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Name):
            yield node.lineno, node.id
        elif isinstance(node, ast.Attribute):
            yield node.lineno, node.attr
        elif isinstance(node, ast.arg) or (isinstance(node, ast.keyword) and node.arg):
            yield node.lineno, str(node.arg)
        elif isinstance(node, ast.alias) and node.asname:
            yield node.lineno, node.asname
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.lineno, node.name


def private_words(source: str) -> list[str]:
    return [
        f"{line}: {name}: say {BANNED[word]}"
        for line, name in identifiers(source)
        if name not in CONTRACT
        for word in sorted(parts(name) & BANNED.keys())
    ]


@pytest.mark.parametrize(
    "source",
    ["told = 1", "class HeardCandidates: ...", "def f(n_held): ...", "x.untold_sd", "f(places=1)"],
)
def test_a_private_word_is_found_wherever_python_names_something(source: str) -> None:
    assert len(private_words(source)) == 1


def test_longer_words_that_begin_alike_and_strings_are_left_alone() -> None:
    assert private_words('shelled = replaces("told")  # held') == []


@pytest.mark.slow
def test_identifiers_are_in_the_words_of_the_field() -> None:
    files = sorted(SOURCE.rglob("*.py"))
    assert len(files) > 20
    found = [
        f"{path.relative_to(SOURCE)}:{fault}"
        for path in files
        for fault in private_words(path.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


# Words of our own that no docstring, comment or message may use either.
BANNED_PROSE = ("told", "untold", "heard", "hows", "spoiled", "looser", "begun", "beforehand")


@pytest.mark.parametrize("file", sorted(SOURCE.rglob("*.py")), ids=lambda f: f.stem)
def test_no_sentence_uses_a_word_of_our_own(file: Path) -> None:
    """Docstrings, comments and messages are in the language of the field's journals."""
    text = file.read_text(encoding="utf-8")
    found = re.findall(rf"\b({'|'.join(BANNED_PROSE)})\b", text, flags=re.IGNORECASE)
    assert found == []
