"""The shape of the code: few nouns, short ways, imports that point one way."""

from __future__ import annotations

import ast
import itertools
import subprocess
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import _shape as shape

FOUND = shape.modules()
NAMES = frozenset(m.name for m in FOUND)


LIMITS = Path(__file__).with_name("limits.toml")


def allowed(what: str) -> int:
    """Return a limit of the house."""
    return int(tomllib.loads(LIMITS.read_text(encoding="utf-8"))[what])


def incomplete_refusals() -> int:
    """Return how many raised `InputError` lack one of what was found, is needed, and to try."""
    calls = [n for m in FOUND for n in ast.walk(m.tree) if isinstance(n, ast.Call)]
    refusals = [n for n in calls if isinstance(n.func, ast.Name) and n.func.id == "InputError"]
    given = [{k.arg for k in n.keywords} for n in refusals]
    return sum(None not in keys and not keys >= {"found", "needed", "hint"} for keys in given)


@pytest.mark.parametrize(
    "what", ("modules", "lines", "core_lines", "records", "constants", "incomplete_refusals")
)
def test_the_house_does_not_grow(what: str) -> None:
    """Each noun, module and constant is one more that a reader has to learn.

    The core is what `identify` imports. Constants are numbers at the level of a module.
    """
    sizes = {
        "modules": len([m for m in FOUND if m.n_lines]),
        "lines": sum(m.n_lines for m in FOUND),
        "core_lines": sum(m.n_lines for m in shape.core(FOUND)),
        "records": len(shape.dataclasses(FOUND)),
        "constants": shape.n_constants(FOUND),
        "incomplete_refusals": incomplete_refusals(),
    }
    assert sizes[what] <= allowed(what)


def test_no_module_is_longer_than_800_lines() -> None:
    """An idea has one module that can be read in one sitting."""
    assert {m.name: m.n_lines for m in FOUND if m.n_lines > 800} == {}


def test_limits_of_the_house_only_fall() -> None:
    """From each version of their file to the next."""
    versions = [tomllib.loads(text) for text in _versions(LIMITS)]
    for older, newer in itertools.pairwise(v for v in versions if "house" not in v):
        for what, limit in older.items():
            assert newer[what] <= limit, what


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


def test_a_function_outside_of_kernels_is_one_screen() -> None:
    """60 lines beside its docstring; how many are longer, and the longest, only fall."""
    found = [(m, f) for m, f in shape.functions(FOUND) if not shape.is_compiled(f)]
    lines = {f"{m.name}.{f.name}": shape.n_code_lines(f) for m, f in found}
    longer = {name: n for name, n in lines.items() if n > 60}
    assert len(longer) <= allowed("longer_functions"), longer
    assert max(lines.values()) <= allowed("longest_function"), longer


def test_no_call_spreads_a_tuple_written_on_the_spot() -> None:
    """``f(*(a, b), c)`` hides which argument is which."""
    assert [f"{m.name}:{line}" for m, line in shape.splats(FOUND)] == []


def test_the_core_imports_no_satellite_no_file_and_no_report() -> None:
    """Satellites may leave for packages of their own without touching the core."""
    outside = (*shape.SATELLITES, "files", "formats", "report", "cli")
    inside = {m.name for m in shape.core(FOUND)}
    assert {name for name in inside if name.split(".")[0] in outside} == set()


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
        "from roomfit.identify import identify\n"
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
    assert shape.imported(module, NAMES) == {"identify"}
    assert Counter(m.name for m in FOUND)["identify"] == 1
