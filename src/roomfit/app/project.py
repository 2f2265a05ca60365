"""A project: a folder with campaign.toml, recordings and results, as the command line has it.

Everything that the workbench changes, it changes here, in the files. Comments of a campaign stay.
"""

from __future__ import annotations

import json
import os
import secrets
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from roomfit.cache import write_json_atomically, write_text_atomically
from roomfit.commands import export_result
from roomfit.errors import InputError
from roomfit.io.campaign import FILL_IN, Campaign, blanks, read_campaign
from roomfit.io.door import read_text
from roomfit.io.draft import draft_campaign
from roomfit.io.exports import FORMATS
from roomfit.io.remedies import Edit, value_text
from roomfit.io.responses import RESPONSE_SUFFIXES
from roomfit.io.responses.sweep import response_name
from roomfit.io.rooms import READERS
from roomfit.io.rooms.model import RoomSpec
from roomfit.io.tables import TABLE_SUFFIXES

CAMPAIGN = "campaign.toml"
QUICK, FULL = "first", "result"
"""Folders of the quick answer and of the full one, within the project."""
RESULTS = (f"{QUICK}/result.json", f"{FULL}/result.json")
TREATMENT_QUESTION, TREATMENT = "treatment.toml", "treatment"
"""Products and targets, and the folder of the answer."""
LISTENED = "listened"
_UNDO = ".roomfit-undo.json"  # the campaign before the last remedy, and the digest of it after
RECORDINGS, DRY = "recordings", "dry"
POSITIONS, DECAY_TIMES = "positions", "decay-times"
"""Folders of tables that were sent."""
MEAN = "mean"
"""The folder of what decay times alone say."""
_LONGEST_NAME = 120
_KNOWN: Mapping[str, Collection[str]] = {
    "room": READERS,
    RECORDINGS: RESPONSE_SUFFIXES,
    DRY: RESPONSE_SUFFIXES,
    POSITIONS: TABLE_SUFFIXES,
    DECAY_TIMES: TABLE_SUFFIXES,
}  # endings of what may be sent, by its place
_ENDINGS = {
    **dict.fromkeys((*FORMATS, "excel", "gltf", "pdf", "word"), ".txt"),
    "catt": ".geo",
    "csv": ".csv",
    "excel": ".xlsx",
    "gltf": ".gltf",
    "pdf": ".pdf",
    "pyroomacoustics": ".json",
}
EXPORTS = tuple(_ENDINGS)


def campaign_file(folder: Path) -> Path:
    """Return where the campaign of a project is, or will be."""
    return folder / CAMPAIGN


def has_campaign(folder: Path) -> bool:
    """Whether the folder is a project already."""
    return campaign_file(folder).is_file()


def best_result(folder: Path) -> Path | None:
    """Return the result.json of the full answer, else of the quick one, None without any."""
    files = [folder / name / "result.json" for name in (FULL, QUICK)]
    return next((file for file in files if file.is_file()), None)


def campaign_text(folder: Path) -> str:
    """Return the campaign file as it is written."""
    return read_text(campaign_file(folder), "campaign file", most="campaign_bytes")


def campaign_document(folder: Path) -> tomlkit.TOMLDocument:
    """Return the campaign file with its comments.

    Raises
    ------
    InputError
        It is no TOML.
    """
    try:
        return tomlkit.parse(campaign_text(folder))
    except (ValueError, RecursionError) as error:
        raise InputError(
            "the campaign file is not valid TOML",
            where=str(campaign_file(folder)),
            found=str(error)[:200],
        ) from error


@contextmanager
def editing(folder: Path) -> Iterator[tomlkit.TOMLDocument]:
    """Give the campaign file to be changed; what is not stays as it is written, and so its time.

    Raises
    ------
    InputError
        The file is no TOML.
    StoreError
        The disk refuses.
    """
    document = campaign_document(folder)
    before = tomlkit.dumps(document)
    yield document
    if (after := tomlkit.dumps(document)) != before:
        write_text_atomically(campaign_file(folder), after)


def _table(parent: Any, name: str) -> Any:
    """Return a table of a document, made where it is missing."""
    if name not in parent:
        parent[name] = tomlkit.table()
    if not isinstance(parent[name], Table | dict):
        raise InputError("a table is needed", where=name, found=repr(parent[name])[:80])
    return parent[name]


def set_room(
    folder: Path,
    file: str | None = None,
    shoebox: Sequence[float] | None = None,
    unit: str | None = None,
) -> None:
    """Give a project its room, as `roomfit init` does; sources, receivers and recordings stay.

    Parameters
    ----------
    file : str, optional
        In the folder; or else
    shoebox : three lengths in m, optional

    Raises
    ------
    InputError
        The room cannot be read, or its unit is in doubt.
    """
    if shoebox is not None:
        x, y, z = (float(length) for length in shoebox)
        spec = RoomSpec(shoebox=(x, y, z), unit=unit)
    else:
        spec = RoomSpec(file=folder / (file or ""), unit=unit)
    drafted = tomlkit.parse(draft_campaign(spec, {}, folder=folder))
    if not has_campaign(folder):
        for key in ("sources", "receivers", "measurements"):
            drafted.remove(key)
        write_text_atomically(campaign_file(folder), tomlkit.dumps(drafted))
        return
    with editing(folder) as document:
        document["room"] = drafted["room"]
        # what the campaign says of materials that the room does not have would be refused
        known = document.get("materials", {})
        new = tomlkit.table(is_super_table=True)
        for name in drafted.get("materials", {}):
            new[name] = known.get(name, tomlkit.table())
        document["materials"] = new
        document.pop("states", None)


def set_surface_material(folder: Path, surface: str, material: str) -> None:
    """Say of which material a surface is.

    Raises
    ------
    InputError
        The name is empty.
    """
    if not material.strip():
        raise InputError("a material without a name", needed="a name")
    with editing(folder) as document:
        _table(_table(document, "room"), "materials")[surface] = material.strip()


def forget_unused_materials(folder: Path, used: Sequence[str]) -> None:
    """Leave out what a campaign says of materials that its room does not have any more."""
    with editing(folder) as document:
        for name in [n for n in document.get("materials", {}) if n not in used]:
            document["materials"].remove(name)


def set_prior(folder: Path, material: str, entry: str | None) -> None:
    """Say by the catalogue what a material is, as its prior; None: nothing is known."""
    with editing(folder) as document:
        own = _table(_table(document, "materials"), material)
        own.pop("prior", None)
        if entry:
            own["prior"] = entry


def set_position(folder: Path, kind: str, name: str, position_m: Sequence[float] | None) -> None:
    """Say where a source or a receiver stands, in m; None takes it out.

    Parameters
    ----------
    kind : {"sources", "receivers"}

    Raises
    ------
    InputError
        Not three finite numbers, or a name that is none.
    """
    if kind not in ("sources", "receivers") or not name.strip():
        raise InputError("a position needs a kind and a name", found=f"{kind} {name!r}")
    if position_m is not None and (
        len(position_m) != 3 or not all(abs(float(x)) < 1e6 for x in position_m)
    ):
        raise InputError(
            "a position is three numbers", where=f"{kind}.{name}", needed="x, y, z in m"
        )
    with editing(folder) as document:
        if position_m is None:
            _table(document, kind).pop(name, None)
        else:
            point = _table(_table(document, kind), name.strip())
            point["position"] = [round(float(x), 4) for x in position_m]


def name_measured(folder: Path, source: str, receiver: str) -> None:
    """Write a measured response into the campaign, of which positions may still be blank.

    Devices delay each recording by another time: its clock is that of its direct sound, as its own
    table says (``unknown`` would be one delay for all files of a source).

    Raises
    ------
    InputError
        The campaign is no TOML, or written in a way that does not allow it.
    """
    if not has_campaign(folder):
        return
    text, file = campaign_text(folder), f"{RECORDINGS}/{response_name(source, receiver)}"
    content = campaign_document(folder).unwrap()
    rows = content.get("measurements", [])
    edits = [
        Edit((kind, name), "position", FILL_IN)
        for kind, name in (("sources", source), ("receivers", receiver))
        if name not in content.get(kind, {})
    ]
    if all(row.get("file") != file for row in rows):
        row = {"source": source, "receiver": receiver, "file": file, "time_zero": "direct"}
        edits += [Edit(("measurements", len(rows) + 1), key, value) for key, value in row.items()]
    write_text_atomically(campaign_file(folder), edited_text(text, edits))


def set_bands(folder: Path, from_hz: float, to_hz: float) -> None:
    """Say which bands are fitted."""
    with editing(folder) as document:
        own = _table(document, "identify")
        own["from_hz"], own["to_hz"] = float(from_hz), float(to_hz)


def has_decay_times(folder: Path) -> bool:
    """Whether the campaign has decay times, from which alone a mean absorption is found."""
    return has_campaign(folder) and "reverberation" in campaign_document(folder)


def set_decay_times(folder: Path, name: str) -> None:
    """Take a table that was sent as the decay times of the campaign.

    Raises
    ------
    InputError
        There is no room yet.
    """
    if not has_campaign(folder):
        raise InputError(
            "there is no room yet",
            found="no campaign in the folder",
            needed="a room file or three lengths",
            hint="give them in the tab Room, then take the table again",
        )
    edit = Edit(("reverberation",), "file", f"{DECAY_TIMES}/{name}")
    text = campaign_text(folder)
    write_text_atomically(campaign_file(folder), edited_text(text, [edit]))


def bands(folder: Path) -> tuple[float, float]:
    """Return the lowest and the highest band that is fitted, by the campaign or by default."""
    own = campaign_document(folder).get("identify", {})
    return float(own.get("from_hz", 125.0)), float(own.get("to_hz", 4000.0))


@contextmanager
def filled_campaign(folder: Path) -> Iterator[Campaign]:
    """Read the campaign of a project as far as it is filled in.

    Sources, receivers and measurements with blanks are left out, for a room can be looked at
    before its positions are known.

    Raises
    ------
    InputError
        See `roomfit.read_campaign`.
    """
    content = campaign_document(folder).unwrap()
    if not blanks(content):
        yield read_campaign(campaign_file(folder), to_fit=False)
        return
    for kind in ("sources", "receivers"):
        points = content.get(kind, {})
        content[kind] = {n: t for n, t in points.items() if not blanks(t)}
    rows = [m for m in content.get("measurements", []) if not blanks(m)]
    content["measurements"] = [
        m
        for m in rows
        if m.get("source") in content["sources"] and m.get("receiver") in content["receivers"]
    ]
    with _read_beside(folder, tomlkit.dumps(content)) as campaign:
        yield campaign


@contextmanager
def _read_beside(folder: Path, text: str) -> Iterator[Campaign]:
    """Read what would be a campaign beside that of the folder, for paths are relative to it."""
    beside = folder / f".roomfit-{secrets.token_hex(8)}.toml"
    try:
        write_text_atomically(beside, text)
        yield read_campaign(beside, to_fit=False)
    finally:
        beside.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Preview:
    """What a remedy would write into a campaign."""

    before: str  # the whole text
    after: str
    lines: tuple[tuple[str, str, str], ...]  # the table, its line as it is, and as it would be


def preview(folder: Path, edits: Sequence[Edit]) -> Preview:
    """Return what the campaign would be with some keys changed, and write nothing.

    Raises
    ------
    InputError
        The campaign cannot be edited key by key, or could not be read any more.
    """
    before = campaign_text(folder)
    content, lines = tomllib.loads(before), []
    for edit in edits:
        old = _part(content, edit.table).get(edit.key)
        stated = "not stated" if old is None else f"{edit.key} = {value_text(old)}"
        number = f", no. {edit.table[1]}" if edit.table[0] == "measurements" else ""
        then = f"{edit.key} = {value_text(edit.value)}"
        lines.append((f"{_heading(edit.table)}{number}", stated, then))
    after = edited_text(before, edits)
    with _read_beside(folder, after):
        return Preview(before, after, tuple(lines))


def apply(folder: Path, wanted: Preview) -> None:
    """Write what was previewed, and keep the text that was there, so that one step can be undone.

    Raises
    ------
    InputError
        The campaign has changed since the preview.
    """
    if campaign_text(folder) != wanted.before:
        raise InputError(
            "the campaign has changed since this was shown",
            where=str(campaign_file(folder)),
            hint="look at what is written now, and apply that",
        )
    kept = {"before": wanted.before, "written": sha256(wanted.after.encode()).hexdigest()}
    write_json_atomically(folder / _UNDO, kept)
    write_text_atomically(campaign_file(folder), wanted.after)


def _undone(folder: Path) -> str | None:
    """Return the text before the last remedy, None where there is none or it was edited since."""
    if not (folder / _UNDO).is_file() or not has_campaign(folder):
        return None
    try:
        kept = json.loads(read_text(folder / _UNDO, "text to be undone to"))
        same = kept["written"] == sha256(campaign_text(folder).encode()).hexdigest()
        return str(kept["before"]) if same else None
    except (InputError, ValueError, KeyError, TypeError):  # not as it was written
        return None


def can_undo(folder: Path) -> bool:
    """Whether the campaign is as the last remedy left it, so that this can be taken back."""
    return _undone(folder) is not None


def undo(folder: Path) -> None:
    """Write the campaign as it was before the last remedy.

    Raises
    ------
    InputError
        There was none, or the campaign was edited since, which would be lost.
    """
    before = _undone(folder)
    if before is None:
        raise InputError(
            "nothing can be undone",
            where=str(campaign_file(folder)),
            found="no remedy, or a campaign that was edited after it",
            hint="edit campaign.toml by hand",
        )
    write_text_atomically(campaign_file(folder), before)
    (folder / _UNDO).unlink()


def edited_text(text: str, edits: Sequence[Edit]) -> str:
    """Return the text of a campaign with some keys changed; all else stays as it is written.

    A new key stands below the last one of its table, a new table at the end.

    Raises
    ------
    InputError
        The text is written in a way that does not allow it, as with one inline table of all
        materials: read again, it has not exactly these keys changed.

    Examples
    --------
    >>> edited_text("[sources.S] # mine", [Edit(("sources", "S"), "directivity", "fit")])
    '[sources.S] # mine\\ndirectivity = "fit"\\n'
    """
    document, expected = tomlkit.parse(text), tomllib.loads(text)
    end = "\r\n" if "\r\n" in text else "\n"
    new: dict[tuple[str | int, ...], list[str]] = {}
    for edit in edits:
        value = list(edit.value) if isinstance(edit.value, tuple) else edit.value
        _part(expected, edit.table)[edit.key] = value
        table = _found(document, edit.table)
        line = f"{tomlkit.key(edit.key).as_string()} = {tomlkit.item(value).as_string()}"
        if table is None:
            new.setdefault(edit.table, [_heading(edit.table)]).append(line)
        elif edit.key in table or not isinstance(table, Table):
            table[edit.key] = value
        else:
            _add_line(table, line, end)
    after = tomlkit.dumps(document)
    for lines in new.values():
        after = f"{after.rstrip()}{end}{end}{end.join(lines)}{end}"
    try:
        as_wanted = tomllib.loads(after) == expected
    except ValueError:
        as_wanted = False
    if not as_wanted:
        raise InputError(
            "the campaign is written in a way that this cannot edit",
            found=", ".join(dict.fromkeys(_heading(edit.table) for edit in edits)),
            needed="tables such as [sources.NAME], one key a line",
            hint="write into campaign.toml by hand: "
            + ", ".join(f"{edit.key} = {value_text(edit.value)}" for edit in edits[:4]),
        )
    return after


def _heading(table: Sequence[str | int]) -> str:
    """Return a table as its first line names it."""
    if table[0] == "measurements":
        return "[[measurements]]"
    return f"[{'.'.join(tomlkit.key(str(name)).as_string() for name in table)}]"


def _part(content: dict[str, Any], table: Sequence[str | int]) -> dict[str, Any]:
    """Return a table of plain content, made where it is missing."""
    part: Any = content
    for name, below in zip(table, (*table[1:], ""), strict=True):
        if isinstance(name, int):
            part += [{} for _ in range(name - len(part))]
            part = part[name - 1]
        else:
            part = part.setdefault(name, [] if isinstance(below, int) else {})
    made: dict[str, Any] = part
    return made


def _found(document: tomlkit.TOMLDocument, table: Sequence[str | int]) -> Any:
    """Return a table of a document, None where it is missing."""
    part: Any = document
    for name in table:
        if isinstance(name, int):
            part = part[name - 1] if isinstance(part, AoT | list) and name <= len(part) else None
        else:
            part = part.get(name) if isinstance(part, dict) else None
        if part is None:
            return None
    return part


def _add_line(table: Table, line: str, end: str) -> None:
    """Write a key below the last one of a table, above comments that lead to the next table.

    tomlkit itself would write it below these.
    """
    own = [item for key, item in table.value.body if key is not None]
    last = next((i for i in reversed(own) if not isinstance(i, Table | AoT)), table)
    trail = last.trivia.trail
    last.trivia.trail = f"{trail if trail.endswith(end) else trail + end}{line}{end}"


def upload_place(folder: Path, kind: str, name: str) -> Path:
    """Return where a file that somebody sends may be put.

    Parameters
    ----------
    kind : {"room", "recordings", "dry", "positions", "decay-times"}
    name : str
        As the sender calls it.

    Raises
    ------
    InputError
        The name is a path, hidden, of no known format, or its place lies outside of the project.
    """
    if kind not in _KNOWN:
        raise InputError("there is no such place for files", found=repr(kind))
    plain = name and len(name.encode()) <= _LONGEST_NAME and name.isprintable()
    if not plain or name.startswith(".") or any(c in name for c in '/\\:*?"<>|'):
        raise InputError("this is no name of a file here", found=repr(name[:200]))
    if Path(name).suffix.lower() not in _KNOWN[kind]:
        needed = f"one of {', '.join(_KNOWN[kind])}"
        raise InputError("the format is not known", found=repr(name), needed=needed)
    parent = folder if kind == "room" else folder / kind
    place = parent / name
    inside(folder, parent)
    if place.is_symlink() or (place.exists() and not place.is_file()):
        raise InputError("a link or a folder has this name", where=str(place))
    return place


def inside(folder: Path, path: Path) -> Path:
    """Return a path with links followed; refuse one that leads out of the project.

    Raises
    ------
    InputError
        It does.
    """
    real, root = Path(os.path.realpath(path)), Path(os.path.realpath(folder))
    if real != root and root not in real.parents:
        raise InputError("this leads out of the project", where=str(path))
    return real


def served_file(folder: Path, path: str) -> Path:
    """Return a file of a result or an export that may be shown or downloaded.

    Raises
    ------
    InputError
        There is no such file, or it is none of those.
    """
    parts = Path(path).parts
    if (
        not path.isprintable()
        or len(parts) < 2
        or parts[0] not in (QUICK, FULL, MEAN, TREATMENT, LISTENED, "exports")
    ):
        raise InputError("only results and exports are shown", found=repr(path[:200]))
    if any(part.startswith(".") for part in parts):
        raise InputError("hidden files are not shown", found=repr(path[:200]))
    real = inside(folder, folder / path)
    if not real.is_file():
        raise InputError("there is no such file", found=repr(path[:200]))
    return real


def export(folder: Path, wanted: str) -> list[str]:
    """Write the best result's materials for another program; return the files, relative.

    Raises
    ------
    InputError
        There is no result, or no such format.
    """
    result = best_result(folder)
    if result is None:
        raise InputError("there is no result yet", hint="identify first")
    if wanted not in _ENDINGS:
        raise InputError("no such format", found=repr(wanted), needed=", ".join(EXPORTS))
    exports = folder / "exports"
    exports.mkdir(exist_ok=True)
    named = {"raven": "raven", "pdf": "report.pdf", "word": "report.docx"}
    out = exports / named.get(wanted, f"materials-{wanted}{_ENDINGS[wanted]}")
    written = export_result(
        result, wanted, inside(folder, out), campaign_file=campaign_file(folder), overwrite=True
    )
    root = Path(os.path.realpath(folder))
    return [Path(os.path.relpath(file, root)).as_posix() for file in written.files]
