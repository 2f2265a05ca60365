"""Bugs planted one at a time in code that decides answers: how many do the tests near it notice?

``python benchmarks/mutants.py`` plants all of mutants.toml, half an hour on two cores; with names
of bugs or areas, some: ``python benchmarks/mutants.py gamma-halved air``. Each bug is a text that
stands once in a file of src, replaced in a temporary copy; the tests named beside it run against
that copy, nearest first, and stop at the first that fails: quick ones, then those marked slow. A
bug that all of them pass has survived, and one whose tests were stopped by time is undecided.
Before that the same tests run once without any bug, and must pass.

``--random N --seed S`` plants N bugs at random places of the syntax tree instead: signs,
comparisons, constants, indices, dropped statements, exchanged arguments; ``--packages`` names the
packages of src, ``numerical`` all that decide numbers. The tests are those that execute the
function, of a minute together, by a file that ``--executed`` names (`_executed.py` writes it), and
where no test does, or no file is named, the files that import the module; what they notice is tried
without the bug. Bugs that mutants.toml lists as equivalent, each with its reason, change no answer:
they are named and not counted. The share noticed is printed by package, with its interval of 95 %
(Clopper and Pearson).
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal, NamedTuple

from scipy.stats import beta

from _executed import (
    NUMERICAL,
    Run,
    executing_tests,
    kernels_holding,
    name_at,
    statement_at,
    watched,
)

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src"
# Imported once and shared by all runs; nothing of roomfit, which differs from run to run.
_PRELOADED = ["numpy", "scipy.signal", "scipy.optimize", "scipy.stats", "numba", "hypothesis"]
LIMIT_S = 240.0
Verdict = Literal["noticed", "SURVIVED", "undecided", "equivalent"]


class Mutant(NamedTuple):
    """A bug, and the tests that should notice it."""

    name: str
    area: str
    path: str  # below src/roomfit
    old: str  # stands there once, or at `start`
    new: str
    tests: tuple[str, ...]  # below tests/, nearest first; a file, or one test of it
    start: int | None = None  # where the old text begins; None: where it stands


class Outcome(NamedTuple):
    """What the tests made of a bug."""

    mutant: Mutant | None
    verdict: Verdict
    how: str
    seconds: float

    @property
    def noticed(self) -> bool:
        """Whether a test failed."""
        return self.verdict == "noticed"


_LIST = REPOSITORY / "benchmarks" / "mutants.toml"


def planted(path: Path = _LIST) -> tuple[Mutant, ...]:
    """Return all bugs of a file, group after group."""
    groups = tomllib.loads(path.read_text(encoding="utf-8"))["group"]
    return tuple(
        Mutant(
            bug["name"],
            group["area"],
            group["path"],
            bug["old"],
            bug["new"],
            tuple(bug.get("tests", group["tests"])),
        )
        for group in groups
        for bug in group["bug"]
    )


MUTANTS = planted()


def equivalent(path: Path = _LIST) -> dict[Mutant, str]:
    """Return changes of the source that change no answer, and why."""
    return {
        Mutant(e["why"], "equivalent", e["path"], e["old"], e["new"], ()): e["why"]
        for e in tomllib.loads(path.read_text(encoding="utf-8"))["equivalent"]
    }


EQUIVALENT = equivalent()


def mutated(mutant: Mutant) -> str:
    """Return the text of a source file with a bug in it; its old text must stand there once."""
    text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
    start = mutant.start
    if start is None:
        if text.count(mutant.old) != 1:
            times = text.count(mutant.old)
            raise SystemExit(f"{mutant.name}: {mutant.old!r} stands {times} times in {mutant.path}")
        start = text.index(mutant.old)
    assert text[start:].startswith(mutant.old), mutant
    return text[:start] + mutant.new + text[start + len(mutant.old) :]


def run_tests(copy: str, tests: Sequence[str], log: str, marked: str) -> None:
    """Run tests of this repository against the package below `copy`; exit with pytest's status."""
    os.setsid()
    with open(log, "w", encoding="utf-8") as stream:  # noqa: PTH123
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    paths = [copy, str(REPOSITORY / "tests" / "helpers"), str(REPOSITORY / "benchmarks")]
    os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    os.environ["MPLBACKEND"] = "Agg"
    sys.path[:0] = paths
    os.chdir(REPOSITORY)
    import pytest

    _keep_kernels(copy)
    import roomfit

    if not str(roomfit.__file__).startswith(copy):
        os._exit(70)
    arguments = ["-x", "-q", "-p", "no:cacheprovider", *(["-m", marked] if marked else [])]
    status = pytest.main([*arguments, *(f"tests/{t}" for t in tests)])
    sys.stdout.flush()
    os._exit(int(status))


def _keep_kernels(copy: str) -> None:
    """Let numba take kernels below `copy` for those of the unchanged source.

    It asks whether a file has changed; those that hold what was changed `tried` has deleted.
    """
    from numba.core import caching

    def stamp(locator: Any) -> object:
        path = Path(locator._py_file)
        if path.is_relative_to(copy):
            path = SOURCE / path.relative_to(copy)
        about = path.stat()
        found: object = caching._hash_source_file(str(path), about.st_mtime, about.st_size)
        return found

    caching._SourceFileBackedLocatorMixin.get_source_stamp = stamp  # type: ignore[method-assign]


_ENDED = "ended by signal"


class _Run(NamedTuple):
    """How pytest ended: None where it was stopped by time."""

    status: int | None
    failed: str
    log: str


def _tested(copy: Path, tests: Sequence[str], log: Path, marked: str, limit_s: float) -> _Run:
    context = get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    arguments = (str(copy), tuple(tests), str(log), marked)
    process = context.Process(target=run_tests, args=arguments)
    process.start()
    try:
        process.join(limit_s)
        late = process.is_alive()
    finally:
        # with whatever the tests have started
        if process.pid is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
    process.join()
    text = log.read_text(encoding="utf-8") if log.exists() else ""
    failed = [line for line in text.splitlines() if line.startswith(("FAILED", "ERROR"))]
    first = failed[0].split(" - ")[0] if failed else ""
    # 0: all passed; 1: a test failed; 2, and 4 for a single test: a test file could not be read; 5:
    # none is marked so; a signal ends what reaches beyond an array in compiled code: noticed
    ended_by_signal = process.exitcode is not None and process.exitcode < 0
    if not late and ended_by_signal:
        return _Run(1, f"{_ENDED} {-(process.exitcode or 0)}", text)
    if not late and process.exitcode not in (0, 1, 2, 5, *([4] if failed else [])):
        raise SystemExit(f"pytest ended with {process.exitcode}:\n{text[-2000:]}")
    return _Run(None if late else process.exitcode, first, text)


def _copied(folder: Path) -> Path:
    """Copy src into a folder, with the documents where its tests look for them."""
    copy = folder / "src"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("*.egg-info"))
    (folder / "docs").symlink_to(REPOSITORY / "docs")
    return copy


def tried(mutant: Mutant | None, tests: Sequence[str], folder: Path, limit_s: float) -> Outcome:
    """Plant a bug, or none, in a copy of src and return whether tests notice it.

    Tests marked slow run where the quick ones notice nothing; each of the two has the time limit.
    """
    began = time.perf_counter()
    copy = _copied(folder)
    if mutant is not None:
        path = copy / "roomfit" / mutant.path
        path.write_text(mutated(mutant), encoding="utf-8")
        text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
        start = text.index(mutant.old) if mutant.start is None else mutant.start
        # machine code of callers, in other files, may hold what was changed
        stale = kernels_holding(name_at(text, text[:start].count("\n") + 1))
        for kept in copy.glob("roomfit/**/__pycache__/*.nb[ci]"):
            if kept.name.split(".", 1)[1].rsplit("-", 1)[0] in stale:
                kept.unlink()
    verdict: Verdict = "SURVIVED"
    how = ""
    if mutant is None:
        marks = ["not slow"]
    else:
        # single tests are in their order already
        marks = [""] if all("::" in t for t in tests) else ["not slow", "slow"]
    for marked in marks:
        run = _tested(copy, tests, folder / "log.txt", marked, limit_s)
        if run.status in (1, 2, 4):
            verdict, how = "noticed", run.failed
            break
        if run.status is None:
            verdict, how = "undecided", f"stopped after {limit_s:g} s ({marked})"
    if mutant is None and verdict != "SURVIVED":
        raise SystemExit(f"the tests fail without any bug ({verdict}):\n{run.log[-4000:]}")
    return Outcome(mutant, verdict, how, time.perf_counter() - began)


def outcomes(mutants: Iterable[Mutant], limit_s: float = LIMIT_S) -> Iterator[Outcome]:
    """Try one bug after the other, after a run of all their tests without any."""
    chosen = tuple(mutants)
    every = tuple(dict.fromkeys(t for m in chosen for t in m.tests))
    with tempfile.TemporaryDirectory() as name:
        yield tried(None, every, Path(name), 20.0 * limit_s)
    for mutant in chosen:
        with tempfile.TemporaryDirectory() as name:
            yield tried(mutant, mutant.tests, Path(name), limit_s)


def random_outcomes(mutants: Iterable[Mutant], limit_s: float = LIMIT_S) -> Iterator[Outcome]:
    """Try one bug after the other; a test that fails without the bug as well decides nothing."""

    @cache
    def fails_anyway(test: str) -> bool:
        with tempfile.TemporaryDirectory() as name:
            # of a copy as well: a test may fail for where the package lies
            copy = _copied(Path(name))
            return _tested(copy, [test], Path(name) / "log.txt", "", 2 * limit_s).status != 0

    for mutant in mutants:
        why = why_equivalent(mutant)
        if why:
            yield Outcome(mutant, "equivalent", why, 0.0)
            continue
        with tempfile.TemporaryDirectory() as name:
            outcome = tried(mutant, mutant.tests, Path(name), limit_s)
        test = outcome.how.removeprefix("FAILED ").removeprefix("ERROR ").removeprefix("tests/")
        by_signal = test.startswith(_ENDED)
        if outcome.noticed and not by_signal and (not test or fails_anyway(test)):
            outcome = outcome._replace(verdict="undecided", how=f"fails without it, too: {test}")
        yield outcome


def why_equivalent(mutant: Mutant) -> str:
    """Return why a bug changes no answer, or "": by the text that it leaves, wherever it stands."""
    own = [e for e in EQUIVALENT if e.path == mutant.path]
    return next((EQUIVALENT[e] for e in own if mutated(e) == mutated(mutant)), "")


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


# Of tests that execute a function, by the seconds that they took when they were watched.
_BUDGET_S = 60.0


def random_mutants(
    number: int,
    seed: int,
    packages: Sequence[str] = (),
    most_tests: int = 6,
    runs: tuple[Run, ...] = (),
) -> list[Mutant]:
    """Return bugs at random places, all places of the packages equally likely.

    Their tests are the runs that execute the function, and where none does the files near it.
    """

    def tests(path: str, text: str, start: int) -> tuple[str, ...]:
        line = text[:start].count("\n") + 1
        name = name_at(text, line)
        found = executing_tests(path, name, runs, _BUDGET_S, statement_at(text, line))
        return tuple(found) or near_tests(path, name.split(".")[0])[:most_tests]

    every: list[tuple[str, Place, str]] = []
    for file in sorted((SOURCE / "roomfit").rglob("*.py")):
        path = file.relative_to(SOURCE / "roomfit").as_posix()
        if not packages or package_of(path) in packages:
            text = file.read_text(encoding="utf-8")
            every += [(path, place, text) for place in places(text)]
    chosen = random.Random(seed).sample(every, min(number, len(every)))
    return [
        Mutant(
            f"{path}:{text[: place.start].count(chr(10)) + 1} {place.kind}",
            package_of(path),
            path,
            text[place.start : place.end],
            place.new,
            tests(path, text, place.start),
            place.start,
        )
        for path, place, text in chosen
    ]


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
_OF_TEXT = frozenset(f"test_{n}.py" for n in ("shape", "words", "docs", "mutants", "front_door"))


@cache
def near_tests(path: str, function: str = "") -> tuple[str, ...]:
    """Return the test files that reach a module by the fewest imports, nearest first.

    Where a function is named, files whose text has it as a word come before all others.
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
    if function:
        named = re.compile(rf"\b{function}\b")
        found.sort(key=lambda t: not named.search((REPOSITORY / "tests" / t).read_text("utf-8")))
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
    parser.add_argument("names", nargs="*", metavar="NAME", help="bugs, or areas; left out: all")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds a bug, %(default)g")
    parser.add_argument("--random", type=int, metavar="N", help="bugs at random places")
    parser.add_argument("--seed", type=int, default=1, help="of the places, %(default)s")
    parser.add_argument("--packages", nargs="*", default=[], help="of random bugs; all")
    parser.add_argument("--most-tests", type=int, default=6, help="files a bug, %(default)s")
    parser.add_argument("--executed", type=Path, help="what _executed.py wrote")
    parser.add_argument("--skip", type=int, default=0, help="so many of them, tried before")
    given = parser.parse_args()
    if given.random:
        packages = NUMERICAL if given.packages == ["numerical"] else given.packages
        runs = watched(given.executed) if given.executed else ()
        chosen = random_mutants(given.random, given.seed, packages, given.most_tests, runs)
        chosen = chosen[given.skip :]
        tries = random_outcomes(chosen, given.limit)
    else:
        names: list[str] = given.names
        known = {m.name for m in MUTANTS} | {m.area for m in MUTANTS}
        for name in names:
            if name not in known:
                parser.error(f"no bug {name!r}")
        chosen = [m for m in MUTANTS if not names or m.name in names or m.area in names]
        tries = outcomes(chosen, given.limit)
    done = []
    for outcome in tries:
        if outcome.mutant is None:
            print(f"without a bug all tests pass, {outcome.seconds:.0f} s", flush=True)
            continue
        done.append(outcome)
        mutant = outcome.mutant
        what = f"  {mutant.old!r} -> {mutant.new!r}" if given.random else ""
        print(
            f"{outcome.verdict:9} {mutant.area}: {mutant.name}, {outcome.seconds:.0f} s{what}  "
            f"{outcome.how}",
            flush=True,
        )
    for area in (*dict.fromkeys(m.area for m in chosen), None):
        own = [o for o in done if o.mutant and area in (None, o.mutant.area)]
        decided = [o for o in own if o.verdict in ("noticed", "SURVIVED")]
        alike = sum(o.verdict == "equivalent" for o in own)
        noticed = sum(o.noticed for o in decided)
        print(
            f"{area or 'all'}: {noticed} of {len(decided)} noticed, "
            f"{share(noticed, len(decided))}; {len(own) - len(decided) - alike} undecided, "
            f"{alike} equivalent"
        )


if __name__ == "__main__":
    main()
