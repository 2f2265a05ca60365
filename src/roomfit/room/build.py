"""From the polygons of a file to a mesh of triangles, with what is wrong with them as findings."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from roomfit.base.arguments import float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Face, Surface, place, triangulate
from roomfit.base.typing import FloatArray, IntArray
from roomfit.room.mesh import (
    Mesh,
    about_points,
    area_vectors_m2,
    fault,
    volume_m3,
    weld,
)

WARPED_FROM_M = 0.001
TOO_WARPED_FROM_M = 0.01
_SHOWN = 3  # of faces with one fault


# Where each kind of fault occurs, as (surface name, position), while a mesh is built.
_Spots = dict[Code, list[tuple[str, FloatArray]]]  # surface and middle of a face


def build_mesh(vertices_m: FloatArray, faces: Sequence[Face]) -> tuple[Mesh, tuple[Finding, ...]]:
    """Weld corners, leave out repeated faces, and cut every polygon into triangles.

    Parameters
    ----------
    vertices_m : float array, shape (n_vertices, 3)
        z up.
    faces : sequence of Face
        Triangles or polygons, concave ones too; sheets in the air need not enclose anything.

    Returns
    -------
    mesh : Mesh
        Surfaces in the order of their first face; corners that no face uses are gone.
    findings : tuple of Finding
        Outlines that cross themselves, and polygons that are not flat by more than 1 mm (above
        1 cm: a fault). Faces without area are left out.

    Raises
    ------
    InputError
        No face has an area, one has fewer than three corners or a corner that does not exist, or a
        coordinate is not finite.
    """
    vertices = float_array("vertices", vertices_m, (None, 3), low=-1e6, high=1e6, unit="m")
    for number, face in enumerate(faces, start=1):
        where = f"face {number}, surface {face.surface.name!r}"
        if len(face.corners) < 3:
            what, found = "a face has fewer than three corners", f"{len(face.corners)}"
            hint = "the file may be damaged: export it again"
            raise InputError(what, where=where, found=found, needed="three or more", hint=hint)
        if bad := [c + 1 for c in face.corners if not 0 <= c < len(vertices)]:
            what, needed = "a face names a corner that does not exist", f"1 to {len(vertices)}"
            found = f"corner {bad[0]}"
            hint = "export the room again: the list of corners is too short"
            raise InputError(what, where=where, found=found, needed=needed, hint=hint)
    representative = weld(vertices) if len(vertices) else np.zeros(0, dtype=np.int64)
    spots: _Spots = defaultdict(list)
    most_warped_m = 0.0
    triangles: list[IntArray] = []
    owner: list[int] = []
    surfaces: dict[Surface, int] = {}
    for corners, surface in _distinct(faces, representative):
        cut = triangulate(vertices[corners])
        if not len(cut.triangles):
            continue  # a seam, or a slip: if it was to close the room, that leaks
        spot = surface.name, vertices[corners].mean(axis=0)
        if cut.crosses_itself:
            spots[Code.SELF_INTERSECTING_POLYGON].append(spot)
        if cut.off_plane_m > WARPED_FROM_M:
            spots[Code.WARPED_POLYGON].append(spot)
            most_warped_m = max(most_warped_m, cut.off_plane_m)
        index = surfaces.setdefault(surface, len(surfaces))
        triangles.append(corners[cut.triangles])
        owner.extend([index] * len(cut.triangles))
    all_corners = np.concatenate([np.zeros((0, 3), dtype=np.int64), *triangles])
    used, renumbered = np.unique(all_corners, return_inverse=True)
    findings = _findings(spots, most_warped_m)
    if not triangles:
        what, found = "the room has no faces", f"none with an area, of {len(faces)}"
        hint = "export the room again, with its surfaces as polygons or triangles"
        needed = "at least four faces with an area"
        raise InputError(what, found=found, needed=needed, hint=hint)
    mesh = Mesh(vertices[used], renumbered.reshape(-1, 3), np.array(owner), tuple(surfaces))
    return mesh, findings


def _distinct(
    faces: Iterable[Face], representative: IntArray
) -> Iterable[tuple[IntArray, Surface]]:
    """Yield welded corners and surface of each face, one that comes again the same way round once.

    Fewer than three corners mean a face that welding has closed up.
    """
    visited: set[tuple[int, ...]] = set()
    stands_for = representative.tolist()
    for face in faces:
        welded = [stands_for[corner] for corner in face.corners]
        before = [welded[-1], *welded[:-1]]
        corners = [c for c, b in zip(welded, before, strict=True) if c != b] or welded[:1]
        start = corners.index(min(corners))
        turn = (*corners[start:], *corners[:start])
        if turn not in visited:
            visited.add(turn)
            yield np.array(corners), face.surface


def _findings(spots: _Spots, most_warped_m: float) -> tuple[Finding, ...]:
    found: list[Finding] = []
    for code, own in spots.items():
        points_m, where = [at for _, at in own], listed([(name, place(at)) for name, at in own])
        count = "1 face is" if len(own) == 1 else f"{len(own)} faces are"
        text = f"{count} not flat, by up to {1e3 * most_warped_m:.1f} mm, and cut: {where}."
        if code is Code.SELF_INTERSECTING_POLYGON:
            text = f"{count} with an outline that crosses itself: {where}."
        evidence = {"off_plane_m": most_warped_m}
        finding = Finding(code, about_points(points_m), text, evidence)
        if code is Code.WARPED_POLYGON and most_warped_m > TOO_WARPED_FROM_M:
            finding = fault(
                Code.POLYGON_NOT_PLANAR,
                "polygons that are not flat",
                where=where,
                found=f"corners up to {1e3 * most_warped_m:.0f} mm off their plane",
                needed=f"at most {1e3 * TOO_WARPED_FROM_M:.0f} mm",
                hint="look for a mistyped corner, or give the surface as triangles",
                points_m=points_m,
                **evidence,
            )
        found.append(finding)
    return tuple(found)


def listed(spots: Sequence[tuple[str, str]]) -> str:
    """Return "'floor' near (...) m, 'west' near (...) m and 4 more"."""
    text = ", ".join(f"{name!r} near {point}" for name, point in spots[:_SHOWN])
    return text + (f" and {len(spots) - _SHOWN} more" if len(spots) > _SHOWN else "")


_LEVEL_NAMES = re.compile(
    r"floor|ceiling|boden|decke|plancher|plafond|(?<![a-z])sol(?![a-z])", re.IGNORECASE
)


def is_level_by_name(surface: Surface) -> bool:
    """Return whether a name of a surface says floor or ceiling, in English, German or French."""
    names = (surface.name, surface.group, surface.file_material)
    return any(_LEVEL_NAMES.search(name) for name in names if name)


def axis_findings(mesh: Mesh) -> tuple[Finding, ...]:
    """Return a finding where floor and ceiling, by their names, stand upright."""
    level = np.array([is_level_by_name(s) for s in mesh.surfaces], dtype=np.bool_)
    sums = np.abs(area_vectors_m2(mesh)[level[mesh.triangle_surface]]).sum(axis=0)
    if not sums.any() or int(np.argmax(sums)) == 2:
        return ()
    names = ", ".join(s.name for s, own in zip(mesh.surfaces, level, strict=True) if own)
    axis = "xy"[int(np.argmax(sums))]
    text = (
        f"{names} should be level and stand upright, across {axis}: another axis of the file "
        'points up. Set up = "y" (or "z") under [room], or give positions in the same axes.'
    )
    return (Finding(Code.AXES_EXCHANGED, About(), text, {"surfaces": names, "axis": axis}),)


def examine(mesh: Mesh) -> tuple[Finding, ...]:
    """Return what is doubtful of the size of a room; serious findings are faults.

    `mesh`: normals out of the air.
    """
    volume = volume_m3(mesh)
    if not volume > 0.0:
        what, needed = "the room encloses no volume", "more than 0 m3"
        hint = "draw floor, ceiling and all walls as faces that enclose the air"
        return (fault(Code.NO_VOLUME, what, found=f"{volume:.3g} m3", needed=needed, hint=hint),)
    if 1.0 <= volume <= 1e6:
        return ()
    text = f"A volume of {volume:.3g} m3 is unusual for a room: is the unit right?"
    return (Finding(Code.UNUSUAL_SIZE, About(), text, {"volume_m3": volume}),)
