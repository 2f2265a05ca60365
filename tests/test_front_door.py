"""``import roomfit``: every public name loads, is typed where it is given, and costs nothing."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import roomfit

NAMES = [name for name in roomfit.__all__ if name != "__version__"]


def typed_imports() -> dict[str, str]:
    """Return name to module as the imports under TYPE_CHECKING say."""
    tree = ast.parse(Path(roomfit.__file__).read_text(encoding="utf-8"))
    block = next(
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    return {
        alias.name: str(statement.module)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }


def test_what_is_typed_is_what_is_public():
    assert typed_imports().keys() == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_the_thing_that_type_checkers_see(name):
    """Loaded lazily it is the same object, of the module that the typed import names."""
    found = getattr(roomfit, name)
    assert found.__name__ == name
    assert found.__module__ == typed_imports()[name]
    assert inspect.getdoc(found), f"{name} has no docstring"


DOCS = Path(__file__).parents[1] / "docs"
PAGES = "".join(p.read_text(encoding="utf-8") for p in DOCS.glob("*.md"))


@pytest.mark.parametrize("name", NAMES)
def test_every_function_shows_an_example_or_stands_in_a_page(name):
    """`tests/test_docs.py` runs the examples of both."""
    found = getattr(roomfit, name)
    shown = ">>> " in (inspect.getdoc(found) or "") or f"roomfit.{name}" in PAGES
    assert shown or not inspect.isfunction(found)


def test_importing_a_module_of_the_name_of_a_function_does_not_hide_the_function():
    """`identify.py`, `predict/` and `design/` are read under the names of what they answer."""
    same = {module.name for module in pkgutil.iter_modules(roomfit.__path__)} & set(NAMES)
    assert "identify" in same
    for name in same:
        importlib.import_module(f"roomfit.{name}")
        assert callable(getattr(roomfit, name)), name


def test_the_front_door_is_small():
    """What a first program needs; other names stay in the modules that hold them."""
    assert len(NAMES) <= 64


def test_names_are_offered_for_completion_and_unknown_ones_refused():
    assert set(NAMES) <= set(dir(roomfit))
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = roomfit.identfy


def test_importing_the_front_door_imports_no_other_package():
    program = "import sys, roomfit; print([m for m in ('numpy', 'pydantic') if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_check_of_recordings_loads_no_pictures_and_no_statistics():
    """Half of its time were packages that it does not use."""
    parts = ("stats", "signal", "optimize", "spatial")
    heavy = ("matplotlib", "jinja2", *(f"scipy.{part}" for part in parts))
    program = (
        "import sys, roomfit.cli.check, roomfit.checks.usable, roomfit.report.check\n"
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_the_version_is_that_of_the_installed_package():
    from importlib.metadata import version

    assert roomfit.__version__ == version("roomfit")
