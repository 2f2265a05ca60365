"""A room as glTF 2.0 whose materials carry the identified absorption."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.exports import MaterialTable
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Room, triangle_material

_FLOAT, _ARRAY_BUFFER, _TRIANGLES = 5126, 34962, 4


def gltf_text(room: Room, table: MaterialTable) -> str:
    """Return a room as a glTF file that contains its own buffer, one primitive a material.

    ``extras.roomfit`` of every material holds ``bands_hz``, ``absorption``, ``lower95``,
    ``upper95`` and ``identifiable``, and ``scattering`` where it is known: viewers ignore it, and
    programs find it under the name of the material [1]_. Metres; glTF's y is up, so that
    (x, y, z) becomes (x, z, -y).

    Parameters
    ----------
    room : Room
    table : MaterialTable
        Materials of the room that are missing here have no ``extras``.

    Raises
    ------
    InputError
        No material of the room is in the table.

    References
    ----------
    .. [1] Khronos Group, "glTF 2.0 Specification" (2021), sections 3.6, 3.7.2 and 3.9.
    """
    if not set(table.names) & set(room.materials):
        raise InputError(
            "the result and the room have no material in common",
            found=f"{', '.join(table.names)} and {', '.join(room.materials)}",
            needed="the campaign that the result was identified from",
            hint="give the campaign of this result, as --campaign",
        )
    owner = triangle_material(room)
    used = [i for i in range(len(room.materials)) if np.any(owner == i)]
    corners = corners_m(room.mesh)[:, :, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    buffer, views, accessors = _packed([corners[owner == i].reshape(-1, 3) for i in used])
    primitives = [
        {"attributes": {"POSITION": k}, "material": k, "mode": _TRIANGLES} for k in range(len(used))
    ]
    content = {
        "asset": {"version": "2.0", "generator": "roomfit"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "room"}],
        "meshes": [{"name": "room", "primitives": primitives}],
        "materials": [_material(room.materials[i], table) for i in used],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {
                "byteLength": len(buffer),
                "uri": "data:application/octet-stream;base64," + base64.b64encode(buffer).decode(),
            }
        ],
    }
    return json.dumps(content, ensure_ascii=False, indent=1) + "\n"


def _packed(
    positions: Sequence[FloatArray],
) -> tuple[bytes, list[dict[str, Any]], list[dict[str, Any]]]:
    """Return arrays of positions one after the other, and where and how each lies in the buffer."""
    buffer = b""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    for own in positions:
        points = own.astype("<f4")
        views.append(
            {
                "buffer": 0,
                "byteOffset": len(buffer),
                "byteLength": points.nbytes,
                "target": _ARRAY_BUFFER,
            }
        )
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": _FLOAT,
                "count": len(points),
                "type": "VEC3",
                "min": points.min(axis=0).tolist(),
                "max": points.max(axis=0).tolist(),
            }
        )
        buffer += points.tobytes()
    return buffer, views, accessors


def _material(name: str, table: MaterialTable) -> dict[str, Any]:
    """Return a grey material, the darker the more it absorbs in the mean over bands."""
    content: dict[str, Any] = {"name": name, "doubleSided": True}
    if name not in table.names:
        return content
    i = table.names.index(name)
    grey = round(1.0 - 0.8 * float(table.absorption[i].mean()), 3)
    content["pbrMetallicRoughness"] = {
        "baseColorFactor": [grey, grey, grey, 1.0],
        "metallicFactor": 0.0,
    }
    found: dict[str, Any] = {
        "bands_hz": table.bands.centres_hz.tolist(),
        **{key: getattr(table, key)[i].tolist() for key in ("absorption", "lower95", "upper95")},
        "identifiable": table.identifiable[i].tolist(),
    }
    if table.scattering is not None:
        found["scattering"] = table.scattering[i].tolist()
    return content | {"extras": {"roomfit": found}}
