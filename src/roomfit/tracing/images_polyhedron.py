"""Image sources of any room of flat walls, convex or not, with sheets in it or not."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roomfit.errors import InputError
from roomfit.geometry.mesh import area_vectors_m2
from roomfit.scene.room import Room, triangle_material
from roomfit.tracing.beam_found import TOO_MUCH_MEMORY, TOO_MUCH_WORK, Found, Limits
from roomfit.tracing.beam_tree import beam_tree
from roomfit.tracing.images_set import ImageSet, reflections_in_order, unfolded_normals
from roomfit.tracing.images_walls import Blockers, Walls, mirrors_of
from roomfit.tracing.paths import Reflections
from roomfit.typing import FloatArray, IntArray

# Bytes that a kept image and a kept hit take, growing and in the sets made of them.
_BYTES = 400
# Walls held against beams; some ten minutes on one core.
WORK_LIMIT = 5e9


def polyhedron_images(
    room: Room,
    source_m: FloatArray,
    receivers_m: FloatArray,
    order: int,
    max_length_m: float,
    *,
    with_reflections: bool = False,
    with_unfolding: bool = False,
    mirrors: tuple[Walls, Blockers] | None = None,
    memory_limit_bytes: float = 4 * 2**30,
    work_limit: float = WORK_LIMIT,
) -> list[ImageSet]:
    """Return for each receiver the visible images of a source, by one tree of beams for all.

    An image counts where every reflection point lies on its wall and nothing stands between.
    Lengths, hits and angles are exact. In a room of few walls all images within some ten mean free
    paths are a matter of seconds; in a room of thousands of walls, order 1 or 2, see
    `roomfit.tracing.images_budget`.

    Parameters
    ----------
    room : Room
    source_m : float array, shape (3,)
    receivers_m : float array, shape (n_receivers, 3)
    order : int
        Most hits of a path, 0 or more.
    max_length_m : float
    with_reflections, with_unfolding : bool
        Return the ordered hits with the normals of their walls, and the product of the
        reflections, as well.
    mirrors : tuple of Walls and Blockers, optional
        From `mirrors_of`, where several sources share a room of thousands of walls.
    memory_limit_bytes : float
    work_limit : float
        Most walls to hold against beams.

    Raises
    ------
    InputError
        The images pass the memory limit, or the search for them that of the work.

    Notes
    -----
    A path through an edge, within the tolerance of `Walls`, is found from both its walls and kept
    once. One that passes an edge of a wall in its way that closely is not stopped.
    """
    walls, blockers = mirrors_of(room) if mirrors is None else mirrors
    source = np.array(source_m, dtype=np.float64)
    receivers = np.array(receivers_m, dtype=np.float64).reshape(-1, 3)
    found = beam_tree(
        walls,
        blockers,
        source,
        receivers,
        distances_to_m(walls, receivers),
        limits_of(order, max_length_m, work_limit, memory_limit_bytes / _BYTES),
    )
    _refuse(found)
    first = np.concatenate(([0], np.cumsum(found.order)))
    owner = triangle_material(room)
    sets = []
    for number, receiver in enumerate(receivers):
        own = _one_of_each(np.flatnonzero(found.receiver == number), found, walls.tolerance_m)
        sets.append(
            _image_set(room, found, first, own, receiver, owner, with_reflections, with_unfolding)
        )
    return sets


def limits_of(order: int, max_length_m: float, work: float, n_hits: float) -> Limits:
    """Return the limits as the compiled tree takes them."""
    largest = 2.0**62
    return Limits(
        int(order), float(max_length_m), int(min(work, largest)), int(min(n_hits, largest))
    )


def distances_to_m(walls: Walls, receivers_m: FloatArray) -> FloatArray:
    """Return how far each wall's plane is from the nearest receiver at least, (n_walls,)."""
    heights = np.abs(walls.normal @ receivers_m.T - walls.offset_m[:, None])
    return np.asarray(np.min(heights, axis=1, initial=np.inf))


def _refuse(found: Found) -> None:
    if found.ending == TOO_MUCH_MEMORY:
        raise InputError(
            "too many image sources for the memory",
            found=f"more than {len(found.receiver)} images of one source",
            hint="lower image_order or duration_s and leave the rest to rays",
        )
    if found.ending == TOO_MUCH_WORK:
        raise InputError(
            "too many image sources to look for",
            found=f"{found.work:.3g} walls held against beams, and more to do",
            hint="lower image_order or duration_s and leave the rest to rays",
        )


def _one_of_each(own: IntArray, found: Found, tolerance_m: float) -> IntArray:
    """Return some images, nearest order first, without those that stand where an earlier one does.

    Two images in one place are one path that touches an edge, found from both its walls.
    """
    own = own[np.argsort(found.order[own], kind="stable")]
    if own.size < 2:
        return own
    tree = cKDTree(found.position_m[own])
    near = tree.query_pairs(10.0 * tolerance_m, output_type="ndarray")
    return np.delete(own, np.unique(near.max(axis=1)) if len(near) else [])


def _image_set(
    room: Room,
    found: Found,
    first: IntArray,
    own: IntArray,
    receiver: FloatArray,
    owner: IntArray,
    with_reflections: bool,
    with_unfolding: bool,
) -> ImageSet:
    to_receiver = receiver - found.position_m[own]
    length = np.linalg.norm(to_receiver, axis=1)
    near = np.argsort(length, kind="stable")
    own, to_receiver, length = own[near], to_receiver[near], length[near]
    arrival = to_receiver / length[:, None]
    matrix = found.matrix[own].reshape(-1, 3, 3)
    # the image's direction, folded back to the source by the transposed matrix
    departure = np.einsum("pij,pi->pj", matrix, arrival)
    counts = found.order[own].astype(np.int64)
    path = np.repeat(np.arange(len(own)), counts)
    place = np.arange(len(path)) - np.repeat(np.cumsum(counts) - counts, counts)
    entry = np.repeat(first[own], counts) + place
    material = owner[found.triangle[entry]]
    n_materials = len(room.materials)
    hits = np.bincount(path * n_materials + material, minlength=len(own) * n_materials)
    reflections: Reflections | None = None
    normals: FloatArray | None = None
    if with_reflections:
        vectors = area_vectors_m2(room.mesh)[found.triangle[entry]]
        unit = vectors / np.linalg.norm(vectors, axis=1)[:, None]
        normals = unfolded_normals(unit, np.concatenate(([0], np.cumsum(counts))))
        cosine = found.cosine[entry]
        reflections = reflections_in_order(
            path, place.astype(np.float64), material, cosine, len(own)
        )
    return ImageSet(
        length,
        hits.reshape(-1, n_materials).astype(np.uint16),
        departure,
        arrival,
        reflections,
        matrix if with_unfolding else None,
        normals,
    )
