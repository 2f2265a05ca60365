"""Prove that answers do not change: small cases run, their output files frozen, two runs compared.

    python benchmarks/golden.py run --out DIR [--threads N] [--cases NAME ...] [--fresh-kernels]
    python benchmarks/golden.py compare DIR1 DIR2 [--tolerance]
    python benchmarks/golden.py reference [NAME ...]
    python benchmarks/golden.py list

`run` leaves in DIR the outputs (work/), their canonical contents (contents/), and digests.json: for
every file "whole", without seconds, versions, paths and provenance, and "numbers", without prose
and the names of findings as well. Answers are the same bit by bit for any number of threads, not
on another processor or with other libraries: compare runs of one machine.

`reference` prints what has changed since the numbers in tests/reference were written, and writes
them anew. `tests/test_reference.py` compares with them within what other processors may change: a
change of numbers that nobody meant is noticed, whatever it lies in.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import roomfit
from _executed import NUMERICAL
from _golden_cases import CASES, Case
from _golden_digests import (
    OF_ANY_MACHINE,
    RENAMED,
    Content,
    FieldDifference,
    FileDifference,
    difference,
    digests_of,
    field_differences,
    numbers_of,
    read_content,
    renamed,
)
from _silent import moved, returned, sums

# The command line of whichever roomfit this Python imports.
ROOMFIT = (sys.executable, "-m", "roomfit")
FORMAT = "roomfit-golden"
REFERENCE = Path(__file__).resolve().parents[1] / "tests" / "reference"
# The cases of seconds; `demo` and `paper` take a minute and more.
OF_SECONDS = tuple(case for case in CASES if case.name not in ("demo", "paper"))


def run_cases(out: Path, names: Sequence[str], threads: int, *, fresh_kernels: bool) -> None:
    """Run cases one after the other, print the seconds of each, and write their digests."""
    chosen = [case for case in CASES if not names or case.name in names]
    environment = {
        **os.environ,
        "NUMBA_NUM_THREADS": str(threads),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MPLBACKEND": "Agg",
        "COLUMNS": "200",
        # the commands run elsewhere, where a relative path would not be found
        "PYTHONPATH": str(Path(roomfit.__file__).parents[1]),
    }
    if (out / "digests.json").exists():
        for name in ("work", "contents"):
            shutil.rmtree(out / name, ignore_errors=True)
        (out / "digests.json").unlink()
    elif out.exists() and any(out.iterdir()):
        raise SystemExit(f"{out} is not empty and holds no earlier run: choose another folder")
    print(f"{roomfit.__file__}, {threads} threads")
    folders: dict[str, Path] = {}
    with tempfile.TemporaryDirectory() as kernels:
        if fresh_kernels:
            environment["NUMBA_CACHE_DIR"] = kernels
        for case in chosen:
            started, busy = time.perf_counter(), _processor_s()
            folders[case.name] = _run_case(case, out, environment)
            took = f"{time.perf_counter() - started:6.1f} s, {_processor_s() - busy:6.1f} CPU s"
            print(f"{took}  {case.name}: {case.about}", flush=True)
            freeze(folders, out)  # again after each case, so that a run that is stopped counts


def _processor_s() -> float:
    """Return the processor time of this process and of its children that ended."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _run_case(case: Case, out: Path, environment: Mapping[str, str]) -> Path:
    """Run a case in a folder of its own and return the folder."""
    folder = (out / "work" / case.name).resolve()
    folder.mkdir(parents=True)
    said: list[str] = []

    def command(*arguments: object) -> None:
        # within the folder and by relative paths, so that no output names a place of this machine
        asked = [str(a.relative_to(folder)) if isinstance(a, Path) else str(a) for a in arguments]
        done = subprocess.run(
            [*ROOMFIT, *asked],
            capture_output=True,
            text=True,
            env=environment,
            cwd=folder,
            check=False,
        )
        if done.returncode != 0:
            raise SystemExit(
                f"case {case.name}: roomfit {' '.join(asked)} ended with {done.returncode}\n"
                f"{done.stdout}{done.stderr}"
            )
        said.append(done.stdout)
        (folder / f"printed-{len(said)}.txt").write_text(done.stdout)

    case.run(folder, command)
    return folder


def answers(case: Case, folder: Path) -> dict[str, Any]:
    """Run a case within this process and return the numbers of its JSON files, and silent ones.

    Parameters
    ----------
    case : Case
    folder : Path
        An empty folder.

    Returns
    -------
    mapping of file to JSON value
        Nine digits of every number, with the findings. As "functions", what `_silent.sums` makes
        of what functions returned.
    """
    from roomfit.base.kernels import at_most_threads
    from roomfit.cli import main as command_line

    def command(*arguments: object) -> None:
        asked = [str(a.relative_to(folder)) if isinstance(a, Path) else str(a) for a in arguments]
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            try:
                command_line(asked)
            except SystemExit as end:
                if end.code:
                    raise RuntimeError(f"roomfit {' '.join(asked)} ended with {end.code}") from end

    # in one thread and process, so that the last call of a function is always the same
    with contextlib.chdir(folder), at_most_threads(1), returned(NUMERICAL) as last:
        case.run(folder, command)
        files = [p for p in _files(folder) if p.suffix == ".json"]
        contents = {p.relative_to(folder).as_posix(): read_content(p) for p in files}
    found = {n: _rounded(numbers_of(c, whole_findings=True)) for n, c in contents.items()}
    return {**found, "functions": sums(last)}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def changed(case: Case, found: Mapping[str, Any]) -> dict[str, FieldDifference]:
    """Return in which fields the answers of a case differ from those that are kept."""
    path = REFERENCE / f"{case.name}.json"
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    silent = moved(kept.get("functions", {}), found["functions"])
    return {f"{n}()": FieldDifference(changed=1, beyond=True) for n in silent} | {
        f"{file}: {name}": field
        for file in sorted({*kept, *found} - {"functions"})
        for name, field in field_differences(
            kept.get(file, {}), found.get(file, {}), tolerance=OF_ANY_MACHINE
        ).items()
    }


def _renew(names: Sequence[str]) -> None:
    """Print what has changed since the reference was written, and write it anew."""
    REFERENCE.mkdir(exist_ok=True)
    for case in (c for c in OF_SECONDS if not names or c.name in names):
        with tempfile.TemporaryDirectory() as name:
            found = answers(case, Path(name).resolve())
        fields = changed(case, found)
        print(f"{case.name}: {len(fields)} fields differ")
        _print_fields(fields)
        path = REFERENCE / f"{case.name}.json"
        aside = path.with_suffix(".new")
        # a line for each function
        silent = found.pop("functions")
        lines = [f"{json.dumps(n)}: {json.dumps(own)}" for n, own in silent.items()]
        rest = json.dumps(found, indent=0).removesuffix("\n}")
        text = f'{rest},\n"functions": {{\n' + ",\n".join(lines) + "\n}\n}\n"
        aside.write_text(text, encoding="utf-8")
        aside.replace(path)


def _print_fields(fields: Mapping[str, FieldDifference]) -> None:
    for name, f in sorted(fields.items()):
        most = f"largest difference {f.largest:.3g}" if f.largest else ""
        changed = f"{f.changed} values changed, added or gone" if f.changed else ""
        verdict = "beyond tolerance" if f.beyond else "within tolerance"
        print(f"    {name}: {', '.join(filter(None, (most, changed, verdict)))}")


def freeze(folders: Mapping[str, Path], out: Path) -> None:
    """Write the canonical contents and the digests of the files of every case's folder."""
    digests: dict[str, Any] = {}
    for case, folder in folders.items():
        digests[case] = {}
        for path in _files(folder):
            name = path.relative_to(folder).as_posix()
            content = read_content(path)
            digests[case][name] = digests_of(content)
            _keep(out / "contents" / case / f"{name}.json", content)
    out.mkdir(parents=True, exist_ok=True)
    frozen = {"format": FORMAT, "format_version": 1, "cases": digests}
    (out / "digests.json").write_text(json.dumps(frozen, indent=1) + "\n")


def _files(folder: Path) -> list[Path]:
    """Return the files of a folder; hidden ones (the cache of traces) are not results."""
    every = sorted(p for p in folder.rglob("*") if p.is_file())
    return [p for p in every if not any(q.startswith(".") for q in p.relative_to(folder).parts)]


def _keep(path: Path, content: Content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    value = {"kind": content.kind, "value": content.value}
    path.write_text(json.dumps(value, indent=1, sort_keys=True) + "\n")


def _kept(out: Path, case: str) -> dict[str, Content]:
    """Return the canonical contents of a case by file name, under new names."""
    folder = out / "contents" / case
    found = {}
    for path in _files(folder):
        parts = path.relative_to(folder).as_posix().removesuffix(".json").split("/")
        name = "/".join(_renamed_file(part) for part in parts)
        value = json.loads(path.read_text())
        found[name] = Content(value["kind"], renamed(value["value"], RENAMED))
    return found


def _renamed_file(name: str) -> str:
    stem, dot, ending = name.partition(".")
    return RENAMED.get(stem, stem) + dot + ending


def compare_runs(
    first: Path, second: Path, names: Sequence[str] = ()
) -> tuple[list[FileDifference], list[str]]:
    """Return the files that differ between two runs, and the cases that only one of them has.

    Only the cases of the given names are looked at; all of them if none is given.
    """
    cases = [[c for c in _cases(run) if not names or c in names] for run in (first, second)]
    if not any(cases):
        raise SystemExit(f"neither {first} nor {second} holds any case that is asked for")
    differences = []
    for case in (c for c in cases[0] if c in cases[1]):
        mine, yours = _kept(first, case), _kept(second, case)
        for file in sorted({*mine, *yours}):
            if file in mine and file in yours:
                found = difference(case, file, mine[file], yours[file])
                differences += [found] if found else []
            else:
                missing = "second" if file in mine else "first"
                differences.append(FileDifference(case, file, True, True, missing))
    return differences, [c for c in (*cases[0], *cases[1]) if not all(c in k for k in cases)]


def _cases(out: Path) -> list[str]:
    try:
        content = json.loads((out / "digests.json").read_text())
    except OSError as error:
        raise SystemExit(f"{out} holds no finished run: {error}") from error
    return list(content["cases"])


def print_differences(
    differences: list[FileDifference], lone_cases: list[str], *, tolerance: bool
) -> int:
    """Print what differs and return the exit code: 1 where numbers do, or a case is missing."""
    for case in lone_cases:
        print(f"{case}: in one of the two runs only")
    for d in differences:
        if d.missing:
            print(f"{d.case}/{d.file}: not in the {d.missing} run")
            continue
        print(f"{d.case}/{d.file}: {'NUMBERS' if d.numbers else 'whole only, numbers agree'}")
        _print_fields(d.fields)
    wrong = [d for d in differences if (d.beyond if tolerance else d.numbers)]
    words = sum(not d.numbers for d in differences)
    kind = "numbers beyond tolerance" if tolerance else "other numbers"
    print(f"{len(wrong)} files with {kind}, {words} that differ in words, pictures or counts only")
    return 1 if wrong or lone_cases else 0


def main() -> int:
    """Read the arguments, run or compare, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    run = verbs.add_parser("run", help="run the cases and freeze their answers")
    run.add_argument("--out", type=Path, required=True, help="folder; an earlier run is replaced")
    run.add_argument("--threads", type=int, default=1, help="NUMBA_NUM_THREADS of every case")
    run.add_argument("--cases", nargs="+", default=(), choices=[c.name for c in CASES])
    run.add_argument(
        "--fresh-kernels",
        action="store_true",
        help="compile every kernel anew: numba's cache on disk does not see changed callees",
    )
    two = verbs.add_parser("compare", help="exit 1 where the numbers of two runs differ")
    two.add_argument("first", type=Path)
    two.add_argument("second", type=Path)
    two.add_argument("--cases", nargs="+", default=(), choices=[c.name for c in CASES])
    two.add_argument(
        "--tolerance",
        action="store_true",
        help="allow 1e-9 of absorption, 1e-3 of an interval's width at its bounds, and 1e-3 of "
        "the largest number of any other field",
    )
    anew = verbs.add_parser(
        "reference", help="print what changed in tests/reference; write it anew"
    )
    anew.add_argument("cases", nargs="*", metavar="NAME", help="cases; left out: all")
    verbs.add_parser("list", help="name the cases")
    asked = parser.parse_args()
    if asked.verb == "run":
        run_cases(asked.out, asked.cases, asked.threads, fresh_kernels=asked.fresh_kernels)
        return 0
    if asked.verb == "compare":
        return print_differences(
            *compare_runs(asked.first, asked.second, asked.cases), tolerance=asked.tolerance
        )
    if asked.verb == "reference":
        _renew(asked.cases)
        return 0
    for case in CASES:
        print(f"{case.name:<12} {case.about}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
