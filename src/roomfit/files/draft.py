"""A first campaign file from what there is: a room, recordings by their names, positions.

What cannot be known is a blank, `FILL_IN`, with which no campaign is read; what was guessed says so
in a comment beside it.
"""

from __future__ import annotations

import json
import os
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.polygon import area_vector_m2
from roomfit.base.typing import FloatArray
from roomfit.files.campaign import FILL_IN
from roomfit.files.encoding import one_line
from roomfit.files.file_names import files_of_shape, shape_of
from roomfit.files.responses import RESPONSE_SUFFIXES
from roomfit.files.rooms import read_mesh, read_model
from roomfit.files.rooms.model import RoomSpec
from roomfit.files.tables import table_rows
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, Thing
from roomfit.materials.catalogue import suggested_entries
from roomfit.room.audience import audience_area_m2
from roomfit.room.mesh import Mesh
from roomfit.room.scene import is_level_by_name, material_areas, surface_materials

# Rooms of people and sound, m and m3: of the units that a size permits, these are plausible.
_LEAST_M, _HIGHEST_M, _LONGEST_M, _LARGEST_M3 = 1.5, 20.0, 150.0, 60_000.0
_UNITS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("ft", "foot", "feet"), "ft"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
}
_STATED_UNIT = re.compile(r"\bunits?\b\W{0,4}([a-z]+)", re.IGNORECASE)
_HEADER_BYTES = 4096
_CLEARLY = 0.75  # an axis along which a room is shorter than that points up
_DEFAULTS = (
    "latency_s = 0.0        # from the first sample to emission",
    'time_zero = "unknown"  # where recordings and source share no clock',
    'level = "per-file"     # where the gain was changed between recordings',
    'excitation = "sweep.wav"  # where they are recordings of a sweep',
)
Positions = Mapping[str, Sequence[float]]


def likely_units(room: Path, space: str | None = None) -> dict[str, str]:
    """Return each unit that a room file may be in, with the reason in words, the stated one alone.

    A format or a header that states its unit decides; else it is by size, and more than one unit,
    or none, means that somebody must say.

    Raises
    ------
    InputError
        The file cannot be read, or is of no known format.
    """
    model, _ = read_model(RoomSpec(file=room, space=space))
    if model.unit is not None:
        return {model.unit: "by the format of the file"}
    head = read_bytes(room, "room file")[:_HEADER_BYTES].decode("ascii", errors="replace")
    stated = [_UNITS[m.lower()] for m in _STATED_UNIT.findall(head) if m.lower() in _UNITS]
    if stated:
        return {stated[0]: "by the header of the file"}
    return plausible_units(np.ptp(model.vertices, axis=0))


def plausible_units(size: FloatArray) -> dict[str, str]:
    """Return the units in which a bounding box, shape (3,), is a room, with its lengths in words.

    Examples
    --------
    >>> plausible_units(np.array([6.0, 5.0, 3.0])), list(plausible_units(np.array([30, 20, 10])))
    ({'m': 'the room is then 6 x 5 x 3 m'}, ['m', 'ft'])
    """
    found = {}
    for unit, metres in METRES_PER_UNIT.items():
        lengths = size * metres
        high = float(lengths.min())
        fits = _LEAST_M <= high <= _HIGHEST_M and float(lengths.max()) <= _LONGEST_M
        if fits and float(np.prod(lengths)) <= _LARGEST_M3:
            found[unit] = f"the room is then {' x '.join(f'{x:.3g}' for x in lengths)} m"
    return found


def likely_up(model: RoomModel) -> tuple[str, str]:
    """Return the axis of a room file that points up, and why: "" where nothing contradicts.

    Surfaces whose names say floor or ceiling are level; without such, a room is the least high.
    """
    upright = np.zeros(3)
    for face in model.faces:
        if is_level_by_name(face.surface):
            upright += np.abs(area_vector_m2(model.vertices[list(face.corners)]))
    if upright.any():
        axis = "xyz"[int(np.argmax(upright))]
        if axis != "x":
            return axis, "" if axis == model.up else "floor and ceiling are level then"
    _, along_y, along_z = np.ptp(model.vertices, axis=0)
    short, long = ("y", along_z) if along_y < along_z else ("z", along_y)
    if short != model.up and min(along_y, along_z) < _CLEARLY * long:
        return short, "the room is the least high then"
    return model.up, ""


def read_positions(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return positions in m by name from a table: name, x, y, z, with or without a heading.

    Separated by commas, or by tabs or semicolons with decimal commas; or an Excel workbook. A
    heading may state the unit, as in ``name,x_mm,y_mm,z_mm`` or ``x [ft]``; without, metres.

    Raises
    ------
    InputError
        The table cannot be read, or a line is not understood.
    """
    delimiter, rows = table_rows(path, "table of positions")
    found: dict[str, tuple[float, float, float]] = {}
    factor = 1.0
    for place, (number, cells) in enumerate(rows):
        try:
            numbers = [float(c.replace(",", ".")) for c in cells[1:4]]
        except ValueError:
            numbers = []
        if (
            delimiter == ","
            and len(cells) == 7
            and all(re.fullmatch(r"-?\d+", c) for c in cells[1:])
        ):
            raise InputError(
                "decimal commas cannot be distinguished from commas between columns",
                where=f"{path}, line {number}",
                found=repr(",".join(cells)),
                needed="semicolons or tabs between columns, or decimal points",
                hint="save the table with semicolons",
            )
        if len(numbers) == 3 and np.all(np.isfinite(numbers)) and cells[0] not in found:
            x, y, z = (factor * n for n in numbers)
            found[cells[0]] = (round(x, 6), round(y, 6), round(z, 6))
        elif found or place:
            raise InputError(
                "a line of the table of positions is not understood",
                where=f"{path}, line {number}",
                found=repr(delimiter.join(cells)),
                needed="a name that stands once, and x, y, z",
                hint="correct the line, or remove it",
            )
        else:
            words = re.split(r"[^a-z]+", " ".join(cells[1:4]).lower())
            units = [_UNITS[w] for w in words if w in _UNITS]
            # "x in cm" is centimetres
            unit = next((u for u in units if u != "in"), units[0] if units else "m")
            factor = METRES_PER_UNIT[unit]
    if not found:
        raise InputError(
            "the table of positions is empty",
            where=str(path),
            found="no line of a name and three numbers",
            needed="lines name, x, y, z",
            hint="write one line for each source or receiver, as S1,1.2,3.4,1.5",
        )
    return found


def matching_files(
    folder: Path, template: str | None, known: Iterable[str] = ()
) -> dict[str, tuple[str, str]]:
    """Return source and receiver by the name of each recording, relative to a folder.

    Parameters
    ----------
    folder : Path
    template : str or None
        As in ``"responses/{source}_{receiver}.wav"``; * stands for any text. None: of
        `recordings_in` the folder those whose names hold two of the known ones, the source first;
        where none does, those of that shape, if most have it, else all of one source.
    known : iterable of str
        Names of sources and receivers. The case of letters does not matter. A name that may be
        split at several places is split where both parts are known.

    Raises
    ------
    InputError
        The template lacks {source} or {receiver}, or no file has its shape; or several folders
        hold recordings.
    """
    if template is None:
        names = recordings_in(folder)
        pairs = {name: _known_in(Path(name).stem, known) for name in names}
        if any(len(pair) == 2 for pair in pairs.values()):
            return {name: (pair[0], pair[1]) for name, pair in pairs.items() if len(pair) == 2}
        split = {name: Path(name).stem.partition("_") for name in names}
        found = {name: (a, b) for name, (a, mark, b) in split.items() if a and mark and b}
        mostly = len(found) >= _MOST_NAMES * len(names)
        return found if mostly else {name: ("S1", Path(name).stem) for name in names}
    with located("--recordings"):
        names, spelled = files_of_shape(folder, template), {n.casefold(): n for n in known}
        shapes = [shape_of(template, one_of=spelled.values())] if spelled else []
        shapes.append(shape_of(template))
    if not names:
        below = Path(template).parent
        raise InputError(
            "no recording has a name of this shape",
            where=str(folder / below),
            found=in_short(_recordings(folder / below)) or "no recordings",
            needed=template,
            hint="put {source} and {receiver} where names differ, and * for other text",
        )
    matches = (next(filter(None, (s.fullmatch(name) for s in shapes)), None) for name in names)
    found = {m[0]: (m["source"], m["receiver"]) for m in matches if m}
    return {
        k: (spelled.get(a.casefold(), a), spelled.get(b.casefold(), b))
        for k, (a, b) in found.items()
    }


_MOST_NAMES = 2 / 3


def _known_in(stem: str, known: Iterable[str]) -> list[str]:
    """Return the known names that a file's name holds as whole words, in their order in it."""
    # some file systems take letters and their dots apart
    text = unicodedata.normalize("NFC", stem)
    starts = {}
    for name in sorted(known, key=len, reverse=True):
        word = re.escape(unicodedata.normalize("NFC", name))
        match = re.search(rf"(?<![^\W_]){word}(?![^\W_])", text, re.IGNORECASE)
        if match:
            starts[match.start()] = name
            text = text[: match.start()] + " " * len(match[0]) + text[match.end() :]
    return [starts[at] for at in sorted(starts)]


def recordings_in(folder: Path) -> list[str]:
    """Return recordings by their endings, relative to a folder; else those one folder below it.

    Raises
    ------
    InputError
        There are none in the folder, and in several below it.
    """
    own = _recordings(folder)
    if own or not folder.is_dir():
        return own
    below = {sub.name: _recordings(sub) for sub in sorted(folder.iterdir()) if sub.is_dir()}
    filled = {name: files for name, files in below.items() if files and name[0] != "."}
    if len(filled) > 1:
        raise InputError(
            "several folders hold recordings",
            where=str(folder),
            found=in_short([f"{name} ({len(files)} files)" for name, files in filled.items()]),
            needed="--recordings 'DIR/{source}_{receiver}.wav', of one of them",
            hint="or move the recordings into one folder",
        )
    return [f"{name}/{file}" for name, files in filled.items() for file in files]


def _recordings(folder: Path) -> list[str]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    files = [f for f in files if f.is_file() and not f.name.startswith(".")]
    chosen = [f for f in files if f.suffix.lower() in RESPONSE_SUFFIXES]
    # exports of REW are texts, and not every text is one
    return [f.name for f in chosen if f.suffix.lower() != ".txt"] or [f.name for f in chosen]


def draft_campaign(
    room: RoomSpec | None,
    recordings: Mapping[str, tuple[str, str]],
    positions: Positions | None = None,
    *,
    folder: Path,
    template: str | None = None,
    because: str = "",
    decay_times: Path | None = None,
) -> str:
    """Return the text of a first campaign file, blanks in place of what is not known.

    Parameters
    ----------
    room : RoomSpec or None
        Its file or its lengths; a unit that is None is guessed, and so is the axis that points up.
    recordings : mapping of file to (source, receiver)
        Paths relative to `folder`, from `matching_files`.
    positions : mapping of name to x, y, z in m, optional
        Of sources and receivers; of a recording's they are looked up, others are left out.
    folder : Path
        Where the file will stand.
    template : str, optional
        That of the recordings' names, which then stands in place of a table for each.
    because : str
        Why the unit is what it is, where the caller chose it among several.
    decay_times : Path, optional
        A table of decay times, which then stands in place of positions and recordings.

    Raises
    ------
    InputError
        The room cannot be read; or its unit is in doubt, with the units that are plausible.
    """
    first = "# A first campaign, made by `roomfit init`. Blanks are marked FILL IN. Then:"
    if decay_times is not None:
        lines = [
            first,
            "#   roomfit reverberation campaign.toml",
            "#   roomfit predict campaign.toml --set MATERIAL=0.6 --out predicted",
            "",
            "[room]",
            *_room_lines(room, folder, because, is_known=True),
            "",
            "[reverberation]",
            f"file = {_quoted(_beside(folder, decay_times))}",
            "",
            *_project_lines(folder),
        ]
        return "\n".join(lines) + "\n"
    lines = [
        first,
        "#   roomfit check campaign.toml",
        "#   roomfit identify campaign.toml --out result",
        "",
        *([f"recordings = {_quoted(template)}", ""] if template is not None else []),
        "[room]",
        *_room_lines(room, folder, because, positions),
        *_point_lines("sources", [s for s, _ in recordings.values()], positions or {}),
        *_point_lines("receivers", [r for _, r in recordings.values()], positions or {}),
        *_measurement_lines(recordings, template),
        "",
        "[identify]",
        "from_hz = 125",
        "to_hz = 4000",
        "",
        *_project_lines(folder),
    ]
    return "\n".join(lines) + "\n"


_LONGEST_TITLE = 120


def _project_lines(folder: Path) -> list[str]:
    """Return the table of the report's headings: the folder's name, the others left to fill in."""
    return [
        "# what stands above the report",
        "[project]",
        f"title = {_quoted(one_line(folder.resolve().name)[:_LONGEST_TITLE].strip() or 'Room')}",
        '# client = ""',
        '# author = ""',
        '# date = ""',
    ]


def _room_lines(
    room: RoomSpec | None,
    folder: Path,
    because: str,
    positions: Positions | None = None,
    *,
    is_known: bool = False,
) -> list[str]:
    if room is None:
        return [f'shoebox = "{FILL_IN}"  # lengths along x, y, z in m; or file = "room.obj"']
    if room.file is None:
        lengths = room.shoebox or (0.0, 0.0, 0.0)
        unit = [f"unit = {_quoted(room.unit)}"] if room.unit not in (None, "m") else []
        lines = [f"shoebox = [{', '.join(f'{x:g}' for x in lengths)}]", *unit]
        materials = {"walls": "walls", "floor": "floor", "ceiling": "ceiling"}
        mesh, _ = read_mesh(room)
        check_unit(mesh, positions or {})
        lines += ["", "# which material is where: south, north, east and west are the walls"]
        lines += ["[room.materials]", *(f"{k} = {_quoted(v)}" for k, v in materials.items())]
        return [*lines, *_material_lines(mesh, materials)]
    model, _ = read_model(room)
    spec, lines = _in_known_unit(room, model, because)
    space = [] if room.space is None else [f"space = {_quoted(room.space)}"]
    lines = [f"file = {_quoted(_beside(folder, room.file))}", *space, *lines]
    mesh, _ = read_mesh(spec)
    check_unit(mesh, positions or {})
    bare = [s.name for s in mesh.surfaces if s.file_material is None]
    if bare:
        lines += ["", "# surfaces without a material in the file", "[room.materials]"]
        lines += [f'{_quoted(name)} = "{FILL_IN}"' for name in dict.fromkeys(bare)]
    is_turned = (spec.unit, spec.up) != (model.unit, model.up)
    things = [] if is_turned else _thing_lines(model.things, mesh, is_known=is_known)
    return [*lines, *_material_lines(mesh, {}), *things]


# By which entry of seats a piece absorbs as far as anybody knows: no table has beds.
_AS_SEATS = {"sofa": "seats-medium-empty", "bed": "seats-heavy-empty", "chair": "seats-light-empty"}
_EDGE_PER_HEIGHT = 0.625  # the strip of 0.5 m along seats stands for sides 0.8 m high


def _thing_lines(things: Sequence[Thing], mesh: Mesh, *, is_known: bool) -> list[str]:
    """Return tables of what stands in a room and absorbs; of chairs only as comments."""
    lines: list[str] = []
    for kind, entry in _AS_SEATS.items():
        own = [t for t in things if t.kind == kind and len(t.outline_m)]
        if not own:
            continue
        table = [
            f"[objects.{_quoted(kind)}]  # {len(own)} by the scan",
            *_area_lines(kind, own, mesh),
            f'{"absorption_area_m2" if is_known else "prior"} = "{entry}"  # or other seats-...',
        ]
        if kind == "chair":
            table = [f"# {line}" for line in ("where they are upholstered:", *table)]
        lines += table
    first = "# What stands in the room absorbs in its volume; here as upholstered seats do."
    return ["", first, *lines] if lines else []


def _area_lines(kind: str, things: Sequence[Thing], mesh: Mesh) -> list[str]:
    """Return the keys that say how large things of a kind are: outlines, or the floor below."""
    floor_m2 = sum(float(np.linalg.norm(area_vector_m2(t.outline_m))) for t in things)
    below = [f"floor_area_m2 = {floor_m2:.2f}"]
    if kind == "chair":  # strips are of blocks, and would be nine tenths of a chair
        return below
    height_m = float(np.mean([t.height_m for t in things]))
    edge_m = min(round(_EDGE_PER_HEIGHT * height_m, 2), 0.5)
    try:
        _, area_m2 = audience_area_m2(mesh, [t.outline_m for t in things], edge_m)
    except InputError:  # one stands in a wall, as a scan may have it
        return below
    rings = [[[round(float(x), 2) for x in p] for p in t.outline_m] for t in things]
    edge = f"edge_m = {edge_m:g}  # sides of {height_m:.2f} m: {area_m2:.1f} m2 with them"
    return [f"outlines = {rings}", edge]


def check_unit(mesh: Mesh, positions: Positions) -> None:
    """Refuse positions most of which lie outside the room, and all of which inside in some unit.

    Raises
    ------
    InputError
        They do.
    """
    points = np.array(list(positions.values())).reshape(-1, 3)
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)

    def inside(factor: float) -> int:
        return int(np.sum(np.all((factor * points > low) & (factor * points < high), axis=1)))

    units = {m: u for u, m in METRES_PER_UNIT.items() if inside(m) == len(points)}
    if units and 2 * inside(1.0) < len(points):
        # in a smaller one they would stand together in a corner
        unit = units[max(units)]
        raise InputError(
            "the table of positions seems to be in another unit",
            found=f"{inside(1.0)} of {len(points)} positions within the room, all of them in "
            f"{unit}",
            needed=f"a heading with the unit, as name,x [{unit}],y [{unit}],z [{unit}]",
            hint="or another --unit of the room",
        )


def _in_known_unit(room: RoomSpec, model: RoomModel, because: str) -> tuple[RoomSpec, list[str]]:
    lines, unit, up = [], room.unit, room.up
    if unit is None:
        units = likely_units(Path(room.file or ""), room.space)
        if len(units) != 1:
            size = " x ".join(f"{x:.4g}" for x in np.ptp(model.vertices, axis=0))
            either = "; ".join(f"{u}: {why}" for u, why in units.items())
            raise InputError(
                "the unit of the room file is in doubt",
                where=str(room.file),
                found=f"a room of {size}, and no unit in the file",
                needed=f"a unit (--unit), one of {', '.join(units or METRES_PER_UNIT)}",
                hint=either or "no unit makes a usual room of it: look at the drawing",
            )
        ((unit, why),) = units.items()
        because = why if why.startswith("by") else f"guessed: {why}"
    lines.append(f"unit = {_quoted(unit)}" + (f"  # {because}" if because else ""))
    if up is None:
        up, why = likely_up(model)
        if why:
            lines.append(f"up = {_quoted(up)}  # guessed: {why}")
    else:
        lines.append(f"up = {_quoted(up)}")
    return replace(room, unit=unit, up=up), lines


def _material_lines(mesh: Mesh, materials: Mapping[str, str]) -> list[str]:
    lines = ["", "# What is known of a material before the measurement, if anything: a prior or a"]
    lines += ["# known absorption. Entries of `roomfit catalogue` are suggested by names alone."]
    owners = surface_materials(mesh.surfaces, materials)
    for name, area in material_areas(mesh, materials).items():
        if name is None:
            continue
        of = [s.name for s, owner in zip(mesh.surfaces, owners, strict=True) if owner == name]
        first, *others = suggested_entries(name) or ("",)
        where = "".join(c if c.isprintable() else "?" for c in in_short(of))
        lines += [f"[materials.{_quoted(name)}]  # {area:.1f} m2: {where}"]
        alike = f"  # or {', '.join(others)}" if others else ""
        lines += [f'# prior = "{first}"{alike}'] if first else []
    return lines


def _beside(folder: Path, file: Path) -> str:
    """Return a file as a campaign in a folder names it."""
    return Path(os.path.relpath(file, folder)).as_posix()


def _point_lines(kind: str, names: Sequence[str], positions: Positions) -> list[str]:
    lines = [""]
    for name in dict.fromkeys(names or ("S1" if kind == "sources" else "R1",)):
        lines.append(f"[{kind}.{_quoted(name)}]")
        if name in positions:
            lines.append(f"position = [{', '.join(f'{x:g}' for x in positions[name])}]")
        else:
            lines.append(f'position = "{FILL_IN}"  # [x, y, z] in m, z up')
    return lines


def _measurement_lines(
    recordings: Mapping[str, tuple[str, str]], template: str | None
) -> list[str]:
    lines = [
        "",
        "# What holds of all recordings, unless their own [[measurements]] say otherwise.",
    ]
    lines += ["[defaults]", *(f"# {line}" for line in _DEFAULTS)]
    if template is not None:
        return lines
    for file, (source, receiver) in (recordings or {FILL_IN: ("S1", "R1")}).items():
        lines += ["", "[[measurements]]", f"source = {_quoted(source)}"]
        lines += [f"receiver = {_quoted(receiver)}", f"file = {_quoted(file)}"]
    return lines


def _quoted(text: str | None) -> str:
    """Return a text as TOML writes it, which quotes as JSON does."""
    return json.dumps(text or "", ensure_ascii=False)
