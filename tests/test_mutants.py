"""Bugs that tests are known to notice: their texts stand in the source, and some are planted."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections import Counter

import pytest
from scipy.stats import binomtest

from _executed import (
    Run,
    executing_tests,
    kernels_holding,
    name_at,
    statement_at,
    watched,
)
from mutants import (
    EQUIVALENT,
    MUTANTS,
    REPOSITORY,
    SOURCE,
    Mutant,
    mutated,
    near_tests,
    outcomes,
    places,
    random_mutants,
    random_outcomes,
    share,
    tried,
    why_equivalent,
)

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
    "boxes with doors",
    "decay times",
    "pressures",
    "scans and seats",
    "scattering weights",
    "seeds",
    "displacement",
    "doors",
    "impedance",
    "kept apart",
    "random places",
    "the rate of decay",
    "limits of absorption",
    "treatment",
    "workers",
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


@pytest.mark.parametrize("mutant", EQUIVALENT, ids=lambda m: m.path)
def test_what_is_called_equivalent_stands_once_in_the_source_and_can_be_planted(mutant):
    """At a place of a random bug, which then is named with its reason and not tried."""
    text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
    made = mutated(mutant)
    same = [p for p in places(text) if text[: p.start] + p.new + text[p.end :] == made]
    assert same, "no random bug leaves this text"
    first = same[0]
    random = Mutant(
        "x", "y", mutant.path, text[first.start : first.end], first.new, (), first.start
    )
    assert why_equivalent(random) == EQUIVALENT[mutant] and len(EQUIVALENT[mutant].split()) > 4
    (outcome,) = random_outcomes([random])
    assert (outcome.verdict, outcome.how) == ("equivalent", EQUIVALENT[mutant])
    listed = {mutated(e) for e in EQUIVALENT if e.path == mutant.path}
    elsewhere = next(
        p for p in places(text) if text[: p.start] + p.new + text[p.end :] not in listed
    )
    other = random._replace(
        old=text[elsewhere.start : elsewhere.end], new=elsewhere.new, start=elsewhere.start
    )
    assert why_equivalent(other) == ""


def test_the_tests_named_beside_a_bug_exist():
    for name in sorted({t for m in MUTANTS for t in m.tests}):
        file, _, function = name.partition("::")
        text = (REPOSITORY / "tests" / file).read_text(encoding="utf-8")
        assert f"def {function or 'test_'}" in text, name


def test_a_random_bug_is_planted_where_it_is_named_and_leaves_the_source_readable():
    """Every kind; the same seed plants the same; nothing else of the file changes."""
    few = ("objective", "uncertainty")  # of all, the places alone take many seconds
    chosen = random_mutants(60, 5, few)
    assert chosen == random_mutants(60, 5, few) != random_mutants(60, 6, few)
    kinds = Counter(m.name.split(" ", 1)[1] for m in chosen)
    assert kinds.keys() == {
        *("sign", "comparison", "constant", "index"),
        *("dropped statement", "exchanged arguments"),
    }
    for mutant in chosen:
        text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
        changed = mutated(mutant)
        assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text)), mutant
        assert changed[: mutant.start] == text[: mutant.start]
        assert mutant.tests, mutant


@pytest.mark.parametrize(
    ("old", "kinds"),
    [
        ("def f(a, b):\n    return a - b * 2\n", ["sign", "sign", "constant"]),
        ("x = g(a, b)[1:]\n", ["index", "exchanged arguments", "constant"]),
        ("if -x < 3 and y:\n    z = 1\n", [*2 * ["comparison"], "sign", *2 * ["constant"]]),
        ('raise E(f"{a + 1}")\n', []),
        ("x: Final[3] = max(a, b)\n", []),
        ("p(x, y, color=BLUE[1])\n", ["dropped statement", "exchanged arguments"]),
        ("p(x, y, lw=1.5)\n", ["dropped statement", "exchanged arguments"]),
        ("f = new_figure(8.0, 2.0 * n)\n", []),
        ("f = _new_figure(8.0, 2.0 * n)\n", []),
        ("x = zip(a, b, strict=True)\n", ["exchanged arguments"]),
    ],
)
def test_places_of_random_bugs_are_those_of_the_syntax_tree(old, kinds):
    assert [place.kind for place in places(old)] == kinds


def test_the_tests_near_a_module_are_those_that_import_it():
    assert near_tests("batch.py")[0] == "test_batch.py"
    assert all((REPOSITORY / "tests" / name).exists() for name in near_tests("logit.py"))
    assert all(name.startswith("io/") for name in near_tests("io/child.py"))
    # of a function that no test names, though some say "_measured"
    assert near_tests("tracing/reflectors.py", "_measure")[0] == "tracing/test_reflectors.py"


def test_tests_of_a_function_are_those_that_execute_it():
    """Files that name it first, then quick ones, then the others as far as time goes."""
    own = frozenset({"air.py:attenuation_per_m"})
    runs = (
        Run("test_reference.py::test_a[b]", 50.0, own),
        Run("solvers/test_endings.py::test_long", 40.0, own),
        Run("solvers/test_endings.py::test_longer", 41.0, own),
        Run("solvers/test_endings.py::test_quick", 0.1, own),
        Run("solvers/test_endings.py::test_other", 0.1, frozenset({"air.py:Air"})),
        Run("test_air.py::test_named", 2.0, own),
    )
    found = executing_tests("air.py", "attenuation_per_m", runs, 45.0)
    order = ["test_named", "test_quick", "test_a[b]", "test_long"]
    assert [name.split("::")[1] for name in found] == order
    assert executing_tests("bands.py", "exact_centres_hz", runs[:0], 45.0) == []


def test_a_kernel_is_executed_where_what_calls_it_is():
    """No interpreter enters compiled code, and its callers' machine code holds it."""
    path = "impedance/wave_kernels.py"
    text = (SOURCE / "roomfit" / path).read_text(encoding="utf-8")
    line = text[: text.index("def conjugate_admittance")].count("\n") + 2
    assert name_at(text, line) == "conjugate_admittance"
    calls = Run("impedance/test_fit.py::test_x", 1.0, frozenset({"impedance/wave_model.py:x"}))
    assert executing_tests(path, "conjugate_admittance", (calls,), 9.0) == []
    caller = calls._replace(functions=frozenset({"impedance/wave_model.py:_pressure"}))
    assert executing_tests(path, "conjugate_admittance", (caller,), 9.0) == [caller.test]
    assert "pressures" in kernels_holding("conjugate_admittance")
    # constants that are defined together
    together = name_at("_A, _B = 1, 2\n", 1)
    gate = Run(
        "diagnostics/test_said.py::test_x", 1.0, frozenset({"diagnostics/noise_gate.py:check"})
    )
    name = "(_GAP_S, _GAP_STEPS, _FEWEST_GAPS)"
    assert together == "(_A, _B)"
    assert executing_tests("diagnostics/noise_gate.py", name, (gate,), 9.0) == [gate.test]


def test_of_the_tests_that_execute_a_function_those_that_execute_the_line_are_taken():
    """Where any does; a statement counts as one line, a block as its head."""
    text = "def f(a):\n    if a > (\n        1\n    ):\n        return [\n  2]\n    return 3\n"
    found = [statement_at(text, line) for line in (1, 3, 4, 6, 7)]
    assert [(lines[0], lines[-1]) for lines in found] == [(1, 1), (2, 4), (2, 4), (5, 6), (7, 7)]
    own = frozenset({"air.py:attenuation_per_m"})
    one, other = (
        Run(f"test_air.py::test_{line}", 0.1, own, {"air.py": frozenset({line})}) for line in (5, 9)
    )
    for lines, expected in (((4, 5), [one]), ((9,), [other]), ((7,), [one, other])):
        found = executing_tests("air.py", "attenuation_per_m", (one, other), 45.0, lines)
        assert found == [run.test for run in expected]


def test_tests_of_a_file_run_together_or_what_they_share_is_made_again():
    own = frozenset({"air.py:attenuation_per_m"})
    runs = tuple(
        Run(f"solvers/test_{file}.py::test_{i}", 0.1 * i, own)
        for i, file in enumerate(("endings", "simplex", "endings", "simplex"), start=1)
    )
    found = executing_tests("air.py", "attenuation_per_m", runs, 45.0)
    assert [name[-1] for name in found] == ["1", "3", "2", "4"]


@pytest.mark.slow
def test_what_a_test_executes_is_written_down(tmp_path):
    """By itself and by what is kept for it; the second test asks for what the first computed."""
    (tmp_path / "test_it.py").write_text(
        "from functools import cache\n"
        "from roomfit.base.bands import bands_between\n"
        "@cache\ndef kept():\n    return bands_between('octave', 500, 1000)\n"
        "def test_a():\n    assert kept()\n"
        "def test_b():\n    assert kept()\n"
        "def test_c():\n    pass\n"
        "def test_d():\n    kept.cache_clear()\n"
    )
    log, benchmarks = tmp_path / "executed.jsonl", REPOSITORY / "benchmarks"
    subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "_executed", "--executed", log, "test_it.py"],
        check=True,
        capture_output=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(SOURCE), str(benchmarks)))},
    )
    entered = {run.test.split("::")[1]: run.functions for run in watched(log)}
    assert entered["test_a"] == entered["test_b"] >= {"bands.py:bands_between"}
    assert entered["test_c"] == entered["test_d"] == frozenset()
    lines = {run.test.split("::")[1]: run.lines for run in watched(log)}
    text = (SOURCE / "roomfit" / "bands.py").read_text(encoding="utf-8")
    of_it = {n for n in lines["test_a"]["bands.py"] if name_at(text, n) == "bands_between"}
    # of octaves: without what refuses other kinds
    body = [
        n for n, _ in enumerate(text.split("\n"), start=1) if name_at(text, n) == "bands_between"
    ]
    assert of_it and of_it < set(body) and lines["test_a"] == lines["test_b"]
    assert lines["test_c"] == lines["test_d"] == {}


def test_a_share_has_the_interval_of_clopper_and_pearson():
    """By scipy's own exact interval of a proportion."""
    for noticed, number in ((0, 5), (5, 5), (43, 71), (1, 60)):
        exact = binomtest(noticed, number).proportion_ci(0.95, method="exact")
        assert f"({100 * exact.low:.0f} to {100 * exact.high:.0f} %)" in share(noticed, number)


@pytest.mark.slow
def test_a_bug_whose_tests_are_stopped_by_time_is_undecided(tmp_path):
    """And one that a test marked slow alone would notice is not called a survivor before it."""
    mutant = next(m for m in MUTANTS if m.name == "replicates-alike")
    assert tried(mutant, mutant.tests, tmp_path / "a", 0.5).verdict == "undecided"


@pytest.mark.slow
def test_a_bug_that_ends_the_process_by_a_signal_is_noticed_and_stops_no_other():
    """As one that reaches beyond an array in compiled code."""
    own = "import numpy as np\n"
    crash = Mutant(
        *("crash", "air", "air.py", own, f"{own}import os; os.kill(os.getpid(), 11)\n"),
        ("test_air.py",),
    )
    (outcome,) = random_outcomes([crash])
    assert (outcome.verdict, outcome.how) == ("noticed", "ended by signal 11")


@pytest.mark.slow
def test_some_bugs_are_noticed_by_the_tests_beside_them():
    chosen = [m for m in MUTANTS if m.name in QUICK]
    assert len(chosen) == len(QUICK)
    first, *others = outcomes(chosen)
    assert first.mutant is None and not first.noticed
    assert [(o.mutant.name, o.noticed) for o in others if o.mutant] == [
        (m.name, True) for m in chosen
    ]
