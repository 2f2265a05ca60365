"""Rooms as Apple's RoomPlan exports them, written after its documentation: none was scanned."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from roomfit.base.typing import FloatArray

# an L of 6 x 5 m without its corner of 2.5 x 2 m: 25 m2
ELL = ((0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (3.5, 3.0), (3.5, 5.0), (0.0, 5.0))
HEIGHT_M = 2.6


def placed(turned_deg: float, moved_m: Sequence[float], ground_m: float) -> FloatArray:
    """Return the matrix of a scan's frame, whose y points up, from a room's with z up."""
    c, s = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turn = np.array([[c, -s, 0, moved_m[0]], [s, c, 0, moved_m[1]], [0, 0, 1, ground_m]])
    return up @ np.vstack([turn, [0.0, 0.0, 0.0, 1.0]])


def upright(
    start: Sequence[float], end: Sequence[float], low_m: float, high_m: float, frame: FloatArray
) -> tuple[list[float], list[float]]:
    """Return dimensions and transform of a rectangle that stands on a line of the plan."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    (x, y), middle = (b - a) / length, (a + b) / 2.0
    # its own x along the line, its own y upwards
    own = np.array(
        [
            [x, 0, y, middle[0]],
            [y, 0, -x, middle[1]],
            [0, 1, 0, (low_m + high_m) / 2.0],
            [0, 0, 0, 1],
        ]
    )
    return [length, high_m - low_m, 0.0], (frame @ own).T.ravel().tolist()


def surface(number: int, kind: str, shape: tuple[list[float], list[float]], **more: Any) -> Any:
    dimensions, transform = shape
    return {
        "identifier": f"{kind}-{number}",
        "category": {kind: {"isOpen": False} if kind == "door" else {}},
        "dimensions": dimensions,
        "transform": transform,
        "confidence": {"high": {}},
        "completedEdges": [],
        "curve": None,
        "parentIdentifier": None,
        "story": 0,
        "polygonCorners": [],
        **more,
    }


def scan(
    outline: Sequence[Sequence[float]] = ELL,
    *,
    gap_m: float = 0.0,
    floor: bool = True,
    skip: Sequence[int] = (),
    turned_deg: float = 25.0,
) -> dict[str, Any]:
    """Return an L-shaped room with a door of 0.9 x 2.1 m, a window of 2 x 1 m and a table.

    The door is in the first wall 1 m from its start, the window in the last; every wall is shorter
    than its side of the outline by `gap_m` at both ends.
    """
    frame = placed(turned_deg, (-1.3, 0.7), -1.45)
    corners = np.array(outline)
    walls, ends = [], list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    for i, (a, b) in enumerate(ends):
        way = (b - a) / np.linalg.norm(b - a)
        shape = upright(a + gap_m * way, b - gap_m * way, 0.0, HEIGHT_M, frame)
        walls.append(surface(i, "wall", shape))

    def within(k: int, start: float, length: float) -> tuple[FloatArray, FloatArray]:
        a, b = ends[k]
        way = (b - a) / np.linalg.norm(b - a)
        return a + start * way, a + (start + length) * way

    door = upright(*within(0, 1.0, 0.9), 0.0, 2.1, frame)
    window = upright(*within(-1, 1.5, 2.0), 0.9, 1.9, frame)
    level = [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    shape = ([6.0, 5.0, 0.0], (frame @ np.array(level)).T.ravel().tolist())
    flat = [[x, y, 0.0] for x, y in outline]
    parent = f"wall-{len(ends) - 1}"
    return {
        "version": 2,
        "story": 0,
        "walls": [w for i, w in enumerate(walls) if i not in skip],
        "doors": [surface(0, "door", door, parentIdentifier="wall-0")],
        "windows": [surface(0, "window", window, parentIdentifier=parent)],
        "openings": [],
        "floors": [surface(0, "floor", shape, polygonCorners=flat)] if floor else [],
        "objects": [{"category": {"table": {}}, "identifier": "o", "dimensions": [1, 1, 1]}],
        "sections": [{"label": "livingRoom", "center": [0, 0, 0], "story": 0}],
    }


def furniture(
    kind: str, middle: Sequence[float], size: Sequence[float], turned_deg: float = 25.0
) -> dict[str, Any]:
    """Return a piece that stands on the floor of `scan`: length, height and depth in m."""
    frame = placed(turned_deg, (-1.3, 0.7), -1.45)
    own = np.eye(4)
    # its own y upwards, its depth towards -y of the room
    own[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    own[:3, 3] = [middle[0], middle[1], size[1] / 2.0]
    matrix = (frame @ own).T.ravel().tolist()
    return {"category": {kind: {}}, "dimensions": list(size), "transform": matrix}


def attic(tops: Sequence[tuple[float, float]] = ((3.0, 4.0),), walls: str = "13") -> dict[str, Any]:
    """Return a room of 8 x 6 m whose walls end at 2.2 m, but for gables of 6 m along y.

    Corners of the gables are given by place along the wall and height in m, and by which walls have
    them. A window of 2 x 1.8 m is in the middle of the second wall, from 1 m on.
    """
    frame, low, high = placed(25.0, (-1.3, 0.7), -1.45), 2.2, max(z for _, z in tops)
    corners = [(0, 0), (8, 0), (8, 6), (0, 6)]
    content = scan(corners)
    for i in range(4):
        own = high if str(i) in walls else low
        shape = upright(corners[i], corners[(i + 1) % 4], 0.0, own, frame)
        outline: list[Any] = []
        if str(i) in walls:
            line = [(0.0, 0.0), (6.0, 0.0), (6.0, low), *reversed(tops), (0.0, low)]
            outline = [[x - 3.0, z - high / 2.0, 0.0] for x, z in line]
        content["walls"][i] = surface(i, "wall", shape, polygonCorners=outline)
    window = upright((8, 2.0), (8, 4.0), 1.0, 2.8, frame)
    parent = {"parentIdentifier": "wall-1"}
    return {**content, "doors": [], "windows": [surface(0, "window", window, **parent)]}


def scan_json(**changes: Any) -> bytes:
    """Return such a scan as Swift's JSONEncoder writes it."""
    return json.dumps(scan(**changes)).encode()


def scan_usdz(*, thick_m: float = 0.16, names: str = "{}{}", meshes: bool = False) -> bytes:
    """Return the same room as a USDZ: boxes of a side of 1 m that are stretched, or meshes.

    The scene is in cm with y up. Meshes lie in the scene's own axes, and a wall's has a notch or
    a hole, so that more points lie on one side than on the other.
    """
    import tempfile
    from pathlib import Path

    from pxr import Gf, Usd, UsdGeom, UsdUtils

    content = scan(floor=False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scan.usdc")
        stage = Usd.Stage.CreateNew(str(file))
        UsdGeom.SetStageUpAxis(stage, "Y")
        UsdGeom.SetStageMetersPerUnit(stage, 0.01)
        UsdGeom.Xform.Define(stage, "/Room")
        for key in ("walls", "doors", "windows"):
            for i, own in enumerate(content[key]):
                kind = key[:-1].capitalize()
                path = f"/Room/{kind}_{i}_grp/{names.format(kind, i)}"
                length, height, _ = own["dimensions"]
                matrix = np.diag([length, height, thick_m, 1.0])
                matrix = 100.0 * np.array(own["transform"]).reshape(4, 4).T @ matrix
                matrix[3] = [0, 0, 0, 1]
                if meshes:
                    unit = [[(i & 1) - 0.5, (i >> 1 & 1) - 0.5, (i >> 2) - 0.5] for i in range(8)]
                    unit += [[0.0, -0.5, 0.5], [0.1, 0.1, 0.5], [0.2, -0.5, 0.5]]
                    points = np.column_stack([unit, np.ones(len(unit))]) @ matrix.T
                    UsdGeom.Mesh.Define(stage, path).CreatePointsAttr(points[:, :3].tolist())
                else:
                    cube = UsdGeom.Cube.Define(stage, path)
                    cube.CreateSizeAttr(1.0)
                    cube.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
        UsdGeom.Cube.Define(stage, "/Room/Object_grp/Table0")
        own = furniture("sofa", (4.0, 0.45), (2.0, 0.8, 0.9))
        matrix = 100.0 * np.array(own["transform"]).reshape(4, 4).T @ np.diag([2.0, 0.8, 0.9, 1.0])
        matrix[3] = [0, 0, 0, 1]
        sofa = UsdGeom.Cube.Define(stage, "/Room/Object_grp/Sofa0")
        sofa.CreateSizeAttr(1.0)
        sofa.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
        stage.Save()
        UsdUtils.CreateNewUsdzPackage(str(file), str(Path(folder, "scan.usdz")))
        return Path(folder, "scan.usdz").read_bytes()
