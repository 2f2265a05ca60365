"""Bugs that tests are known to notice: their texts stand in the source, and some are planted."""

from __future__ import annotations

import ast
from collections import Counter

import pytest

from mutants import MUTANTS, REPOSITORY, mutated, outcomes

# Each with tests of a few seconds, of four areas.
QUICK = ("phi-over-all-data", "misfit-not-in-gaussian", "energies-as-pressures", "g-at-1-m")
AREAS = {
    "noise model",
    "coherence",
    "profiles",
    "prediction intervals",
    "identifiability",
    "room parameters",
    "speech transmission",
    "responses after a change",
    "air",
    "scattering weights",
    "seeds",
}


def test_there_are_sixty_bugs_and_more_of_every_area():
    assert len(MUTANTS) >= 60
    assert {m.area for m in MUTANTS} == AREAS
    assert [n for n, count in Counter(m.name for m in MUTANTS).items() if count > 1] == []


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: m.name)
def test_the_text_of_a_bug_stands_once_in_the_source_and_leaves_it_readable(mutant):
    """Otherwise the source has changed, and the bug is to be planted anew."""
    assert mutant.old != mutant.new
    ast.parse(mutated(mutant))


def test_the_tests_named_beside_a_bug_exist():
    for name in sorted({t for m in MUTANTS for t in m.tests}):
        file, _, function = name.partition("::")
        text = (REPOSITORY / "tests" / file).read_text(encoding="utf-8")
        assert f"def {function or 'test_'}" in text, name


@pytest.mark.slow
def test_some_bugs_are_noticed_by_the_tests_beside_them():
    chosen = [m for m in MUTANTS if m.name in QUICK]
    assert len(chosen) == len(QUICK)
    first, *others = outcomes(chosen)
    assert first.mutant is None and not first.noticed
    assert [(o.mutant.name, o.noticed) for o in others if o.mutant] == [
        (m.name, True) for m in chosen
    ]
