"""From the polygons of a file to a mesh of triangles, telling what was wrong with them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.geometry.faults import fault, place, refuse
from roomfit.geometry.mesh import Mesh, Surface
from roomfit.geometry.polygon import Triangulation, triangulate
from roomfit.geometry.weld import weld
from roomfit.typing import FloatArray, IntArray

WARPED_FROM_M = 0.001
TOO_WARPED_FROM_M = 0.01


class Face(NamedTuple):
    """One polygon of a file: indices of its corners in order, and the surface it belongs to."""

    corners: tuple[int, ...]
    surface: Surface


@dataclass(slots=True)
class _Doubts:
    """Where each kind of trouble was met, as (surface name, place), while a mesh is built."""

    no_area: list[tuple[str, str]]
    seams: list[tuple[str, str]]
    repeated: list[tuple[str, str]]
    back_to_back: list[tuple[str, str]]
    crossing: list[tuple[str, str]]
    warped: list[tuple[str, str]]
    most_warped_m: float = 0.0


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
    _check_faces(faces, len(vertices))
    representative = weld(vertices) if len(vertices) else np.zeros(0, dtype=np.int64)
    doubts = _Doubts([], [], [], [], [], [])
    flat: list[tuple[IntArray, Surface]] = []
    triangles: list[IntArray] = []
    owner: list[int] = []
    surfaces: dict[Surface, int] = {}
    for corners, surface in _distinct(faces, representative, vertices, doubts):
        if len(corners) < 3:
            flat.append((corners, surface))
            continue
        cut = triangulate(vertices[corners])
        if not len(cut.triangles):
            flat.append((corners, surface))
            continue
        _note(cut, surface, vertices[corners], doubts)
        index = surfaces.setdefault(surface, len(surfaces))
        triangles.append(corners[cut.triangles])
        owner.extend([index] * len(cut.triangles))
    _sort_flat(flat, triangles, vertices, doubts)
    findings = _findings(doubts)
    if not triangles:
        refuse(findings)
        raise InputError("the room has no faces", needed="at least four faces with an area")
    used, renumbered = np.unique(np.concatenate(triangles), return_inverse=True)
    mesh = Mesh(vertices[used], renumbered.reshape(-1, 3), np.array(owner), tuple(surfaces))
    return mesh, findings


def _check_faces(faces: Sequence[Face], n_vertices: int) -> None:
    for number, face in enumerate(faces, start=1):
        if len(face.corners) < 3:
            raise InputError(
                "a face has fewer than three corners",
                where=f"face {number}, surface {face.surface.name!r}",
                found=f"{len(face.corners)}",
                hint="the file may be damaged: export it again",
            )
        for corner in face.corners:
            if not 0 <= corner < n_vertices:
                raise InputError(
                    "a face names a corner that does not exist",
                    where=f"face {number}, surface {face.surface.name!r}",
                    found=f"corner {corner + 1}",
                    needed=f"1 to {n_vertices}",
                )


def _distinct(
    faces: Iterable[Face], representative: IntArray, vertices: FloatArray, doubts: _Doubts
) -> Iterable[tuple[IntArray, Surface]]:
    """Yield welded corners and surface of each face that was not there before.

    Fewer than three corners mean a face that welding has closed up.
    """
    seen: dict[tuple[int, ...], tuple[int, ...]] = {}
    stands_for = representative.tolist()
    for face in faces:
        welded = [stands_for[corner] for corner in face.corners]
        before = [welded[-1], *welded[:-1]]
        corners = [c for c, b in zip(welded, before, strict=True) if c != b]
        if len(corners) < 3:
            points = vertices[list(face.corners)]
            if len(np.unique(points, axis=0)) < 3:
                doubts.no_area.append(_spot(face.surface, points))
            else:
                yield np.unique(welded)[:2], face.surface
            continue
        turn = _from_smallest(corners)
        outline = min(turn, _from_smallest(corners[::-1]))
        earlier = seen.setdefault(outline, turn)
        if earlier is turn:
            yield np.array(corners), face.surface
        elif earlier == turn or face.surface.double_sided:
            doubts.repeated.append(_spot(face.surface, vertices[corners]))
        else:
            doubts.back_to_back.append(_spot(face.surface, vertices[corners]))
            yield np.array(corners), face.surface


def _sort_flat(
    flat: list[tuple[IntArray, Surface]],
    triangles: list[IntArray],
    vertices: FloatArray,
    doubts: _Doubts,
) -> None:
    """Tell seams from faults among the faces that came out without area.

    Programs that cut surfaces into triangles leave such faces where the corners of other faces
    stand on a long edge; the mesh is as tight without them. A face without area that has a corner
    of its own is a mistake.
    """
    used = np.unique(np.concatenate(triangles)) if triangles else np.zeros(0, dtype=np.int64)
    for corners, surface in flat:
        kind = doubts.seams if np.isin(corners, used).all() else doubts.no_area
        kind.append(_spot(surface, vertices[corners]))


def _from_smallest(corners: list[int]) -> tuple[int, ...]:
    start = corners.index(min(corners))
    return (*corners[start:], *corners[:start])


def _spot(surface: Surface, corners_m: FloatArray) -> tuple[str, str]:
    return surface.name, place(corners_m.mean(axis=0))


def _note(cut: Triangulation, surface: Surface, corners_m: FloatArray, doubts: _Doubts) -> None:
    spot = _spot(surface, corners_m)
    if cut.crosses_itself:
        doubts.crossing.append(spot)
    if cut.off_plane_m > WARPED_FROM_M:
        doubts.warped.append(spot)
        doubts.most_warped_m = max(doubts.most_warped_m, cut.off_plane_m)


def _findings(doubts: _Doubts) -> tuple[Finding, ...]:
    found: list[Finding] = []
    if doubts.no_area:
        found.append(
            fault(
                "zero-area-face",
                "faces without area",
                where=listed(doubts.no_area),
                found=f"{len(doubts.no_area)}",
                needed="at least three corners that do not stand on one line",
                hint="delete these faces in the drawing program (in Blender: Degenerate Dissolve)",
            )
        )
    if doubts.seams:
        text = f"{_count(doubts.seams)} a seam without area, left out: {listed(doubts.seams)}."
        found.append(Finding("seam-faces", "info", text, {"places": doubts.seams}))
    if doubts.repeated:
        found.append(_warning("repeated-face", "given twice and kept once", doubts.repeated))
    if doubts.back_to_back:
        sentence = "back to back with another face; which of the two materials sound meets is open"
        found.append(_warning("back-to-back-faces", sentence, doubts.back_to_back))
    if doubts.crossing:
        sentence = "with an outline that crosses itself; a part may be covered twice or not at all"
        found.append(_warning("self-crossing-polygon", sentence, doubts.crossing))
    if doubts.warped:
        found.append(_warped(doubts))
    return tuple(found)


def _warped(doubts: _Doubts) -> Finding:
    off_plane_m = doubts.most_warped_m
    if off_plane_m > TOO_WARPED_FROM_M:
        return fault(
            "warped-polygon",
            "polygons that are not flat",
            where=listed(doubts.warped),
            found=f"corners up to {1e3 * off_plane_m:.0f} mm off their plane",
            needed=f"at most {1e3 * TOO_WARPED_FROM_M:.0f} mm",
            hint="look for a mistyped corner, or give the surface as triangles",
            off_plane_m=off_plane_m,
        )
    text = (
        f"{_count(doubts.warped)} not flat, by up to {1e3 * off_plane_m:.1f} mm: "
        f"{listed(doubts.warped)}. They are cut into flat triangles."
    )
    return Finding("warped-polygon", "info", text, {"off_plane_m": off_plane_m})


def _warning(code: str, sentence: str, spots: list[tuple[str, str]]) -> Finding:
    text = f"{_count(spots)} {sentence}: {listed(spots)}."
    return Finding(code, "warning", text, {"places": spots})


def _count(spots: Sequence[object]) -> str:
    return "1 face is" if len(spots) == 1 else f"{len(spots)} faces are"


def listed(spots: Sequence[tuple[str, str]], shown: int = 3) -> str:
    """Return "'floor' near (...) m, 'west' near (...) m and 4 more"."""
    text = ", ".join(f"{name!r} near {point}" for name, point in spots[:shown])
    return text + (f" and {len(spots) - shown} more" if len(spots) > shown else "")
