"""Canonical contents of output files, their digests, and what two runs differ in.

Canonical is what stays the same when the same program runs again: no seconds, versions, paths of
the machine or provenance. "Whole" is all of that; "numbers" leaves out what people read (sentences,
names of findings) and what is counted on the way to an answer.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import soundfile
from PIL import Image

# In neither digest: they change from run to run, or from release to release.
TIMES = frozenset(
    {
        "seconds",
        "median_seconds",
        "provenance",
        "roomfit",
        "digest",
        "content_sha256",
        "files_sha256",
    }
)
# In "whole" and not in "numbers": how often a function was evaluated on the way to the answer.
COUNTS = frozenset({"evaluations", "median_evaluations"})
# Old name -> new name of keys, one-word values and file names, applied when two runs are compared.
RENAMED: Mapping[str, str] = MappingProxyType({})

# absorption.csv has five decimals: a difference far below that may turn over the last one.
CSV_STEP = 1e-5

_FINDING = frozenset({"code", "severity", "sentence"})
# How long a run took, as printed; its version, time and inputs' digests, as in report.html.
_SECONDS = re.compile(
    r"\d+(?:\.\d+)? s(?= for the identification)|(?<=; )\d+(?:\.\d+)? s$", re.MULTILINE
)
_PROVENANCE = re.compile(r"(?<=<dt>)(roomfit|time)</dt>(\s*<dd>)[^<]*")
_SHA256 = re.compile(r"\b[0-9a-f]{64}\b")
_EMBEDDED_PNG = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=]+)")
_TEXT_ENDINGS = frozenset({".html", ".txt", ".svg", ".md", ".obj"})


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How much numbers may differ.

    Attributes
    ----------
    absorption, of_width : float
        Of absorption: a number, and beyond it a share of its interval's width.
    bound : float
        Of an interval's bounds, as a share of its width.
    other : float
        Of any other number, as a share of the largest of its field.
    """

    absorption: float
    of_width: float
    bound: float
    other: float


# What --tolerance allows.
OF_ONE_MACHINE = Tolerance(1e-9, 0.0, 1e-3, 1e-3)
# Other processors round otherwise, and a fit then ends a little elsewhere: one without vector
# instructions changed absorption by 7e-7 of a width at most, bounds by 6e-7, others by 4e-6.
OF_ANY_MACHINE = Tolerance(0.0, 3e-5, 1e-4, 1e-4)


@dataclass(frozen=True, slots=True)
class Content:
    """The canonical content of one file.

    Attributes
    ----------
    kind : str
        ``"json"``, ``"csv"``, ``"toml"``, ``"text"`` or ``"bytes"``.
    value : JSON value
        For CSV a list of rows, each a mapping of column to cell; for text the lines; for bytes
        a mapping with the digest of what the file holds.
    """

    kind: str
    value: Any


@dataclass(slots=True)
class FieldDifference:
    """How much one field of a file differs: indices of lists, rows of tables are pooled.

    Attributes
    ----------
    largest : float
        Of the absolute differences of numbers.
    changed : int
        Values that are no numbers, or stand in one of the two files only.
    beyond : bool
        Whether a number is outside what --tolerance allows, or anything else changed.
    """

    largest: float = 0.0
    changed: int = 0
    beyond: bool = False


@dataclass(frozen=True, slots=True)
class FileDifference:
    """One file that differs between two runs."""

    case: str
    file: str
    whole: bool
    numbers: bool
    missing: str = ""  # "first" or "second" where only the other run has the file
    fields: Mapping[str, FieldDifference] = field(default_factory=dict)

    @property
    def beyond(self) -> bool:
        """Whether the numbers differ by more than --tolerance allows."""
        return self.numbers and (bool(self.missing) or any(f.beyond for f in self.fields.values()))


def read_content(path: Path) -> Content:
    """Return the canonical content of a file."""
    ending = path.suffix.lower()
    if ending == ".png":
        return Content("bytes", _pixels(path.read_bytes()))
    if ending == ".wav":
        samples, rate_hz = soundfile.read(path, dtype="float32", always_2d=True)
        return Content("bytes", {"rate_hz": rate_hz, "samples": _of_array(samples)})
    if ending == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: _of_array(archive[name]) for name in sorted(archive.files)}
        return Content("bytes", arrays)
    if ending not in {".json", ".csv", ".toml", *_TEXT_ENDINGS}:
        return Content("bytes", {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()})
    text = path.read_text(encoding="utf-8")
    if ending == ".json":
        return Content("json", without_times(json.loads(text)))
    if ending == ".csv":
        return Content("csv", without_times(list(csv.DictReader(io.StringIO(text)))))
    if ending == ".toml":
        return Content("toml", tomllib.loads(text))
    return Content("text", canonical_text(text).splitlines())


def without_times(value: Any) -> Any:
    """Return a JSON value without `TIMES`, at any depth."""
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key not in TIMES}
    if isinstance(value, list):
        return [without_times(item) for item in value]
    return value


def canonical_text(text: str) -> str:
    """Return text without seconds and versions, and its pictures by their pixels."""

    def of_picture(match: re.Match[str]) -> str:
        return f"<png {_pixels(base64.b64decode(match[1]))['sha256']}>"

    text = _PROVENANCE.sub(r"\1</dt>\2", text)
    text = _SECONDS.sub("<time>", _SHA256.sub("<sha256>", text))
    return _EMBEDDED_PNG.sub(of_picture, text)


def _pixels(png: bytes) -> dict[str, Any]:
    """Return what a picture shows: metadata, such as a program's version, are left out."""
    with Image.open(io.BytesIO(png)) as picture:
        return _of_array(np.asarray(picture.convert("RGBA")))


def _of_array(array: np.ndarray[Any, Any]) -> dict[str, Any]:
    content = np.ascontiguousarray(array)
    return {
        "shape": list(array.shape),
        "dtype": array.dtype.str,
        "sha256": hashlib.sha256(content.tobytes()).hexdigest(),
    }


def numbers_of(content: Content, *, whole_findings: bool = False) -> Any:
    """Return what is left without prose, findings' words and counts; None where nothing is.

    Findings are left as how many there are of each severity, or with their names and numbers. Text
    of one word stays: it says how a search ended, or which model was chosen.
    """
    if content.kind == "csv":
        return [
            {name: _cell(cell) for name, cell in row.items() if name not in COUNTS}
            for row in content.value
        ]
    if content.kind in {"json", "toml"}:
        return _numbers(content.value, whole_findings)
    return None


def _numbers(value: Any, whole_findings: bool) -> Any:
    if isinstance(value, dict):
        kept = {key: item for key, item in value.items() if key not in COUNTS}
        return {
            key: _severities(item)
            if not whole_findings and _are_findings(key, item)
            else _numbers(item, whole_findings)
            for key, item in kept.items()
            if not _is_prose(item)
        }
    if isinstance(value, list):
        return [_numbers(item, whole_findings) for item in value if not _is_prose(item)]
    return value


def _is_prose(value: Any) -> bool:
    return isinstance(value, str) and len(value.split()) != 1


def _are_findings(key: str, value: Any) -> bool:
    if not isinstance(value, list):
        return False
    alike = all(isinstance(item, dict) and set(item) >= _FINDING for item in value)
    return alike and (bool(value) or key == "findings")


def _severities(findings: list[dict[str, Any]]) -> dict[str, int]:
    return dict(sorted(Counter(str(f["severity"]) for f in findings).items()))


def _cell(text: str | None) -> float | str | None:
    try:
        return text if text is None else float(text)
    except ValueError:
        return text


def digest_of(value: Any) -> str | None:
    """Return the SHA-256 of a JSON value, numbers at full precision and keys in order of names."""
    if value is None:
        return None
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def digests_of(content: Content) -> dict[str, str | None]:
    """Return both digests of a file; "numbers" is None for a file without any."""
    return {"whole": digest_of(content.value), "numbers": digest_of(numbers_of(content))}


def renamed(value: Any, names: Mapping[str, str]) -> Any:
    """Return a JSON value with keys and one-word values under their new names."""
    if isinstance(value, dict):
        return {names.get(key, key): renamed(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [renamed(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


def difference(case: str, file: str, first: Content, second: Content) -> FileDifference | None:
    """Return what two contents differ in, or None where they are the same."""
    whole = first.value != second.value or first.kind != second.kind
    a, b = numbers_of(first), numbers_of(second)
    if not whole:
        return None
    if digest_of(a) == digest_of(b):
        return FileDifference(case, file, whole, numbers=False)
    step = CSV_STEP if first.kind == "csv" else 0.0
    return FileDifference(case, file, whole, True, fields=field_differences(a, b, step))


def field_differences(
    a: Any, b: Any, step: float = 0.0, tolerance: Tolerance = OF_ONE_MACHINE
) -> dict[str, FieldDifference]:
    """Return the differences of two JSON values by field, and which exceed the tolerance."""
    mine, yours = dict(_leaves(a)), dict(_leaves(b))
    largest: dict[str, float] = {}
    for path, value in mine.items():
        if _is_number(value):
            name = _field(path)
            largest[name] = max(largest.get(name, 0.0), abs(value))
    found: dict[str, FieldDifference] = {}
    for path in (*mine, *(p for p in yours if p not in mine)):
        old, new = mine.get(path, _FINDING), yours.get(path, _FINDING)
        if _is_number(old) and _is_number(new):
            if old == new:
                continue
            this = found.setdefault(_field(path), FieldDifference())
            off = abs(new - old)
            this.largest = max(this.largest, off)
            allowed = _allowed(path, mine, step, largest[_field(path)], tolerance)
            this.beyond = this.beyond or not off <= allowed
        elif old is _FINDING or type(old) is not type(new) or old != new:
            this = found.setdefault(_field(path), FieldDifference())
            this.changed += 1
            this.beyond = True
    return found


_Path = tuple[str | int, ...]


def _leaves(value: Any, path: _Path = ()) -> Iterator[tuple[_Path, Any]]:
    """Yield every value that is no container with its path; an empty container counts as one."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from _leaves(item, (*path, key))
    elif isinstance(value, list) and value:
        for number, item in enumerate(value):
            yield from _leaves(item, (*path, number))
    else:
        yield path, json.dumps(value) if isinstance(value, dict | list) else value


def _field(path: _Path) -> str:
    return ".".join("[]" if isinstance(key, int) else key for key in path).replace(".[]", "[]")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _allowed(
    path: _Path, mine: Mapping[_Path, Any], step: float, largest: float, tolerance: Tolerance
) -> float:
    """Return how much the number at a path may differ.

    Absorption and its bounds are known by their three names side by side.
    """
    place = next((i for i in range(len(path) - 1, -1, -1) if isinstance(path[i], str)), None)
    if place is not None:

        def beside(name: str) -> Any:
            return mine.get((*path[:place], name, *path[place + 1 :]))

        value, low, high = beside("absorption"), beside("lower95"), beside("upper95")
        if all(_is_number(v) for v in (value, low, high)):
            if path[place] == "absorption":
                return tolerance.absorption + tolerance.of_width * float(high - low) + step
            if path[place] in {"lower95", "upper95"}:
                return tolerance.bound * float(high - low) + step
    return tolerance.other * largest
