"""What the tabs show, as JSON: plain functions of the project folder, carried out by the worker.

Each takes a function for progress first and says what a command of the command line says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.app import project, recordings
from roomfit.app.treatment import ask_treatment, treatment_view
from roomfit.app.what_if import what_if, what_if_prepare
from roomfit.base.arguments import in_short
from roomfit.base.door import read_bytes
from roomfit.base.errors import InputError, RoomfitError, located
from roomfit.base.findings import About, Code, Finding
from roomfit.base.typing import Progress
from roomfit.cli.check import check_campaign_recordings
from roomfit.cli.identify import identify_to_folder
from roomfit.cli.listen import listen_to_folder
from roomfit.cli.reverberation import reverberation_to_folder
from roomfit.cli.treat import treat_to_folder
from roomfit.demo.boxes import demo_plan, write_measured_box
from roomfit.files.campaign import Campaign, read_campaign
from roomfit.files.draft import check_unit, read_positions
from roomfit.files.encoding import (
    EditedFile,
    finding_content,
    finding_of,
    number_or_null,
    numbers_or_null,
)
from roomfit.files.inputs import check_campaign
from roomfit.files.questions import Wanted
from roomfit.files.remedies import advised, changed_since, is_file
from roomfit.files.responses import SOUND_SUFFIXES, read_response
from roomfit.files.responses.recordings import ResponseSpec
from roomfit.files.responses.sweep import SweepPlan, response_from_recording, wav_bytes
from roomfit.files.results import read_result_content
from roomfit.files.reverberation import read_decay_times
from roomfit.files.rooms import read_mesh
from roomfit.files.rooms.model import RoomSpec
from roomfit.formats.model import UnchosenSpaceError
from roomfit.predict.changes import read_change
from roomfit.report.room_figure import MOST_FACES, outline_m
from roomfit.report.text import text
from roomfit.report.wording import material_colour
from roomfit.room.mesh import Mesh, area_vectors_m2, triangle_areas_m2
from roomfit.room.scene import Room, check_mesh, surface_materials

_MOST_WALLS = 16  # of more walls names hide each other
_NO_MATERIAL = "(no material)"
_IN_WALLS = ("door", "window", "opening")  # of a scan, whose names would lie upon the wall's
_FEW = 3  # a finding about more recordings, or more materials, than these stands by itself
_VOIDING = frozenset(code.value for code in Code if code.voids_identifiability)


def finding_of_error(error: RoomfitError) -> dict[str, Any]:
    """Return an error as a serious finding, for a page that shows it where it belongs."""
    sentence = "; ".join(filter(None, (error.what, error.where, error.found, error.hint)))
    points = [list(point) for point in error.points_m]
    about = {"points_m": points} if points else {}
    return {"code": "input", "severity": "serious", "sentence": sentence, "about": about}


def room_view(_: Progress, folder: str) -> dict[str, Any]:
    """Return the room for drawing, with materials, positions and faults, as far as it can be read.

    Faces are triangles of three corners and a surface, the largest 2,500 of them.
    """
    with project.filled_campaign(Path(folder)) as campaign:
        mesh, findings = read_mesh(campaign.room)
        try:
            check = check_campaign(campaign)
            faults: list[dict[str, Any]] = []
        except InputError as error:  # materials of the campaign and of the room disagree
            faults = [finding_of_error(error)]
            check = check_mesh(mesh, {}, findings)
            room = _any_room(mesh, {})
        else:
            room = _any_room(mesh, campaign.room.materials)
        priors = {name: table.prior for name, table in campaign.materials.items()}
        points = {"sources": campaign.sources, "receivers": campaign.receivers}
    largest = np.argsort(-triangle_areas_m2(mesh), kind="stable")[:MOST_FACES]
    return {
        "vertices": np.round(mesh.vertices_m, 4).tolist(),
        "faces": [[*mesh.triangles[i].tolist(), int(mesh.triangle_surface[i])] for i in largest],
        "edges": np.round(outline_m(room), 4).tolist(),
        **_surfaces(room, priors),
        **{
            kind: [{"name": p.name, "position_m": np.asarray(p.position_m).tolist()} for p in own]
            for kind, own in points.items()
        },
        "findings": [*faults, *map(finding_content, check.findings)],
        "volume_m3": check.volume_m3,
        "surface_m2": check.surface_m2,
        "mean_free_path_m": number_or_null(check.mean_free_path_m),
        "traceable": check.traceable,
    }


def _surfaces(room: Room, priors: Mapping[str, object]) -> dict[str, Any]:
    """Return what the tab lists of surfaces and materials, with areas, colours and priors."""
    mesh = room.mesh
    areas = triangle_areas_m2(mesh)
    by_surface = np.bincount(mesh.triangle_surface, areas, len(mesh.surfaces))
    return {
        "surfaces": [
            {
                "name": s.name,
                "material": room.materials[int(k)],
                "material_index": int(k),
                "area_m2": round(float(a), 2),
                "sheet": bool(s.double_sided),
            }
            for s, k, a in zip(mesh.surfaces, room.surface_material, by_surface, strict=True)
        ],
        "materials": [
            {
                "name": name,
                "colour": material_colour(i),
                "area_m2": round(float(by_surface[room.surface_material == i].sum()), 2),
                "prior": priors.get(name) if isinstance(priors.get(name), str) else None,
            }
            for i, name in enumerate(room.materials)
        ],
    }


def _any_room(mesh: Mesh, materials: Mapping[str, str]) -> Room:
    """Return a mesh as a room even where it has faults, which are to be drawn, too."""
    names = [name or _NO_MATERIAL for name in surface_materials(mesh.surfaces, materials)]
    order = tuple(dict.fromkeys(names))
    return Room(mesh, order, np.array([order.index(n) for n in names]))


def recordings_view(_: Progress, folder: str) -> dict[str, Any]:
    """Return recordings by their names, positions, and what `roomfit check` says of them."""
    root = Path(folder)
    rows: dict[str, dict[str, Any]] = {}
    view: dict[str, Any] = {"bands_hz": [], "findings": [], "plan": [], "advised": []}
    known: dict[str, dict[str, Any]] = {"sources": {}, "receivers": {}}
    view |= {"walls": [], "template": "", "decay_times": ""}
    if project.has_campaign(root):
        content = project.campaign_content(root)
        view["template"] = next(iter(recordings.templates(content)), "")
        view["decay_times"] = str(content.get("reverberation", {}).get("file", ""))
        with project.filled_campaign(root) as campaign:
            for kind, points in (("sources", campaign.sources), ("receivers", campaign.receivers)):
                known[kind] = {p.name: np.asarray(p.position_m).tolist() for p in points}
                known[kind] |= {n: None for n in content.get(kind, {}) if n not in known[kind]}
            view["plan"], view["walls"] = _plan(campaign)
            for m in campaign.measurements:
                name = recordings.file_name(root, Path(m.response.path))
                rows[name] = {"file": name, "source": m.source, "receiver": m.receiver}
    tables: Mapping[str, object] = {}
    try:
        tables = recordings.table_positions(root)
    except RoomfitError as error:  # somebody has put it there by another way
        view["findings"].append(finding_of_error(error))
    for name, (source, receiver) in recordings.named_recordings(root, [*tables]).items():
        rows.setdefault(name, {"file": name, "source": source, "receiver": receiver})
        known["sources"].setdefault(source, None)
        known["receivers"].setdefault(receiver, None)
    view["positions"] = [
        {"kind": kind, "name": name, "position_m": position}
        for kind in ("sources", "receivers")
        for name, position in known[kind].items()
    ]
    view["rows"] = list(rows.values())
    view["findings"] += _about_names(root, rows, view["positions"], tables)
    # without a place of each nothing can be examined, and that is said already
    is_placed = all(p["position_m"] is not None for p in view["positions"])
    if rows and is_placed and project.has_campaign(root):
        try:
            _check(root, rows, view)
        except RoomfitError as error:
            view["findings"].append(finding_of_error(error))
    return view


def _about_names(
    root: Path,
    rows: Mapping[str, object],
    positions: Iterable[Mapping[str, Any]],
    tables: Mapping[str, object],
) -> list[dict[str, Any]]:
    """Return which positions are not known, and which names of files and tables fit nothing."""
    missing = [p["name"] for p in positions if p["position_m"] is None]
    unused = recordings.unused_recordings(root, rows)
    idle = [name for name in tables if name not in [p["name"] for p in positions]]
    texts = {
        f"Where {in_short(missing)} stand is not known: type x, y, z into the table, or take a "
        "table of positions.": bool(rows and missing),
        f"Left out, names that do not fit: {in_short(unused)}.": bool(unused),
        f"Positions that no recording names: {in_short(idle)}.": bool(idle),
    }
    finding = {"code": "positions", "severity": "warning", "about": {}}
    return [{**finding, "sentence": text} for text, is_so in texts.items() if is_so]


def table_positions(_: Progress, folder: str, table: str = "") -> list[dict[str, Any]]:
    """Return positions in m by name of all tables that were sent, and those of one of them."""
    root = Path(folder)
    place = project.upload_place(root, project.POSITIONS, table) if table else None
    return [recordings.table_positions(root), {} if place is None else dict(read_positions(place))]


def _plan(campaign: Campaign) -> tuple[list[list[float]], list[list[Any]]]:
    """Return the edges of the room from above, each x, y, x, y in m, and x, y, name of walls."""
    mesh = read_mesh(campaign.room)[0]
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


def _check(root: Path, rows: dict[str, dict[str, Any]], view: dict[str, Any]) -> None:
    """Add what is known of each recording, and findings to the recordings that they are about."""
    campaign = read_campaign(project.campaign_file(root))
    checked = check_campaign_recordings(campaign)
    view["advised"] = advice_view(checked.findings, campaign)
    view["bands_hz"] = checked.bands.centres_hz.tolist()
    by_pair = {(r["source"], r["receiver"], Path(f).name): r for f, r in rows.items()}
    for i, m in enumerate(checked.measurements):
        row = by_pair.get((m.source, m.receiver, m.name))
        if row is None:
            continue
        row |= {
            "onset_ms": number_or_null(1e3 * checked.onset_s[i]),
            "travel_ms": number_or_null(1e3 * checked.travel_s[i]),
            "noise_db": numbers_or_null(checked.peak_to_noise_db[i]),
            "range_db": numbers_or_null(checked.decay_range_db[i]),
            "usable": checked.usable[i].tolist(),
            "has_t20": checked.has_t20[i].tolist(),
            "notes": [],
        }
    examined = [row for row in rows.values() if "notes" in row]
    for finding in checked.findings:
        content = finding_content(finding)
        own = concerned_recordings(finding.about, examined)
        for row in own if len(own) <= _FEW or len(own) < len(examined) else ():
            row["notes"].append(content)  # what is about all of them stands once, above
        if not own or len(own) > _FEW:
            view["findings"].append(content)


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


def concerned_recordings(about: About, rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows, each with file, source and receiver, that a finding names; never all."""
    return [
        row
        for row in rows
        if (about.files or about.pairs)
        and (not about.files or any(is_file(name, row["file"]) for name in about.files))
        and (not about.pairs or (row["source"], row["receiver"]) in about.pairs)
    ]


def result_view(_: Progress, folder: str, name: str) -> dict[str, Any] | None:
    """Return absorption with intervals by material, and findings, None where there is no result.

    ``beside`` of a finding are the materials at which it is shown; ``usable`` says what still
    holds, where a finding voids what is identifiable; ``advised`` is what `advice_view` returns;
    ``mean`` is that of decay times alone, with its interval: in each band three numbers.
    """
    file = Path(folder) / name / "result.json"
    if not file.is_file():
        return None
    content, doubts = read_result_content(EditedFile(file))
    content["findings"] = [*content["findings"], *map(finding_content, doubts)]
    materials, findings = content["materials"], []
    for finding in content["findings"]:
        named = finding.get("about", {}).get("materials", [])
        own = [m for m in named if m in materials]
        findings.append({**finding, "beside": own if len(own) <= _FEW else []})
    voids = any(finding["code"] in _VOIDING for finding in findings)
    keys = ("absorption", "lower95", "upper95", "identifiable", "area_m2")
    stale = changed_since(content, project.campaign_file(Path(folder)))
    means = content.get("combinations", []) if "reverberation" in content else []
    return {
        "mean": [[m[key] for key in keys[:3]] for m in means],
        "bands_hz": content["bands_hz"],
        "materials": {m: {k: own[k] for k in keys} for m, own in materials.items()},
        "findings": findings,
        "usable": content.get("usable", []) if voids else [],
        "plan": content.get("plan", []),
        "seconds": content["fit"].get("seconds"),
        "made": file.stat().st_mtime,
        "stale": stale,
        "advised": [] if doubts else _advised_by(content, Path(folder), stale),
    }


def _advised_by(content: Mapping[str, Any], folder: Path, stale: bool) -> list[dict[str, Any]]:
    """Return what a result advises; nothing where the campaign cannot be read any more."""
    with suppress(InputError):
        campaign = read_campaign(project.campaign_file(folder), to_fit=False)
        findings = [finding_of(f, "result.json") for f in content["findings"]]
        return advice_view(findings, campaign, changed=stale)
    return []


def identify(progress: Progress, folder: str, quick: bool) -> str:
    """Identify, as ``roomfit identify [--quick]`` does, into the folder of this kind of answer."""
    root = Path(folder)
    out = root / (project.QUICK if quick else project.FULL)
    project.inside(root, out)
    identify_to_folder(
        project.campaign_file(root), out, quick=quick, overwrite=True, progress=progress
    )
    return out.name


def reverberation(_: Progress, folder: str) -> str:
    """Find the mean absorption from decay times alone, as ``roomfit reverberation`` does."""
    root = Path(folder)
    out = root / project.MEAN
    project.inside(root, out)
    reverberation_to_folder(project.campaign_file(root), out, overwrite=True)
    return out.name


def demo(progress: Progress, folder: str) -> str:
    """Write the campaign of ``roomfit demo``: a simulated room of known absorption."""
    root = Path(folder)
    if project.has_campaign(root):
        what = "the folder has a campaign already"
        needed, hint = "a folder without a campaign", "start roomfit app in a new folder"
        raise InputError(what, where=str(root), found="campaign.toml", needed=needed, hint=hint)
    write_measured_box(demo_plan(), root, np.random.default_rng(1), progress)
    return "campaign.toml"


def set_room(_: Progress, folder: str, **room: Any) -> None:
    """Give the project its room, see `project.set_room`, and what was sent before it its names."""
    project.set_room(Path(folder), **room)
    recordings.name_recordings(Path(folder), recordings.table_positions(Path(folder)))


def treat(progress: Progress, folder: str, doubted: bool = False) -> str:
    """Choose what to hang where, as ``roomfit treat`` does; return the answer in words."""
    root = Path(folder)
    result = project.best_result(root)
    project.answer_file(root, or_decay_times=True)
    out = root / project.TREATMENT
    project.inside(root, out)
    _, shown = treat_to_folder(
        project.campaign_file(root),
        result,
        root / project.TREATMENT_QUESTION,
        out,
        wanted=Wanted(doubted=doubted),
        overwrite=True,
        progress=progress,
    )
    return text(shown)


def look_at_upload(_: Progress, folder: str, kind: str, file: str) -> None:
    """Read a file that somebody has sent, as far as its kind can be read by itself."""
    path = Path(folder) / file
    try:
        if kind == "room":
            try:
                read_mesh(RoomSpec(file=path))
            except UnchosenSpaceError:
                pass  # it is asked for later
            except InputError:  # perhaps its unit is in doubt, which is asked for later
                read_mesh(RoomSpec(file=path, unit="m"))
        elif kind in (project.POSITIONS, project.DECAY_TIMES):
            _look_at_table(Path(folder), kind, path)
        elif path.suffix.lower() in SOUND_SUFFIXES:  # of others choices are to be made first
            try:
                read_response(ResponseSpec(path, channel=0))
            except InputError as error:  # perhaps the first channel of several is silent
                try:
                    read_response(ResponseSpec(path, channel=1))
                except InputError:
                    raise error from None
    except RoomfitError as error:
        # the place where it waits is nobody's business
        is_own = error.where is not None and error.where.startswith(str(path))
        where = str(error.where).replace(str(path), path.name) if is_own else None
        hint = error.hint if is_own else None
        found, needed = error.found, error.needed
        raise InputError(error.what, where=where, found=found, needed=needed, hint=hint) from None


def _look_at_table(root: Path, kind: str, path: Path) -> None:
    """Refuse a table that is none, or whose positions are in another unit than the room."""
    if kind == project.DECAY_TIMES:
        read_decay_times(path)
        return
    positions = read_positions(path)
    if project.has_campaign(root):
        with project.filled_campaign(root) as campaign, located(str(path)):
            check_unit(read_mesh(campaign.room)[0], positions)


def measure(_: Progress, folder: str, file: str, plan: dict[str, Any]) -> dict[str, Any]:
    """Write the response of a recording, ``recorded`` beside it; return its quality."""
    path = Path(folder) / file
    try:
        recorded = np.frombuffer(read_bytes(path.with_name("recorded"), "recording"), "<f4")
    except RoomfitError as error:  # without the place, which is nobody's business
        raise InputError(
            error.what, found=error.found, needed=error.needed, hint="measure again"
        ) from None
    measured = response_from_recording(SweepPlan(**plan), recorded.astype(np.float64))
    path.write_bytes(wav_bytes(measured.response))
    return measured.content()


def listen(
    progress: Progress, folder: str, changes: list[str], dry: str = "", doubted: bool = False
) -> str:
    """Make what a change sounds like, as ``roomfit listen`` does."""
    root = Path(folder)
    result = project.answer_file(root)
    if not changes:
        what = "there is nothing to compare yet"
        needed = "one change or more"
        raise InputError(what, found="no change", needed=needed, hint="change a wall under What if")
    out = root / project.LISTENED
    project.inside(root, out)
    listen_to_folder(
        project.campaign_file(root),
        result,
        out,
        [read_change(text) for text in changes],
        Wanted("campaign", doubted=doubted),
        dry=project.upload_place(root, project.DRY, dry) if dry else None,
        overwrite=True,
        progress=progress,
    )
    return out.name


def export(_: Progress, folder: str, wanted: str) -> list[str]:
    """Write the best result for another program, see `project.export`."""
    return project.export(Path(folder), wanted)


def echo(_: Progress, text: str) -> str:
    """Return what was sent: whether the worker lives."""
    return text


TASKS: dict[str, Callable[..., Any]] = {
    f.__name__: f
    for f in (
        room_view,
        recordings_view,
        table_positions,
        result_view,
        identify,
        reverberation,
        demo,
        set_room,
        treatment_view,
        ask_treatment,
        treat,
        listen,
        measure,
        look_at_upload,
        export,
        what_if_prepare,
        what_if,
        echo,
    )
}
"""What the worker can be asked for, by name."""
