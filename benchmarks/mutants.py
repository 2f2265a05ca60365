"""Bugs planted one at a time at random places: of those that move a public answer, how many does
the suite notice?

    python benchmarks/mutants.py --moved 100 --seed 1
    python benchmarks/mutants.py --moved 20 --packages fit uncertainty

Signs, comparisons, constants, indices, dropped statements, exchanged arguments, at places of the
syntax tree drawn with equal probability, in a temporary copy of src. A bug counts where it moves a
public answer: an exit code, a file or a message of one of four small cases that are run by the
command line, each in a process of its own. What moves nothing public need not be noticed. Then the
kept answers and the test files that reach the module by the fewest imports run against the copy.
Bugs are planted until as many as `--moved` says have moved an answer; the share noticed is printed
by package, with its interval of 95 % (Clopper and Pearson).
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from scipy.stats import beta

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src"
CASES = ("quick", "values", "decay-times", "known-and-priors")


class Mutant(NamedTuple):
    """A bug: the text of a file below src/roomfit from `start`, and what stands there instead."""

    path: str
    start: int
    old: str
    new: str
    name: str


def planted(mutant: Mutant | None, folder: Path) -> Path:
    """Copy src into a folder with a bug in it, or none, and return the copy.

    Files keep their dates, so that compiled kernels are those of the unchanged source; kernels are
    compiled anew where one was changed, since machine code of callers holds what they call.
    """
    copy = folder / "src"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("*.egg-info"))
    (folder / "docs").symlink_to(REPOSITORY / "docs")
    if mutant is not None:
        path = copy / "roomfit" / mutant.path
        text = path.read_text(encoding="utf-8")
        end = mutant.start + len(mutant.old)
        path.write_text(text[: mutant.start] + mutant.new + text[end:], encoding="utf-8")
        if "@kernel" in text or "@device_function" in text:
            for kept in copy.glob("roomfit/**/__pycache__/*.nb[ci]"):
                kept.unlink()
    return copy


def run(copy: Path, arguments: Sequence[str], limit_s: float) -> tuple[int | None, str]:
    """Return exit code and output of Python with the package of a copy; None: out of time."""
    paths = (copy, REPOSITORY / "tests" / "helpers", REPOSITORY / "benchmarks")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "MPLBACKEND": "Agg",
        "NUMBA_NUM_THREADS": os.environ.get("NUMBA_NUM_THREADS", "1"),
    }
    process = subprocess.Popen(
        [sys.executable, *arguments],
        cwd=REPOSITORY,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None, ""
    return process.returncode, said


_ANSWER = """
import json, sys, tempfile
from pathlib import Path
from golden_cases import CASES
from roomfit.cli import main
case = CASES[sys.argv[1]]
with tempfile.TemporaryDirectory() as folder:
    print(json.dumps(case.run(Path(folder), words=True), sort_keys=True))
"""


def answers(copy: Path, limit_s: float) -> dict[str, object]:
    """Return what the four cases give by the command line: exit codes, files, messages."""
    return {name: run(copy, ["-c", _ANSWER, name], limit_s) for name in CASES}


class Outcome(NamedTuple):
    """What became of a bug: "moved nothing", "noticed" or "SURVIVED"."""

    mutant: Mutant
    verdict: str
    how: str
    seconds: float


def tried(mutant: Mutant, right: dict[str, object], limit_s: float, most_tests: int) -> Outcome:
    """Plant a bug and return whether it moves an answer, and if so, whether tests notice it."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        copy = planted(mutant, Path(name))
        if answers(copy, limit_s) == right:
            return Outcome(mutant, "moved nothing", "", time.perf_counter() - began)
        verdict, how = "SURVIVED", ""
        for tests in (["golden"], near_tests(mutant.path)[:most_tests]):
            pytest = ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
            code, said = run(copy, [*pytest, *(f"tests/{t}" for t in tests)], 10.0 * limit_s)
            if code not in (0, 5):
                failed = [line for line in said.splitlines() if line.startswith(("FAILED", "ERR"))]
                verdict, how = "noticed", failed[0].split(" - ")[0] if failed else "ended"
                break
    return Outcome(mutant, verdict, how, time.perf_counter() - began)


_SIGNS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*"}
_COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
# The same whichever argument comes first.
_SYMMETRIC = frozenset({"max", "min", "maximum", "minimum", "hypot", "isclose", "gcd"})
# How a picture looks, not what it shows.
_LOOKS = frozenset(
    {"alpha", "bbox_to_anchor", "capsize", "color", "columnspacing", "elinewidth", "fontsize"}
    | {"handlelength", "linewidth", "linewidths", "lw", "mew", "ms", "ncols", "pad", "rotation"}
    | {"zorder"}
)
# Their text is read by people alone, or by type checkers.
_NOT_PLANTED = (ast.JoinedStr, ast.Raise, ast.Assert)


class Place(NamedTuple):
    """Where a random bug may be planted, and what would stand there."""

    kind: str
    start: int
    end: int
    new: str


def places(text: str) -> list[Place]:
    """Return the bugs that can be planted in a module, in the order of its syntax tree.

    Messages, annotations, decorators, how pictures look, whether lengths are checked and what only
    type checkers see are left out.
    """
    lines = [0]
    for line in text.split("\n"):
        lines.append(lines[-1] + len(line) + 1)

    def offset(line: int, column: int) -> int:
        start = lines[line - 1]
        own = text[start : lines[line]].encode()[:column]
        return start + len(own.decode())

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None and node.end_col_offset is not None
        return offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)

    found: list[Place] = []

    def between(kind: str, left: ast.expr, right: ast.expr, old: str, new: str) -> None:
        start, end = span(left)[1], span(right)[0]
        at = text.find(old, start, end)
        if at >= 0 and "#" not in text[start:end]:
            found.append(Place(kind, at, at + len(old), new))

    def visit(node: ast.AST) -> None:
        if isinstance(node, _NOT_PLANTED):
            return
        if isinstance(node, ast.keyword) and node.arg in {*_LOOKS, "strict"}:
            return
        if isinstance(node, ast.Call) and ast.unparse(node.func).lstrip("_") == "new_figure":
            return
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        _plant_in(node, text, span, between, found)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    visit(child)

    visit(ast.parse(text))
    return found


Span = Callable[[ast.expr | ast.stmt], tuple[int, int]]
Between = Callable[[str, ast.expr, ast.expr, str, str], None]


def _plant_in(node: ast.AST, text: str, span: Span, between: Between, found: list[Place]) -> None:
    """Add the bugs that can be planted in one node, not in those within it."""
    if isinstance(node, ast.BinOp) and type(node.op) in _SIGNS:
        old = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}[
            type(node.op)
        ]
        between("sign", node.left, node.right, old, _SIGNS[type(node.op)])
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        start = span(node)[0]
        length = 1 if isinstance(node.op, ast.USub) else 3
        found.append(Place("sign", start, start + length, ""))
    elif isinstance(node, ast.Compare):
        olds = {
            type(op): ast.unparse(ast.Compare(ast.Name("a"), [op], [ast.Name("b")]))[2:-2]
            for op in node.ops
        }
        for left, op, right in zip(
            [node.left, *node.comparators], node.ops, node.comparators, strict=False
        ):
            between("comparison", left, right, olds[type(op)], _COMPARISONS[type(op)])
    elif isinstance(node, ast.BoolOp):
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        between("comparison", node.values[0], node.values[1], old, new)
    elif isinstance(node, ast.Constant) and isinstance(value := node.value, bool | int | float):
        new = repr(not value if isinstance(value, bool) else value + 1)
        if isinstance(value, float):
            new = repr(1.5 * value if value else 1.0)
        found.append(Place("constant", *span(node), new))
    elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Slice):
        for bound in (node.slice.lower, node.slice.upper):
            if bound is not None:
                start, end = span(bound)
                found.append(Place("index", start, end, f"({text[start:end]}) + 1"))
    elif isinstance(node, ast.Expr | ast.AugAssign):
        if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant | ast.Yield)):
            found.append(Place("dropped statement", *span(node), "pass"))
    elif isinstance(node, ast.Call) and len(node.args) > 1:
        (a, b), (c, d) = span(node.args[0]), span(node.args[1])
        is_symmetric = ast.unparse(node.func).split(".")[-1] in _SYMMETRIC
        if text[a:b] != text[c:d] and "*" not in (text[a], text[c]) and not is_symmetric:
            new = text[c:d] + text[b:c] + text[a:b]
            found.append(Place("exchanged arguments", a, d, new))


def package_of(path: str) -> str:
    """Return the package of a file below src/roomfit, or the module where it lies in none."""
    return path.split("/")[0].removesuffix(".py")


def random_mutants(seed: int, packages: Sequence[str]) -> Iterator[Mutant]:
    """Yield bugs at random places without end, all places of the packages equally likely."""
    every: list[tuple[str, Place, str]] = []
    for file in sorted((SOURCE / "roomfit").rglob("*.py")):
        path = file.relative_to(SOURCE / "roomfit").as_posix()
        if not packages or package_of(path) in packages:
            text = file.read_text(encoding="utf-8")
            every += [(path, place, text) for place in places(text)]
    random.Random(seed).shuffle(every)
    for path, place, text in every:
        line = text[: place.start].count("\n") + 1
        old = text[place.start : place.end]
        yield Mutant(path, place.start, old, place.new, f"{path}:{line} {place.kind}")


@cache
def _imports(file: Path) -> frozenset[str]:
    """Return the modules of roomfit that a file imports; public names stand for their modules."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == "roomfit":
            found.add(f"roomfit.{_public().get(node.attr, node.attr)}")
    return frozenset(name for name in found if name.startswith("roomfit."))


@cache
def _public() -> dict[str, str]:
    text = (SOURCE / "roomfit" / "__init__.py").read_text(encoding="utf-8")
    dicts = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Dict)]
    return {
        key.value: value.value
        for node in dicts
        for key, value in zip(node.keys, node.values, strict=True)
        if isinstance(key, ast.Constant) and isinstance(value, ast.Constant)
        if isinstance(key.value, str) and isinstance(value.value, str)
    }


# They look at the text of the sources, which a copy has elsewhere.
_OF_TEXT = frozenset(f"test_{n}.py" for n in ("shape", "words", "docs", "front_door"))


@cache
def near_tests(path: str) -> tuple[str, ...]:
    """Return the test files that reach a module by the fewest imports, nearest first.

    Those that import it come before those that import what imports it, and so on; among them those
    named after it, those in the folder of its package, then those that import least.
    """
    source, folder, stem = SOURCE / "roomfit", package_of(path), Path(path).stem
    name = ".".join(("roomfit", *Path(path).with_suffix("").parts)).removesuffix(".__init__")
    files = {
        ".".join(("roomfit", *f.relative_to(source).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): f
        for f in source.rglob("*.py")
        if f != source / "__init__.py"
    }
    tests = sorted(t for t in (REPOSITORY / "tests").rglob("test_*.py") if t.name not in _OF_TEXT)
    reached, ring, found = {name}, {name}, list[str]()
    for _ in range(3):
        own = [t for t in tests if _imports(t) & ring]
        own.sort(
            key=lambda t: (
                stem not in t.stem,
                folder not in t.as_posix().split("tests/")[1],
                len(_imports(t)),
            )
        )
        found += [t.relative_to(REPOSITORY / "tests").as_posix() for t in own]
        ring = {m for m, f in files.items() if _imports(f) & ring} - reached
        reached |= ring
    if not found:  # it is run as a file and imported by nobody
        found = [
            t.relative_to(REPOSITORY / "tests").as_posix()
            for t in tests
            if folder in t.relative_to(REPOSITORY / "tests").parts
        ]
    return tuple(dict.fromkeys(found))


def share(noticed: int, number: int) -> str:
    """Return a share in percent with its interval of 95 % by Clopper and Pearson."""
    if not number:
        return "none"
    low = float(beta.ppf(0.025, noticed, number - noticed + 1)) if noticed else 0.0
    high = float(beta.ppf(0.975, noticed + 1, number - noticed)) if noticed < number else 1.0
    return f"{100 * noticed / number:.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moved", type=int, default=100, help="bugs to count, %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="of the places, %(default)s")
    parser.add_argument("--packages", nargs="*", default=[], help="where bugs are planted; all")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds a case, %(default)g")
    parser.add_argument("--most-tests", type=int, default=8, help="files a bug, %(default)s")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        right = answers(planted(None, Path(name)), 10.0 * given.limit)
    if any(json.dumps(answer).startswith("[null") for answer in right.values()):
        raise SystemExit("a case does not end without any bug")
    counted: list[Outcome] = []
    planted_bugs = 0
    for mutant in random_mutants(given.seed, given.packages):
        if len(counted) == given.moved:
            break
        planted_bugs += 1
        outcome = tried(mutant, right, given.limit, given.most_tests)
        print(
            f"{outcome.verdict:13} {mutant.name}, {outcome.seconds:.0f} s  "
            f"{mutant.old!r} -> {mutant.new!r}  {outcome.how}",
            flush=True,
        )
        if outcome.verdict != "moved nothing":
            counted.append(outcome)
    print(f"{planted_bugs} bugs were planted, {len(counted)} moved a public answer")
    for package in (*sorted({package_of(o.mutant.path) for o in counted}), ""):
        own = [o for o in counted if package in ("", package_of(o.mutant.path))]
        noticed = sum(o.verdict == "noticed" for o in own)
        print(f"{package or 'all'}: {noticed} of {len(own)}, {share(noticed, len(own))}")


if __name__ == "__main__":
    main()
