"""Formats read by trimesh: STL and GLB."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import InputError
from roomfit.files.rooms.model import RoomModel
from roomfit.files.rooms.text import finite, read_bytes
from roomfit.geometry.build import Face
from roomfit.geometry.mesh import Surface
from roomfit.typing import FloatArray

# What a parser of others may raise on a damaged file; anything else is a fault of this program.
PARSER_ERRORS = (
    *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError),
    *(NotImplementedError, OSError, RecursionError, TypeError, ValueError, struct.error),
)


def read_stl(path: Path) -> RoomModel:
    """Read an STL file: triangles without unit, names or materials.

    There is one surface, named as the file.

    Raises
    ------
    InputError
        Not an STL file, cut short, or a coordinate that is not finite.
    """
    parts = _load(path, "stl")
    surface = Surface(path.stem or "unnamed")
    return _joined(path, [(p, t, surface) for _, p, t, _ in parts])


def read_glb(path: Path) -> RoomModel:
    """Read a GLB file, the binary form of glTF 2.0 [1]_: metres, y up by its standard.

    The name of a surface is its node's, its material the one the file gives it.

    Raises
    ------
    InputError
        Not a GLB file, cut short, or a coordinate that is not finite.

    References
    ----------
    .. [1] ISO/IEC 12113:2022, "Runtime 3D asset delivery format (glTF 2.0)".
    """
    parts = _load(path, "glb")
    model = _joined(path, [(p, t, Surface(name, None, m)) for name, p, t, m in parts])
    return RoomModel(model.vertices, model.faces, model.findings, "m", "y")


def _load(path: Path, kind: str) -> list[tuple[str, FloatArray, np.ndarray[Any, Any], str | None]]:
    """Return name, vertices, triangles and material of every part, where the file places it."""
    import trimesh

    content = io.BytesIO(read_bytes(path))
    try:
        scene = trimesh.load_scene(content, file_type=kind, process=False)
        parts = []
        for node in scene.graph.nodes_geometry:
            transform, key = scene.graph[node]
            mesh = scene.geometry[key]
            points = trimesh.transform_points(mesh.vertices, transform)
            material = getattr(getattr(mesh.visual, "material", None), "name", None)
            parts.append((str(node), points, np.asarray(mesh.faces), material or None))
    except PARSER_ERRORS as error:
        raise InputError(
            f"this {kind.upper()} file cannot be read",
            where=str(path),
            found=f"{type(error).__name__}: {error}"[:200],
            hint="the file may be damaged or cut short: export it again",
        ) from error
    return parts


def _joined(path: Path, parts: list[tuple[FloatArray, np.ndarray[Any, Any], Surface]]) -> RoomModel:
    faces: list[Face] = []
    first = 0
    for points, triangles, surface in parts:
        bad = np.argwhere(~np.isfinite(points))
        if len(bad):
            vertex, axis = bad[0]
            finite(str(points[vertex, axis]), f"{path}, {surface.name!r}, vertex {vertex}")
        faces.extend(Face(tuple((t + first).tolist()), surface) for t in triangles)
        first += len(points)
    if not faces:
        hint = "the file may be damaged or cut short: export it again"
        raise InputError("the room file has no faces", where=str(path), hint=hint)
    return RoomModel(np.concatenate([p for p, _, _ in parts]), tuple(faces))
