"""Faults of a mesh, each with its position; leaks are found by rays followed inside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.findings import About, Code, Finding
from roomfit.base.kernels import in_threads, kernel
from roomfit.base.polygon import place
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.room.build import listed
from roomfit.room.inside import (
    along,
    cross,
    dot,
    flight_m,
    interior_points,
    minus,
    nearest_triangles,
    put,
    row,
    triangle_at,
)
from roomfit.room.mesh import (
    Edges,
    Mesh,
    about_points,
    box_of,
    corners_m,
    edges_of,
    fault,
    triangle_areas_m2,
    unmatched,
    volume_m3,
)

# A start nearer to a wall than this counts as on it: faces may lie upon each other.
_ON_WALL_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Leak:
    """Outcome of test rays that were followed inside a room."""

    n_hits: int  # of walls
    n_escapes: int  # rays that left the room
    last_m: FloatArray  # (n_escapes, 3), where each lost ray started its last flight
    directions: FloatArray  # (n_escapes, 3), unit vectors of these flights

    @property
    def fraction(self) -> float:
        """Escapes per hit; 1 where nothing was hit."""
        return min(1.0, self.n_escapes / self.n_hits) if self.n_hits else 1.0


def find_leaks(
    mesh: Mesh, points_m: FloatArray, n_rays: int, seed: int, n_bounces: int = 50
) -> Leak:
    """Follow specular rays from points inside and record those that leave the room.

    `points_m`, shape (n_points, 3): inside the room; the rays are dealt out to them in turn.
    """
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n_rays, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    starts = np.resize(np.asarray(points_m, dtype=np.float64), (n_rays, 3))
    hits, lost = np.zeros(n_rays, dtype=np.int64), np.zeros(n_rays, dtype=np.bool_)
    in_threads(_bounce, n_rays, corners_m(mesh), starts, directions, n_bounces, hits, lost)
    return Leak(int(hits.sum()), int(lost.sum()), starts[lost], directions[lost])


@kernel(allocates=False)
def _bounce(
    first: int,
    end: int,
    corners_m: FloatArray,
    starts_m: FloatArray,
    directions: FloatArray,
    n_bounces: int,
    hits: IntArray,
    escaped: BoolArray,
) -> None:
    """Move rays on, in place, until they have bounced enough or met no wall; for threads."""
    for r in range(first, end):
        last = -1
        for _ in range(n_bounces):
            nearest, hit = np.inf, int(np.int64(-1))
            for i in range(len(corners_m)):
                distance = flight_m(corners_m, i, row(starts_m, r), row(directions, r))
                if _ON_WALL_M < distance < nearest and i != last:
                    nearest, hit = distance, i
            if hit < 0:
                escaped[r] = True
                break
            hits[r] += 1
            last = hit
            put(starts_m, r, along(row(starts_m, r), row(directions, r), nearest))
            _reflect(corners_m, hit, directions, r)


@kernel(allocates=False)
def _reflect(corners_m: FloatArray, i: int, directions: FloatArray, r: int) -> None:
    """Mirror direction r at triangle i, in place."""
    a, b, c = triangle_at(corners_m, i)
    n = cross(minus(b, a), minus(c, a))
    d = row(directions, r)
    d = along(d, n, -2.0 * dot(d, n) / dot(n, n))
    put(directions, r, along((0.0, 0.0, 0.0), d, 1.0 / np.sqrt(dot(d, d))))


# Escapes per hit above which a mesh is no room; a decay to -60 dB takes about 100 hits.
LEAK_LIMIT = 1e-3
SLIVER_M = 1e-4
# Rays against all triangles: at most so many tests, at most and at least so many rays.
_LEAK_TESTS = 2e8
_LEAK_RAYS = (64, 2000)
_LEAK_STARTS = (16, 100)
_BOUNCES = 50
_SEED = 1


def examine(mesh: Mesh) -> tuple[bool, float | None, tuple[Finding, ...]]:
    """Examine a mesh that `geometry.build.oriented` returned.

    Returns
    -------
    closed : bool
        Every edge is matched by one that runs the other way.
    leak : float or None
        Escapes per hit of test rays; None where no point inside was found.
    findings : tuple of Finding
        Serious ones are faults: not closed, not tight, of no room's size, slivers.
    """
    volume = volume_m3(mesh)
    edges = edges_of(mesh)
    open_edges = unmatched(edges)
    leak, leak_findings = _leak(mesh) if box_of(mesh) is None else (0.0, [])
    findings = [*leak_findings, *_slivers(mesh)]
    if volume > 0.0 and not 1.0 <= volume <= 1e6:
        text = f"A volume of {volume:.3g} m3 is unusual for a room: is the unit right?"
        findings.append(Finding(Code.UNUSUAL_SIZE, About(), text, {"volume_m3": volume}))
    if len(open_edges):
        findings.append(_not_closed(mesh, edges, open_edges, volume))
    if not volume > 0.0:
        what, needed = "the room encloses no volume", "more than 0 m3"
        hint = "draw floor, ceiling and all walls as faces that enclose the air"
        found = f"{volume:.3g} m3"
        findings.append(fault(Code.NO_VOLUME, what, found=found, needed=needed, hint=hint))
    return not len(open_edges), leak, tuple(findings)


def _leak(mesh: Mesh) -> tuple[float | None, list[Finding]]:
    rng = np.random.default_rng(_SEED)
    n_rays = int(np.clip(_LEAK_TESTS / (_BOUNCES * len(mesh.triangles)), *_LEAK_RAYS))
    points = interior_points(mesh, int(np.clip(n_rays // 4, *_LEAK_STARTS)), rng)
    if not len(points):
        what = "no point inside the room was found"
        needed = "faces that enclose a volume"
        hint = "check that walls are not all marked as double sided, and that none is missing"
        return None, [fault(Code.NO_INTERIOR, what, needed=needed, hint=hint)]
    leak = find_leaks(mesh, points, n_rays, _SEED, _BOUNCES)
    if not leak.n_escapes:
        return 0.0, []
    last_m = leak.last_m[:3]
    _, triangle = nearest_triangles(mesh, last_m)
    ways = []
    for start, direction, t in zip(last_m, leak.directions, triangle, strict=False):
        name = mesh.surfaces[mesh.triangle_surface[t]].name
        x, y, z = np.round(direction, 2) + 0.0
        ways.append(f"{name!r} {place(start)} towards ({x:.2f}, {y:.2f}, {z:.2f})")
    out = "leaving from " + "; ".join(ways)
    counts = f"{leak.n_escapes} of {n_rays} rays lost in {leak.n_hits} hits"
    evidence = {"escapes": leak.n_escapes, "hits": leak.n_hits, "limit": LEAK_LIMIT}
    if leak.fraction <= LEAK_LIMIT:
        text = (
            f"The mesh leaks a little: {counts} ({1e2 * leak.fraction:.3g} %; "
            f"up to {1e2 * LEAK_LIMIT:g} % is harmless), {out}."
        )
        return leak.fraction, [Finding(Code.SMALL_LEAK, about_points(last_m), text, evidence)]
    serious = fault(
        Code.LEAK,
        "the mesh leaks",
        where=out,
        found=f"{counts} ({1e2 * leak.fraction:.3g} %)",
        needed=f"at most {1e2 * LEAK_LIMIT:g} % of the hits",
        hint="close the gap in the drawing program, or add the missing surface",
        points_m=last_m,
        **evidence,
    )
    return leak.fraction, [serious]


def _not_closed(mesh: Mesh, edges: Edges, open_edges: IntArray, volume: float) -> Finding:
    ends = mesh.vertices_m[edges.ends[open_edges]]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    order = np.argsort(-lengths, kind="stable")
    spots = []
    for i in order:
        name = mesh.surfaces[mesh.triangle_surface[edges.triangle[open_edges[i]]]].name
        spots.append((name, f"{place(ends[i, 0])} to {place(ends[i, 1])}"))
    text = (
        f"The mesh is not closed: {len(open_edges)} of {len(edges.ends)} edges have no neighbour, "
        f"{lengths.sum():.2f} m in all; the longest: {listed(spots)}. "
        f"The volume of {volume:.4g} m3 is approximate."
    )
    evidence = {"edges": len(open_edges), "of": len(edges.ends), "length_m": float(lengths.sum())}
    return Finding(Code.NOT_CLOSED, about_points(ends[order].mean(axis=1)), text, evidence)


def _slivers(mesh: Mesh) -> list[Finding]:
    """Report triangles less high than 0.1 mm; they are harmless but show a careless drawing."""
    corners = corners_m(mesh)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = 2.0 * triangle_areas_m2(mesh) / longest
    thin = np.flatnonzero(height < SLIVER_M)
    if not len(thin):
        return []
    spots = [
        (mesh.surfaces[mesh.triangle_surface[t]].name, place(corners[t].mean(axis=0))) for t in thin
    ]
    count = "1 triangle is" if len(thin) == 1 else f"{len(thin)} triangles are"
    text = f"{count} thinner than 0.1 mm: {listed(spots)}."
    about = about_points(corners[thin].mean(axis=1))
    return [Finding(Code.SLIVERS, about, text, {"triangles": len(thin)})]
