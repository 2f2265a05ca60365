"""What the tabs show, as JSON, and what was sent: plain functions of the project folder.

A process of its own carries them out (`roomfit.app.jobs`); each says what the command line says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project
from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, RoomfitError, located
from roomfit.base.findings import Finding
from roomfit.cli.check import check_campaign_recordings
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.draft import check_unit
from roomfit.files.encoding import finding_content, numbers_or_null
from roomfit.files.inputs import check_campaign, positions_m
from roomfit.files.remedies import advised, unchosen
from roomfit.files.responses import SOUND_SUFFIXES, read_response
from roomfit.files.responses.recordings import UnchosenChannelError
from roomfit.files.responses.sweep import SweepPlan, response_from_recording, wav_bytes
from roomfit.files.rooms import read_mesh
from roomfit.files.schema import ResponseSpec, RoomSpec
from roomfit.files.values import read_decay_times, read_positions
from roomfit.formats.model import UnchosenSpaceError
from roomfit.report.room_figure import MOST_FACES, outline_m
from roomfit.report.wording import material_colour
from roomfit.room.mesh import Mesh, area_vectors_m2, triangle_areas_m2
from roomfit.room.scene import Room, check_mesh, surface_materials

_MOST_WALLS = 16  # of more walls names hide each other
_NO_MATERIAL = "(no material)"
_IN_WALLS = ("door", "window", "opening")  # of a scan, whose names would lie upon the wall's


def finding_of_error(error: RoomfitError) -> dict[str, Any]:
    """Return an error as a serious finding, for a page that shows it where it belongs."""
    sentence = "; ".join(filter(None, (error.what, error.where, error.found, error.hint)))
    points = [list(point) for point in error.points_m]
    about = {"points_m": points} if points else {}
    return {"code": "input", "severity": "serious", "sentence": sentence, "about": about}


# The room.


def room_view(folder: Path) -> dict[str, Any]:
    """Return the room for drawing, with materials, positions and faults, as far as it can be read.

    Faces are triangles of three corners and a surface, the largest 2,500 of them.
    """
    with project.filled_campaign(folder) as campaign:
        mesh, findings = read_mesh(campaign.room, positions_m(campaign))
        faults = list[dict[str, Any]]()
        try:
            check = check_campaign(campaign)
        except InputError as error:  # materials of the campaign and of the room disagree
            faults = [finding_of_error(error)]
            check = check_mesh(mesh, {}, findings)
    room, areas_m2 = _any_room(mesh, campaign.room.materials), triangle_areas_m2(mesh)
    by_surface_m2 = np.bincount(mesh.triangle_surface, areas_m2, len(mesh.surfaces))
    priors = {name: table.prior for name, table in campaign.materials.items()}
    points = {"sources": campaign.sources, "receivers": campaign.receivers}
    return {
        "vertices": np.round(mesh.vertices_m, 4).tolist(),
        "faces": [
            [*mesh.triangles[i].tolist(), int(mesh.triangle_surface[i])]
            for i in np.argsort(-areas_m2, kind="stable")[:MOST_FACES]
        ],
        "edges": np.round(outline_m(room), 4).tolist(),
        "surfaces": [
            {
                "name": s.name,
                "material": room.materials[int(k)],
                "material_index": int(k),
                "area_m2": round(float(a), 2),
                "sheet": bool(s.double_sided),
            }
            for s, k, a in zip(mesh.surfaces, room.surface_material, by_surface_m2, strict=True)
        ],
        "materials": [
            {
                "name": name,
                "colour": material_colour(i),
                "prior": priors[name] if isinstance(priors.get(name), str) else None,
            }
            for i, name in enumerate(room.materials)
        ],
        **{
            kind: [{"name": p.name, "position_m": np.asarray(p.position_m).tolist()} for p in own]
            for kind, own in points.items()
        },
        "findings": [*faults, *map(finding_content, check.findings)],
        "volume_m3": check.volume_m3,
        "surface_m2": check.surface_m2,
        "mean_free_path_m": numbers_or_null(check.mean_free_path_m),
        "traceable": check.traceable,
    }


def _any_room(mesh: Mesh, materials: Mapping[str, str]) -> Room:
    """Return a mesh as a room even where it has faults, which are to be drawn, too."""
    names = [name or _NO_MATERIAL for name in surface_materials(mesh.surfaces, materials)]
    order = tuple(dict.fromkeys(names))
    return Room(mesh, order, np.array([order.index(n) for n in names]))


def set_room(folder: Path, **room: Any) -> None:
    """Give the project its room, see `project.set_room`, and what was sent before it its names."""
    project.set_room(folder, **room)
    project.name_recordings(folder, project.table_positions(folder))


# Measurements.


def recordings_view(folder: Path) -> dict[str, Any]:
    """Return recordings by their names, positions, and what `roomfit check` says of them."""
    has_room, content = project.has_campaign(folder), project.campaign_content(folder)
    view: dict[str, Any] = {
        "template": next(iter(project.templates(content)), ""),
        "decay_times": str(content.get("reverberation", {}).get("file", "")),
        "page": "",
        **{key: [] for key in ("findings", "advised", "plan", "walls")},
    }
    rows: dict[str, dict[str, Any]] = {}
    known: dict[str, dict[str, Any]] = {"sources": {}, "receivers": {}}
    if has_room:
        with project.filled_campaign(folder) as campaign:
            for kind, points in (("sources", campaign.sources), ("receivers", campaign.receivers)):
                known[kind] = {p.name: np.asarray(p.position_m).tolist() for p in points}
                known[kind] |= {n: None for n in content.get(kind, {}) if n not in known[kind]}
            view["plan"], view["walls"] = _plan(campaign)
            for m in campaign.measurements:
                name = project.file_name(folder, Path(m.response.path))
                rows[name] = {"file": name, "source": m.source, "receiver": m.receiver}
    tables: Mapping[str, object] = {}
    try:
        tables = project.table_positions(folder)
    except RoomfitError as error:  # somebody has put it there by another way
        view["findings"].append(finding_of_error(error))
    for name, (source, receiver) in project.named_recordings(folder, tables).items():
        rows.setdefault(name, {"file": name, "source": source, "receiver": receiver})
        known["sources"].setdefault(source, None)
        known["receivers"].setdefault(receiver, None)
    view["positions"] = [
        {"kind": kind, "name": name, "position_m": position}
        for kind, points in known.items()
        for name, position in points.items()
    ]
    view["rows"] = list(rows.values())
    missing = [p["name"] for p in view["positions"] if p["position_m"] is None]
    sent = [f"{project.RECORDINGS}/{p.name}" for p in project.listed(folder, project.RECORDINGS)]
    unused = [name for name in sent if name not in rows]
    idle = [name for name in tables if name not in {p["name"] for p in view["positions"]}]
    for names, sentence in (
        (
            missing if rows else [],
            "Where {} stand is not known: type x, y, z into the table, or take a table of "
            "positions.",
        ),
        (unused, "Left out, names that do not fit: {}."),
        (idle, "Positions that no recording names: {}."),
    ):
        own = {"code": "positions", "severity": "warning", "about": {}}
        if names:
            view["findings"].append({**own, "sentence": sentence.format(in_short(names))})
    if rows and has_room and not missing:  # without a place of each nothing can be examined
        _examine(folder, view)
    return view


def _examine(folder: Path, view: dict[str, Any]) -> None:
    """Add what `roomfit check` says of the recordings."""
    try:
        campaign = read_campaign(project.campaign_file(folder))
        out = project.inside(folder, folder / project.CHECKED)
        checked = check_campaign_recordings(campaign, out, overwrite=True)
        view["advised"] = advice_view(checked.findings, campaign)
        view["findings"] += map(finding_content, checked.findings)
        made_ns = (out / "recordings.html").stat().st_mtime_ns
        view["page"] = f"files/{project.CHECKED}/recordings.html?of={made_ns}"
    except UnchosenChannelError as error:
        view["advised"] = advice_view([unchosen(error)], campaign)
        view["findings"].append(finding_content(unchosen(error)))
    except RoomfitError as error:
        view["findings"].append(finding_of_error(error))


def table_positions(folder: Path, table: str = "") -> list[dict[str, Any]]:
    """Return positions in m by name of all tables that were sent, and those of one of them."""
    place = project.upload_place(folder, project.POSITIONS, table) if table else None
    return [project.table_positions(folder), {} if place is None else read_positions(place)[0]]


def _plan(campaign: Campaign) -> tuple[list[list[float]], list[list[Any]]]:
    """Return the edges of the room from above, each x, y, x, y in m, and x, y, name of walls."""
    mesh = read_mesh(campaign.room, positions_m(campaign))[0]
    edges = outline_m(_any_room(mesh, campaign.room.materials))[:, :, :2]
    # an upright edge is a point from above, and two lie upon each other
    plan: list[list[float]] = np.unique(np.round(edges.reshape(-1, 4), 3), axis=0).tolist()
    areas, centres_m = triangle_areas_m2(mesh), mesh.vertices_m[mesh.triangles].mean(axis=1)
    is_wall = np.abs(area_vectors_m2(mesh)[:, 2]) < 0.3 * areas  # upright, or nearly
    walls = []
    for i, surface in enumerate(mesh.surfaces):
        own = is_wall & (mesh.triangle_surface == i)
        if own.any() and surface.group not in _IN_WALLS:
            at_m = np.average(centres_m[own], axis=0, weights=areas[own])
            walls.append([*np.round(at_m[:2], 3).tolist(), surface.name])
    return plan, walls if len(walls) <= _MOST_WALLS else []


def advice_view(
    findings: Sequence[Finding], campaign: Campaign, *, changed: bool = False
) -> list[dict[str, Any]]:
    """Return what `roomfit.files.remedies.advised` does, for a page."""
    shown = []
    for code, options in advised(findings, campaign, changed=changed).items():
        own = [f for f in findings if f.code is code]
        severity = "serious" if any(f.severity == "serious" for f in own) else own[0].severity
        entry = {"code": code.value, "severity": severity, "n": len(own)}
        shown.append({**entry, "options": [asdict(one) for one in options]})
    return shown


# What was sent.


@contextmanager
def _placeless(path: Path, hint: str | None = None) -> Iterator[None]:
    """Say in errors of a file that waits its name alone: where it waits is nobody's business."""
    try:
        yield
    except RoomfitError as error:
        where = None
        if error.where is not None and error.where.startswith(str(path)):
            where, hint = error.where.replace(str(path), path.name), error.hint
        found, needed = error.found, error.needed
        raise InputError(error.what, where=where, found=found, needed=needed, hint=hint) from None


def look_at_upload(folder: Path, kind: str, file: str) -> None:
    """Read a file that somebody has sent, as far as its kind can be read by itself."""
    path = folder / file
    with _placeless(path):
        if kind == "room":
            try:
                read_mesh(RoomSpec(file=path))
            except UnchosenSpaceError:
                pass  # it is asked for later
            except InputError:  # perhaps its unit is in doubt, which is asked for later
                read_mesh(RoomSpec(file=path, unit="m"))
        elif kind == project.DECAY_TIMES:
            read_decay_times(path)
        elif kind == project.POSITIONS:
            positions, _ = read_positions(path)
            if project.has_campaign(folder):  # in the unit of its room?
                with project.filled_campaign(folder) as campaign, located(str(path)):
                    check_unit(read_mesh(campaign.room)[0], positions)
        elif path.suffix.lower() in SOUND_SUFFIXES:  # of others choices are to be made first
            with suppress(UnchosenChannelError):
                read_response(ResponseSpec(path))


def measure(folder: Path, file: str, plan: dict[str, Any]) -> dict[str, Any]:
    """Write the response of a recording, ``recorded`` beside it; return its quality."""
    path = folder / file
    with _placeless(path, "measure again"):
        recorded = np.frombuffer(read_bytes(path.with_name("recorded"), "recording"), "<f4")
    measured = response_from_recording(SweepPlan(**plan), recorded.astype(np.float64))
    path.write_bytes(wav_bytes(measured.response))
    return measured.content()
