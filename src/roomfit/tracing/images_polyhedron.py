"""Image sources of any room of flat walls, convex or not, with sheets in it or not."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from roomfit.scene.room import Room, triangle_material
from roomfit.tracing.images_set import ImageSet, reflections_in_order
from roomfit.tracing.images_tree import Tree, image_tree
from roomfit.tracing.images_visible import Legs, follow_back
from roomfit.tracing.images_walls import Screens, Walls, mirrors_of
from roomfit.tracing.paths import Reflections
from roomfit.typing import FloatArray, IntArray


def polyhedron_images(
    room: Room,
    source_m: FloatArray,
    receivers_m: FloatArray,
    order: int,
    max_length_m: float,
    *,
    with_reflections: bool = False,
    mirrors: tuple[Walls, Screens] | None = None,
    memory_limit_bytes: float = 4 * 2**30,
) -> list[ImageSet]:
    """Return for each receiver the visible images of a source.

    The source is mirrored in the walls again and again; an image counts where every reflection
    point lies on its wall and nothing stands between. Distances, hits and angles are exact. The
    number of images to try grows with the number of walls to the power of the order: meant for
    order 4 to 6 in rooms of some ten walls, 1 or 2 in rooms of thousands.

    Parameters
    ----------
    room : Room
    source_m : float array, shape (3,)
    receivers_m : float array, shape (n_receivers, 3)
    order : int
        Most hits of a path, 0 or more.
    max_length_m : float
    with_reflections : bool
        Return the ordered hits as well.
    mirrors : tuple of Walls and Screens, optional
        From `mirrors_of`, where several sources share a room of thousands of walls.
    memory_limit_bytes : float

    Raises
    ------
    InputError
        The images to try would pass the memory limit.
    """
    walls, screens = mirrors_of(room) if mirrors is None else mirrors
    source = np.asarray(source_m, dtype=np.float64)
    tree = image_tree(walls, source, order, max_length_m, memory_limit_bytes=memory_limit_bytes)
    owner = triangle_material(room)
    sets = []
    for receiver in np.asarray(receivers_m, dtype=np.float64):
        legs = follow_back(walls, screens, tree, np.array(receiver), max_length_m)
        kept = _one_of_each(np.flatnonzero(legs.visible), tree, 10.0 * walls.tolerance_m)
        sets.append(_image_set(room, tree, legs, kept, receiver, owner, with_reflections))
    return sets


def _one_of_each(visible: IntArray, tree: Tree, tolerance_m: float) -> IntArray:
    """Return the visible images without those that stand where an earlier one does.

    Two images in one place are one path that touches an edge, found from both its walls.
    """
    if visible.size < 2:
        return visible
    near = cKDTree(tree.position_m[visible]).query_pairs(tolerance_m, output_type="ndarray")
    return np.delete(visible, np.unique(near.max(axis=1)) if len(near) else [])


def _image_set(
    room: Room,
    tree: Tree,
    legs: Legs,
    kept: IntArray,
    receiver: FloatArray,
    owner: IntArray,
    with_reflections: bool,
) -> ImageSet:
    to_receiver = receiver - tree.position_m[kept]
    length = np.linalg.norm(to_receiver, axis=1)
    near = np.argsort(length, kind="stable")
    kept, to_receiver, length = kept[near], to_receiver[near], length[near]
    path, place = np.nonzero(legs.triangle[kept] >= 0)
    material = owner[legs.triangle[kept][path, place]]
    hits = np.zeros((len(kept), len(room.materials)), dtype=np.uint16)
    np.add.at(hits, (path, material), 1)
    reflections: Reflections | None = None
    if with_reflections:
        cosine = legs.cosine[kept][path, place]
        reflections = reflections_in_order(
            path, place.astype(np.float64), material, cosine, len(kept)
        )
    return ImageSet(length, hits, legs.departure[kept], to_receiver / length[:, None], reflections)
