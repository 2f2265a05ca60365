"""What files have in common: text, findings, provenance, unknown numbers."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.findings import About, Finding, code_of
from roomfit.io.door import files_read, read_bytes
from roomfit.typing import FloatArray


def numbers_or_null(values: FloatArray) -> list[float | None]:
    """Return an array as a list, None for what is unknown."""
    return [number_or_null(v) for v in values]


def number_or_null(value: float) -> float | None:
    """Return a number, None where it is unknown (not finite)."""
    return float(value) if np.isfinite(value) else None


def one_line(text: str) -> str:
    """Return a text without line ends and letters that steer: what may stand in a comment."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def finding_content(finding: Finding) -> dict[str, Any]:
    """Return a finding as a JSON object."""
    return {
        "code": finding.code.value,
        "severity": finding.severity,
        "sentence": finding.sentence,
        "about": {name: _plain(value) for name, value in asdict(finding.about).items() if value},
        "evidence": _plain(finding.evidence),
    }


def finding_of(content: Mapping[str, Any], where: str) -> Finding:
    """Return the finding that `finding_content` wrote; `about` is empty in older files.

    Raises
    ------
    InputError
        The code is unknown, or not of this severity.
    """
    code, severity = code_of(content.get("code"), where), content.get("severity")
    graded = None if len(code.severities) < 2 else severity
    about = About(**content.get("about", {}))
    return Finding(code, about, content["sentence"], content.get("evidence", {}), graded)


def _plain(value: Any) -> Any:
    """Return evidence as JSON values; numbers that are not finite become text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | int | str) or (isinstance(value, float) and np.isfinite(value)):
        return value
    return str(value)


def provenance(inputs: Iterable[Path]) -> dict[str, Any]:
    """Return the version of roomfit and the digests of the input files; see `input_digests`."""
    return {"roomfit": version("roomfit"), "inputs_sha256": input_digests(tuple(inputs))}


def input_digests(inputs: tuple[Path, ...]) -> dict[str, str]:
    """Return the SHA-256 of every file, named relative to the folder of the first.

    As it was read, within `roomfit.io.door.reading_noted`; else of what lies there now.
    """
    folder = inputs[0].parent if inputs else Path()
    noted, digests = files_read(), {}
    for path in inputs:
        name = path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)
        content = noted.get(path) or hashlib.sha256(read_bytes(path, "input file")).hexdigest()
        # names of files need not be UTF-8
        digests[name.encode(errors="replace").decode()] = content
    return digests
