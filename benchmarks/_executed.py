"""Which functions and lines of roomfit every test executes: a plugin of pytest, and its readers.

``pytest -p _executed --executed FILE tests`` adds a line of JSON for each test: its name, its
seconds, and the functions and lines that it, its fixtures and the functions that it keeps by
`functools.cache` entered. The lines of a function are watched until all of them, or some thousands,
have run in a test. Compiled kernels are entered by no interpreter, and constants by nobody: they
are executed where a function is that names them. What runs in other processes is not seen.
"""

from __future__ import annotations

import ast
import functools
import inspect
import json
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src" / "roomfit"

# The packages that decide numbers: not those that read and write files, show or start something.
NUMERICAL = (
    *("air", "bands", "batch", "diagnostics", "experiment_design"),
    *("eyring", "geometry", "identification", "impedance", "inversion", "logit", "materials"),
    *("measurement", "objective", "prediction", "response", "scene", "signals", "solvers"),
    *("suh2001", "synthetic", "tracing", "treatment", "uncertainty"),
)

_entered: set[CodeType | tuple[CodeType, int]] = set()  # of what runs now, with lines
_left: dict[CodeType, set[int]] = {}  # lines that have not run in this test
_watches: dict[CodeType, int] = {}  # of how many lines more
_MOST_LINES = 5000


def _trace(frame: FrameType, _event: str, _argument: object) -> Callable[..., Any] | None:
    code = frame.f_code
    if code not in _entered:
        _entered.add(code)
        # what stands outside of functions runs in the test that happens to import it first
        if code.co_filename.startswith(str(SOURCE)) and code.co_flags & inspect.CO_OPTIMIZED:
            _left[code] = {line for *_, line in code.co_lines() if line} - {code.co_firstlineno}
            _watches[code] = _MOST_LINES
        else:
            _left[code] = set()
    return _trace_lines if _left[code] else None


def _trace_lines(frame: FrameType, event: str, _argument: object) -> Callable[..., Any]:
    code = frame.f_code
    if event == "line" and code in _left:
        _watches[code] -= 1
        if frame.f_lineno in _left[code]:
            _left[code].remove(frame.f_lineno)
            _entered.add((code, frame.f_lineno))
        if not _watches[code]:
            _left[code].clear()
        frame.f_trace_lines = bool(_left[code])
    return _trace_lines


def _kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return `functools.cache` of a function: each call counts as if it had run."""
    cached = functools.lru_cache(maxsize=None)(function)
    of_call: dict[object, set[CodeType | tuple[CodeType, int]]] = {}

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        key = (arguments, tuple(sorted(named.items())))
        if key in of_call:
            _entered.update(of_call[key])
            return cached(*arguments, **named)
        before = set(_entered)
        _entered.clear()
        try:
            value = cached(*arguments, **named)
            of_call[key] = set(_entered)
        finally:
            _entered.update(before)
        return value

    call.cache_clear = cached.cache_clear  # type: ignore[attr-defined]
    return call


def names(entered: set[CodeType | tuple[CodeType, int]]) -> tuple[list[str], dict[str, list[int]]]:
    """Return the functions of roomfit among what was entered, by file and name, and its lines."""
    found, lines = set[str](), dict[str, set[int]]()
    for item in entered:
        code, line = item if isinstance(item, tuple) else (item, 0)
        # what stands outside of functions runs in the test that happens to import it first
        if code.co_filename.startswith(str(SOURCE)) and code.co_flags & inspect.CO_OPTIMIZED:
            path = Path(code.co_filename).relative_to(SOURCE).as_posix()
            found.add(f"{path}:{code.co_qualname.split('.<')[0]}")
            if line:
                lines.setdefault(path, set()).add(line)
    return sorted(found), {path: sorted(own) for path, own in lines.items()}


class Recorder:
    """Watches tests one after the other and writes a line for each."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.of_fixture: dict[int, set[CodeType | tuple[CodeType, int]]] = {}

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        before = set(_entered)
        _entered.clear()
        yield
        self.of_fixture[id(fixturedef)] = set(_entered)
        _entered.update(before)

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[None]:
        _entered.clear()
        began = time.perf_counter()
        yield
        seconds = time.perf_counter() - began
        codes = set(_entered)
        for definitions in item._fixtureinfo.name2fixturedefs.values():
            for fixture in definitions:
                codes |= self.of_fixture.get(id(fixture), set())
        functions, lines = names(codes)
        line = {
            "test": item.nodeid.removeprefix("tests/"),
            "seconds": round(seconds, 3),
            "functions": functions,
            "lines": lines,
        }
        with self.path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")


def pytest_addoption(parser: Any) -> None:
    parser.addoption("--executed", help="file to which a line is added for each test")


def pytest_configure(config: Any) -> None:
    path = config.getoption("--executed")
    if path:
        # before the files of tests are read
        functools.cache = _kept  # type: ignore[assignment]
        config.pluginmanager.register(Recorder(Path(path)))
        threading.settrace(_trace)
        sys.settrace(_trace)


def pytest_unconfigure() -> None:
    sys.settrace(None)
    threading.settrace(None)


class Run(NamedTuple):
    """A test that was watched."""

    test: str  # below tests/, with the name of the test
    seconds: float
    functions: frozenset[str]
    lines: Mapping[str, frozenset[int]] = {}  # by file below src/roomfit


@functools.cache
def watched(path: Path) -> tuple[Run, ...]:
    """Return the tests of a file that the plugin wrote."""
    lines = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    runs = (
        Run(
            v["test"],
            v["seconds"],
            frozenset(v["functions"]),
            {path: frozenset(own) for path, own in v["lines"].items()},
        )
        for v in lines
    )
    return tuple({run.test: run for run in runs}.values())


_DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


def _defined(text: str) -> Iterator[tuple[str, ast.stmt]]:
    """Yield the functions, methods and further statements of a module with their names."""
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, _DEFINITIONS):
                    yield f"{node.name}.{inner.name}", inner
            yield node.name, node
        elif isinstance(node, _DEFINITIONS):
            yield node.name, node
        else:
            targets = node.targets if isinstance(node, ast.Assign) else [node]
            for target in targets:
                yield ast.unparse(getattr(target, "target", target)).split("\n")[0], node


def name_at(text: str, line: int) -> str:
    """Return what a line belongs to: a function, Class.method, a class or a constant; or ""."""
    for name, node in _defined(text):
        if node.lineno <= line <= (node.end_lineno or 0):
            return name
    return ""


def statement_at(text: str, line: int) -> range:
    """Return the lines of the innermost statement about a line; of a block, those of its head."""
    found = range(line, line + 1)
    for node in ast.walk(ast.parse(text)):  # outer ones first
        if isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case):
            inside = [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.stmt)]
            parts = [n for n in ast.walk(node) if isinstance(n, ast.stmt | ast.expr)]
            first = getattr(node, "lineno", min(n.lineno for n in parts))
            last = max(n.end_lineno or 0 for n in parts)
            if first <= line <= last:
                found = range(first, max(first, inside[0].lineno - 1 if inside else last) + 1)
    return found


@functools.cache
def _mentions(*, compiled: bool = False) -> dict[str, set[str]]:
    """Return, for every name, and attribute with its dot, what functions and constants have it.

    Of compiled functions and constants alone where they are asked for.
    """
    found: dict[str, set[str]] = {}
    for file in SOURCE.rglob("*.py"):
        path = file.relative_to(SOURCE).as_posix()
        for name, node in _defined(file.read_text(encoding="utf-8")):
            decorators = getattr(node, "decorator_list", [])
            is_kernel = any("kernel" in ast.unparse(d) for d in decorators)
            if compiled and isinstance(node, _DEFINITIONS) and not is_kernel:
                continue
            for inner in ast.walk(node):
                used = getattr(inner, "id", "") or f".{getattr(inner, 'attr', '')}"
                if used != ".":
                    found.setdefault(used, set()).add(f"{path}:{name}")
    return found


def _mentioning(path: str, name: str) -> set[str]:
    """Return what has a name of a module: of a private one, which others may have too, its own."""
    found = _mentions().get(name, set())
    own = {key for key in found if key.startswith(f"{path}:") and name.lstrip(".").startswith("_")}
    return own or found


def _names(name: str) -> list[str]:
    """Return what `name_at` names: of constants that are defined together, each."""
    return re.findall(r"\w+", name) if name.startswith("(") else [name]


def kernels_holding(name: str) -> set[str]:
    """Return a function or constant, and the compiled functions whose machine code holds it."""
    ring = set(_names(name))
    seen = set(ring)
    while ring:
        callers = (k for n in ring for k in _mentions(compiled=True).get(n, ()))
        ring = {key.split(":")[1] for key in callers} - seen
        seen |= ring
    return seen


@functools.cache
def _test_text(file: str) -> str:
    return (REPOSITORY / "tests" / file).read_text(encoding="utf-8")


_QUICK_S = 10.0  # times one and a hundredth of the functions that a test enters
# Answers of small cases, seconds each.
_KEPT = "test_reference.py"


def executing_tests(
    path: str, name: str, runs: tuple[Run, ...], budget_s: float, lines: Sequence[int] = ()
) -> list[str]:
    """Return tests that execute a function, best first, which take no longer together.

    Those alone that execute one of the lines, where any does. Where none executes the function (a
    kernel, a constant, a class), those of what names it, and so on. First come
    the tests of files whose text has its name, then tests of few seconds and few other functions,
    but before those that take long answers that are kept, which any change of a number moves.

    Parameters
    ----------
    path, name : str
        File below src/roomfit, and what `name_at` returns.
    runs : tuple of Run
    budget_s : float
    lines : sequence of int
        Of the statement that holds the bug.
    """
    ring = {f"{path}:{name}"}
    seen = set(ring)
    chosen: list[Run] = []
    while ring and not chosen:
        chosen = [run for run in runs if not ring.isdisjoint(run.functions)]
        # a method is called as an attribute, all else by its name
        named = [(key.split(":")[0], n) for key in ring for n in _names(key.split(":")[1])]
        short = {(home, re.sub(r"^\w+(?=\.)", "", n)) for home, n in named}
        ring = {key for home, s in short for key in _mentioning(home, s)} - seen
        seen |= ring
    own = [run for run in chosen if not run.lines.get(path, frozenset()).isdisjoint(lines)]
    chosen = own or chosen
    word = re.compile(rf"\b{re.escape(name.split('.')[-1])}\b") if name else re.compile(r"(?!)")

    @functools.cache
    def has_word(file: str) -> bool:
        return bool(word.search(_test_text(file)))

    def kind(run: Run) -> int:
        file = run.test.split("::")[0]
        is_quick = effort(run) < _QUICK_S
        return 0 if has_word(file) and is_quick else 2 if file == _KEPT else 1 if is_quick else 3

    def effort(run: Run) -> float:
        return run.seconds * (1.0 + len(run.functions) / 100.0)

    found, used_s = list[Run](), 0.0
    for run in sorted(chosen, key=lambda run: (kind(run), effort(run))):
        if run.test.startswith(_KEPT) or used_s + run.seconds <= budget_s:
            found.append(run)
            used_s += 0.0 if run.test.startswith(_KEPT) else run.seconds
    # those of a file together, or what they share is made anew for each
    first: dict[tuple[int, str], int] = {}
    for number, run in enumerate(found):
        first.setdefault((kind(run), run.test.split("::")[0]), number)
    return [run.test for run in sorted(found, key=lambda r: first[kind(r), r.test.split("::")[0]])]
