"""Answers of small cases stay what they are: regression, not proof of any of them.

What the numbers mean other tests prove, by laws, other programs and known rooms. These say that a
change of the code moved one of them, anywhere between a command and its files; where that is meant,
``scripts/golden reference`` prints what moved and writes the numbers anew.
"""

from __future__ import annotations

import json

import pytest

from golden import OF_SECONDS, REFERENCE, answers, changed


@pytest.mark.slow
@pytest.mark.parametrize("case", OF_SECONDS, ids=lambda case: case.name)
def test_answers_of_a_small_case_are_those_that_are_kept(case, tmp_path):
    """Within a ten-thousandth of an interval's width, or of the largest number of a field."""
    fields = changed(case, answers(case, tmp_path.resolve()))
    moved = {name: field for name, field in fields.items() if field.beyond}
    assert not moved, "scripts/golden reference says what moved, and writes it anew if it is meant"


def test_every_small_case_is_kept_and_has_numbers():
    assert {p.stem for p in REFERENCE.glob("*.json")} == {c.name for c in OF_SECONDS}
    for path in REFERENCE.glob("*.json"):
        assert len(json.loads(path.read_text(encoding="utf-8"))) > 0, path
