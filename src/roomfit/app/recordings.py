"""Recordings of a project by their names, and positions by the tables in its folder.

Sources and receivers come from names of files as `roomfit init` reads them, by the same functions,
and are written into the campaign, blanks where no position is known yet.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from roomfit.app import project
from roomfit.base.errors import InputError
from roomfit.files.campaign import FILL_IN, blanks
from roomfit.files.draft import matching_files, read_positions
from roomfit.files.edits import Edit, edited_text, rewrite, without_tables

_KINDS = {"sources": "source", "receivers": "receiver"}
_NAMES_ALONE = {"source", "receiver", "file"}
Positions = Mapping[str, Sequence[float]]


def table_positions(folder: Path) -> dict[str, tuple[float, float, float]]:
    """Return positions in m by name of all tables in the project, of the newest that has a name."""
    below = folder / project.POSITIONS
    if not below.is_dir():
        return {}
    project.inside(folder, below)
    files = [file for file in below.iterdir() if not file.name.startswith(".")]
    found: dict[str, tuple[float, float, float]] = {}
    for file in sorted(files, key=lambda file: file.stat().st_mtime_ns):
        found |= read_positions(project.inside(folder, file))
    return found


def named_recordings(folder: Path, known: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return source and receiver by file of all recordings of a project.

    By the tables of its campaign, blanks or not, by the template that this states, or else by names
    in the folder of recordings; `known` are further names of sources and receivers.
    """
    content = _content(folder)
    rows = {
        file_name(folder, Path(row["file"])): (str(row["source"]), str(row["receiver"]))
        for row in content.get("measurements", [])
        if row.keys() >= _NAMES_ALONE and not blanks(row)
    }
    placed = [name for kind in _KINDS for name in _placed(content, kind)]
    found = _by_name(folder, templates(content), [*placed, *known])
    return rows | {file: pair for file, pair in found.items() if file not in rows}


def name_recordings(folder: Path, positions: Positions, moved: Positions | None = None) -> None:
    """Write sources, receivers and measurements into the campaign, as far as files say.

    What has a position keeps it, unless it is `moved`. A measurement whose table says nothing but
    names is named anew while the position of its source or of its receiver is not known, and where
    a template names it.
    """
    if project.has_campaign(folder):
        change = partial(_renamed, folder, {**positions, **(moved or {})}, moved or {})
        rewrite(project.campaign_file(folder), change)


def _renamed(folder: Path, positions: Positions, moved: Positions, before: str) -> str:
    """Return the text of a campaign with its recordings named."""
    content = _content(folder)
    placed = {kind: _placed(content, kind) for kind in _KINDS}
    known = [*placed["sources"], *placed["receivers"], *positions]
    found = _by_name(folder, templates(content), known)
    rows = content.get("measurements", [])
    by_template = found if templates(content) else {}
    loose = [i for i, row in enumerate(rows) if _is_loose(row, placed, by_template)]
    kept = [row for i, row in enumerate(rows) if i not in loose]
    used = {row.get("file") for row in kept}
    new = {file: pair for file, pair in found.items() if file not in used}
    needed = {
        "sources": [*(r.get("source") for r in kept), *(s for s, _ in new.values())],
        "receivers": [*(r.get("receiver") for r in kept), *(r for _, r in new.values())],
    }
    text, edits = _without(before, loose, needed), []
    points = tomllib.loads(text)
    for kind, names in needed.items():
        own = points.get(kind, {})
        for name in dict.fromkeys([*filter(None, names), *own]):
            is_free = name not in placed[kind] or name in moved
            if name in positions and is_free:
                edits.append(Edit((kind, name), "position", tuple(positions[name])))
            elif name not in own:
                edits.append(Edit((kind, name), "position", FILL_IN))
    if not by_template:
        for number, (file, (source, receiver)) in enumerate(new.items(), start=len(kept) + 1):
            own = {"source": source, "receiver": receiver, "file": file}
            edits += [Edit(("measurements", number), key, value) for key, value in own.items()]
    return edited_text(text, edits)


def set_template(folder: Path, template: str, positions: Positions) -> None:
    """Say how recordings are named, as in ``recordings/{source}-{receiver}.wav``; "": by names."""
    if template:
        if Path(template).is_absolute() or ".." in Path(template).parts:
            what = "recordings lie in the project's folder"
            needed = "a path without .. below the project"
            hint = "write recordings/{source}-{receiver}.wav"
            raise InputError(what, found=repr(template), needed=needed, hint=hint)
        matching_files(folder, template)
    if project.has_campaign(folder):
        project.edit(folder, Edit((), "recordings", template or None))
        name_recordings(folder, positions)


def templates(content: Mapping[str, Any]) -> list[str]:
    """Return the templates that a campaign states: none, one or several."""
    stated = content.get("recordings") or []
    return [stated] if isinstance(stated, str) else list(stated)


def file_name(folder: Path, file: Path) -> str:
    """Return a file that a campaign names, relative to the project where it lies in it."""
    path = folder / file
    return path.relative_to(folder).as_posix() if folder in path.parents else str(path)


def unused_recordings(folder: Path, named: Mapping[str, object]) -> list[str]:
    """Return the recordings that were sent and have no name that fits."""
    below = folder / project.RECORDINGS
    files = sorted(below.iterdir()) if below.is_dir() else []
    names = [f"{project.RECORDINGS}/{file.name}" for file in files if file.name[0] != "."]
    return [name for name in names if name not in named]


def _content(folder: Path) -> dict[str, Any]:
    return project.campaign_content(folder) if project.has_campaign(folder) else {}


def _placed(content: Mapping[str, Any], kind: str) -> list[str]:
    return [name for name, point in content.get(kind, {}).items() if not blanks(point)]


def _by_name(folder: Path, stated: list[str], known: list[str]) -> dict[str, tuple[str, str]]:
    """Return source and receiver by file: of the templates, or else of the folder of recordings."""
    found: dict[str, tuple[str, str]] = {}
    with suppress(InputError):  # no file has a name of this shape, which findings say
        for template in stated:
            found |= matching_files(folder, template, known)
        if not stated:
            own = matching_files(folder / project.RECORDINGS, None, known)
            found = {f"{project.RECORDINGS}/{name}": pair for name, pair in own.items()}
    return found


def _is_loose(
    row: Mapping[str, Any], placed: Mapping[str, list[str]], by_template: Mapping[str, object]
) -> bool:
    """Whether a measurement says nothing but names, and these may still be others."""
    if set(row) != _NAMES_ALONE or not str(row["file"]).startswith(f"{project.RECORDINGS}/"):
        return False
    is_positioned = all(row[word] in placed[kind] for kind, word in _KINDS.items())
    return row["file"] in by_template or not is_positioned


def _without(text: str, loose: list[int], needed: Mapping[str, list[str]]) -> str:
    """Return a campaign without some measurements, and without blank points of theirs alone."""
    content = tomllib.loads(text)
    rows = [content["measurements"][i] for i in loose]
    points = [
        (kind, name)
        for kind, word in _KINDS.items()
        for name in {row.get(word) for row in rows} & content.get(kind, {}).keys()
        if name not in needed[kind] and blanks(content[kind][name])
    ]
    return without_tables(text, [*(("measurements", i + 1) for i in loose), *points])
