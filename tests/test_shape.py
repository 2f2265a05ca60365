"""The shape of the code: few nouns, short ways, imports that point one way."""

from __future__ import annotations

import ast
import itertools
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import shape
from roomfit import core

FOUND = shape.modules()
NAMES = frozenset(m.name for m in FOUND)


LIMITS = Path(__file__).with_name("limits.toml")
Limits = dict[str, Any]


def allowed(limits: Limits, what: str) -> int:
    """Return a limit of the house with what capabilities that came later state that they add."""
    added = limits.get("capability", {}).values()
    return int(limits["house"][what]) + sum(int(c.get(what, 0)) for c in added)


def incomplete_refusals() -> int:
    """Return how many raised `InputError` lack one of what was found, is needed, and to try."""
    calls = [n for m in FOUND for n in ast.walk(m.tree) if isinstance(n, ast.Call)]
    refusals = [n for n in calls if isinstance(n.func, ast.Name) and n.func.id == "InputError"]
    given = [{k.arg for k in n.keywords} for n in refusals]
    return sum(None not in keys and not keys >= {"found", "needed", "hint"} for keys in given)


@pytest.mark.parametrize(
    "what",
    ("modules", "lines", "core_lines", "records", "constants", "incomplete_refusals"),
)
def test_the_house_does_not_grow(what: str) -> None:
    """Each noun, module and constant is one more that a reader has to learn.

    The core is what `identify` imports. Constants are numbers at the level of a module.
    """
    sizes = {
        "modules": len([m for m in FOUND if m.name.split(".")[0] != "cli"]),
        "lines": sum(m.n_lines for m in FOUND),
        "core_lines": sum(m.n_lines for m in shape.core(FOUND)),
        "records": len(shape.dataclasses(FOUND)),
        "constants": shape.n_constants(FOUND),
        "incomplete_refusals": incomplete_refusals(),
    }
    assert sizes[what] <= allowed(tomllib.loads(LIMITS.read_text(encoding="utf-8")), what)


def test_no_module_is_longer_than_800_lines() -> None:
    """An idea has one module that can be read in one sitting."""
    assert {m.name: m.n_lines for m in FOUND if m.n_lines > 800} == {}


def test_limits_of_the_house_only_fall() -> None:
    """From each version of their file to the next, and a capability states its cost once.

    What a capability adds has a decision that says what was tried for less.
    """
    versions = [tomllib.loads(text) for text in _versions(LIMITS)]
    for older, newer in itertools.pairwise(versions):
        for what, limit in older["house"].items():
            assert newer["house"][what] <= limit, what
        for name, cost in newer.get("capability", {}).items():
            once = older.get("capability", {}).get(name, cost)
            assert all(n <= once[what] for what, n in cost.items() if what != "decision"), name
    for name, cost in versions[-1].get("capability", {}).items():
        found = list((LIMITS.parents[1] / "docs" / "decisions").glob(f"{cost['decision']}-*.md"))
        assert len(found) == 1, name


def _versions(file: Path) -> Iterator[str]:
    """Yield what a file contained in every commit that changed it, oldest first, and now."""
    git = ["git", "-C", str(file.parent)]
    log = [*git, "log", "--first-parent", "--reverse", "--format=%H", "--", file.name]
    listed = subprocess.run(log, capture_output=True, text=True, check=False)
    for commit in listed.stdout.split() if listed.returncode == 0 else ():
        show = [*git, "show", f"{commit}:./{file.name}"]
        yield subprocess.run(show, capture_output=True, text=True, check=True).stdout
    yield file.read_text(encoding="utf-8")


def test_no_function_outside_of_kernels_takes_more_than_eight_arguments() -> None:
    """More means that a record is missing."""
    long = {
        f"{m.name}.{f.name}": shape.n_parameters(f)
        for m, f in shape.functions(FOUND)
        if shape.n_parameters(f) > 8 and not shape.is_compiled(f)
    }
    assert long == {}


# Functions that are longer, in lines beside the docstring: neither grows, nor do they.
LONG = {
    "diagnostics.reflections._isolated": 79,
    "inversion.displacement.displacement_model": 66,
    "inversion.coherent.fit_coherent": 66,
    "inversion.trace_plan.plan_trace": 63,
    "inversion.paths.traced_paths": 63,
    "uncertainty.other_room.room_posterior": 61,
}


def test_a_function_outside_of_kernels_is_one_screen() -> None:
    """60 lines beside its docstring; those that wait on purpose (``async``) count as others do."""
    lines = {
        f"{m.name}.{f.name}": shape.n_code_lines(f)
        for m, f in shape.functions(FOUND)
        if not shape.is_compiled(f)
    }
    assert {name for name, n in lines.items() if n > LONG.get(name, 60)} == set()
    assert {name: lines[name] for name in LONG} == LONG, "a limit that may fall"


def test_no_call_spreads_a_tuple_written_on_the_spot() -> None:
    """``f(*(a, b), c)`` hides which argument is which."""
    assert [f"{m.name}:{line}" for m, line in shape.splats(FOUND)] == []


def test_the_core_imports_no_satellite_no_file_and_no_report() -> None:
    """Satellites may leave for packages of their own without touching the core."""
    outside = (*shape.SATELLITES, "io", "report", "commands", "cli")
    inside = {m.name for m in shape.core(FOUND)}
    assert {name for name in inside if name.split(".")[0] in outside} == set()


# Names from the core that are not in `roomfit.core`; they only fall.
NOT_PUBLIC = {
    "app": 6,
    "batch": 6,
    "certified": 17,
    "coverage": 31,
    "impedance": 33,
    "report": 27,
    "suh2001": 34,
    "synthetic": 7,
    "treatment": 2,
}


@pytest.mark.parametrize("satellite", (*shape.SATELLITES, "batch", "report"))
def test_what_stands_beside_the_core_takes_public_names_of_it(satellite: str) -> None:
    """All of `prediction` and `experiment_design`; of the others no more than counted above."""
    public = {(home, name) for name, home in shape.front_door(FOUND).items()}
    private = shape.taken(FOUND, satellite) - public
    assert len(private) <= NOT_PUBLIC.get(satellite, 0), sorted(private)


def test_the_inner_front_door_loads_what_type_checkers_see() -> None:
    """Each name, from the module named beside it, and nothing before it is asked for."""
    homes = shape.front_door(FOUND)
    assert homes == core._HOME
    for name, home in homes.items():
        assert getattr(core, name) is getattr(import_module(f"roomfit.{home}"), name)
    assert set(homes) <= set(dir(core))
    with pytest.raises(AttributeError, match="no attribute 'Traced'"):
        _ = core.Traced


def test_importing_the_inner_front_door_imports_no_other_package() -> None:
    program = "import sys, roomfit.core; print([m for m in ('numpy', 'scipy') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_modules_import_each_other_in_no_circle() -> None:
    """When they are imported; results know inside functions how to print and draw themselves."""
    arrows = {m.name: shape.imported(m, NAMES, lazily=False) - {""} for m in FOUND}
    done: set[str] = set()
    while len(done) < len(arrows):
        free = {name for name, to in arrows.items() if name not in done and to <= done}
        left = sorted(set(arrows) - done)
        assert free, f"modules in or above a circle: {', '.join(left)}"
        done |= free


def test_the_counts_see_what_they_count() -> None:
    """Each rule, broken on purpose."""
    tree = ast.parse(
        "def f(a, b, c, d, e, g, h, i, j): ...\n"
        "@kernel\ndef k(a, b, c, d, e, g, h, i, j): ...\n"
        "f(*(1, 2), 3)\nf(*x)\n"
        "from roomfit.identification import identify\n"
        "A = 3.0\nB: int = -2\nC = (1, 2.5)\nD = f(2)\nE = 'x'\nF = True\n"
    )
    (first, second) = (n for n in tree.body if isinstance(n, ast.FunctionDef))
    assert shape.n_parameters(first) == 9
    assert [shape.is_compiled(f) for f in (first, second)] == [False, True]
    late = ast.parse('async def f():\n    """What\n    it does."""\n    return 1\n')
    ((_, waiting),) = shape.functions([shape.Module("made", shape.SOURCE, late, 4)])
    assert shape.n_code_lines(waiting) == 2
    module = shape.Module("made", shape.SOURCE, tree, 5)
    assert shape.n_constants([module]) == 3
    assert [line for _, line in shape.splats([module])] == [4]
    assert shape.imported(module, NAMES) == {"identification"}
    assert Counter(m.name for m in FOUND)["identification"] == 1


@pytest.mark.slow
def test_eleven_frames_at_most_lie_between_identify_and_the_innermost_kernel() -> None:
    """On the default path: responses of an omnidirectional source, pressures that add.

    Calls beside that way, down to the corners of a triangle, may lie three deeper.
    """
    to_kernel, deepest = shape.deepest_stacks(FOUND)
    assert len(to_kernel) <= 11, "\n".join(to_kernel)
    assert len(deepest) <= 14, "\n".join(deepest)
