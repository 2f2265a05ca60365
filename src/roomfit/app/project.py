"""A project: a folder with campaign.toml, recordings and results, as the command line has it.

Everything that the workbench changes, it changes here, in the files. Comments of a campaign stay.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from roomfit.base.arguments import check_known, check_name
from roomfit.base.door import read_text
from roomfit.base.errors import InputError
from roomfit.base.findings import Edit
from roomfit.base.whole_files import write_text_atomically
from roomfit.cli.export import export_result
from roomfit.files.campaign import FILL_IN, Campaign, blanks, read_campaign, read_toml
from roomfit.files.draft import Positions, draft_campaign
from roomfit.files.edits import (
    edited_text,
    read_beside,
    rewrite,
    sole_editor,
    value_text,
    without_tables,
)
from roomfit.files.file_names import matching_files
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.files.responses.sweep import response_name
from roomfit.files.rooms import READERS
from roomfit.files.schema import RoomSpec
from roomfit.files.tables import TABLE_SUFFIXES
from roomfit.files.values import read_positions

CAMPAIGN = "campaign.toml"
QUICK, FULL = "first", "result"
"""Folders of the quick answer and of the full one, within the project."""
RESULTS = (f"{QUICK}/result.json", f"{FULL}/result.json")
TREATMENT_QUESTION, TREATMENT = "treatment.toml", "treatment"
"""Products and targets, and the folder of the answer."""
VARIANTS = "variants.txt"
"""Changes that belong to a variant, a line each, as those of ``roomfit predict --set``."""
LISTENED, CHECKED = "listened", "checked"
RECORDINGS, DRY = "recordings", "dry"
POSITIONS, DECAY_TIMES = "positions", "decay-times"
"""Folders of tables that were sent."""
MEAN, MEAN_FILES = "mean", ("reverberation.html", "reverberation.csv", "result.json")
"""The folder of what decay times alone say, and what it holds."""
_SHOWN = (QUICK, FULL, MEAN, TREATMENT, LISTENED, CHECKED, "exports")
_KINDS = {"sources": "source", "receivers": "receiver"}
_NAMES_ALONE = {"source", "receiver", "file"}
_LONGEST_NAME = 120
_KNOWN: Mapping[str, Collection[str]] = {
    "room": READERS,
    RECORDINGS: RESPONSE_SUFFIXES,
    DRY: RESPONSE_SUFFIXES,
    POSITIONS: TABLE_SUFFIXES,
    DECAY_TIMES: TABLE_SUFFIXES,
}  # endings of what may be sent, by its place
_EXPORTS = {
    "csv": "materials-csv.csv",
    "catt": "materials-catt.geo",
    "odeon": "materials-odeon.txt",
    "isimpa": "materials-isimpa.txt",
    "pyroomacoustics": "materials-pyroomacoustics.json",
    "excel": "materials-excel.xlsx",
    "pdf": "report.pdf",
    "word": "report.docx",
    "client-pdf": "client.pdf",
    "client-word": "client.docx",
}


def campaign_file(folder: Path) -> Path:
    """Return where the campaign of a project is, or will be."""
    return folder / CAMPAIGN


def campaign_content(folder: Path) -> dict[str, Any]:
    """Return the campaign file as plain content; nothing where there is none yet."""
    file = campaign_file(folder)
    return read_toml(file) if file.is_file() else {}


def has_campaign(folder: Path) -> bool:
    """Whether the folder is a project already."""
    return campaign_file(folder).is_file()


def check_campaign_there(folder: Path) -> None:
    """Refuse a folder without a campaign, of which nothing can be asked."""
    if not has_campaign(folder):
        what, found = "there is no room yet", "no campaign in the folder"
        needed, hint = "a room file or three lengths", "give them in the tab Room, then try again"
        raise InputError(what, found=found, needed=needed, hint=hint)


def best_result(folder: Path) -> Path | None:
    """Return the result.json of the full answer, else of the quick one, None without any."""
    files = [folder / name / "result.json" for name in (FULL, QUICK)]
    return next((file for file in files if file.is_file()), None)


def answer_file(folder: Path, *, or_decay_times: bool = False) -> Path:
    """Return the best result, or the table of decay times where that does as well."""
    found = best_result(folder) or (decay_times(folder) if or_decay_times else None)
    if found is None:
        what, needed = "there is no answer yet", "a first or a full answer"
        found_here = "no result" + (" and no table of decay times" if or_decay_times else "")
        hint = 'press "First answer only" under Identify'
        raise InputError(what, found=found_here, needed=needed, hint=hint)
    return found


# What the tabs change.


def edit(
    folder: Path,
    *edits: Edit,
    of: Callable[[dict[str, Any]], Iterable[Edit]] = lambda _: (),
) -> None:
    """Change keys of the campaign file; where none is another, it keeps its time.

    `of`: returns further edits of what the file says, as plain content.
    """
    rewrite(
        campaign_file(folder),
        lambda text: edited_text(text, (*edits, *of(campaign_content(folder)))),
    )


def differences(
    now: Mapping[str, Any], then: Mapping[str, Any], *above: str | int
) -> Iterator[Edit]:
    """Yield what makes one content of another, table by table; rows that are gone stay."""
    yield from (Edit(above, key, None) for key in now if key not in then)
    for key, value in then.items():
        old = now.get(key)
        if isinstance(value, Mapping) and (value or isinstance(old, Mapping)):
            yield from differences(old if isinstance(old, Mapping) else {}, value, *above, key)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for number, row in enumerate(value, start=1):
                was = old[number - 1] if isinstance(old, list) and number <= len(old) else {}
                yield from differences(was, row, *above, key, number)
        elif value != old:
            yield Edit(above, key, value)


def set_room(
    folder: Path,
    file: str | None = None,
    shoebox: Sequence[float] | None = None,
    unit: str | None = None,
    space: str | None = None,
) -> None:
    """Give a project its room, as `roomfit init` does; sources, receivers and recordings stay."""
    if shoebox is not None:
        spec = RoomSpec(shoebox=_three("the size of a box", shoebox), unit=unit)
    else:
        spec = RoomSpec(file=folder / (file or ""), unit=unit, space=space or None)
    drafted = draft_campaign(spec, {}, folder=folder)
    with sole_editor(campaign_file(folder)):
        if not has_campaign(folder):
            no = [Edit((), key, None) for key in ("sources", "receivers", "measurements")]
            text = re.sub(r"\n{3,}", "\n\n", edited_text(drafted, no))
            write_text_atomically(campaign_file(folder), text)
            return
    edit(folder, of=partial(_of_room, tomllib.loads(drafted)))


def _of_room(new: Mapping[str, Any], old: Mapping[str, Any]) -> list[Edit]:
    """Return what gives a campaign the room of another, and what belongs to it."""
    objects = old.get("objects", {})
    # what the campaign says of materials that the room does not have would be refused
    gone = [("materials", n) for n in old.get("materials", {}) if n not in new.get("materials", {})]
    gone += [("objects", n) for n, table in objects.items() if "outlines" in table]
    kept = {n for n in objects if ("objects", n) not in gone}
    stands = {n: table for n, table in new.get("objects", {}).items() if n not in kept}
    return [
        *differences(old.get("room", {}), new["room"], "room"),
        *[Edit((kind,), name, None) for kind, name in gone],
        *differences({}, stands, "objects"),
        Edit((), "states", None),
        *(_known_objects(stands) if _decay_times(old, alone=True) else ()),
    ]


def _three(what: str, typed: Sequence[Any], where: str = "") -> tuple[float, float, float]:
    """Return three lengths in m that somebody has typed."""
    if len(typed) != 3 or not all(isinstance(x, float | int) and abs(x) < 1e6 for x in typed):
        what, found = f"{what} is three numbers", str(list(typed))[:80]
        needed, hint = "x, y, z in m", "type them as 5.42 or 5,42"
        raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    x, y, z = (round(float(x), 4) for x in typed)
    return x, y, z


def set_surface_material(folder: Path, surface: str, material: str) -> None:
    """Say of which material a surface is."""
    check_name("material", material.strip())
    edit(folder, Edit(("room", "materials"), surface, material.strip()))


def forget_unused_materials(folder: Path, used: Sequence[str]) -> None:
    """Leave out what a campaign says of materials that its room does not have any more."""

    def gone(content: Mapping[str, Any]) -> list[Edit]:
        known = content.get("materials", {})
        return [Edit(("materials",), name, None) for name in known if name not in used]

    edit(folder, of=gone)


def set_prior(folder: Path, material: str, entry: str | None) -> None:
    """Say by the catalogue what a material is, as its prior; None: nothing is known."""
    edit(folder, Edit(("materials", material), "prior", entry or None))


def set_position(folder: Path, kind: str, name: str, position_m: Sequence[float] | None) -> None:
    """Say where a source or a receiver stands, in m; None takes it out."""
    check_known("only sources and receivers have positions", kind, _KINDS)
    check_name(kind[:-1], name.strip())
    if position_m is None:
        edit(folder, Edit((kind,), name, None))
        return
    place = _three("a position", position_m, f"{kind}.{name}")
    edit(folder, Edit((kind, name.strip()), "position", place))


def name_measured(folder: Path, source: str, receiver: str) -> None:
    """Write a measured response into the campaign, of which positions may still be blank.

    Devices delay each recording by another time: its clock is that of its direct sound, as its own
    table says (``unknown`` would be one delay for all files of a source).
    """
    file = f"{RECORDINGS}/{response_name(source, receiver)}"
    own = {"source": source, "receiver": receiver, "file": file, "time_zero": "direct"}

    def measured(content: Mapping[str, Any]) -> Iterator[Edit]:
        rows = content.get("measurements", [])
        for kind, name in zip(_KINDS, (source, receiver), strict=True):
            if name not in content.get(kind, {}):
                yield Edit((kind, name), "position", FILL_IN)
        if all(row.get("file") != file for row in rows):
            yield from differences({}, own, "measurements", len(rows) + 1)

    if has_campaign(folder):
        edit(folder, of=measured)


def set_bands(folder: Path, from_hz: float, to_hz: float) -> None:
    """Say which bands are fitted."""
    limits_hz = (("from_hz", float(from_hz)), ("to_hz", float(to_hz)))
    edit(folder, *[Edit(("identify",), key, value) for key, value in limits_hz])


def bands(folder: Path) -> tuple[float, float]:
    """Return the lowest and the highest band that is fitted, by the campaign or by default."""
    own = campaign_content(folder).get("identify", {})
    return float(own.get("from_hz", 125.0)), float(own.get("to_hz", 4000.0))


def variants(folder: Path) -> list[str]:
    """Return the changes of all variants that are kept."""
    file = folder / VARIANTS
    return read_text(file, "variants", most="campaign_bytes").splitlines() if file.is_file() else []


def keep_variant(folder: Path, name: str, changes: Sequence[str]) -> None:
    """Keep changes under a name in place of those that it had; no changes: forget it."""
    if not name.strip() or "|" in name:
        needed, hint = "a name without |", "type one, as curtain open"
        raise InputError("a variant needs a name", found=repr(name), needed=needed, hint=hint)
    others = [x for x in variants(folder) if x.rpartition("|")[0].strip() != name.strip()]
    lines = [*others, *(f"{' '.join(name.split())} | {change}" for change in changes)]
    write_text_atomically(folder / VARIANTS, "".join(f"{line}\n" for line in lines))


def decay_times(folder: Path, *, alone: bool = False) -> Path | None:
    """Return the table of decay times; None without one, or, `alone`, beside recordings."""
    own = _decay_times(campaign_content(folder), alone=alone)
    return None if own is None else folder / str(own.get("file", ""))


def _decay_times(content: Mapping[str, Any], *, alone: bool) -> Mapping[str, Any] | None:
    own = content.get("reverberation")
    is_beside = alone and {"measurements", "recordings"} & set(content)
    return own if isinstance(own, Mapping) and not is_beside else None


def set_decay_times(folder: Path, name: str) -> None:
    """Take a table that was sent as the decay times of the campaign."""
    check_campaign_there(folder)
    table = Edit(("reverberation",), "file", f"{DECAY_TIMES}/{name}")
    edit(folder, table, of=lambda content: _known_objects(content.get("objects", {})))


def _known_objects(objects: Mapping[str, Mapping[str, Any]]) -> Iterator[Edit]:
    """Yield what makes objects absorb as their entries say, which decay times cannot find out."""
    for name, table in objects.items():
        if isinstance(entry := table.get("prior"), str):
            yield Edit(("objects", name), "absorption_area_m2", entry)
            yield Edit(("objects", name), "prior", None)


@contextmanager
def filled_campaign(folder: Path) -> Iterator[Campaign]:
    """Read the campaign of a project as far as it is filled in.

    Sources, receivers and measurements with blanks are left out, for a room can be looked at
    before its positions are known.
    """
    content = campaign_content(folder)
    if not blanks(content):
        yield read_campaign(campaign_file(folder), to_fit=False)
        return
    for kind in _KINDS:
        points = content.get(kind, {})
        content[kind] = {n: t for n, t in points.items() if not blanks(t)}
    content["measurements"] = [
        m
        for m in content.get("measurements", [])
        if not blanks(m)
        and m.get("source") in content["sources"]
        and m.get("receiver") in content["receivers"]
    ]
    lines = [f"{value_text({key: value})[1:-1]}\n" for key, value in content.items()]
    with read_beside(folder, "".join(lines)) as campaign:
        yield campaign


# Recordings by their names, and positions by the tables in the folder. Names of files are read as
# `roomfit init` reads them, and written into the campaign, blanks where no position is known yet.


def table_positions(folder: Path) -> dict[str, tuple[float, float, float]]:
    """Return positions in m by name of all tables in the project, of the newest that has a name."""
    inside(folder, folder / POSITIONS)
    files = listed(folder, POSITIONS)
    found: dict[str, tuple[float, float, float]] = {}
    for file in sorted(files, key=lambda file: file.stat().st_mtime_ns):
        found |= read_positions(inside(folder, file))[0]
    return found


def named_recordings(folder: Path, known: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Return source and receiver by file of all recordings of a project.

    By the tables of its campaign, blanks or not, by the template that this states, or else by names
    in the folder of recordings; `known` are further names of sources and receivers.
    """
    content = campaign_content(folder)
    rows = {
        file_name(folder, Path(row["file"])): (str(row["source"]), str(row["receiver"]))
        for row in content.get("measurements", [])
        if row.keys() >= _NAMES_ALONE and not blanks(row)
    }
    return rows | _by_name(folder, content, known) | rows  # those of the campaign first


def name_recordings(folder: Path, positions: Positions, moved: Positions | None = None) -> None:
    """Write sources, receivers and measurements into the campaign, as far as files say.

    What has a position keeps it, unless it is `moved`. A measurement whose table says nothing but
    names is named anew while the position of its source or of its receiver is not known, and where
    a template names it.
    """
    if has_campaign(folder):
        change = partial(_renamed, folder, {**positions, **(moved or {})}, moved or {})
        rewrite(campaign_file(folder), change)


def _renamed(folder: Path, positions: Positions, moved: Positions, before: str) -> str:
    """Return the text of a campaign with its recordings named."""
    content = campaign_content(folder)
    found = _by_name(folder, content, positions)
    by_template = found if templates(content) else {}
    rows = content.get("measurements", [])
    loose = [i for i, row in enumerate(rows) if _is_loose(row, content, by_template)]
    kept = [row for i, row in enumerate(rows) if i not in loose]
    used = {row.get("file") for row in kept}
    named = [(*pair, file) for file, pair in found.items() if file not in used]
    new = [dict(zip(("source", "receiver", "file"), own, strict=True)) for own in named]
    needed = {
        k: [r[w] for r in (*kept, *new) if r.get(w, FILL_IN) != FILL_IN] for k, w in _KINDS.items()
    }
    # tables go, and with them blank points that nothing else needs
    gone: list[tuple[str | int, ...]] = [("measurements", i + 1) for i in loose]
    for kind, word in _KINDS.items():
        own = content.get(kind, {})
        names = {rows[i].get(word) for i in loose} & own.keys() - set(needed[kind])
        gone += [(kind, name) for name in names if blanks(own[name])]
    text, edits = without_tables(before, gone), []
    points = tomllib.loads(text)
    for kind, names_needed in needed.items():
        own = points.get(kind, {})
        for name in dict.fromkeys([*names_needed, *own]):
            if name in positions and (name in moved or blanks(own.get(name, FILL_IN))):
                edits.append(Edit((kind, name), "position", tuple(positions[name])))
            elif name not in own:
                edits.append(Edit((kind, name), "position", FILL_IN))
    for number, row in enumerate(() if by_template else new, start=len(kept) + 1):
        edits += differences({}, row, "measurements", number)
    return edited_text(text, edits)


def set_template(folder: Path, template: str, positions: Positions) -> None:
    """Say how recordings are named, as in ``recordings/{source}-{receiver}.wav``; "": by names."""
    if template:
        if Path(template).is_absolute() or ".." in Path(template).parts:
            what, needed = "recordings lie in the project's folder", "a path without .. below it"
            hint = "write recordings/{source}-{receiver}.wav"
            raise InputError(what, found=repr(template), needed=needed, hint=hint)
        matching_files(folder, template)
    if has_campaign(folder):
        edit(folder, Edit((), "recordings", template or None))
        name_recordings(folder, positions)


def templates(content: Mapping[str, Any]) -> list[str]:
    """Return the templates that a campaign states: none, one or several."""
    stated = content.get("recordings") or []
    return [stated] if isinstance(stated, str) else list(stated)


def file_name(folder: Path, file: Path) -> str:
    """Return a file that a campaign names, relative to the project where it lies in it."""
    path = folder / file
    return path.relative_to(folder).as_posix() if folder in path.parents else str(path)


def _has_place(content: Mapping[str, Any], kind: str, name: str) -> bool:
    return not blanks(content.get(kind, {}).get(name, FILL_IN))


def _by_name(
    folder: Path, content: Mapping[str, Any], others: Iterable[str]
) -> dict[str, tuple[str, str]]:
    """Return source and receiver by file: of the templates, or else of the folder of recordings."""
    names = [(kind, name) for kind in _KINDS for name in content.get(kind, {})]
    known = [*(n for kind, n in names if _has_place(content, kind, n)), *others]
    found: dict[str, tuple[str, str]] = {}
    stated = templates(content)
    with suppress(InputError):  # no file has a name of this shape, which findings say
        for template in stated:
            found |= matching_files(folder, template, known)
        if not stated:
            own = matching_files(folder / RECORDINGS, None, known)
            found = {f"{RECORDINGS}/{name}": pair for name, pair in own.items()}
    return found


def _is_loose(
    row: Mapping[str, Any], content: Mapping[str, Any], by_template: Mapping[str, object]
) -> bool:
    """Whether a measurement says nothing but names, and these may still be others."""
    if set(row) != _NAMES_ALONE or not str(row["file"]).startswith(f"{RECORDINGS}/"):
        return False
    is_positioned = all(_has_place(content, kind, row[word]) for kind, word in _KINDS.items())
    return row["file"] in by_template or not is_positioned


# Files that come and go.


def upload_place(folder: Path, kind: str, name: str) -> Path:
    """Return where a file that somebody sends may be put."""
    check_known("there is no such place for files", kind, _KNOWN)
    plain = name and len(name.encode()) <= _LONGEST_NAME and name.isprintable()
    if not plain or name.startswith(".") or any(c in name for c in '/\\:*?"<>|'):
        what, found = "this is no name of a file here", repr(name[:200])
        needed = f'at most {_LONGEST_NAME} bytes, no dot first, none of /\\:*?"<>|'
        raise InputError(what, found=found, needed=needed, hint="rename the file, as R1.wav")
    check_known("the format is not known", Path(name).suffix.lower(), _KNOWN[kind], where=name)
    parent = folder if kind == "room" else folder / kind
    place = parent / name
    inside(folder, parent)
    if place.is_symlink() or (place.exists() and not place.is_file()):
        what = "a link or a folder has this name"
        needed, hint = "a name that is free, or that of a file", "rename the file that is sent"
        raise InputError(what, where=str(place), found=repr(name), needed=needed, hint=hint)
    return place


def inside(folder: Path, path: Path) -> Path:
    """Return a path with links followed; refuse one that leads out of the project."""
    real, root = Path(os.path.realpath(path)), Path(os.path.realpath(folder))
    if real != root and root not in real.parents:
        what, found = "this leads out of the project", "a link, or .., to a place outside"
        needed, hint = "a file within the project", "copy what the link points to into the project"
        raise InputError(what, where=str(path), found=found, needed=needed, hint=hint)
    return real


def served_file(folder: Path, path: str) -> Path:
    """Return a file of a result or an export that may be shown or downloaded."""
    parts = Path(path).parts
    plain = path.isprintable() and not any(part.startswith(".") for part in parts)
    if plain and len(parts) > 1 and parts[0] in _SHOWN:
        real = inside(folder, folder / path)
        if real.is_file():
            return real
    what = "no file of this name is shown"
    needed = f"a file that is not hidden, in {', '.join(_SHOWN)}"
    hint = "reload the page: the file may have been written anew since"
    raise InputError(what, found=repr(path[:200]), needed=needed, hint=hint)


def listed(folder: Path, kind: str) -> list[Path]:
    """Return the files of a folder of the project that are not hidden, by name."""
    below = folder / kind
    files = below.iterdir() if below.is_dir() else ()
    return sorted(file for file in files if not file.name.startswith("."))


def export(folder: Path, wanted: str) -> str:
    """Write the best result's materials for another program; return the file, relative."""
    check_known("no such format", wanted, _EXPORTS)
    is_client = wanted.startswith("client-")
    result = folder / TREATMENT / "client.html" if is_client else answer_file(folder)
    exports = folder / "exports"
    exports.mkdir(exist_ok=True)
    out = inside(folder, exports / _EXPORTS[wanted])
    export_result(result, wanted.removeprefix("client-"), out, overwrite=True)
    return f"{exports.name}/{out.name}"
