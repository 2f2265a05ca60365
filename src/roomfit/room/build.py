"""From the polygons of a file to a mesh of triangles whose normals point out of the air.

What was wrong with the polygons is reported in findings.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from roomfit.base.arguments import float_array
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.polygon import Face, Surface, place, triangulate
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.inside import is_inside
from roomfit.room.mesh import (
    Edges,
    Mesh,
    about_points,
    area_vectors_m2,
    corners_m,
    edges_of,
    fault,
    is_double_sided,
    refuse,
    triangle_areas_m2,
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
        Faces without area (a fault, unless they only fill a seam between others), repeated and
        back-to-back ones, outlines that cross themselves, and polygons that are not flat by more
        than 1 mm (above 1 cm: a fault).

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
    flat: list[tuple[IntArray, Surface]] = []
    triangles: list[IntArray] = []
    owner: list[int] = []
    surfaces: dict[Surface, int] = {}
    for corners, surface in _distinct(faces, representative, vertices, spots):
        cut = triangulate(vertices[corners]) if len(corners) >= 3 else None
        if cut is None or not len(cut.triangles):
            flat.append((corners, surface))
            continue
        spot = _spot(surface, vertices[corners])
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
    # Programs that cut surfaces into triangles leave faces without area where the corners of other
    # faces stand on a long edge; the mesh is as tight without them. Such a face with a corner of
    # its own is a mistake.
    for corners, surface in flat:
        code = Code.SEAM_FACES if np.isin(corners, used).all() else Code.ZERO_AREA_FACE
        spots[code].append(_spot(surface, vertices[corners]))
    findings = _findings(spots, most_warped_m)
    if not triangles:
        refuse(findings)
        what, found = "the room has no faces", f"none with an area, of {len(faces)}"
        hint = "export the room again, with its surfaces as polygons or triangles"
        needed = "at least four faces with an area"
        raise InputError(what, found=found, needed=needed, hint=hint)
    mesh = Mesh(vertices[used], renumbered.reshape(-1, 3), np.array(owner), tuple(surfaces))
    return mesh, findings


def _distinct(
    faces: Iterable[Face], representative: IntArray, vertices: FloatArray, spots: _Spots
) -> Iterable[tuple[IntArray, Surface]]:
    """Yield welded corners and surface of each face that does not repeat an earlier one.

    Fewer than three corners mean a face that welding has closed up.
    """
    visited: dict[tuple[int, ...], tuple[int, ...]] = {}
    stands_for = representative.tolist()
    for face in faces:
        welded = [stands_for[corner] for corner in face.corners]
        before = [welded[-1], *welded[:-1]]
        corners = [c for c, b in zip(welded, before, strict=True) if c != b]
        if len(corners) < 3:
            points = vertices[list(face.corners)]
            if len(np.unique(points, axis=0)) < 3:
                spots[Code.ZERO_AREA_FACE].append(_spot(face.surface, points))
            else:
                yield np.unique(welded)[:2], face.surface
            continue
        turn = _from_smallest(corners)
        outline = min(turn, _from_smallest(corners[::-1]))
        earlier = visited.setdefault(outline, turn)
        if earlier is turn:
            yield np.array(corners), face.surface
        elif earlier == turn or face.surface.double_sided:
            spots[Code.REPEATED_FACE].append(_spot(face.surface, vertices[corners]))
        else:
            spots[Code.BACK_TO_BACK_FACES].append(_spot(face.surface, vertices[corners]))
            yield np.array(corners), face.surface


def _from_smallest(corners: list[int]) -> tuple[int, ...]:
    start = corners.index(min(corners))
    return (*corners[start:], *corners[:start])


def _spot(surface: Surface, corners_m: FloatArray) -> tuple[str, FloatArray]:
    return surface.name, corners_m.mean(axis=0)


_SENTENCES = {
    Code.SEAM_FACES: "a seam without area, left out",
    Code.REPEATED_FACE: "given twice and kept once",
    Code.BACK_TO_BACK_FACES: "back to back with another face; which of the two materials sound "
    "meets is open",
    Code.SELF_INTERSECTING_POLYGON: "with an outline that crosses itself; a part may be "
    "covered twice or not at all",
}


def _findings(spots: _Spots, most_warped_m: float) -> tuple[Finding, ...]:
    found: list[Finding] = []
    for code in (Code.ZERO_AREA_FACE, *_SENTENCES, Code.WARPED_POLYGON):
        points_m = [point_m for _, point_m in spots.get(code, ())]
        named = [(name, place(point_m)) for name, point_m in spots.get(code, ())]
        n, where, about = len(named), listed(named), about_points(points_m)
        count = "1 face is" if n == 1 else f"{n} faces are"
        if not n:
            continue
        if code is Code.ZERO_AREA_FACE:
            needed = "at least three corners that do not stand on one line"
            hint = "delete these faces in the drawing program (in Blender: Degenerate Dissolve)"
            what, at = "faces without area", points_m
            found.append(
                fault(
                    Code.ZERO_AREA_FACE, what, where=where, found=str(n), needed=needed, hint=hint,
                    points_m=at,
                )
            )  # fmt: skip
        elif code in _SENTENCES:
            text = f"{count} {_SENTENCES[code]}: {where}."
            found.append(Finding(code, about, text, {"places": named}))
        elif most_warped_m <= TOO_WARPED_FROM_M:
            text = (
                f"{count} not flat, by up to {1e3 * most_warped_m:.1f} mm: {where}. "
                "They are cut into flat triangles."
            )
            found.append(Finding(code, about, text, {"off_plane_m": most_warped_m}))
        else:
            found.append(
                fault(
                    Code.POLYGON_NOT_PLANAR,
                    "polygons that are not flat",
                    where=where,
                    found=f"corners up to {1e3 * most_warped_m:.0f} mm off their plane",
                    needed=f"at most {1e3 * TOO_WARPED_FROM_M:.0f} mm",
                    hint="look for a mistyped corner, or give the surface as triangles",
                    points_m=points_m,
                    off_plane_m=most_warped_m,
                )
            )
    return tuple(found)


def listed(spots: Sequence[tuple[str, str]]) -> str:
    """Return "'floor' near (...) m, 'west' near (...) m and 4 more"."""
    text = ", ".join(f"{name!r} near {point}" for name, point in spots[:_SHOWN])
    return text + (f" and {len(spots) - _SHOWN} more" if len(spots) > _SHOWN else "")


# How far from a face the air is looked for: beyond the rounding of drawings, within any wall.
_STEP_M = 1e-3
_PROBES = 5


def oriented(mesh: Mesh) -> tuple[Mesh, tuple[Finding, ...]]:
    """Return the mesh with normals that point out of the air, and what was turned.

    Neighbours are made to agree across every edge that two triangles share. Then each connected
    part is turned as a whole, by asking on which side of its largest faces the room encloses a
    point; so the walls' normals point outwards and a pillar's inwards, into the pillar.

    Returns
    -------
    mesh : Mesh
        The same triangles in the same order; sheets in the air stay as they are.
    findings : tuple of Finding
        `Code.INSIDE_OUT` where most of the area pointed into the air, `Code.FLIPPED_FACES` for a
        minority that did not agree with the rest, `Code.SURFACE_NOT_ORIENTABLE` where no
        orientation is possible.
    """
    flip, part, agrees = _agreement(edges_of(mesh), len(mesh.triangles))
    flip ^= _air_in_front(mesh, part, flip)[part]
    flip &= ~is_double_sided(mesh)
    findings = _flip_findings(mesh, flip)
    if not agrees:
        sentence = "The faces cannot be oriented: a surface has one side only, as a Moebius strip."
        findings = (*findings, Finding(Code.SURFACE_NOT_ORIENTABLE, About(), sentence))
    triangles = mesh.triangles.copy()
    triangles[flip] = triangles[flip][:, ::-1]
    return replace(mesh, triangles=triangles), findings


def _agreement(edges: Edges, n_triangles: int) -> tuple[BoolArray, IntArray, bool]:
    """Return which triangles to flip so that neighbours agree, the part of each, and success.

    Edges that more than two triangles share join nothing: which belong together is not known.
    """
    neighbours = _neighbours(edges, n_triangles)
    flip = np.zeros(n_triangles, dtype=np.bool_)
    part = np.full(n_triangles, -1)
    n_parts, agrees = 0, True
    for root in range(n_triangles):
        if part[root] >= 0:
            continue
        part[root] = n_parts
        waiting = deque([root])
        while waiting:
            t = waiting.popleft()
            for other, differs in neighbours[t]:
                if part[other] < 0:
                    part[other] = n_parts
                    flip[other] = flip[t] ^ differs
                    waiting.append(other)
                else:
                    agrees &= bool(flip[other] == flip[t] ^ differs)
        n_parts += 1
    return flip, part, agrees


def _neighbours(edges: Edges, n_triangles: int) -> list[list[tuple[int, bool]]]:
    """Return for each triangle its neighbours and whether the two are oriented differently."""
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in range(n_triangles)]
    order = np.argsort(edges.line, kind="stable")
    count = np.bincount(edges.line) if len(order) else np.zeros(0, dtype=np.int64)
    shared = order[count[edges.line[order]] == 2].reshape(-1, 2)
    # neighbours that agree run along their common edge in opposite directions
    differs = edges.ends[shared[:, 0], 0] == edges.ends[shared[:, 1], 0]
    for (one, two), d in zip(edges.triangle[shared].tolist(), differs.tolist(), strict=True):
        neighbours[one].append((two, d))
        neighbours[two].append((one, d))
    return neighbours


def _air_in_front(mesh: Mesh, part: IntArray, flip: BoolArray) -> BoolArray:
    """Return for each part whether its normals point to where the room is, shape (n_parts,)."""
    areas = triangle_areas_m2(mesh)
    # the largest triangles of each part, as positions in a list sorted by part, then area
    order = np.lexsort((-areas, part))
    starts = np.searchsorted(part[order], np.arange(part.max() + 1))
    rank = np.arange(len(order)) - starts[part[order]]
    probes = order[(rank < _PROBES) & (areas[order] > 0.0)]
    normals = area_vectors_m2(mesh)[probes] / areas[probes, None]
    normals[flip[probes]] *= -1.0
    middles = corners_m(mesh)[probes].mean(axis=1)
    in_front = is_inside(mesh, middles + _STEP_M * normals).astype(np.float64)
    behind = is_inside(mesh, middles - _STEP_M * normals)
    votes = np.bincount(part[probes], in_front - behind, minlength=int(part.max()) + 1)
    return np.asarray(votes > 0.0)


def _flip_findings(mesh: Mesh, flip: BoolArray) -> tuple[Finding, ...]:
    walls = ~is_double_sided(mesh)
    areas = triangle_areas_m2(mesh)
    found: list[Finding] = []
    inside_out = bool(areas[flip].sum() > 0.5 * areas[walls].sum())
    if inside_out:
        sentence = "The file is inside out: its normals point into the room. They were turned."
        found.append(Finding(Code.INSIDE_OUT, About(), sentence, {"flipped": int(flip.sum())}))
    odd = np.flatnonzero((flip != inside_out) & walls)
    if len(odd):
        first = odd[np.argmax(areas[odd])]
        name = mesh.surfaces[mesh.triangle_surface[first]].name
        middle_m = corners_m(mesh)[odd].mean(axis=1)
        spot = place(corners_m(mesh)[first].mean(axis=0))
        sentence = (
            f"{len(odd)} triangles of {areas[odd].sum():.3g} m2 were oriented against the rest and "
            f"were flipped, the largest in {name!r} near {spot}."
        )
        found.append(
            Finding(Code.FLIPPED_FACES, about_points(middle_m), sentence, {"triangles": len(odd)})
        )
    return tuple(found)
