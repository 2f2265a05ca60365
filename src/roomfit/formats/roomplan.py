"""Apple's RoomPlan: rooms as telephones and tablets scan them, closed by what a scan leaves out.

A scan has walls, doors and windows, each flat and by itself, perhaps the outline of the floor, and
no ceiling. Here they become one closed room: walls meet in corners, what is in a wall is cut out of
it, floor and ceiling are put in.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.door import check_limit, complete, json_content, read_text
from roomfit.base.errors import InputError, located
from roomfit.base.findings import About, Code, Finding, Severity
from roomfit.base.polygon import Surface, place, triangulate
from roomfit.base.typing import FloatArray
from roomfit.formats.model import (
    Outlines,
    Polygon,
    RoomModel,
    Thing,
    counted,
    isolated_polygons,
    joined,
    outline,
    unknown_space,
)

# Ends of walls nearer than this are one corner, and what is that near to a wall's plane is in it.
_MEETS_M = 0.3
# Tops of walls as near as this to one plane carry one ceiling.
_LEVEL_M = 0.1
# A rim nearer than this to the wall's own is on it, and nothing narrower is cut out.
_RIM_M = 0.05
_DISTINCT_M = 0.01
_PARALLEL = 0.966  # cosine of 15 degrees
_MOST_KINDS = 20
_MOST_GABLES = 6
_KINDS = {"wall": "walls", "door": "doors", "window": "windows", "opening": "openings"}
_HINT = "close the room in a drawing program, and give it as OBJ or COLLADA"


class Part(NamedTuple):
    """A wall of a scan, or what is in a wall: upright and flat."""

    name: str
    kind: str  # wall, door, window or opening
    corners_m: FloatArray  # (n_corners, 3), z up
    own: str = ""  # identifier
    parent: str = ""  # identifier of the wall it is in, "" where that is not said
    is_curved: bool = False  # its corners are the ends of its arc


class _Edge(NamedTuple):
    """A side of the floor, from its start with the room to the left, and the wall above it."""

    start_m: FloatArray  # (2,)
    end_m: FloatArray
    wall: Part | None
    tops_m: tuple[float, float] = (np.nan, np.nan)  # heights of the ceiling over both ends


def read_roomplan(path: Path, space: str | None = None) -> RoomModel:
    """Read a ``CapturedRoom`` of RoomPlan as Swift's JSONEncoder writes it [1]_: m, z up.

    Surfaces are Wall0, Door0, Window0, Opening0, ..., Floor0 and Ceiling; their materials and
    groups wall, door, window, opening, floor and ceiling. See `closed_room`.

    References
    ----------
    .. [1] Apple Inc., "RoomPlan: CapturedRoom", developer documentation (2022 to 2025).
    """
    with located(str(path)):
        content = _chosen(json_content(read_text(path, "room file"), "room file"), space)
        if not isinstance(content, dict) or not isinstance(content.get("walls"), list):
            raise InputError(
                "this JSON file is no scan of a room",
                found="no list of walls",
                needed="a CapturedRoom of Apple's RoomPlan, encoded by JSONEncoder",
                hint="export the scan anew; a drawing is given as OBJ, IFC or COLLADA",
            )
        with complete("scan", "dimensions and transform of each surface, as RoomPlan has them"):
            # before each is looked at, which takes long
            n_parts = sum(len(content.get(key) or ()) for key in (*_KINDS.values(), "objects"))
            check_limit("scan_parts", n_parts, "the scan")
            parts = [
                _part(kind, i, surface)
                for kind, key in _KINDS.items()
                for i, surface in enumerate(content.get(key) or ())
            ]
            floors = [_corners(f) for f in content.get("floors") or () if f.get("polygonCorners")]
            things = [_thing(thing) for thing in content.get("objects") or ()]
        if len(floors) > 1:
            raise InputError(
                "the scan has several floors", found=f"{len(floors)}", needed="one", hint=_HINT
            )
        return closed_room(parts, floors[0] if floors else None, things)


def _chosen(content: Any, space: str | None) -> Any:
    """Return the one room of a structure that is asked for; a lone room where none is."""
    if not isinstance(content, dict):
        return content
    names: dict[str, Any] = {}
    with complete("scan", "a list of rooms, each with its sections, as RoomPlan has them"):
        times: Counter[str] = Counter()
        for room in content.get("rooms") or [content]:
            label = str(((room.get("sections") or [{}])[0]).get("label") or "room")
            times[label] += 1
            names[f"{label} {times[label]}" if times[label] > 1 else label] = room
        known = {**{str(room.get("identifier")): room for room in names.values()}, **names}
    if space is None and len(names) == 1:
        return next(iter(names.values()))
    if space not in known:
        hint = "names are the labels of RoomPlan, counted where rooms have the same"
        raise unknown_space("the scan", names, space, hint=hint)
    return known[space]


def _part(kind: str, number: int, surface: Mapping[str, Any]) -> Part:
    own, parent = (str(surface.get(k) or "") for k in ("identifier", "parentIdentifier"))
    is_curved = surface.get("curve") is not None
    name = f"{kind.capitalize()}{number}"
    return Part(name, kind, _corners(surface), own, parent, is_curved)


def _thing(thing: Mapping[str, Any]) -> Thing:
    """Return a piece of furniture; Swift writes a case as the only key of a mapping."""
    kind = str(next(iter(thing["category"])) if thing["category"] else "object")[:40]
    if thing.get("transform") is None:
        return Thing(kind, np.zeros((0, 3)), 0.0)
    x, y, z = (float(length) / 2.0 for length in thing["dimensions"])
    base = [(-x, -y, -z), (x, -y, -z), (x, -y, z), (-x, -y, z)]
    return Thing(kind, _placed(base, thing["transform"]), 2.0 * y)


def _corners(surface: Mapping[str, Any]) -> FloatArray:
    """Return the corners of a surface, shape (n, 3), in m with z up."""
    outline = surface.get("polygonCorners") or ()
    if len(outline) < 3:
        width, height, _ = (float(x) / 2.0 for x in surface["dimensions"])
        outline = [(-width, -height, 0), (width, -height, 0), (width, height, 0)]
        outline.append((-width, height, 0))
    return _placed(outline, surface["transform"])


def _placed(outline: Sequence[Sequence[float]], transform: Any) -> FloatArray:
    """Return points, shape (n, 3), of something's own axes in those of the scan, with z up."""
    # written column by column
    matrix = np.array(transform, dtype=np.float64).reshape(4, 4).T
    own = np.array(outline, dtype=np.float64).reshape(-1, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = matrix[:3, :3] @ own.T + matrix[:3, 3:]
    found = np.stack([x, -z, y], axis=1)
    if not (np.abs(found) < 1e6).all():
        raise ValueError("a coordinate that is not a finite number")
    return found


def closed_room(
    parts: Sequence[Part], floor_m: FloatArray | None, things: Sequence[Thing]
) -> RoomModel:
    """Return a closed room of what a scan has found: m, z up."""
    n_parts = len(parts) + (0 if floor_m is None else len(floor_m)) + len(things)
    check_limit("scan_parts", n_parts, "the scan")
    walls = [p for p in parts if p.kind == "wall" and _length(_foot(p)) > _DISTINCT_M]
    if len(walls) < 3:
        what = "the scan encloses no room"
        raise InputError(what, found=f"{len(walls)} walls", needed="three or more", hint=_HINT)
    edges, moved_m = _edges_by_walls(walls) if floor_m is None else (_by_floor(floor_m, walls), 0.0)
    if all(e.wall is None for e in edges):
        raise InputError(
            "no wall of the scan stands on the outline of its floor",
            found=f"{len(walls)} walls elsewhere",
            needed="a wall on one side or more",
            hint=_HINT,
        )
    ground_m = float(np.median([w.corners_m[:, 2].min() for w in walls]))
    longest = max(edges, key=lambda e: _length(np.stack([e.start_m, e.end_m])))
    edges, ceiling = _covered(edges, walls, ground_m)
    polygons, used = _sides(edges, parts, ground_m)
    around = np.array([e.start_m for e in edges])
    floor = np.column_stack([around, np.full(len(around), ground_m)])
    polygons.append((floor[::-1], Surface("Floor0", "floor", "floor")))
    polygons += ceiling
    idle = [p.name for p in parts if p.name not in used]
    vertices, faces = joined(polygons)
    run = np.array([[*longest.start_m, ground_m], [*longest.end_m, ground_m]])
    bases = [t.outline_m * [1.0, 1.0, 0.0] + [0.0, 0.0, ground_m] for t in things]
    room, (start, end), *stand = _at_home(longest, vertices, run, *bases)
    lies = (
        f"x runs along {longest.wall.name if longest.wall else 'the longest side'}, from "
        f"{place(start)} to {place(end)}: give positions in these axes."
    )
    heights_m = np.array([e.tops_m for e in edges]) - ground_m
    n_planes = len({surface.name for _, surface in ceiling})
    findings = (
        _completed(edges, moved_m, heights_m, n_planes, lies),
        *_left_out(idle, Counter(t.kind for t in things)),
    )
    placed = tuple(t._replace(outline_m=at) for t, at in zip(things, stand, strict=True))
    return RoomModel(room, faces, findings, "m", "z", placed)


def part_of(name: str, kind: str, points_m: FloatArray) -> Part:
    """Return a part from the points of a slab that stands upright, shape (n_points, 3).

    Its outline is the convex hull of the points, upright and in the middle of the slab.
    """
    from scipy.spatial import ConvexHull  # heavy, and JSON needs none

    middle = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))[:2]
    plan = points_m[:, :2] - middle
    way, across = np.linalg.svd(plan, full_matrices=False)[2]
    if np.ptp(plan @ across) > _DISTINCT_M:
        # the thinnest way through a slab is square to one of the sides of its outline
        ring = plan[ConvexHull(plan).vertices]
        ways = np.roll(ring, -1, axis=0) - ring
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        way = ways[np.argmin([np.ptp(ring @ np.array([-y, x])) for x, y in ways])]
        across = np.array([-way[1], way[0]])
    flat = np.column_stack([plan @ way, points_m[:, 2]])
    low, high = flat.min(axis=0), flat.max(axis=0)
    rim = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    if (high - low > _DISTINCT_M).all():
        rim = flat[ConvexHull(flat).vertices]
    aside = plan @ across
    plan = middle + np.outer(rim[:, 0], way) + 0.5 * (aside.min() + aside.max()) * across
    return Part(name, kind, np.column_stack([plan, rim[:, 1]]))


def thing_of(name: str, points_m: FloatArray) -> Thing:
    """Return a piece of furniture from the points of its shapes, shape (n_points, 3), by its name.

    Its outline is their convex hull as seen from above.
    """
    from scipy.spatial import ConvexHull  # heavy, and JSON needs none

    kind, base = name.rstrip("0123456789_").lower(), np.zeros((0, 3))
    if (np.linalg.svd(points_m[:, :2] - points_m[:, :2].mean(axis=0))[1] > _DISTINCT_M).all():
        base = points_m[ConvexHull(points_m[:, :2]).vertices]
    return Thing(kind[:40], base, float(np.ptp(points_m[:, 2])))


def _foot(part: Part) -> FloatArray:
    """Return the two ends of what stands upright as seen from above, shape (2, 2)."""
    plan = part.corners_m[:, :2]
    a = plan[np.argmax(np.linalg.norm(plan - plan.mean(axis=0), axis=1))]
    b = plan[np.argmax(np.linalg.norm(plan - a, axis=1))]
    return np.stack([a, b])


def _length(ends: FloatArray) -> float:
    return float(np.linalg.norm(ends[1] - ends[0]))


def _edges_by_walls(walls: Sequence[Part]) -> tuple[list[_Edge], float]:
    """Return the sides of a floor whose corners are those of walls, and the widest gap closed."""
    if bent := [w.name for w in walls if w.is_curved]:
        raise InputError(
            "a wall of the scan is curved, and nothing says along which line",
            where=", ".join(bent),
            found="no outline of the floor",
            needed="an outline, whose corners follow the curve",
            hint="scan with iOS 17 or later, which exports it, or " + _HINT,
        )
    feet = np.array([_foot(w) for w in walls])
    order = _loop(walls, feet)
    ends = [feet[i][::-1] if back else feet[i] for i, back in order]
    starts: list[FloatArray] = []
    owners: list[Part] = []
    moved_m = 0.0
    for (i, _), one, two in zip(order, ends, ends[1:] + ends[:1], strict=True):
        meeting = _meeting(one, two)
        moved_m = max(moved_m, float(np.linalg.norm(two[0] - one[1])))
        starts += meeting
        # of two corners the step between them belongs to the wall that ends there
        owners += [walls[i]] * len(meeting)
    # the first of these corners is where the first wall ends
    last = [*starts[1:], starts[0]]
    after = [*owners[1:], owners[0]]
    return _turning_left(
        [_Edge(a, b, w) for a, b, w in zip(starts, last, after, strict=True)]
    ), moved_m


def _loop(walls: Sequence[Part], feet: FloatArray) -> list[tuple[int, bool]]:
    """Return walls one behind the other around the room, and which run from their second end."""
    first = int(np.argmax(np.linalg.norm(feet[:, 1] - feet[:, 0], axis=1)))
    order = [(first, False)]
    left = set(range(len(walls))) - {first}
    end = feet[first, 1]
    while True:
        home = float(np.linalg.norm(feet[first, 0] - end)) if len(order) > 2 else np.inf
        ways = {(w, e): float(np.linalg.norm(feet[w, e] - end)) for w in left for e in (0, 1)}
        near = min(ways, key=lambda way: ways[way], default=(first, 0))
        gap = min(home, ways.get(near, np.inf))
        if gap > _MEETS_M:
            name = walls[order[-1][0]].name
            raise InputError(
                "walls of the scan do not meet",
                where=f"the end of {name}",
                found=f"{gap:.2f} m to the nearest end of another" if left else "no other wall",
                needed=f"at most {_MEETS_M:g} m",
                hint="scan with iOS 17 or later, which exports the outline of the floor, or "
                + _HINT,
            )
        if home == gap:
            return order
        order.append((near[0], near[1] == 1))
        left.remove(near[0])
        end = feet[near[0], 1 - near[1]]


def _meeting(one: FloatArray, two: FloatArray) -> list[FloatArray]:
    """Return the corner where a wall ends and the next begins, or two with a step between them."""
    a, b = one[1] - one[0], two[1] - two[0]
    cross = a[0] * b[1] - a[1] * b[0]
    apart = two[0] - one[1]
    if abs(cross) > np.sqrt(1.0 - _PARALLEL**2) * np.linalg.norm(a) * np.linalg.norm(b):
        along = (apart[0] * b[1] - apart[1] * b[0]) / cross
        corner = one[1] + along * a
        if max(np.linalg.norm(corner - one[1]), np.linalg.norm(corner - two[0])) <= _MEETS_M:
            return [corner]
    elif abs(apart[0] * a[1] - apart[1] * a[0]) <= _RIM_M * np.linalg.norm(a):
        return [0.5 * (one[1] + two[0])]
    return [one[1], two[0]]


def _by_floor(floor_m: FloatArray, walls: Sequence[Part]) -> list[_Edge]:
    """Return the sides of an outlined floor, each with the wall that covers most of it."""
    plan = floor_m[:, :2]
    plan = plan[np.linalg.norm(plan - np.roll(plan, 1, axis=0), axis=1) > _DISTINCT_M]
    if len(plan) < 3:
        raise InputError(
            "the floor of the scan has no area",
            found=f"{len(plan)} corners that are apart",
            needed="three corners or more",
            hint=_HINT,
        )
    flat, bent = [w for w in walls if not w.is_curved], [w for w in walls if w.is_curved]
    return _turning_left(
        [
            _Edge(a, b, _over(a, b, flat) or _around(a, b, bent))
            for a, b in zip(plan, np.roll(plan, -1, 0), strict=True)
        ]
    )


def _around(start: FloatArray, end: FloatArray, bent: Sequence[Part]) -> Part | None:
    """Return the curved wall of whose arc an edge may be a chord: in the circle over its ends."""
    middle = 0.5 * (start + end)

    def off(part: Part) -> float:
        foot = _foot(part)
        return float(np.linalg.norm(middle - foot.mean(axis=0))) - 0.5 * _length(foot)

    nearest = min(bent, key=off, default=None)
    return nearest if nearest is not None and off(nearest) <= _MEETS_M else None


def _over(start: FloatArray, end: FloatArray, parts: Sequence[Part]) -> Part | None:
    """Return which of the parts stands along most of an edge, if one does along half of it."""
    length = _length(np.stack([start, end]))
    covered = {p.name: _shared(start, end, p) for p in parts}
    best = max(parts, key=lambda p: covered[p.name], default=None)
    return best if best is not None and covered[best.name] > 0.5 * length else None


def _shared(start: FloatArray, end: FloatArray, part: Part) -> float:
    """Return the length over which a part stands along an edge; 0 where it stands elsewhere."""
    foot = _foot(part)
    along, aside = _beside(start, end, foot)
    if np.abs(aside).max() > _MEETS_M or abs(np.ptp(along)) < _PARALLEL * _length(foot):
        return 0.0
    length = _length(np.stack([start, end]))
    return float(max(min(along.max(), length) - max(along.min(), 0.0), 0.0))


def _beside(start: FloatArray, end: FloatArray, plan: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far points, shape (n, 2), lie along an edge and beside it, each (n,)."""
    way = (end - start) / np.linalg.norm(end - start)
    from_start = plan - start
    return from_start @ way, from_start @ np.array([-way[1], way[0]])


def _turning_left(edges: list[_Edge]) -> list[_Edge]:
    """Return the sides of a floor in the sense that has the room to the left."""
    x, y = np.array([e.start_m for e in edges]).T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0:
        return edges
    return [_Edge(e.end_m, e.start_m, e.wall) for e in reversed(edges)]


def _covered(
    edges: Sequence[_Edge], walls: Sequence[Part], ground_m: float
) -> tuple[list[_Edge], list[Polygon]]:
    """Return the sides of a floor with the heights over their ends, and what closes them above."""
    try:
        plane = _ceiling(walls, ground_m)
    except InputError:
        found = _gabled(edges, ground_m)
        if found is None:
            raise
        return found
    starts = np.array([e.start_m for e in edges])
    corners = np.column_stack([starts, plane[0] + starts @ plane[1:]])
    owners = [e.wall for e in edges]
    return _crowned(corners, owners), [(corners, Surface("Ceiling", "ceiling", "ceiling"))]


def _crowned(corners_m: FloatArray, owners: Sequence[Part | None]) -> list[_Edge]:
    """Return sides from the corners of the ceiling, shape (n, 3), and whose wall follows each."""
    after = np.roll(corners_m, -1, axis=0)
    return [
        _Edge(a[:2], b[:2], wall, (float(a[2]), float(b[2])))
        for a, b, wall in zip(corners_m, after, owners, strict=True)
    ]


def _gabled(edges: Sequence[_Edge], ground_m: float) -> tuple[list[_Edge], list[Polygon]] | None:
    """Return sides cut at their gables and planes from gable to gable; None where none close it."""
    corners, owners, gables = _profile(edges)
    ways = _folded(corners, range(len(corners)), gables) if len(corners) else []
    if len(ways) != 1 or (corners[:, 2] - ground_m).min() <= _LEVEL_M:
        return None
    polygons: list[Polygon] = []
    for i, ring in enumerate(sorted(ways[0])):
        own, surface = corners[list(ring)], Surface(f"Ceiling{i}", "ceiling", "ceiling")
        # corners of a scan are off their plane by centimetres, which triangles are not
        polygons += [(own[three], surface) for three in triangulate(own).triangles]
    return _crowned(corners, owners), polygons


def _profile(edges: Sequence[_Edge]) -> tuple[FloatArray, list[Part | None], frozenset[int]]:
    """Return the line on which a ceiling rests: its corners, whose wall follows each, and gables.

    Corners of the floor have the height at which the walls beside them end; gables are corners
    within a wall, by their numbers. No corners where walls that meet end at two heights.
    """
    corners: list[FloatArray] = []
    owners: list[Part | None] = []
    gables: list[int] = []
    starts: list[int] = []
    ends: list[list[float]] = [[] for _ in edges]  # heights of walls at each corner of the floor
    for k, edge in enumerate(edges):
        starts.append(len(corners))
        corners.append(np.array([*edge.start_m, np.nan]))
        owners.append(edge.wall)
        if edge.wall is None:
            continue
        along, _ = _beside(edge.start_m, edge.end_m, edge.wall.corners_m[:, :2])
        z, length = edge.wall.corners_m[:, 2], _length(np.stack([edge.start_m, edge.end_m]))
        top = [i for i in np.argsort(along) if z[i] > z.min() + _LEVEL_M]
        for corner, at in ((k, 0.0), ((k + 1) % len(edges), length)) if top else ():
            ends[corner].append(float(np.interp(at, along[top], z[top])))
        for i in top:
            if _MEETS_M < along[i] < length - _MEETS_M:
                gables.append(len(corners))
                plan = edge.start_m + along[i] / length * (edge.end_m - edge.start_m)
                corners.append(np.array([*plan, z[i]]))
                owners.append(edge.wall)
    for number, heights in zip(starts, ends, strict=True):
        if not heights or np.ptp(heights) > _LEVEL_M:
            return np.zeros((0, 3)), [], frozenset()
        corners[number][2] = np.mean(heights)
    return np.array(corners), owners, frozenset(gables)


def _folded(
    corners_m: FloatArray, ring: Sequence[int], gables: frozenset[int]
) -> list[frozenset[tuple[int, ...]]]:
    """Return the ways to fold a ceiling into the fewest planes along lines from gable to gable.

    A plane has all of its corners within 0.1 m. Several ways mean that a ceiling would be guessed.
    """
    own = corners_m[list(ring)]
    at = np.column_stack([np.ones(len(own)), own[:, :2]])
    off_m = own[:, 2] - at @ np.linalg.lstsq(at, own[:, 2], rcond=None)[0]
    x, y = own[:, :2].T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) <= 0.0:  # the line leaves the room
        return []
    if np.abs(off_m).max() <= _LEVEL_M:
        k = int(np.argmin(ring))  # the same plane has the same name, whichever line was first
        return [frozenset({(*ring[k:], *ring[:k])})]
    found: set[frozenset[tuple[int, ...]]] = set()
    free = [i for i, corner in enumerate(ring) if corner in gables]
    for i, j in combinations(free[:_MOST_GABLES], 2):
        if 1 < j - i < len(ring) - 1:
            left, right = ring[i : j + 1], [*ring[j:], *ring[: i + 1]]
            ones = _folded(corners_m, left, gables)
            found |= {a | b for a in ones for b in _folded(corners_m, right, gables)}
    fewest = min(map(len, found), default=0)
    return [way for way in found if len(way) == fewest]


def _ceiling(walls: Sequence[Part], ground_m: float) -> FloatArray:
    """Return the plane z = c + p x + q y of the ceiling as (c, p, q): level where that will do."""
    tops = []
    for wall in walls:
        z = wall.corners_m[:, 2]
        tops.append(wall.corners_m[z > z.min() + _LEVEL_M])
    points = np.concatenate(tops)
    if not len(points):
        raise InputError(
            "the walls of the scan have no height",
            found=f"{len(walls)} walls lower than {_LEVEL_M:g} m",
            needed="tops above their feet",
            hint=_HINT,
        )
    level = np.array([np.median(points[:, 2]), 0.0, 0.0])
    at = np.column_stack([np.ones(len(points)), points[:, :2]])
    sloping = np.linalg.lstsq(at, points[:, 2], rcond=None)[0]
    for plane in (level, sloping):
        off_m = float(np.abs(at @ plane - points[:, 2]).max())
        if off_m <= _LEVEL_M and (at @ plane - ground_m).min() > _LEVEL_M:
            return plane
    low, high = points[:, 2].min() - ground_m, points[:, 2].max() - ground_m
    raise InputError(
        "a scan has no ceiling, and the tops of its walls carry none",
        found=f"tops {low:.2f} to {high:.2f} m above the floor, up to {off_m:.2f} m off a plane",
        needed=f"all within {_LEVEL_M:g} m of one plane, level or sloping, or of planes that meet "
        "along lines between gables, of walls that end alike in the corners",
        hint=_HINT,
    )


_Hole = tuple[Part, FloatArray]  # what is in a wall: from and to along it, from and to in height


def _sides(
    edges: Sequence[_Edge], parts: Sequence[Part], ground_m: float
) -> tuple[list[Polygon], set[str]]:
    """Return the polygons of all walls and of what is in them, and the names of those in use."""
    holes: dict[int, list[_Hole]] = {i: [] for i in range(len(edges))}
    for part in parts:
        if part.kind == "wall":
            continue
        own = [_shared(e.start_m, e.end_m, part) for e in edges]
        if part.parent in {e.wall.own for e in edges if e.wall is not None}:
            kept = [e.wall is not None and e.wall.own == part.parent for e in edges]
            own = [length if keep else 0.0 for length, keep in zip(own, kept, strict=True)]
        best = int(np.argmax(own))
        # a wall with a gable has two sides, and a window may be in both
        for i, edge in enumerate(edges):
            is_there = i == best or (edge.wall is not None and edge.wall is edges[best].wall)
            hole = _hole(edge, part, ground_m) if is_there and own[i] > 0.0 else None
            if hole is not None:
                holes[i].append((part, hole))
    polygons: list[Polygon] = []
    for i, edge in enumerate(edges):
        polygons += _pieces(edge, holes[i], f"Gap{i}", ground_m)
    # an opening may take a whole wall
    walls = {e.wall.name for e in edges if e.wall is not None}
    return polygons, walls | {surface.name for _, surface in polygons}


def _hole(edge: _Edge, part: Part, ground_m: float) -> FloatArray | None:
    """Return where in a wall something is: from and to along it and in height, shape (4,)."""
    along, _ = _beside(edge.start_m, edge.end_m, part.corners_m[:, :2])
    length = _length(np.stack([edge.start_m, edge.end_m]))
    z = part.corners_m[:, 2]
    found = np.array([along.min(), along.max(), z.min(), z.max()])
    top = float(np.interp(found[:2], [0.0, length], edge.tops_m).min())
    for k, (low, high) in enumerate([(0.0, length)] * 2 + [(ground_m, top)] * 2):
        value = min(max(found[k], low), high)
        found[k] = low if value - low < _RIM_M else high if high - value < _RIM_M else value
    return found if min(found[1] - found[0], found[3] - found[2]) >= _RIM_M else None


def _pieces(edge: _Edge, holes: Sequence[_Hole], unnamed: str, ground_m: float) -> list[Polygon]:
    """Return a wall in columns, cut at the rims of what is in it; where two overlap, the first."""
    wall = (
        Surface(unnamed, "opening", "opening")
        if edge.wall is None
        else Surface(edge.wall.name, "wall", "wall")
    )
    length = _length(np.stack([edge.start_m, edge.end_m]))
    way = (edge.end_m - edge.start_m) / length
    found: list[Polygon] = []
    cuts = np.unique([0.0, length, *(x for _, hole in holes for x in hole[:2])])
    for left, right in pairwise(cuts):
        plan = edge.start_m + np.outer([left, right], way)
        tops = np.interp([left, right], [0.0, length], edge.tops_m)
        here = [h for h in holes if h[1][0] <= left and right <= h[1][1]]
        # a sloping top is met by the last piece of a column alone
        rims = np.unique([ground_m, *(z for _, hole in here for z in hole[2:])])
        rims = rims[rims < tops.min() - _DISTINCT_M]
        below = [np.full(2, z) for z in rims]
        for low, high in zip(below, [*below[1:], tops], strict=True):
            middle = 0.5 * (low.mean() + min(high.mean(), high.min() + _RIM_M))
            part = next((p for p, hole in here if hole[2] <= middle <= hole[3]), None)
            surface = wall if part is None else Surface(part.name, part.kind, part.kind)
            corners = [(*plan[0], low[0]), (*plan[1], low[1]), (*plan[1], high[1])]
            corners.append((*plan[0], high[0]))
            found.append((np.array(corners), surface))
    return found


def _at_home(longest: _Edge, vertices_m: FloatArray, *more_m: FloatArray) -> list[FloatArray]:
    """Return points with the longest side of the floor along x, the lowest of all vertices at 0."""
    c, s = (longest.end_m - longest.start_m) / _length(np.stack([longest.start_m, longest.end_m]))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = (vertices_m @ turn).min(axis=0)
    # corners of a scan are known to centimetres
    return [np.asarray(np.round(x @ turn - origin, 6) + 0.0) for x in (vertices_m, *more_m)]


def _completed(
    edges: Sequence[_Edge], moved_m: float, heights_m: FloatArray, n_planes: int, lies: str
) -> Finding:
    """Return what was put in, and how the axes lie."""
    low, high = float(heights_m.min()), float(heights_m.max())
    tall = f"{low:.2f}" if high - low < _DISTINCT_M else f"{low:.2f} to {high:.2f}"
    flat = "A flat ceiling" if n_planes == 1 else f"A ceiling of {n_planes} planes between gables"
    text = f"{flat} was put {tall} m above the floor, on the walls' tops: a scan has none. "
    if moved_m > _DISTINCT_M:
        text += f"Ends of walls up to {moved_m:.2f} m apart were joined. "
    gaps_m = [_length(np.stack([e.start_m, e.end_m])) for e in edges if e.wall is None]
    if gaps_m:
        text += (
            f"Sides of the floor without a wall, {sum(gaps_m):.2f} m in all, were closed by an "
            "'opening': say in [room.materials] what is there. "
        )
    evidence = {"height_m": [low, high], "joined_m": moved_m, "without_wall_m": gaps_m}
    grade: Severity = "warning" if gaps_m else "info"
    return Finding(Code.ROOM_COMPLETED, About(), text + lies, evidence, graded=grade)


def _left_out(idle: Sequence[str], objects: Counter[str]) -> list[Finding]:
    """Return what of a scan is not in the room."""
    found = []
    code = Code.ENTITIES_IGNORED
    if idle:
        text = f"Parts of the scan are on no outer wall, left out: {', '.join(idle)}."
        found.append(Finding(code, About(), text, {"parts": list(idle)}, graded="warning"))
    if objects:
        text = (
            f"What stands in the scanned room is no wall of it: {counted(objects)}. It absorbs as "
            "[objects] say, to which `roomfit init` writes beds and sofas; a piece whose shadow "
            "matters belongs into the room's file."
        )
        kinds = dict(objects.most_common(_MOST_KINDS))
        found.append(Finding(code, About(), text, kinds, graded="info"))
    return found


def read_usdz(path: Path) -> RoomModel:
    """Read a scan by Apple's RoomPlan from its USDZ by usd-core: metres, z up.

    Walls, doors and windows are known by their names, each flat where the middle of its box is.
    See `closed_room`.
    """
    _, shapes = isolated_polygons(
        path,
        "roomfit.formats.roomplan:read_scan",
        "usd-core",
        "USDZ",
        "roomfit[usd], or give the scan's JSON, which needs nothing and says more",
    )
    parts = [part_of(s.name, s.group or "", points) for points, s in shapes if s.group != "thing"]
    things = [thing_of(s.name, points) for points, s in shapes if s.group == "thing"]
    with located(str(path)):
        return closed_room(parts, None, things)


def read_scan(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the points of each wall, door, window and opening of a scan by RoomPlan, m, z up.

    They are known by names, as Wall0 or Door_0; whatever else ends in a number is a thing, of the
    group "thing".
    """
    os.environ["PXR_WORK_THREAD_LIMIT"] = "1"  # each thread takes addresses, which are limited
    from pxr import Tf, Usd, UsdGeom

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scan.usdz")
        file.write_bytes(content)
        try:
            stage = Usd.Stage.Open(str(file))
        except Tf.ErrorException as error:
            # its text has places in the library and of this copy
            raise ValueError("no layer of USD that can be opened") from error
        for layer in stage.GetUsedLayers():
            if not (layer.anonymous or layer.realPath.startswith(str(file))):
                raise ValueError("it leads to other files")
        found: dict[tuple[str, str, str], list[Any]] = {}
        for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Gprim):
                continue
            place[0] = str(prim.GetPath())
            kind, number = _numbered(prim)
            if kind in ("wall", "door", "window", "opening"):
                named = (f"{kind.capitalize()}{number}", kind, "")
                found.setdefault(named, []).append(_points(prim))
            elif kind not in ("", "floor", "ceiling"):
                found.setdefault((f"{kind}{number}", "thing", ""), []).append(_points(prim))
        metres, up = UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)
    if all(group == "thing" for _, group, _ in found):
        raise ValueError("nothing in it is named Wall0: no scan by RoomPlan; export it as GLB")
    polygons: Outlines = []
    for named, parts in found.items():
        x, y, z = metres * np.concatenate(parts).T
        polygons.append((np.stack([x, -z, y] if up == "Y" else [x, y, z], axis=1), named))
    return outline(polygons)


def _numbered(prim: Any) -> tuple[str, str]:
    """Return kind and number in the name of a shape, or else of what it belongs to."""
    while prim and not prim.IsPseudoRoot():
        match = re.fullmatch(r"([A-Za-z]+)_?([0-9]+)", prim.GetName())
        if match:
            return match[1].lower(), match[2]
        prim = prim.GetParent()
    return "", ""


def _points(prim: Any) -> Any:
    """Return the points of a mesh, or the corners of what encloses another shape, in the scene."""
    from pxr import Usd, UsdGeom

    own = UsdGeom.Mesh(prim).GetPointsAttr().Get() if prim.IsA(UsdGeom.Mesh) else None
    if own is None:
        now = Usd.TimeCode.Default()
        low, high = np.array(
            UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), now)
        )
        own = [np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)]
    points = np.array(own, dtype=np.float64).reshape(-1, 3)
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    return points @ matrix[:3, :3] + matrix[3, :3]
