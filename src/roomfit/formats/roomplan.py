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


class _Part(NamedTuple):
    """A wall of a scan, or what is in a wall: upright and flat."""

    name: str
    kind: str  # wall, door, window or opening
    corners_m: FloatArray  # (n_corners, 3), z up
    parent: str = ""  # name of the wall it is in, "" where that is not said
    is_curved: bool = False  # its corners are the ends of its arc


class _Side(NamedTuple):
    """A side of the floor, with the room to the left of its way from start to end."""

    ends_m: FloatArray  # (2, 3), with the heights of the ceiling
    wall: _Part | None

    @property
    def length_m(self) -> float:
        """Length on the floor."""
        return _length(self.ends_m[:, :2])


def read_roomplan(path: Path, space: str | None = None) -> RoomModel:
    """Read a ``CapturedRoom`` of RoomPlan as Swift's JSONEncoder writes it [1]_: m, z up.

    Surfaces are Wall0, Door0, Window0, Opening0, ..., Floor0 and Ceiling; their materials and
    groups wall, door, window, opening, floor and ceiling. See `_closed_room`.

    References
    ----------
    .. [1] Apple Inc., "RoomPlan: CapturedRoom", developer documentation (2022 to 2025).
    """
    with located(str(path)):
        content = _chosen(json_content(read_text(path, "room file"), "room file"), space)
        if not isinstance(content, dict) or not isinstance(content.get("walls"), list):
            what = "this JSON file is no scan of a room"
            needed = "a CapturedRoom of Apple's RoomPlan, encoded by JSONEncoder"
            hint = "export the scan anew; a drawing is given as OBJ, IFC or COLLADA"
            raise _refused(what, "no list of walls", needed, hint)
        with complete("scan", "dimensions and transform of each surface, as RoomPlan has them"):
            each = {kind: content.get(key) or () for kind, key in _KINDS.items()}
            own = [(kind, i, x) for kind, found in each.items() for i, x in enumerate(found)]
            furniture = content.get("objects") or ()
            # before each is looked at, which takes long
            check_limit("scan_parts", len(own) + len(furniture), "the scan")
            names = {x.get("identifier"): f"Wall{i}" for k, i, x in own if k == "wall"}
            parts = []
            for kind, i, x in own:
                parent = names.get(x.get("parentIdentifier"), "")
                is_curved, name = x.get("curve") is not None, f"{kind.capitalize()}{i}"
                parts.append(_Part(name, kind, _corners(x), parent, is_curved))
            floors = [_corners(f) for f in content.get("floors") or () if f.get("polygonCorners")]
            things = [_thing(thing) for thing in furniture]
        if len(floors) > 1:
            raise _refused("the scan has several floors", f"{len(floors)}", "one")
        return _closed_room(parts, floors[0] if floors else None, things)


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


def _closed_room(
    parts: Sequence[_Part], floor_m: FloatArray | None, things: Sequence[Thing]
) -> RoomModel:
    """Return a closed room of what a scan has found: m, z up."""
    n_parts = len(parts) + (0 if floor_m is None else len(floor_m)) + len(things)
    check_limit("scan_parts", n_parts, "the scan")
    walls = [p for p in parts if p.kind == "wall" and _length(_foot(p)) > _DISTINCT_M]
    if len(walls) < 3:
        raise _refused("the scan encloses no room", f"{len(walls)} walls", "three or more")
    plan, owners, moved_m = _by_walls(walls) if floor_m is None else _by_floor(floor_m, walls)
    x, y, _ = plan.T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) <= 0.0:  # the room is to the right
        plan, owners = np.roll(plan[::-1], 1, axis=0), owners[::-1]
    if not any(owners):
        what = "no wall of the scan stands on the outline of its floor"
        raise _refused(what, f"{len(walls)} walls elsewhere", "a wall on one side or more")
    ground_m = float(np.median([w.corners_m[:, 2].min() for w in walls]))
    longest = max(_sides(plan, owners), key=lambda side: side.length_m)
    corners, owners, ceiling = _covered(plan, owners, walls, ground_m)
    sides = _sides(corners, owners)
    polygons = _cut(sides, parts, ground_m)
    # an opening may take a whole wall
    used = {w.name for w in owners if w is not None} | {surface.name for _, surface in polygons}
    floor = corners * [1.0, 1.0, 0.0] + [0.0, 0.0, ground_m]
    polygons.append((floor[::-1], Surface("Floor0", "floor", "floor")))
    vertices, faces = joined([*polygons, *ceiling])
    run = longest.ends_m + np.array([0.0, 0.0, ground_m])
    bases = [t.outline_m * [1.0, 1.0, 0.0] + [0.0, 0.0, ground_m] for t in things]
    # the longest side lies along x, and the lowest of all vertices at 0
    c, s = (run[1] - run[0])[:2] / longest.length_m
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = (vertices @ turn).min(axis=0)
    # corners of a scan are known to centimetres
    room, (start, end), *stand = (
        np.asarray(np.round(x @ turn - origin, 6) + 0.0) for x in (vertices, run, *bases)
    )
    lies = (
        f"x runs along {longest.wall.name if longest.wall else 'the longest side'}, from "
        f"{place(start)} to {place(end)}: give positions in these axes."
    )
    findings = (
        _completed(sides, moved_m, ground_m, len({surface.name for _, surface in ceiling}), lies),
        *_left_out([p.name for p in parts if p.name not in used], Counter(t.kind for t in things)),
    )
    placed = tuple(t._replace(outline_m=at) for t, at in zip(things, stand, strict=True))
    return RoomModel(room, faces, findings, "m", "z", placed)


def _refused(what: str, found: str, needed: str, hint: str = _HINT, where: str = "") -> InputError:
    return InputError(what, where=where or None, found=found, needed=needed, hint=hint)


def _foot(part: _Part) -> FloatArray:
    """Return the two ends of what stands upright as seen from above, shape (2, 2)."""
    plan = part.corners_m[:, :2]
    a = plan[np.argmax(np.linalg.norm(plan - plan.mean(axis=0), axis=1))]
    b = plan[np.argmax(np.linalg.norm(plan - a, axis=1))]
    return np.stack([a, b])


def _length(ends: FloatArray) -> float:
    return float(np.linalg.norm(ends[1] - ends[0]))


def _sides(corners_m: FloatArray, owners: Sequence[_Part | None]) -> list[_Side]:
    """Return the sides from corner to corner, shape (n, 3), and whose wall is on each."""
    ends = np.stack([corners_m, np.roll(corners_m, -1, axis=0)], axis=1)
    return [_Side(*side) for side in zip(ends, owners, strict=True)]


# corners (n, 3) at z 0; walls; the widest gap that was closed, in m
_Outline = tuple[FloatArray, list["_Part | None"], float]


def _by_walls(walls: Sequence[_Part]) -> _Outline:
    """Return a floor whose corners are those of walls, which follow each other around the room."""
    if bent := [w.name for w in walls if w.is_curved]:
        what = "a wall of the scan is curved, and nothing says along which line"
        needed = "an outline, whose corners follow the curve"
        hint = f"scan with iOS 17 or later, which exports it, or {_HINT}"
        raise _refused(what, "no outline of the floor", needed, hint, ", ".join(bent))
    feet = np.array([_foot(w) for w in walls])
    first = int(np.argmax(np.linalg.norm(feet[:, 1] - feet[:, 0], axis=1)))
    order, ends = [first], [feet[first]]
    while True:
        gaps_m = np.linalg.norm(feet - ends[-1][1], axis=2)
        home_m = gaps_m[first, 0] if len(order) > 2 else np.inf
        gaps_m[order] = np.inf
        near, back = divmod(int(np.argmin(gaps_m)), 2)
        gap_m = min(home_m, gaps_m[near, back])
        if gap_m > _MEETS_M:
            what, where = "walls of the scan do not meet", f"the end of {walls[order[-1]].name}"
            found = f"{gap_m:.2f} m to the nearest end of another"
            hint = f"scan with iOS 17 or later, which exports the outline of the floor, or {_HINT}"
            raise _refused(what, found, f"at most {_MEETS_M:g} m", hint, where)
        if home_m == gap_m:
            break
        order.append(near)
        ends.append(feet[near][::-1] if back else feet[near])
    plan: list[FloatArray] = []
    owners: list[_Part | None] = []
    moved_m = 0.0
    for i, one, two in zip(order, ends, [*ends[1:], ends[0]], strict=True):
        meeting = _meeting(one, two)
        moved_m = max(moved_m, float(np.linalg.norm(two[0] - one[1])))
        plan += meeting
        # of two corners the step between them belongs to the wall that ends there
        owners += [walls[i]] * len(meeting)
    # the first of these corners is where the first wall ends
    return np.pad(plan, ((0, 0), (0, 1))), [*owners[1:], owners[0]], moved_m


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


def _by_floor(floor_m: FloatArray, walls: Sequence[_Part]) -> _Outline:
    """Return an outlined floor, on each side the wall that covers most of it.

    Where there is none, that may be a chord of a curved wall, in the circle over the wall's ends.
    """
    plan = floor_m * [1.0, 1.0, 0.0]
    plan = plan[np.linalg.norm(plan - np.roll(plan, 1, axis=0), axis=1) > _DISTINCT_M]
    if len(plan) < 3:
        found = f"{len(plan)} corners that are apart"
        raise _refused("the floor of the scan has no area", found, "three corners or more")
    flat, bent = [w for w in walls if not w.is_curved], [w for w in walls if w.is_curved]

    def owner(side: _Side) -> _Part | None:
        covered = [_shared(side, w) for w in flat]
        if max(covered, default=0.0) > 0.5 * side.length_m:
            return flat[int(np.argmax(covered))]
        middle = side.ends_m[:, :2].mean(axis=0)
        feet = [_foot(w) for w in bent]
        off_m = [np.linalg.norm(middle - f.mean(axis=0)) - 0.5 * _length(f) for f in feet]
        return bent[int(np.argmin(off_m))] if min(off_m, default=np.inf) <= _MEETS_M else None

    return plan, [owner(side) for side in _sides(plan, [None] * len(plan))], 0.0


def _shared(side: _Side, part: _Part) -> float:
    """Return the length over which a part stands along a side; 0 where it stands elsewhere."""
    foot = _foot(part)
    along, aside = _beside(side, foot)
    if np.abs(aside).max() > _MEETS_M or abs(np.ptp(along)) < _PARALLEL * _length(foot):
        return 0.0
    return float(max(min(along.max(), side.length_m) - max(along.min(), 0.0), 0.0))


def _beside(side: _Side, plan: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far points, shape (n, 2), lie along a side and beside it, each (n,)."""
    start, end = side.ends_m[:, :2]
    way = (end - start) / np.linalg.norm(end - start)
    from_start = plan - start
    return from_start @ way, from_start @ np.array([-way[1], way[0]])


_Ceiling = tuple[FloatArray, list["_Part | None"], list[Polygon]]  # corners (n, 3); walls; planes


def _covered(
    plan: FloatArray, owners: list[_Part | None], walls: Sequence[_Part], ground_m: float
) -> _Ceiling:
    """Return the line on which a ceiling rests, whose wall is on each side, and the ceiling.

    One plane, level where that will do; else planes that meet along lines from gable to gable.
    """
    tops = [w.corners_m[w.corners_m[:, 2] > w.corners_m[:, 2].min() + _LEVEL_M] for w in walls]
    points = np.concatenate(tops)
    if not len(points):
        found = f"{len(walls)} walls lower than {_LEVEL_M:g} m"
        raise _refused("the walls of the scan have no height", found, "tops above their feet")
    level = np.array([np.median(points[:, 2]), 0.0, 0.0])
    at = np.column_stack([np.ones(len(points)), points[:, :2]])
    sloping = np.linalg.lstsq(at, points[:, 2], rcond=None)[0]
    for plane in (level, sloping):
        off_m = float(np.abs(at @ plane - points[:, 2]).max())
        if off_m <= _LEVEL_M and (at @ plane - ground_m).min() > _LEVEL_M:
            heights = plane[0] + plan[:, :2] @ plane[1:]
            corners = np.column_stack([plan[:, :2], heights])
            return corners, owners, [(corners, Surface("Ceiling", "ceiling", "ceiling"))]
    corners, owners, gables = _profile(_sides(plan, owners))
    ways = _folded(corners, range(len(corners)), gables) if len(corners) else []
    if len(ways) != 1 or (corners[:, 2] - ground_m).min() <= _LEVEL_M:
        low, high = points[:, 2].min() - ground_m, points[:, 2].max() - ground_m
        raise _refused(
            "a scan has no ceiling, and the tops of its walls carry none",
            f"tops {low:.2f} to {high:.2f} m above the floor, up to {off_m:.2f} m off a plane",
            f"all within {_LEVEL_M:g} m of one plane, level or sloping, or of planes that meet "
            "along lines between gables, of walls that end alike in the corners",
        )
    ceiling = []
    for i, ring in enumerate(sorted(ways[0])):
        own, surface = corners[list(ring)], Surface(f"Ceiling{i}", "ceiling", "ceiling")
        # corners of a scan are off their plane by centimetres, which triangles are not
        ceiling += [(own[three], surface) for three in triangulate(own).triangles]
    return corners, owners, ceiling


def _profile(sides: Sequence[_Side]) -> tuple[FloatArray, list[_Part | None], frozenset[int]]:
    """Return the line on which a folded ceiling rests: its corners, walls, and which are gables.

    Corners of the floor have the height at which the walls beside them end; gables are corners
    within a wall. No corners where walls that meet end at two heights.
    """
    tops: list[list[tuple[float, float]]] = []  # over each side: place along it and height
    ends: list[list[float]] = []  # heights over the two ends of each side, none without a wall
    for side in sides:
        corners_m = np.zeros((0, 3)) if side.wall is None else side.wall.corners_m
        along, _ = _beside(side, corners_m[:, :2])
        z = corners_m[:, 2]
        top = [i for i in np.argsort(along) if z[i] > z.min() + _LEVEL_M]
        within = [i for i in top if _MEETS_M < along[i] < side.length_m - _MEETS_M]
        tops.append([(along[i] / side.length_m, z[i]) for i in within])
        ends.append(list(np.interp([0.0, side.length_m], along[top], z[top])) if top else [])
    corners: list[FloatArray] = []
    owners: list[_Part | None] = []
    gables: list[int] = []
    for k, side in enumerate(sides):
        heights = [*ends[k][:1], *ends[k - 1][1:]]
        if not heights or np.ptp(heights) > _LEVEL_M:
            return np.zeros((0, 3)), [], frozenset()
        start, end = side.ends_m
        corners.append(np.array([*start[:2], np.mean(heights)]))
        gables += range(len(corners), len(corners) + len(tops[k]))
        corners += [np.array([*(start + share * (end - start))[:2], z]) for share, z in tops[k]]
        owners += [side.wall] * (1 + len(tops[k]))
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


def _cut(sides: Sequence[_Side], parts: Sequence[_Part], ground_m: float) -> list[Polygon]:
    """Return the polygons of all walls and of what is in them."""
    holes: list[list[_Hole]] = [[] for _ in sides]
    for part in (part for part in parts if part.kind != "wall"):
        shared = np.array([_shared(side, part) for side in sides])
        is_own = [side.wall is not None and side.wall.name == part.parent for side in sides]
        if any(is_own):
            shared *= is_own
        best = int(np.argmax(shared))
        # a wall with a gable has two sides, and a window may be in both
        for i, side in enumerate(sides):
            is_there = i == best or (side.wall is not None and side.wall is sides[best].wall)
            hole = _hole(side, part, ground_m) if is_there and shared[i] > 0.0 else None
            if hole is not None:
                holes[i].append((part, hole))
    pieces = (_pieces(s, holes[i], f"Gap{i}", ground_m) for i, s in enumerate(sides))
    return [polygon for own in pieces for polygon in own]


_Hole = tuple[_Part, FloatArray]  # what is in a wall: from and to along it, from and to in height


def _hole(side: _Side, part: _Part, ground_m: float) -> FloatArray | None:
    """Return where in a wall something is: from and to along it and in height, shape (4,)."""
    along, _ = _beside(side, part.corners_m[:, :2])
    length, z = side.length_m, part.corners_m[:, 2]
    found = np.array([along.min(), along.max(), z.min(), z.max()])
    top = float(np.interp(found[:2], [0.0, length], side.ends_m[:, 2]).min())
    for k, (low, high) in enumerate([(0.0, length)] * 2 + [(ground_m, top)] * 2):
        value = min(max(found[k], low), high)
        found[k] = low if value - low < _RIM_M else high if high - value < _RIM_M else value
    return found if min(found[1] - found[0], found[3] - found[2]) >= _RIM_M else None


def _pieces(side: _Side, holes: Sequence[_Hole], unnamed: str, ground_m: float) -> list[Polygon]:
    """Return a wall in columns, cut at the rims of what is in it; where two overlap, the first."""
    kind = "opening" if side.wall is None else "wall"
    wall = Surface(unnamed if side.wall is None else side.wall.name, kind, kind)
    found: list[Polygon] = []
    length = side.length_m
    (start, end), way_m = side.ends_m[:, :2], [0.0, length]
    cuts = np.unique([0.0, length, *(x for _, hole in holes for x in hole[:2])])
    for left, right in pairwise(cuts):
        plan = start + np.outer([left, right], (end - start) / length)
        tops = np.interp([left, right], way_m, side.ends_m[:, 2])
        here = [h for h in holes if h[1][0] <= left and right <= h[1][1]]
        # a sloping top is met by the last piece of a column alone
        rims = np.unique([ground_m, *(z for _, hole in here for z in hole[2:])])
        below = [np.full(2, z) for z in rims[rims < tops.min() - _DISTINCT_M]]
        for low, high in zip(below, [*below[1:], tops], strict=True):
            middle = 0.5 * (low.mean() + min(high.mean(), high.min() + _RIM_M))
            part = next((p for p, hole in here if hole[2] <= middle <= hole[3]), None)
            surface = wall if part is None else Surface(part.name, part.kind, part.kind)
            heights = [low[0], low[1], high[1], high[0]]
            found.append((np.column_stack([plan[[0, 1, 1, 0]], heights]), surface))
    return found


def _completed(
    sides: Sequence[_Side], moved_m: float, ground_m: float, n_planes: int, lies: str
) -> Finding:
    """Return what was put in, and how the axes lie."""
    heights_m = [side.ends_m[:, 2] - ground_m for side in sides]
    low, high = float(np.min(heights_m)), float(np.max(heights_m))
    tall = f"{low:.2f}" if high - low < _DISTINCT_M else f"{low:.2f} to {high:.2f}"
    flat = "A flat ceiling" if n_planes == 1 else f"A ceiling of {n_planes} planes between gables"
    text = f"{flat} was put {tall} m above the floor, on the walls' tops: a scan has none. "
    if moved_m > _DISTINCT_M:
        text += f"Ends of walls up to {moved_m:.2f} m apart were joined. "
    gaps_m = [side.length_m for side in sides if side.wall is None]
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
    See `_closed_room`.
    """
    read = "roomfit.formats.roomplan:read_scan"
    install = "roomfit[usd], or give the scan's JSON, which needs nothing and says more"
    _, shapes = isolated_polygons(path, read, "usd-core", "USDZ", install)
    parts = [_Part(s.name, s.group, own) for own, s in shapes if s.group and s.group != "thing"]
    things = [
        Thing(s.name.rstrip("0123456789_").lower()[:40], own[:-1], float(own[-1, 2]))
        for own, s in shapes
        if s.group == "thing"
    ]
    with located(str(path)):
        return _closed_room(parts, None, things)


def read_scan(content: bytes, _: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return each wall, door, window and opening of a scan by RoomPlan, m, z up.

    They are known by names, as Wall0 or Door_0, and flattened by `_flat`; whatever else ends in a
    number is a thing, of the group "thing": its outline as seen from above, and behind it a point
    as high as it is tall.
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
        points = np.stack([x, -z, y] if up == "Y" else [x, y, z], axis=1)
        if named[1] == "thing":
            own = np.pad(_rim(points[:, :2]), ((0, 1), (0, 1)))
            own[-1, 2] = np.ptp(points[:, 2])
        else:
            own = _flat(points)
        polygons.append((own, named))
    return outline(polygons)


def _flat(points_m: FloatArray) -> FloatArray:
    """Return the outline of a slab that stands upright, in the middle of it, shape (n, 3)."""
    middle = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))[:2]
    plan = points_m[:, :2] - middle
    # the thinnest way through a slab is square to one of the sides of its outline
    ring = _rim(plan)
    ways = np.roll(ring, -1, axis=0) - ring
    ways = ways if len(ring) else np.linalg.svd(plan, full_matrices=False)[2][:1]
    ways = ways / np.linalg.norm(ways, axis=1)[:, None]
    way = ways[np.argmin([np.ptp(plan @ np.array([-y, x])) for x, y in ways])]
    across = np.array([-way[1], way[0]])
    aside = plan @ across
    rim = _rim(np.column_stack([plan @ way, points_m[:, 2]]))
    plan = middle + np.outer(rim[:, 0], way) + 0.5 * (aside.min() + aside.max()) * across
    return np.column_stack([plan, rim[:, 1]])


def _rim(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of points in a plane, shape (n, 2); none of a line."""
    from scipy.spatial import ConvexHull, QhullError  # heavy, and JSON needs none

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points[:0]


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
        box = UsdGeom.Boundable(prim), Usd.TimeCode.Default()
        low, high = np.array(UsdGeom.Boundable.ComputeExtentFromPlugins(*box))
        own = [np.where([i & 1, i & 2, i & 4], high, low) for i in range(8)]
    points = np.array(own, dtype=np.float64).reshape(-1, 3)
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    return points @ matrix[:3, :3] + matrix[3, :3]
