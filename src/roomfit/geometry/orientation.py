"""Turn triangles so that every normal points out of the air."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from roomfit.findings import Finding
from roomfit.geometry.edges import Edges, edges_of
from roomfit.geometry.faults import place
from roomfit.geometry.inside import is_inside
from roomfit.geometry.mesh import (
    Mesh,
    area_vectors_m2,
    corners_m,
    is_double_sided,
    triangle_areas_m2,
)
from roomfit.typing import BoolArray, IntArray

# How far from a face the air is looked for: beyond the rounding of drawings, within any wall.
_STEP_M = 1e-3
_PROBES = 5


def oriented(mesh: Mesh) -> tuple[Mesh, tuple[Finding, ...]]:
    """Return the mesh with normals that point out of the air, and what had to be turned.

    Neighbours are made to agree across every edge that two triangles share. Then each connected
    part is turned as a whole, by asking on which side of its largest faces the room encloses a
    point; so the walls' normals point outwards and a pillar's inwards, into the pillar.

    Returns
    -------
    mesh : Mesh
        The same triangles in the same order; sheets in the air stay as they are.
    findings : tuple of Finding
        "inside-out" where most of the area pointed into the air, "flipped-faces" for a minority
        that did not agree with the rest, "one-sided" where no orientation is possible.
    """
    flip, part, agrees = _agreement(edges_of(mesh), len(mesh.triangles))
    flip ^= _air_in_front(mesh, part, flip)[part]
    flip &= ~is_double_sided(mesh)
    findings = _flip_findings(mesh, flip)
    if not agrees:
        sentence = "The faces cannot be oriented: a surface has one side only, as a Moebius strip."
        findings = (*findings, Finding("one-sided", "warning", sentence))
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
        found.append(Finding("inside-out", "info", sentence, {"flipped": int(flip.sum())}))
    odd = np.flatnonzero((flip != inside_out) & walls)
    if len(odd):
        first = odd[np.argmax(areas[odd])]
        name = mesh.surfaces[mesh.triangle_surface[first]].name
        spot = place(corners_m(mesh)[first].mean(axis=0))
        sentence = (
            f"{len(odd)} triangles of {areas[odd].sum():.3g} m2 were oriented against the rest and "
            f"were flipped, the largest in {name!r} near {spot}."
        )
        found.append(Finding("flipped-faces", "warning", sentence, {"triangles": len(odd)}))
    return tuple(found)
