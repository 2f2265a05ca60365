"""Bugs planted one at a time in code that decides answers: how many do the tests near it notice?

``python benchmarks/mutants.py`` plants all of mutants.toml, half an hour on two cores; with names
of bugs or areas, some: ``python benchmarks/mutants.py gamma-halved air``. Each bug is a text that
stands once in a file of src, replaced in a temporary copy; the tests named beside it run against
that copy, nearest first, and stop at the first that fails. A bug that all of them pass has
survived. Before that the same tests run once without any bug, and must pass.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import os
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCE = REPOSITORY / "src"
# Imported once and shared by all runs; nothing of roomfit, which differs from run to run.
_PRELOADED = ["numpy", "scipy.signal", "scipy.optimize", "scipy.stats", "numba", "hypothesis"]
LIMIT_S = 240.0


class Mutant(NamedTuple):
    """A bug, and the tests that should notice it."""

    name: str
    area: str
    path: str  # below src/roomfit
    old: str  # stands there once
    new: str
    tests: tuple[str, ...]  # below tests/, nearest first; a file, or one test of it


class Outcome(NamedTuple):
    """What the tests made of a bug."""

    mutant: Mutant | None
    noticed: bool
    how: str
    seconds: float


def planted(path: Path = REPOSITORY / "benchmarks" / "mutants.toml") -> tuple[Mutant, ...]:
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


def mutated(mutant: Mutant) -> str:
    """Return the text of a source file with a bug in it; its old text must stand there once."""
    text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
    if text.count(mutant.old) != 1:
        raise SystemExit(
            f"{mutant.name}: {mutant.old!r} stands {text.count(mutant.old)} times in {mutant.path}"
        )
    return text.replace(mutant.old, mutant.new)


def _is_compiled(mutant: Mutant) -> bool:
    """Whether a bug lies in a compiled function."""
    text = (SOURCE / "roomfit" / mutant.path).read_text(encoding="utf-8")
    line = text[: text.index(mutant.old)].count("\n") + 1
    return any(
        isinstance(node, ast.FunctionDef)
        and node.lineno <= line <= (node.end_lineno or 0)
        and any("kernel" in ast.unparse(d) for d in node.decorator_list)
        for node in ast.walk(ast.parse(text))
    )


def run_tests(copy: str, tests: Sequence[str], log: str) -> None:
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

    import roomfit

    if not str(roomfit.__file__).startswith(copy):
        os._exit(70)
    arguments = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not slow"]
    status = pytest.main([*arguments, *(f"tests/{t}" for t in tests)])
    sys.stdout.flush()
    os._exit(int(status))


def tried(mutant: Mutant | None, tests: Sequence[str], folder: Path, limit_s: float) -> Outcome:
    """Plant a bug, or none, in a copy of src and return whether tests notice it."""
    began = time.perf_counter()
    copy, log = folder / "src", folder / "log.txt"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("*.egg-info"))
    (folder / "docs").symlink_to(REPOSITORY / "docs")
    if mutant is not None:
        path = copy / "roomfit" / mutant.path
        path.write_text(mutated(mutant), encoding="utf-8")
        if _is_compiled(mutant):
            # machine code of callers, in other files, may hold what was changed
            for kept in copy.glob("roomfit/**/__pycache__/*.nb[ci]"):
                kept.unlink()
    context = get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    process = context.Process(target=run_tests, args=(str(copy), tuple(tests), str(log)))
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
    # 1: a test failed; 2: a test file could not be read
    noticed = late or process.exitcode in (1, 2)
    if process.exitcode not in (0, 1, 2) and not late:
        raise SystemExit(f"pytest ended with {process.exitcode}:\n{text[-2000:]}")
    how = "time limit" if late else (failed[0].split(" - ")[0] if failed else "")
    if mutant is None and noticed:
        raise SystemExit(f"the tests fail without any bug:\n{text[-4000:]}")
    return Outcome(mutant, noticed, how, time.perf_counter() - began)


def outcomes(mutants: Iterable[Mutant], limit_s: float = LIMIT_S) -> Iterable[Outcome]:
    """Try one bug after the other, after a run of all their tests without any."""
    chosen = tuple(mutants)
    every = tuple(dict.fromkeys(t for m in chosen for t in m.tests))
    with tempfile.TemporaryDirectory() as name:
        yield tried(None, every, Path(name), 20.0 * limit_s)
    for mutant in chosen:
        with tempfile.TemporaryDirectory() as name:
            yield tried(mutant, mutant.tests, Path(name), limit_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="bugs, or areas; left out: all")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds a bug, %(default)g")
    given = parser.parse_args()
    names: list[str] = given.names
    known = {m.name for m in MUTANTS} | {m.area for m in MUTANTS}
    for name in names:
        if name not in known:
            parser.error(f"no bug {name!r}")
    chosen = [m for m in MUTANTS if not names or m.name in names or m.area in names]
    done = []
    for outcome in outcomes(chosen, given.limit):
        if outcome.mutant is None:
            print(f"without a bug all tests pass, {outcome.seconds:.0f} s", flush=True)
            continue
        done.append(outcome)
        word = "noticed" if outcome.noticed else "SURVIVED"
        mutant = outcome.mutant
        print(
            f"{word:8} {mutant.area}: {mutant.name}, {outcome.seconds:.0f} s  {outcome.how}",
            flush=True,
        )
    for area in dict.fromkeys(m.area for m in chosen):
        own = [o.noticed for o in done if o.mutant is not None and o.mutant.area == area]
        print(f"{area}: {sum(own)} of {len(own)} noticed")
    found = sum(o.noticed for o in done)
    print(f"{found} of {len(done)} bugs noticed, {100 * found / max(len(done), 1):.1f} %")


if __name__ == "__main__":
    main()
