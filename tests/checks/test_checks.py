"""Checks as a whole: one form, laws that are stated, and what a new one takes."""

from __future__ import annotations

import ast
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.checks import examine as checks
from roomfit.checks.examine import AFTER_THE_FIT, BEFORE_THE_FIT
from roomfit.checks.verdict import judge, voided
from roomfit.materials.priors import unknown_material

FOLDER = Path(checks.__file__).parent
EVERY = (*BEFORE_THE_FIT, *AFTER_THE_FIT)
MODULES = sorted({check.__module__ for check in EVERY})


# Form.


def test_every_check_stands_once_in_one_of_the_two_tuples():
    """Functions named check or check_... of the modules, but for that of recordings as a whole."""
    assert len(set(EVERY)) == len(EVERY)
    found = {
        f"roomfit.checks.{path.stem}.{node.name}"
        for path in FOLDER.glob("*.py")
        if path.stem != "usable"
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef) and re.fullmatch(r"check(_\w+)?", node.name)
    }
    assert found == {f"{check.__module__}.{check.__name__}" for check in EVERY}


@pytest.mark.parametrize("name", MODULES)
def test_a_law_is_stated_of_every_code_that_a_module_raises_and_of_no_other(name):
    """Levels of significance are probabilities."""
    module = name.rpartition(".")[2]
    tree = ast.parse((FOLDER / f"{module}.py").read_text(encoding="utf-8"))
    raised = {
        Code[code.attr].value
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding"
        for code in ast.walk(node.args[0])
        if isinstance(code, ast.Attribute) and getattr(code.value, "id", "") == "Code"
    }
    laws = tomllib.loads((FOLDER / "laws.toml").read_text(encoding="utf-8"))
    assert set(laws) == {other.rpartition(".")[2] for other in MODULES}
    assert laws[module].keys() == raised
    for law in laws[module].values():
        assert law["null"] and law["statistic"]
        assert 0.0 < law.get("level", 0.05) <= 0.05


# The verdict.

BANDS = Bands("octave", [500.0, 1000.0])
PRIORS = (
    unknown_material("floor", 2),
    unknown_material("walls", 2),
    replace(unknown_material("door", 2), known=np.array([0.1, 0.1])),
)


def verdict(*findings: Finding) -> np.ndarray:
    """Return the verdict on bands that the rule calls identifiable throughout."""
    return judge(np.ones((3, 2), dtype=np.bool_), findings, PRIORS, BANDS)


def test_without_a_finding_the_rule_decides():
    assert verdict().all()


def test_a_finding_voids_what_it_is_about_and_nothing_else():
    """A decay its band, a reflection its material there; what is fixed stays."""
    about = About(bands_hz=[500.0])
    decay = Finding(Code.DECAY_NOT_REPRODUCED, about, "It is not.")
    assert verdict(decay).tolist() == [[False, True], [False, True], [True, True]]
    about = About(materials=["floor"], bands_hz=[1000.0])
    grave, slight = (
        Finding(Code.REFLECTION_DISAGREES, about, "It does.", graded=g)
        for g in ("serious", "warning")
    )
    assert verdict(grave).tolist() == [[True, False], [True, True], [True, True]]
    assert verdict(slight).all()


def test_an_ambiguity_voids_its_entries_where_these_are_not_all_of_its_materials_and_bands():
    entries = [("floor", 500.0), ("walls", 500.0), ("walls", 1000.0)]
    about = About(["floor", "walls"], [500.0, 1000.0], entries=entries)
    found = voided(Finding(Code.MIRROR_AMBIGUITY, about, "It is."), PRIORS, BANDS)
    assert found.tolist() == [[True, False], [True, True], [False, False]]


def test_only_the_verdict_decides_what_a_finding_voids():
    """No other module of the science asks a code what it voids in order to void it."""
    source, asking = FOLDER.parent, set()
    for path in source.rglob("*.py"):
        if "voids_its_own" in path.read_text(encoding="utf-8"):
            asking.add(path.relative_to(source).as_posix())
    assert asking == {"base/findings.py", "checks/verdict.py"}
