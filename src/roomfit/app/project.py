"""A project: a folder with campaign.toml, recordings and results, as the command line has it.

Everything that the workbench changes, it changes here, in the files. Comments of a campaign stay.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from roomfit.base.arguments import check_known, check_name
from roomfit.base.errors import InputError
from roomfit.base.whole_files import write_text_atomically
from roomfit.cli.export import export_result
from roomfit.files.campaign import FILL_IN, Campaign, blanks, read_campaign, read_toml
from roomfit.files.draft import draft_campaign
from roomfit.files.edits import Edit, edited_text, read_beside, rewrite, sole_editor, value_text
from roomfit.files.exports import FORMATS
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.files.responses.sweep import response_name
from roomfit.files.rooms import READERS
from roomfit.files.rooms.model import RoomSpec
from roomfit.files.tables import TABLE_SUFFIXES

CAMPAIGN = "campaign.toml"
QUICK, FULL = "first", "result"
"""Folders of the quick answer and of the full one, within the project."""
RESULTS = (f"{QUICK}/result.json", f"{FULL}/result.json")
TREATMENT_QUESTION, TREATMENT = "treatment.toml", "treatment"
"""Products and targets, and the folder of the answer."""
LISTENED = "listened"
RECORDINGS, DRY = "recordings", "dry"
POSITIONS, DECAY_TIMES = "positions", "decay-times"
"""Folders of tables that were sent."""
MEAN, MEAN_FILES = "mean", ("reverberation.html", "reverberation.csv", "result.json")
"""The folder of what decay times alone say, and what it holds."""
_LONGEST_NAME = 120
_KNOWN: Mapping[str, Collection[str]] = {
    "room": READERS,
    RECORDINGS: RESPONSE_SUFFIXES,
    DRY: RESPONSE_SUFFIXES,
    POSITIONS: TABLE_SUFFIXES,
    DECAY_TIMES: TABLE_SUFFIXES,
}  # endings of what may be sent, by its place
_ENDINGS = {
    **dict.fromkeys((*FORMATS, "excel", "pdf", "word"), ".txt"),
    "catt": ".geo",
    "csv": ".csv",
    "excel": ".xlsx",
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


def campaign_content(folder: Path) -> dict[str, Any]:
    """Return the campaign file as plain content."""
    return read_toml(campaign_file(folder))


def edit(
    folder: Path,
    *edits: Edit,
    of: Callable[[dict[str, Any]], Iterable[Edit]] | None = None,
) -> None:
    """Change keys of the campaign file; where none is another, it keeps its time.

    `of`: returns further edits of what the file says, as plain content.
    """

    def change(text: str) -> str:
        return edited_text(text, (*edits, *(of(campaign_content(folder)) if of else ())))

    rewrite(campaign_file(folder), change)


def set_room(
    folder: Path,
    file: str | None = None,
    shoebox: Sequence[float] | None = None,
    unit: str | None = None,
    space: str | None = None,
) -> None:
    """Give a project its room, as `roomfit init` does; sources, receivers and recordings stay."""
    if shoebox is not None:
        x, y, z = (float(length) for length in shoebox)
        spec = RoomSpec(shoebox=(x, y, z), unit=unit)
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
    wanted, known = _leaves(new["room"], "room"), _leaves(old.get("room", {}), "room")
    # what the campaign says of materials that the room does not have would be refused
    gone = [("materials", n) for n in old.get("materials", {}) if n not in new.get("materials", {})]
    objects = old.get("objects", {})
    gone += [("objects", n) for n, table in objects.items() if "outlines" in table]
    kept = {n for n in objects if ("objects", n) not in gone}
    stands = {n: table for n, table in new.get("objects", {}).items() if n not in kept}
    return [
        *[Edit(path[:-1], path[-1], value) for path, value in wanted.items()],
        *[Edit(path[:-1], path[-1], None) for path in known if path not in wanted],
        *[Edit((kind,), name, None) for kind, name in gone],
        *[Edit(path[:-1], path[-1], x) for path, x in _leaves(stands, "objects").items()],
        Edit((), "states", None),
        *(_known_objects(stands) if _decay_times(old, alone=True) else ()),
    ]


def _leaves(content: Mapping[str, Any], *above: str) -> dict[tuple[str, ...], Any]:
    """Return the keys of a table and of those within it, by their paths."""
    found: dict[tuple[str, ...], Any] = {}
    for name, value in content.items():
        deeper = isinstance(value, Mapping)
        found |= _leaves(value, *above, name) if deeper else {(*above, name): value}
    return found


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
    if kind not in ("sources", "receivers") or not name.strip():
        what = "a position needs a kind and a name"
        needed = "sources or receivers, and a name of one letter or more"
        raise InputError(what, found=f"{kind} {name!r}", needed=needed, hint="name it, as S1 or R1")
    if position_m is not None and (
        len(position_m) != 3 or not all(abs(float(x)) < 1e6 for x in position_m)
    ):
        raise InputError(
            "a position is three numbers",
            where=f"{kind}.{name}",
            found=str(list(position_m))[:80],
            needed="x, y, z in m",
            hint="measure from the origin of the room file, in m",
        )
    if position_m is None:
        edit(folder, Edit((kind,), name, None))
    else:
        place = tuple(round(float(x), 4) for x in position_m)
        edit(folder, Edit((kind, name.strip()), "position", place))


def name_measured(folder: Path, source: str, receiver: str) -> None:
    """Write a measured response into the campaign, of which positions may still be blank.

    Devices delay each recording by another time: its clock is that of its direct sound, as its own
    table says (``unknown`` would be one delay for all files of a source).
    """
    if has_campaign(folder):
        edit(folder, of=partial(_of_measured, source, receiver))


def _of_measured(source: str, receiver: str, content: Mapping[str, Any]) -> list[Edit]:
    file, rows = f"{RECORDINGS}/{response_name(source, receiver)}", content.get("measurements", [])
    edits = [
        Edit((kind, name), "position", FILL_IN)
        for kind, name in (("sources", source), ("receivers", receiver))
        if name not in content.get(kind, {})
    ]
    if all(row.get("file") != file for row in rows):
        row = {"source": source, "receiver": receiver, "file": file, "time_zero": "direct"}
        edits += [Edit(("measurements", len(rows) + 1), key, value) for key, value in row.items()]
    return edits


def set_bands(folder: Path, from_hz: float, to_hz: float) -> None:
    """Say which bands are fitted."""
    limits_hz = (("from_hz", float(from_hz)), ("to_hz", float(to_hz)))
    edit(folder, *[Edit(("identify",), key, value) for key, value in limits_hz])


def decay_times(folder: Path, *, alone: bool = False) -> Path | None:
    """Return the table of decay times of the campaign; None without one."""
    content = campaign_content(folder) if has_campaign(folder) else {}
    own = _decay_times(content, alone=alone)
    return None if own is None else folder / str(own.get("file", ""))


def _decay_times(content: Mapping[str, Any], *, alone: bool) -> Mapping[str, Any] | None:
    own = content.get("reverberation")
    is_beside = alone and {"measurements", "recordings"} & set(content)
    return own if isinstance(own, Mapping) and not is_beside else None


def set_decay_times(folder: Path, name: str) -> None:
    """Take a table that was sent as the decay times of the campaign."""
    if not has_campaign(folder):
        what = "there is no room yet"
        needed = "a room file or three lengths"
        hint = "give them in the tab Room, then take the table again"
        raise InputError(what, found="no campaign in the folder", needed=needed, hint=hint)
    table = Edit(("reverberation",), "file", f"{DECAY_TIMES}/{name}")
    edit(folder, table, of=lambda content: _known_objects(content.get("objects", {})))


def _known_objects(objects: Mapping[str, Mapping[str, Any]]) -> list[Edit]:
    """Return what makes objects absorb as their entries say, which decay times cannot find out."""
    found = [(n, t["prior"]) for n, t in objects.items() if isinstance(t.get("prior"), str)]
    return [
        *[Edit(("objects", n), "absorption_area_m2", entry) for n, entry in found],
        *[Edit(("objects", n), "prior", None) for n, _ in found],
    ]


def bands(folder: Path) -> tuple[float, float]:
    """Return the lowest and the highest band that is fitted, by the campaign or by default."""
    own = campaign_content(folder).get("identify", {})
    return float(own.get("from_hz", 125.0)), float(own.get("to_hz", 4000.0))


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
    for kind in ("sources", "receivers"):
        points = content.get(kind, {})
        content[kind] = {n: t for n, t in points.items() if not blanks(t)}
    rows = [m for m in content.get("measurements", []) if not blanks(m)]
    content["measurements"] = [
        m
        for m in rows
        if m.get("source") in content["sources"] and m.get("receiver") in content["receivers"]
    ]
    lines = [f"{value_text({key: value})[1:-1]}\n" for key, value in content.items()]
    with read_beside(folder, "".join(lines)) as campaign:
        yield campaign


def upload_place(folder: Path, kind: str, name: str) -> Path:
    """Return where a file that somebody sends may be put."""
    check_known("there is no such place for files", kind, _KNOWN)
    plain = name and len(name.encode()) <= _LONGEST_NAME and name.isprintable()
    if not plain or name.startswith(".") or any(c in name for c in '/\\:*?"<>|'):
        raise InputError(
            "this is no name of a file here",
            found=repr(name[:200]),
            needed=f'at most {_LONGEST_NAME} bytes, no dot first, none of /\\:*?"<>|',
            hint="rename the file, as R1.wav",
        )
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
        raise InputError(
            "this leads out of the project",
            where=str(path),
            found="a link, or .., to a place outside",
            needed="a file within the project",
            hint="copy what the link points to into the project",
        )
    return real


# Folders of results and of what is written from them
_SHOWN = (QUICK, FULL, MEAN, TREATMENT, LISTENED, "exports")


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


def answer_file(folder: Path, *, or_decay_times: bool = False) -> Path:
    """Return the best result, or the table of decay times where that does as well."""
    found = best_result(folder) or (decay_times(folder) if or_decay_times else None)
    if found is None:
        raise InputError(
            "there is no answer yet",
            found="no result" + (" and no table of decay times" if or_decay_times else ""),
            needed="a first or a full answer",
            hint='press "First answer only" under Identify',
        )
    return found


def export(folder: Path, wanted: str) -> list[str]:
    """Write the best result's materials for another program; return the files, relative."""
    result = answer_file(folder)
    check_known("no such format", wanted, _ENDINGS)
    exports = folder / "exports"
    exports.mkdir(exist_ok=True)
    named = {"pdf": "report.pdf", "word": "report.docx"}
    out = exports / named.get(wanted, f"materials-{wanted}{_ENDINGS[wanted]}")
    written = export_result(result, wanted, inside(folder, out), overwrite=True)
    root = Path(os.path.realpath(folder))
    return [Path(os.path.relpath(file, root)).as_posix() for file in written.files]
