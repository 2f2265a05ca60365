"""Volume, area and mean free path of a room."""

from __future__ import annotations

import numpy as np

from roomfit.geometry.mesh import (
    Mesh,
    area_vectors_m2,
    corners_m,
    is_double_sided,
    triangle_areas_m2,
)


def volume_m3(mesh: Mesh) -> float:
    """Return the enclosed volume; negative where the normals point into the air.

    The divergence theorem over the triangles that enclose (sheets in the air are left out). It is
    taken about the middle of the room: exact for a closed mesh wherever that is, and for a mesh
    with small gaps the choice that counts each missing piece least.
    """
    walls = ~is_double_sided(mesh)
    if not walls.any():
        return 0.0
    vectors = area_vectors_m2(mesh)[walls]
    middles = corners_m(mesh)[walls].mean(axis=1)
    areas = np.linalg.norm(vectors, axis=1)
    total = areas.sum()
    middle = (areas @ middles) / total if total > 0.0 else middles.mean(axis=0)
    return float(np.einsum("ij,ij->", middles - middle, vectors) / 3.0)


def surface_area_m2(mesh: Mesh) -> float:
    """Return the area that sound can strike: both sides of sheets in the air, one of walls."""
    return float(triangle_areas_m2(mesh) @ np.where(is_double_sided(mesh), 2.0, 1.0))


def mean_free_path_m(mesh: Mesh) -> float:
    """Return the mean distance between two reflections in a diffuse field, ``4 V / S`` [1]_.

    References
    ----------
    .. [1] C. W. Kosten, "The mean free path in room acoustics", Acustica 10, 245-250 (1960).
    """
    return 4.0 * volume_m3(mesh) / surface_area_m2(mesh)
