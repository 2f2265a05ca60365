"""SketchUp models, read by openskp."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.base.door import too_many_numbers
from roomfit.base.polygon import Surface
from roomfit.formats.model import (
    Outlines,
    RoomModel,
    ignored,
    isolated_polygons,
    joined,
    outline,
)


def read_skp(path: Path) -> RoomModel:
    """Read the faces of a SketchUp model by openskp: inches, z up.

    A surface has the name of its component or group, "model" outside of them, and the material
    that is painted on it; unpainted faces have that of the component, and sides without paint that
    of the other side. Each face comes once for its front and, turned, once for its back, so that
    the one counts which looks into the air. Hidden faces are of the room as well, for ceilings are
    hidden to look in.
    """
    read, install = "roomfit.formats.skp:read", "roomfit[skp], or export it as COLLADA, OBJ or GLB"
    head, painted = isolated_polygons(path, read, "openskp", "SketchUp", install)
    polygons = []
    for points, sides in painted:
        front, back = sides.file_material, sides.group
        polygons.append((points, Surface(sides.name, None, front or back)))
        polygons.append((points[::-1], Surface(sides.name, None, back or front)))
    kinds = {str(kind): int(n) for kind, n in dict(head["ignored"]).items()}
    if int(head["hidden"]):
        kinds["hidden face, taken all the same"] = int(head["hidden"])
    findings = ignored("The model has parts that are hidden or no faces", kinds)
    return RoomModel(*joined(polygons), findings, "in", "z")


def read(content: bytes, most_bytes: float, place: list[str]) -> tuple[dict[str, Any], list[Any]]:
    """Return the faces of a SketchUp model, every component where it is placed, in inches, z up.

    Corners run counter-clockwise as seen from a face's front. A surface is named as the component
    or group; in place of group and material are the materials of back and front.
    """
    from openskp import SkpFile
    from openskp.errors import SkpParseError

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "room.skp")
        file.write_bytes(content)
        try:
            model = SkpFile(file).parse()
        except SkpParseError as error:
            raise ValueError(str(error)) from error
    names = {i: str(material.name) for i, material in model.materials_by_id.items()}
    polygons: Outlines = []
    ignored: Counter[str] = Counter()
    n_bytes, hidden = 0, 0
    # what is placed, how, under which name and paint, hidden or not, and within what
    stack = [(model.root, np.eye(4)[:3], "model", "", False, frozenset[int]())]
    while stack:
        own, matrix, name, paint, is_hidden, within = stack.pop()
        place[0] = repr(name)
        for face in own.faces.values():
            back, front = (names.get(i, paint) for i in (face.back_material_id, face.material_id))
            for corners in _face_corners(own, face, matrix):
                polygons.append((corners, (name, back, front)))
                n_bytes += corners.nbytes
                hidden += is_hidden or bool(face.hidden)
            if n_bytes > most_bytes:
                raise too_many_numbers(most_bytes)
        for part in own.instances:
            inner = model.definitions.get(part.ref_idx)
            if inner is None or inner.is_image or inner.always_faces_camera:
                ignored["part without a definition" if inner is None else "picture"] += 1
                continue
            if part.ref_idx in within:
                raise ValueError("a component that contains itself")
            m = np.array(part.matrix[:12], dtype=np.float64)
            turn = matrix[:, :3] @ m[:9].reshape(3, 3)
            put = np.column_stack([turn, matrix[:, :3] @ m[9:] + matrix[:, 3]])
            called = str(part.name or inner.name or "group")
            shown = names.get(part.material_id, paint), is_hidden or bool(part.hidden)
            stack.append((inner, put, called, *shown, within | {part.ref_idx}))
    return outline(polygons, ignored=ignored, hidden=hidden)


def _face_corners(own: Any, face: Any, matrix: Any) -> list[Any]:
    """Return the outline of a face, or where it has holes the triangles around them."""
    from mapbox_earcut import triangulate_float64

    loops = []
    for loop in face.loops:
        ends = [(own.edges[edge], forwards) for edge, forwards in loop]
        at = [own.vertices[e.v1_id if forwards > 0 else e.v2_id] for e, forwards in ends]
        loops.append(np.array([(v.x, v.y, v.z) for v in at], dtype=np.float64))
    loops.sort(key=lambda loop: -float(np.linalg.norm(_normal(loop))))
    if face.normal is not None and _normal(loops[0]) @ np.array(face.normal) < 0.0:
        loops[0] = loops[0][::-1]
    normal = _normal(loops[0])
    if len(loops) == 1:
        parts = loops
    else:
        points = np.concatenate(loops)
        axes = np.linalg.svd(normal[None])[2][1:]
        rings = np.cumsum([len(loop) for loop in loops]).astype(np.uint32)
        flat = np.ascontiguousarray(points @ axes.T)
        parts = list(points[triangulate_float64(flat, rings).astype(np.int64).reshape(-1, 3)])
        parts = [p if _normal(p) @ normal > 0.0 else p[::-1] for p in parts]
    # a mirror leaves the front where it was, and turns the corners round
    sense = 1 if np.linalg.det(matrix[:, :3]) > 0.0 else -1
    return [(p @ matrix[:, :3].T + matrix[:, 3])[::sense] for p in parts]


def _normal(corners: Any) -> Any:
    """Return twice the area of a polygon along its normal, shape (3,)."""

    return np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
