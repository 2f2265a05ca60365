"""A first campaign file from what there is: a room, recordings by their names, positions.

What cannot be known is a blank, `FILL_IN`, with which no campaign is read; what was guessed says so
in a comment beside it.
"""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, located
from roomfit.base.polygon import area_vector_m2, place
from roomfit.base.typing import FloatArray
from roomfit.files.campaign import FILL_IN
from roomfit.files.edits import value_text
from roomfit.files.encoding import one_line
from roomfit.files.responses.sofa import read_sofa_pairs
from roomfit.files.rooms import read_mesh, read_model
from roomfit.files.schema import RoomSpec
from roomfit.files.tables import unit_of
from roomfit.formats.model import METRES_PER_UNIT, RoomModel, Thing
from roomfit.materials.catalogue import catalogue, suggested_entries
from roomfit.room.audience import audience_area_m2
from roomfit.room.build import is_level_by_name
from roomfit.room.mesh import Mesh, refuse
from roomfit.room.scene import material_areas, misread, surface_materials

# Rooms of people and sound, m and m3: of the units that a size permits, these are plausible.
_LEAST_M, _HIGHEST_M, _LONGEST_M, _LARGEST_M3 = 1.5, 20.0, 150.0, 60_000.0
_STATED_UNIT = re.compile(r"\bunits?\b\W{0,4}([a-z]+)", re.IGNORECASE)
_HEADER_BYTES = 4096
_CLEARLY = 0.75  # an axis along which a room is shorter than that points up
_DEFAULTS = (
    "latency_s = 0.0        # from the first sample to emission",
    'time_zero = "unknown"  # where recordings and source share no clock',
    'level = "per-file"     # where the gain was changed between recordings',
    'excitation = "sweep.wav"  # where they are recordings of a sweep',
)
_SAME_M = 0.01
Positions = Mapping[str, Sequence[float]]


def likely_units(room: Path, space: str | None = None) -> dict[str, str]:
    """Return each unit that a room file may be in, with the reason in words, the stated one alone.

    A format or a header that states its unit decides; else it is by size, and more than one unit,
    or none, means that somebody must say.
    """
    model, _ = read_model(RoomSpec(file=room, space=space))
    if model.unit is not None:
        return {model.unit: "by the format of the file"}
    head = read_bytes(room, "room file")[:_HEADER_BYTES].decode("ascii", errors="replace")
    stated = [unit for m in _STATED_UNIT.findall(head) if (unit := unit_of(m.lower()))]
    if stated:
        return {stated[0]: "by the header of the file"}
    return plausible_units(np.ptp(model.vertices, axis=0))


def plausible_units(size: FloatArray) -> dict[str, str]:
    """Return the units in which a bounding box, shape (3,), is a room, with its size in words."""
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


class Carried(NamedTuple):
    """What files of responses say themselves of pairs, positions, room and air."""

    rows: Sequence[Mapping[str, str | int]]  # of [[measurements]]
    positions: Positions
    lengths_m: tuple[float, float, float] | None
    temperature_c: float | None
    doubts: Sequence[str]


def carried_in(
    folder: Path, recordings: Mapping[str, tuple[str, str]], known: Positions, room: RoomSpec | None
) -> Carried:
    """Return what the SOFA files among recordings hold: a row for each response.

    Positions within 1 cm are one, and those that are `known` decide; a file of one response has its
    pair by its name. Where a file does not say where it was measured, sources are blank, and
    receivers numbered. Positions count from the corner of the file's room where that is the room.
    """
    rows, doubts = list[dict[str, str | int]](), list[str]()
    names = {kind: {n: np.array(p) for n, p in known.items()} for kind in ("source", "receiver")}
    boxes, celsius = list[tuple[float, float, float]](), list[float]()
    for file, pair in recordings.items():
        if not file.lower().endswith(".sofa"):
            continue
        with located(str(folder / file)):
            own = read_sofa_pairs(read_bytes(folder / file, "response file"))
        doubts += [f"{file}: {text}" for text in own.doubts]
        boxes += [] if own.lengths_m is None else [own.lengths_m]
        celsius += [] if own.temperature_c is None else [own.temperature_c]
        box = own.lengths_m if room is None else room.shoebox
        is_own = own.lengths_m and box and np.allclose(box, own.lengths_m, atol=_SAME_M)
        ends_m = own.ends_m - own.corner_m if is_own else own.ends_m
        for i, choice in enumerate(own.choices):
            row: dict[str, str | int] = {}
            for (kind, stand), at_m, name in zip(names.items(), ends_m[:, i], pair, strict=True):
                if choice:
                    near = (n for n, p in stand.items() if np.linalg.norm(p - at_m) <= _SAME_M)
                    new = (f"{kind[0].upper()}{k}" for k in range(1, len(stand) + 2))
                    name = next(near, next(n for n in new if n not in stand))
                is_blank = choice and kind == "source" and not np.isfinite(at_m).all()
                row[kind] = FILL_IN if is_blank else name
                before = at_m if is_blank else stand.setdefault(name, at_m)
                if not is_blank and not np.isfinite(before).all():
                    stand[name] = at_m
                elif np.linalg.norm(before - at_m) > _SAME_M:
                    found = f"{name} at {place(at_m)} in {file}, and at {place(before)}"
                    if name not in known:
                        what, needed = "one name stands at two places", "one place for each name"
                        hint = "give --positions, which decides, or names of their own to the files"
                        raise InputError(what, found=found, needed=needed, hint=hint)
                    doubts.append(f"{found} in the table of positions, which applies")
            rows.append({**row, "file": file, **choice})
    stands = {n: p for stand in names.values() for n, p in stand.items() if np.isfinite(p).all()}
    positions = {n: tuple(p.round(3).tolist()) for n, p in stands.items()} | dict(known)
    if len(set(boxes)) > 1:
        doubts.append("files of responses disagree on the size of the room, which is left blank")
    lengths_m = boxes[0] if len(set(boxes)) == 1 else None
    return Carried(rows, positions, lengths_m, float(np.mean(celsius)) if celsius else None, doubts)


def draft_campaign(
    room: RoomSpec | None,
    recordings: Mapping[str, tuple[str, str]],
    positions: Positions | None = None,
    *,
    folder: Path,
    template: str | None = None,
    because: str = "",
    decay_times: Path | None = None,
    carried: Carried | None = None,
) -> str:
    """Return the text of a first campaign file, blanks in place of what is not known.

    A unit of the room that is None is guessed, and so is the axis that points up; `because` says
    why it is what it is. `recordings` are files, relative to the `folder` where the campaign will
    stand, with source and receiver; the template of their names takes the place of a table for
    each, a table of decay times that of positions and recordings.
    """
    carried = carried or Carried((), {}, None, None, ())
    positions, celsius = {**carried.positions, **(positions or {})}, carried.temperature_c
    if room is None and carried.lengths_m is not None:
        room = RoomSpec(shoebox=carried.lengths_m)
    own = {str(row["file"]) for row in carried.rows}
    rows: list[Mapping[str, str | int]] = [
        {"source": source, "receiver": receiver, "file": file}
        for file, (source, receiver) in recordings.items()
        if file not in own
    ]
    rows += carried.rows
    if decay_times is not None:
        commands = (
            "reverberation campaign.toml",
            "predict campaign.toml --set MATERIAL=0.6 --out predicted",
        )
        table = f"file = {value_text(_beside(folder, decay_times))}"
        before, fitted = [], ["[reverberation]", table]
        after = []
    else:
        commands = ("check campaign.toml", "identify campaign.toml --out result")
        before = [] if template is None else [f"recordings = {value_text(template)}", ""]
        after = [
            *_point_lines("sources", [str(row["source"]) for row in rows], positions),
            *_point_lines("receivers", [str(row["receiver"]) for row in rows], positions),
            *([] if celsius is None else ["", "[air]", f"temperature_c = {celsius:.1f}"]),
            *_measurement_lines(rows, template),
        ]
        fitted = ["[identify]", "from_hz = 125", "to_hz = 4000"]
    is_known = decay_times is not None
    lines = [
        "# A first campaign, made by `roomfit init`. Blanks are marked FILL IN. Then:",
        *(f"#   roomfit {command}" for command in commands),
        *(f"# In doubt: {one_line(text)}." for text in carried.doubts),
        "",
        *before,
        "[room]",
        *_room_lines(room, folder, because, positions, is_known=is_known),
        *after,
        "",
        *fitted,
        "",
        "# what stands above the report",
        "[project]",
        f"title = {value_text(one_line(folder.resolve().name)[:120].strip() or 'Room')}",
        *(f'# {key} = ""' for key in ("client", "author", "date")),
    ]
    return "\n".join(lines) + "\n"


def _room_lines(
    room: RoomSpec | None, folder: Path, because: str, positions: Positions, *, is_known: bool
) -> list[str]:
    """Return the room, its materials, and what stands in it; an object's area may be known."""
    if room is None:
        return [f'shoebox = "{FILL_IN}"  # lengths along x, y, z in m; or file = "room.obj"']
    if room.file is None:
        unit = [f"unit = {value_text(room.unit)}"] if room.unit not in (None, "m") else []
        lines = [f"shoebox = [{', '.join(f'{x:g}' for x in room.shoebox or ())}]", *unit]
        materials = {name: name for name in ("walls", "floor", "ceiling")}
        mesh, _ = read_mesh(room)
        check_unit(mesh, positions)
        lines += ["", "# which material is where: south, north, east and west are the walls"]
        lines += ["[room.materials]", *(f"{k} = {value_text(v)}" for k, v in materials.items())]
        return [*lines, *_material_lines(mesh, materials)]
    model, _ = read_model(room)
    spec, lines = _in_known_unit(room, model, because)
    space = [] if room.space is None else [f"space = {value_text(room.space)}"]
    lines = [f"file = {value_text(_beside(folder, room.file))}", *space, *lines]
    mesh, _ = read_mesh(spec)
    check_unit(mesh, positions)
    bare = [s.name for s in mesh.surfaces if s.file_material is None]
    if bare:
        lines += ["", "# surfaces without a material in the file", "[room.materials]"]
        lines += [f'{value_text(name)} = "{FILL_IN}"' for name in dict.fromkeys(bare)]
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
        if own:
            key = "absorption_area_m2" if is_known else "prior"
            table = [
                f"[objects.{value_text(kind)}]  # {len(own)} by the scan",
                *_area_lines(kind, own, mesh),
                f'{key} = "{entry}"  # or other seats-...',
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
    """Refuse positions most of which lie outside the room, and all of which inside in some unit."""
    refuse(misread(mesh, np.array(list(positions.values())).reshape(-1, 3)))


def _in_known_unit(room: RoomSpec, model: RoomModel, because: str) -> tuple[RoomSpec, list[str]]:
    """Return a room with a unit and an upward axis, stated or guessed, and the lines of both."""
    unit, up, why_up = room.unit, str(room.up or ""), ""
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
    if not up:
        up, why_up = likely_up(model)
    lines = [f"unit = {value_text(unit)}" + (f"  # {because}" if because else "")]
    if why_up or room.up is not None:
        lines.append(f"up = {value_text(up)}" + (f"  # guessed: {why_up}" if why_up else ""))
    return room.model_copy(update={"unit": unit, "up": up}), lines


def _material_lines(mesh: Mesh, materials: Mapping[str, str]) -> list[str]:
    text = (
        f"What each material is, where somebody knows: {', '.join(catalogue().classes)}, or a kind "
        "of `roomfit catalogue`. Suggested by names alone; what stays a comment is not taken."
    )
    lines = ["", *textwrap.wrap(text, 96, initial_indent="# ", subsequent_indent="# ")]
    owners = surface_materials(mesh.surfaces, materials)
    for name, area in material_areas(mesh, materials).items():
        if name is None:
            continue
        of = [s.name for s, owner in zip(mesh.surfaces, owners, strict=True) if owner == name]
        where = "".join(c if c.isprintable() else "?" for c in in_short(of))
        lines.append(f"[materials.{value_text(name)}]  # {area:.1f} m2: {where}")
        first, *others = suggested_entries(name) or ("...",)
        lines.append(f'# prior = "{first}"' + (f"  # or {', '.join(others)}" if others else ""))
    return lines


def _beside(folder: Path, file: Path) -> str:
    """Return a file as a campaign in a folder names it."""
    return Path(os.path.relpath(file, folder)).as_posix()


def _point_lines(kind: str, names: Sequence[str], positions: Positions) -> list[str]:
    lines = [""]
    known = [name for name in names if name != FILL_IN]
    for name in dict.fromkeys(known or ("S1" if kind == "sources" else "R1",)):
        place = f'"{FILL_IN}"  # [x, y, z] in m, z up'
        if name in positions:
            place = f"[{', '.join(f'{x:g}' for x in positions[name])}]"
        lines += [f"[{kind}.{value_text(name)}]", f"position = {place}"]
    return lines


def _measurement_lines(rows: Sequence[Mapping[str, str | int]], template: str | None) -> list[str]:
    lines = ["", "# What holds of all recordings, unless their own [[measurements]] say otherwise."]
    lines += ["[defaults]", *(f"# {line}" for line in _DEFAULTS)]
    if template is not None:
        return lines
    for own in rows or [{"source": "S1", "receiver": "R1", "file": FILL_IN}]:
        lines += ["", "[[measurements]]", *(f"{k} = {value_text(v)}" for k, v in own.items())]
    return lines
