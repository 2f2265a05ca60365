"""What files have in common: text, findings, provenance, unknown numbers."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roomfit.base.door import files_read, json_content, read_bytes, read_text
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Edit, Finding, Remedy, code_of
from roomfit.base.whole_files import CONTENT_DIGEST, content_digest


class EditedFile(NamedTuple):
    """A file that was changed since roomfit wrote it, and is to be read as it is."""

    path: Path


ResultFile = Path | EditedFile


def path_of(file: ResultFile) -> Path:
    """Return where a file lies."""
    return file.path if isinstance(file, EditedFile) else Path(file)


def written_content(file: ResultFile, what: str) -> tuple[Any, tuple[Finding, ...]]:
    """Return what a JSON file of roomfit holds, and whether its digest vouches for it.

    A file without digest, by hand or of an earlier version, is read and named in a finding.
    """
    path = path_of(file)
    text = read_text(path, what)
    with located(str(path)):
        content = json_content(text, what)
    if not isinstance(content, dict):
        return content, ()
    needed = content.get(CONTENT_DIGEST)
    try:
        found = content_digest(content)
    except RecursionError:
        found = "nested too deep"
    return content, digest_findings(file, what, found, needed)


def digest_findings(file: ResultFile, what: str, found: str, needed: object) -> tuple[Finding, ...]:
    """Return what a digest says of a file; `needed` is None where nothing states it."""
    path = path_of(file)
    if found == needed:
        return ()
    if needed is not None and not isinstance(file, EditedFile):
        raise InputError(
            f"the {what} was changed after roomfit wrote it",
            where=str(path),
            found=f"content with the SHA-256 {found}",
            needed=str(needed),
            hint="copy or make it again, or add --edited to read it as it is",
        )
    code = Code.RESULT_WITHOUT_DIGEST if needed is None else Code.RESULT_EDITED
    text = (
        f"The {what} {path.name} bears no digest, so that nobody can tell whether it is as written."
        if needed is None
        else f"The {what} {path.name} was edited after roomfit wrote it; it was read as it is."
    )
    return (Finding(code, About(), text, {"found": found, "needed": needed}),)


def numbers_or_null(values: ArrayLike) -> Any:
    """Return numbers as nested lists, or one number; None where it is unknown (not finite)."""
    own = np.asarray(values, dtype=np.float64)
    found = own.astype(object)
    found[~np.isfinite(own)] = None
    return found.tolist() if own.ndim else found[()]


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
        **({"remedies": [asdict(one) for one in finding.remedies]} if finding.remedies else {}),
    }


def finding_of(content: Mapping[str, Any], where: str) -> Finding:
    """Return the finding that `finding_content` wrote; `about` is empty in older files."""
    code, severity = code_of(content.get("code"), where), content.get("severity")
    graded = None if len(code.severities) < 2 else severity
    about = About(**content.get("about", {}))
    remedies = [
        Remedy(
            [Edit(**{**edit, "table": tuple(edit["table"])}) for edit in one["edits"]],
            one["words"],
            one["once"],
        )
        for one in content.get("remedies", ())
    ]
    evidence = content.get("evidence", {})
    return Finding(code, about, content["sentence"], evidence, graded, remedies=remedies)


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

    As it was read, within `roomfit.base.door.reading_noted`; else of what lies there now.
    """
    folder = inputs[0].parent if inputs else Path()
    noted, digests = files_read(), {}
    for path in inputs:
        name = path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)
        content = noted.get(path) or hashlib.sha256(read_bytes(path, "input file")).hexdigest()
        # names of files need not be UTF-8
        digests[name.encode(errors="replace").decode()] = content
    return digests
