"""The shape of the code in numbers: modules, lines, types, functions, and the way to the kernels.

Run it with ``--frames`` to identify the demo's room as well and count how many frames of roomfit
lie on the stack, from `roomfit.identify` to a function that enters a compiled kernel, and to the
innermost call of any kind.

    python benchmarks/shape.py [--frames]
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

SOURCE = Path(__file__).resolve().parents[1] / "src" / "roomfit"
SATELLITES = (
    "app",
    "certified",
    "coverage",
    "experiment_design",
    "impedance",
    "prediction",
    "suh2001",
    "synthetic",
    "treatment",
)
# Beside the core as well, and no part of what satellites may take from it.
AROUND = (*SATELLITES, "batch", "cli", "commands", "io", "report", "table")
# What `identify` works with in the first place; commands, reports and files come on top of it.
FRONT = "identification"


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


def taken(found: list[Module], satellite: str) -> set[tuple[str, str]]:
    """Return module and name of everything that a satellite imports from the core.

    Names for type checkers alone count; those of `roomfit.core` stand with the module that holds
    them.
    """
    homes, names = front_door(found), set()
    for m in found:
        if m.name.split(".")[0] != satellite:
            continue
        for node in ast.walk(m.tree):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith(
                "roomfit."
            ):
                continue
            base = (node.module or "").removeprefix("roomfit.")
            if base.split(".")[0] in AROUND:
                continue
            names |= {(homes[a.name] if base == "core" else base, a.name) for a in node.names}
    return names


def front_door(found: list[Module]) -> dict[str, str]:
    """Return every name that `roomfit.core` publishes, and the module that holds it."""
    (core_module,) = (m for m in found if m.name == "core")
    return {
        alias.name: (node.module or "").removeprefix("roomfit.")
        for node in ast.walk(core_module.tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("roomfit.")
        for alias in node.names
    }


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


def used_once(found: list[Module]) -> list[tuple[Module, ast.FunctionDef]]:
    """Return the private functions at the top of a module that one place of it mentions."""
    once = []
    for m in found:
        uses = Counter(n.id for n in ast.walk(m.tree) if isinstance(n, ast.Name))
        once += [
            (m, node)
            for node in m.tree.body
            if isinstance(node, ast.FunctionDef)
            and node.name.startswith("_")
            and uses[node.name] == 1
        ]
    return once


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


def entering_kernels(found: list[Module]) -> set[str]:
    """Return the functions, as ``path:name``, that call a compiled one."""
    compiled = {f.name for _, f in functions(found) if is_compiled(f)}
    return {
        f"{m.path.relative_to(SOURCE)}:{f.name}"
        for m, f in functions(found)
        if not is_compiled(f) and compiled & _names(f, ast.Load) - _names(f, ast.Store)
    }


def _names(function: ast.AST, context: type[ast.expr_context]) -> set[str]:
    """Return the names that a function reads, or those that it assigns to."""
    return {
        n.id for n in ast.walk(function) if isinstance(n, ast.Name) and isinstance(n.ctx, context)
    }


_CARRIERS = ("forks.py", "_numba.py")


def deepest_stacks(found: list[Module]) -> tuple[list[str], list[str]]:
    """Identify the demo's room, and return the deepest stacks of the own frames of some modules.

    The first ends where a compiled kernel is entered, the second with any call, down to the checks
    of an array. What hands work to copies of the process or to threads counts as little as `map`
    does, and a local function belongs to the function that it stands in.
    """
    from dataclasses import replace
    from tempfile import TemporaryDirectory

    import numpy as np

    from roomfit.identification import identify
    from roomfit.io.inputs import load_campaign
    from roomfit.synthetic.boxes import demo_plan, write_measured_box

    enters = entering_kernels(found)
    to_kernel: list[str] = []
    deepest: list[str] = []

    @cache  # taken apart at every call, paths took most of the time
    def own_path(filename: str) -> str:
        path = Path(filename)
        return path.relative_to(SOURCE).as_posix() if path.is_relative_to(SOURCE) else ""

    def name_of(code: CodeType) -> str:
        path = own_path(code.co_filename)
        is_own = path and path not in _CARRIERS and "<" not in code.co_qualname
        return f"{path}:{code.co_name}" if is_own else ""

    def watch(frame: FrameType, event: str, _argument: Any) -> None:
        if event != "call" or not name_of(frame.f_code):
            return  # what others call makes no stack of ours longer
        stack: list[str] = []
        at: FrameType | None = frame
        while at is not None:
            if name := name_of(at.f_code):
                stack.append(name)
            at = at.f_back
        if len(stack) > len(deepest):
            deepest[:] = stack[::-1]
        if len(stack) > len(to_kernel) and stack[0] in enters:
            to_kernel[:] = stack[::-1]

    plan = demo_plan()
    plan = replace(plan, sources_m={"LS1": plan.sources_m["LS1"]})
    with TemporaryDirectory() as folder:
        campaign = write_measured_box(plan, Path(folder), np.random.default_rng(1))
        text = campaign.read_text(encoding="utf-8")
        text = text.replace("from_hz = 125", "from_hz = 1000").replace("= 4000", "= 1000")
        campaign.write_text(text, encoding="utf-8")
        arguments = load_campaign(campaign)
        sys.setprofile(watch)
        try:
            identify(**arguments)
        finally:
            sys.setprofile(None)
    return to_kernel, deepest


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", action="store_true", help="identify, and count the frames")
    wanted = parser.parse_args()
    found = modules()
    names = frozenset(m.name for m in found)
    inner = core(found)
    defined = functions(found)
    arrows = sum(len(imported(m, names) - {""}) for m in found)
    rows = [
        ("lines of src", sum(m.n_lines for m in found)),
        ("lines of the core (what identify imports)", sum(m.n_lines for m in inner)),
        ("modules", len(found)),
        ("modules of the core", len(inner)),
        ("longest module, lines", max(m.n_lines for m in found)),
        ("dataclasses", len(dataclasses(found))),
        ("numbers named at the level of a module", n_constants(found)),
        ("functions and methods", len(defined)),
        ("private functions used once", len(used_once(found))),
        (
            "functions of more than 8 parameters, kernels apart",
            sum(n_parameters(f) > 8 and not is_compiled(f) for _, f in defined),
        ),
        ("calls of the form f(*(a, b), c)", len(splats(found))),
        ("import arrows", arrows),
    ]
    public = set(front_door(found).items())
    for satellite in (*SATELLITES, "batch", "report"):
        own = {(name, home) for home, name in taken(found, satellite)}
        rows.append((f"names that {satellite} takes from the core", len(own)))
        rows.append(("  of these not in roomfit.core", len(own - public)))
    if wanted.frames:
        stacks = deepest_stacks(found)
        rows.append(("frames to the innermost kernel", len(stacks[0])))
        rows.append(("frames at the deepest", len(stacks[1])))
    width = max(len(text) for text, _ in rows)
    for text, number in rows:
        print(f"{text:<{width}}  {number:>7,}")
    if wanted.frames:
        for stack in stacks:
            print("\n".join(["", *(f"{'  ' * i}{at}" for i, at in enumerate(stack))]))


if __name__ == "__main__":
    main()
