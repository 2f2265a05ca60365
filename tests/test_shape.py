"""The shape of the code: few nouns, short ways, imports that point one way."""

from __future__ import annotations

import ast
from collections import Counter

import pytest

import shape

FOUND = shape.modules()
NAMES = frozenset(m.name for m in FOUND)


def test_there_are_few_modules_and_none_is_longer_than_800_lines() -> None:
    """An idea has one module that can be read in one sitting.

    140 modules are aimed at, beside the thin files of the commands; more than there are now need a
    new capability as their reason.
    """
    assert len([m for m in FOUND if m.name.split(".")[0] != "cli"]) <= 227
    assert {m.name: m.n_lines for m in FOUND if m.n_lines > 800} == {}


def test_the_core_and_all_of_src_do_not_grow() -> None:
    """The core is what `identify` imports; 45,000 lines are aimed at for the whole.

    Records are nouns that a reader has to learn: about 150 are aimed at.
    """
    assert sum(m.n_lines for m in shape.core(FOUND)) <= 31_260
    assert sum(m.n_lines for m in FOUND) <= 70_180
    assert len(shape.dataclasses(FOUND)) <= 236


def test_no_function_outside_of_kernels_takes_more_than_eight_arguments() -> None:
    """More means that a record is missing."""
    long = {
        f"{m.name}.{f.name}": shape.n_parameters(f)
        for m, f in shape.functions(FOUND)
        if shape.n_parameters(f) > 8 and not shape.is_compiled(f)
    }
    assert long == {}


def test_no_call_spreads_a_tuple_written_on_the_spot() -> None:
    """``f(*(a, b), c)`` hides which argument is which."""
    assert [f"{m.name}:{line}" for m, line in shape.splats(FOUND)] == []


def test_the_core_imports_no_satellite_no_file_and_no_report() -> None:
    """Satellites may leave for packages of their own without touching the core."""
    outside = (*shape.SATELLITES, "io", "report", "commands", "cli")
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
        "from roomfit.identification import identify\n"
    )
    (first, second) = (n for n in tree.body if isinstance(n, ast.FunctionDef))
    assert shape.n_parameters(first) == 9
    assert [shape.is_compiled(f) for f in (first, second)] == [False, True]
    module = shape.Module("made", shape.SOURCE, tree, 5)
    assert [line for _, line in shape.splats([module])] == [4]
    assert shape.imported(module, NAMES) == {"identification"}
    assert Counter(m.name for m in FOUND)["identification"] == 1


@pytest.mark.slow
def test_eleven_frames_at_most_lie_between_identify_and_the_innermost_kernel() -> None:
    """On the default path: responses of an omnidirectional source, pressures that add.

    Calls beside that way, down to the corners of a triangle, may lie three deeper.
    """
    to_kernel, deepest = shape.deepest_stacks()
    assert len(to_kernel) <= 11, "\n".join(to_kernel)
    assert len(deepest) <= 14, "\n".join(deepest)
