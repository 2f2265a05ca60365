"""Symmetries of a room, and the second answers that they permit.

A reflection or rotation that carries the room's surface and every fitted pair into itself exchanges
walls without changing any response: the data cannot distinguish an answer from its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from roomfit.base.typing import FloatArray, IntArray
from roomfit.fit.measurements import Measurements
from roomfit.materials.priors import MaterialPrior, prior_logit_law
from roomfit.model.observation import DEFAULT_POSITION_SD_M
from roomfit.room.inside import nearest_triangles
from roomfit.room.mesh import area_vectors_m2, corners_m
from roomfit.room.scene import Room, Scene, pair_names, select_pairs, triangle_material
from roomfit.tracing.states import parts_of

# A wall counts as carried into another where it lies this close to it.
TOLERANCE_M = 0.02
_FEW_SAMPLES, _SAMPLES = (4, 40), 600
_SAME_DIRECTION = 1e-3
# Samples next to the seam of two materials may fall on either.
_WHOLE_SHARE = 0.98
# Positions may be off by this many of their standard deviations.
_SYMMETRIC_WITHIN_SD = 3.0


# Pairs this close to a plane of symmetry cost as much as on it: in a box 2.8 m high walls are known
# a tenth better at 0.1 m off it and by a third at 0.2 m.
_ON_PLANE_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Symmetry:
    """An isometry ``x -> centre + matrix (x - centre)`` that carries the surface into itself."""

    matrix: FloatArray  # (3, 3), orthogonal: a reflection, or several one after the other
    centre_m: FloatArray  # (3,)
    exchange: IntArray  # (n_materials,), the material that each material is carried to


def room_symmetries(room: Room, tolerance_m: float = TOLERANCE_M) -> tuple[Symmetry, ...]:
    """Return every symmetry that mirror planes generate, the identity left out.

    Planes through the centroid that reflect one wall's normal into itself or another's, or that are
    perpendicular to a principal axis, are tried on points of the surface, then combined to a group.
    """
    if room.states:
        parts, of_part = parts_of(room)
        kept = []
        for symmetry in room_symmetries(parts, tolerance_m):
            carried = np.arange(len(room.materials))
            images = of_part[:, symmetry.exchange]
            carried[of_part] = images
            # unless a material has two images
            if np.array_equal(carried[of_part], images) and np.unique(carried).size == carried.size:
                kept.append(replace(symmetry, exchange=carried))
        return tuple(kept)
    points, material = _surface_points(room, _SAMPLES)
    centre_m = _centroid_m(room)
    # isometries that differ for no point of the surface by more than twice the tolerance are one
    same = 2.0 * tolerance_m / float(np.linalg.norm(points - centre_m, axis=1).max())
    known, found = [np.eye(3)], list[Symmetry]()

    def is_new(matrix: FloatArray) -> bool:
        """Whether a matrix differs for a unit vector by more than a length from all known."""
        return not any(np.linalg.norm(matrix - k, 2) <= same for k in known)

    for normal in _candidate_normals(room):
        matrix = np.eye(3) - 2.0 * np.outer(normal, normal)
        moved = centre_m + (points - centre_m) @ matrix.T
        exchange = _exchange(room, material, moved, tolerance_m) if is_new(matrix) else None
        if exchange is not None:
            found.append(Symmetry(matrix, centre_m, exchange))
            known.append(matrix)
    group, grew = list(found), bool(found)
    while grew and len(group) < 48:  # until products are no longer new
        grew = False
        for one in found:
            for other in list(group):
                matrix = one.matrix @ other.matrix
                if is_new(matrix):
                    group.append(Symmetry(matrix, centre_m, one.exchange[other.exchange]))
                    known.append(matrix)
                    grew = True
    return tuple(group)


def deviation_m(symmetry: Symmetry, scene: Scene) -> FloatArray:
    """Return how far each pair is from being carried into itself, in m, shape (n_pairs,).

    Half the larger distance of source and receiver from their images or, if that is less, from each
    other's images (reciprocity).
    """
    sources = np.array([s.position_m for s in scene.sources])[scene.pairs[:, 0]]
    receivers = np.array([r.position_m for r in scene.receivers])[scene.pairs[:, 1]]
    ends = np.stack((sources, receivers))
    carried = symmetry.centre_m + (ends - symmetry.centre_m) @ symmetry.matrix.T
    kept = np.linalg.norm(carried - ends, axis=2).max(axis=0)
    exchanged = np.linalg.norm(carried - ends[::-1], axis=2).max(axis=0)
    # a point at the distance d from a plane is 2 d from its image
    return np.asarray(0.5 * np.minimum(kept, exchanged))


def mirror_planes(scene: Scene) -> tuple[tuple[Symmetry, FloatArray], ...]:
    """Return the planes that mirror room and every pair and exchange materials, with normals (3,).

    Data determine the product of what the exchanged walls return, hardly their ratio.
    """
    found = []
    for symmetry in room_symmetries(scene.room) if len(scene.pairs) else ():
        size, axis = np.linalg.eigh(0.5 * (symmetry.matrix + symmetry.matrix.T))
        # of a plane, unlike a rotation or an inversion, one direction alone is reversed
        is_plane = np.isclose(size[0], -1.0, atol=0.01) and np.allclose(size[1:], 1.0, atol=0.01)
        moves = np.any(symmetry.exchange != np.arange(symmetry.exchange.size))
        if is_plane and moves and np.all(deviation_m(symmetry, scene) <= _ON_PLANE_M):
            normal = axis[:, 0]
            found.append(
                (symmetry, np.asarray(normal * np.sign(normal[np.argmax(np.abs(normal))])))
            )
    return tuple(found)


def _centroid_m(room: Room) -> FloatArray:
    """Return the centroid of the surface, which every symmetry leaves where it is."""
    areas = np.linalg.norm(area_vectors_m2(room.mesh), axis=1)
    return np.asarray(areas @ corners_m(room.mesh).mean(axis=1) / areas.sum())


def _surface_points(room: Room, n: int) -> tuple[FloatArray, IntArray]:
    """Return points spread over the surface by area, and the material of each."""
    rng = np.random.default_rng(0)
    corners = corners_m(room.mesh)
    areas = np.linalg.norm(area_vectors_m2(room.mesh), axis=1)
    owner = rng.choice(len(areas), n, p=areas / areas.sum())
    share = np.sort(rng.random((n, 2)), axis=1)
    weights = np.stack((share[:, 0], share[:, 1] - share[:, 0], 1.0 - share[:, 1]), axis=1)
    points = np.einsum("nk,nkj->nj", weights, corners[owner])
    # every material has a point, however small
    largest = [
        int(np.flatnonzero(triangle_material(room) == m)[np.argmax(own)])
        for m in range(len(room.materials))
        if (own := areas[triangle_material(room) == m]).size
    ]
    owner = np.concatenate((owner, largest))
    return np.concatenate((points, corners[largest].mean(axis=1))), triangle_material(room)[owner]


def _candidate_normals(room: Room) -> list[FloatArray]:
    vectors = area_vectors_m2(room.mesh)
    areas = np.linalg.norm(vectors, axis=1)
    found: list[FloatArray] = []

    def add(new: FloatArray) -> None:
        """Append a direction unless it, or its opposite, is among them."""
        known = np.array(found).reshape(-1, 3)
        if not np.any(np.abs(known @ new) > 1.0 - 0.5 * _SAME_DIRECTION**2):
            found.append(new)

    order = np.argsort(-areas)
    for i in order[areas[order] > 0.0]:
        add(vectors[i] / areas[i])
        if len(found) == 40:
            break
    for one, other in combinations(list(found), 2):
        for between in (one - other, one + other):
            length = float(np.linalg.norm(between))
            if length > _SAME_DIRECTION:
                add(between / length)
    # last: the axes of a cube are any three, and some of these nearly a wall's direction
    spread = corners_m(room.mesh).mean(axis=1) - _centroid_m(room)
    for axis in np.linalg.eigh((spread.T * areas) @ spread)[1].T:
        add(axis)
    return found


def _exchange(
    room: Room, material: IntArray, moved: FloatArray, tolerance_m: float
) -> IntArray | None:
    """Return where points of the surface, moved, carry their materials; None where off it."""
    for n in (*_FEW_SAMPLES, len(moved)):
        distance, triangle = nearest_triangles(room.mesh, moved[:n])
        if np.any(distance > tolerance_m):
            return None
    n = len(room.materials)
    counts = np.zeros((n, n))
    np.add.at(counts, (material, triangle_material(room)[triangle]), 1.0)
    total = counts.sum(axis=1)
    exchange = np.where(total > 0.0, counts.argmax(axis=1), np.arange(n))
    whole = counts[np.arange(n), exchange] >= _WHOLE_SHARE * total
    if not np.all(whole) or np.unique(exchange).size < n:
        return None
    return np.asarray(exchange, dtype=np.int64)


def mirror_symmetries(
    measurements: Measurements, priors: tuple[MaterialPrior, ...]
) -> tuple[Symmetry, ...]:
    """Return the symmetries of room and fitted pairs that exchange materials of equal priors."""
    scene = fitted_scene(measurements)
    stated = [[p.position_sd_m for p in points] for points in (scene.sources, scene.receivers)]
    sources, receivers = (
        np.array([DEFAULT_POSITION_SD_M if sd is None else sd for sd in sds]) for sds in stated
    )
    sd_m = np.maximum(sources[scene.pairs[:, 0]], receivers[scene.pairs[:, 1]])
    tolerance_m = _SYMMETRIC_WITHIN_SD * sd_m + 1e-3
    return tuple(
        symmetry
        for symmetry in (room_symmetries(scene.room) if len(scene.pairs) else ())
        if _priors_are_exchangeable(priors, symmetry.exchange)
        and not np.any(deviation_m(symmetry, scene) > tolerance_m)
    )


def fitted_scene(measurements: Measurements) -> Scene:
    """Return the scene of the pairs that are fitted."""
    scene = measurements.scene
    fitted_pairs = {m.pair for m in measurements.responses if m.measurement.use == "fit"}
    tabulated = {v.pair_name for v in measurements.values}
    names = pair_names(scene)
    kept = [i for i, name in enumerate(names) if i in fitted_pairs or name in tabulated]
    return select_pairs(scene, np.array(kept, dtype=np.int64))


def _priors_are_exchangeable(priors: tuple[MaterialPrior, ...], exchange: IntArray) -> bool:
    """Whether materials are exchanged, and only such that have equal priors and products."""
    mean, covariance = prior_logit_law(priors)
    exchanged = covariance[:, exchange][:, :, exchange]
    if not (np.array_equal(mean, mean[exchange]) and np.allclose(covariance, exchanged, rtol=1e-9)):
        return False
    moved = np.flatnonzero(exchange != np.arange(exchange.size))
    return moved.size > 0 and all(
        one.known is None
        and other.known is None
        and (one.lower, one.upper) == (other.lower, other.upper)
        for one, other in ((priors[i], priors[exchange[i]]) for i in moved)
    )
