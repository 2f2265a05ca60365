"""The shape of the code in numbers, as `tests/test_shape.py` limits it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "roomfit"
SATELLITES = (
    "app",
    "batch",
    "demo",
    "design",
    "impedance",
    "paper",
    "predict",
    "treat",
)
# Beside the core as well, and no part of what satellites may take from it.
AROUND = (*SATELLITES, "cli", "files", "formats", "report")
# What `identify` works with in the first place; commands, reports and files come on top of it.
FRONT = "identify"


Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Module:
    """One file of the package with something in it."""

    name: str
    """Dotted, without ``roomfit.``; the package itself is the empty string."""
    path: Path
    tree: ast.Module
    n_lines: int


def modules(source: Path = SOURCE) -> list[Module]:
    """Return every module that has more in it than a docstring."""
    found = []
    for path in sorted(source.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        if any(not _is_text(node) for node in tree.body):
            name = ".".join(path.relative_to(source).with_suffix("").parts)
            name = name.removesuffix("__init__").rstrip(".")
            found.append(Module(name, path, tree, text.count("\n")))
    return found


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def imported(module: Module, names: frozenset[str], *, lazily: bool = True) -> set[str]:
    """Return which modules of roomfit one imports.

    Parameters
    ----------
    module : Module
    names : frozenset of str
        Of all modules.
    lazily : bool
        Count imports inside functions, too. Those for type checkers alone never count.
    """
    nodes = _nodes(module.tree, lazily=lazily)
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "roomfit":
            base = (node.module or "").removeprefix("roomfit").removeprefix(".")
            for alias in node.names:
                inner = f"{base}.{alias.name}".removeprefix(".")
                found.add(inner if inner in names else base)
        elif isinstance(node, ast.Import):
            found |= {
                a.name.removeprefix("roomfit").removeprefix(".")
                for a in node.names
                if a.name.split(".")[0] == "roomfit"
            }
    return found & (names | {""}) - {module.name}


def _nodes(tree: ast.AST, *, lazily: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, Function) and not lazily:
            continue
        yield node
        yield from _nodes(node, lazily=lazily)


def core(found: list[Module]) -> list[Module]:
    """Return the modules that `roomfit.identify` cannot do without: what it imports, and so on.

    What is imported inside functions does not count: the certificate, where one is asked for, and
    how a result prints and draws itself.
    """
    names = frozenset(m.name for m in found)
    by_name = {m.name: m for m in found}
    waiting, observed = [FRONT], {FRONT}
    while waiting:
        for name in imported(by_name[waiting.pop()], names, lazily=False) - {""}:
            if name not in observed and name in by_name:
                observed.add(name)
                waiting.append(name)
    return [m for m in found if m.name in observed]


def functions(found: list[Module]) -> list[tuple[Module, Function]]:
    """Return every function and method with its module."""
    return [(m, node) for m in found for node in ast.walk(m.tree) if isinstance(node, Function)]


def n_code_lines(function: Function) -> int:
    """Return the number of lines of a function beside its docstring."""
    first = function.body[0]
    text = (first.end_lineno or 0) - first.lineno + 1 if _is_text(first) else 0
    return (function.end_lineno or 0) - function.lineno + 1 - text


def dataclasses(found: list[Module]) -> list[tuple[Module, ast.ClassDef]]:
    """Return every class with a decorator ``dataclass``."""
    return [
        (m, node)
        for m in found
        for node in ast.walk(m.tree)
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.unparse(d) for d in node.decorator_list)
    ]


def n_constants(found: list[Module]) -> int:
    """Return how many numbers, and tuples of numbers, have a name at the level of a module."""
    values = (
        node.value
        for m in found
        for node in m.tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
    )
    return sum(_is_number(value) for value in values)


def _is_number(value: ast.expr) -> bool:
    """Whether an expression is made of numbers alone."""
    leaves = [n for n in ast.walk(value) if isinstance(n, ast.Constant | ast.Name | ast.Call)]
    return bool(leaves) and all(
        isinstance(n, ast.Constant) and type(n.value) in (int, float) for n in leaves
    )


def n_parameters(function: Function) -> int:
    """Return how many arguments a function takes, `self` and `cls` not counted."""
    a = function.args
    named = [p.arg for p in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len([p for p in named if p not in ("self", "cls")])


def is_compiled(function: Function) -> bool:
    """Whether a function is compiled by numba, or stands for one that is."""
    marks = ("kernel", "njit", "overload", "intrinsic", "device_function")
    return any(mark in ast.unparse(d) for d in function.decorator_list for mark in marks)


def splats(found: list[Module]) -> list[tuple[Module, int]]:
    """Return where a call spreads a tuple written on the spot: ``f(*(a, b), c)``."""
    return [
        (m, node.lineno)
        for m in found
        for node in ast.walk(m.tree)
        if isinstance(node, ast.Call)
        and any(isinstance(a, ast.Starred) and isinstance(a.value, ast.Tuple) for a in node.args)
    ]
