"""Kinds of finding: one list, which the sources use, the files hold and the documentation shows."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import roomfit.base.findings
from roomfit.base.errors import InputError
from roomfit.base.findings import Code, code_of

SOURCE = Path(roomfit.__file__).parent
PAGE = SOURCE.parents[1] / "docs" / "findings.md"
OWN = Path(roomfit.base.findings.__file__)
TREES = {
    path: ast.parse(path.read_text(encoding="utf-8"))
    for path in sorted(SOURCE.rglob("*.py"))
    if path != OWN
}


# code, severity, whether it voids, what it means
ROWS = re.findall(
    r"^\| `([\w-]+)` \| (.+?) \| (yes|its own|no) \| (.+) \|$", PAGE.read_text("utf-8"), re.M
)


# One list.


def test_the_name_of_a_code_is_its_text():
    """Whoever reads a result file finds the member, and the other way round."""
    for code in Code:
        assert code.value == str(code) == code.name.lower().replace("_", "-")


def test_the_documentation_says_of_every_code_in_order_what_it_means():
    """There alone; severity and whether it voids identifiability are those of the code."""
    assert [row[:3] for row in ROWS] == [
        (
            code.value,
            " or ".join(code.severities),
            "yes" if code.voids_identifiability else "its own" if code.voids_its_own else "no",
        )
        for code in Code
    ]
    meanings = [row[3] for row in ROWS]
    assert all(text.endswith((".", "?")) for text in meanings)
    assert len(set(meanings)) == len(Code)


def test_these_findings_and_no_others_void_identifiability():
    """Each of them says that the description of the whole room is in doubt."""
    found = {code.value for code in Code if code.voids_identifiability}
    assert found == {
        *("coordinates-scaled", "decay-bent", "noise-gated", "exchanged", "levels-apart"),
        *("recordings-late", "recording-of-two-pairs", "displacement-detected"),
        *("model-misfit-all-bands", "reflection-delay-detected", "position-inconsistent"),
        *("wall-position-mismatch", "source-not-omnidirectional"),
        *("scattering-underestimated",),
    }


# The sources.


def test_no_other_module_writes_a_code_as_text():
    """Where a code steers what is computed it must be a member, which a type checker knows.

    Also in comments and docstrings, where a renamed code would be forgotten.
    """
    written = re.compile(rf"""["'`]({"|".join(code.value for code in Code)})["'`]""")
    for path in TREES:
        found = written.findall(path.read_text(encoding="utf-8"))
        assert not found, f"{path.relative_to(SOURCE)} writes {found}"


def test_every_code_is_used():
    used = {
        node.attr
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "Code"
    }
    assert used == set(Code.__members__)


def calls(name: str) -> list[ast.Call]:
    found = [
        node
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
    ]
    assert found, name
    return found


def test_whatever_stops_a_room_has_a_serious_code():
    """`refuse` raises serious findings only: a fault of another code would pass unseen."""
    codes = [call.args[0] for name in ("fault", "wrong") for call in calls(name)]
    attributes = [code.attr for code in codes if isinstance(code, ast.Attribute)]
    assert len(attributes) > 3
    assert {n for n in attributes if Code[n].severities != ("serious",)} == set()


def test_codes_of_two_severities_are_graded_wherever_they_come_up():
    """Else the usual severity would be shown whatever the size."""
    graded = {
        call.args[0].attr
        for call in calls("Finding")
        if isinstance(call.args[0], ast.Attribute) and any(k.arg == "graded" for k in call.keywords)
    }
    plain = {
        call.args[0].attr
        for call in calls("Finding")
        if isinstance(call.args[0], ast.Attribute) and all(k.arg != "graded" for k in call.keywords)
    }
    assert graded == {code.name for code in Code if len(code.severities) > 1}
    assert not graded & plain


# One finding.


# Files.


@pytest.mark.parametrize("text", ["only-the-prior", "LEAK", "", None, 3, ["leak"]])
def test_an_unknown_code_in_a_file_is_reported_in_five_parts(text):
    with pytest.raises(InputError, match="unknown code") as caught:
        code_of(text, "out/result.json")
    error = caught.value
    assert error.where == "out/result.json"
    assert error.found == repr(text)
    assert "docs/findings.md" in str(error.needed)
    assert error.hint
