"""Embree's own single-ray loop, on the library that the embreex package carries.

Calls `rtcIntersect1` for one ray after the other from compiled code, so that nothing but Embree is
measured. Its robust mode is the one that promises no gaps between triangles.
"""

from __future__ import annotations

import ctypes
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import embreex
import numba
import numpy as np

_TRIANGLES, _INDEX, _VERTEX, _UINT3, _FLOAT3, _ROBUST = 0, 0, 1, 0x5003, 0x9003, 4
_NONE = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True)
class Embree:
    """A committed scene and the function that intersects one ray with it."""

    intersect: Any
    scene: int


def embree_of(corners_m: np.ndarray, *, robust: bool) -> Embree:
    """Build a scene of triangles, shape (n, 3 corners, 3)."""
    # the folder differs between wheels
    folder = Path(embreex.__file__).parent
    found = [*folder.glob("libembree4*"), *folder.parent.glob("embreex.libs/libembree4*")]
    for tbb in [*folder.glob("libtbb*"), *folder.parent.glob("embreex.libs/libtbb*")]:
        ctypes.CDLL(os.fspath(tbb), mode=ctypes.RTLD_GLOBAL)
    library = ctypes.CDLL(os.fspath(found[0]))
    place, size, number = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint
    for name, result, arguments in (
        ("rtcNewDevice", place, [ctypes.c_char_p]),
        ("rtcNewScene", place, [place]),
        ("rtcNewGeometry", place, [place, number]),
        ("rtcSetNewGeometryBuffer", place, [place, number, number, number, size, size]),
        ("rtcCommitGeometry", None, [place]),
        ("rtcAttachGeometry", number, [place, place]),
        ("rtcSetSceneFlags", None, [place, number]),
        ("rtcCommitScene", None, [place]),
        ("rtcIntersect1", None, [size, size, size]),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    device = library.rtcNewDevice(None)
    scene = library.rtcNewScene(device)
    geometry = library.rtcNewGeometry(device, _TRIANGLES)
    points, n = corners_m.reshape(-1, 3), len(corners_m)
    for kind, layout, item, count, values in (
        (_VERTEX, _FLOAT3, ctypes.c_float, 3 * n, points.astype(np.float32)),
        (_INDEX, _UINT3, ctypes.c_uint, n, np.arange(3 * n, dtype=np.uint32)),
    ):
        buffer = library.rtcSetNewGeometryBuffer(geometry, kind, 0, layout, 12, count)
        np.ctypeslib.as_array(ctypes.cast(buffer, ctypes.POINTER(item)), (values.size,))[:] = (
            values.reshape(-1)
        )
    library.rtcCommitGeometry(geometry)
    library.rtcAttachGeometry(scene, geometry)
    library.rtcSetSceneFlags(scene, _ROBUST if robust else 0)
    library.rtcCommitScene(scene)
    return Embree(library.rtcIntersect1, scene)


def embree_hits(
    embree: Embree, starts: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return distance and triangle of every ray, float32 and uint32; infinity for none."""
    memory = np.zeros(48, np.float32)
    shift = (-memory.ctypes.data % 16) // 4
    ray = memory[shift : shift + 40]
    bits = ray.view(np.uint32)
    found: tuple[np.ndarray, np.ndarray] = _loop(
        embree.intersect, embree.scene, ray, bits, starts, directions
    )
    return found


@numba.njit(nogil=True)
def _loop(intersect, scene, ray, bits, starts, directions):  # type: ignore[no-untyped-def]
    distance = np.empty(len(starts), np.float32)
    triangle = np.empty(len(starts), np.uint32)
    place = ray.ctypes.data
    for i in range(len(starts)):
        for axis in range(3):
            ray[axis], ray[4 + axis] = starts[i, axis], directions[i, axis]
        ray[3], ray[7], ray[8] = np.float32(1e-4), np.float32(0.0), np.float32(np.inf)
        bits[9], bits[10], bits[11] = _NONE, np.uint32(0), np.uint32(0)
        bits[17], bits[18], bits[19] = _NONE, _NONE, _NONE
        intersect(scene, place, 0)
        distance[i], triangle[i] = ray[8], bits[17]
    return distance, triangle
