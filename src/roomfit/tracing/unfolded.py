"""Image paths of moving sources and receivers, with the angle at every wall: for pressures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import read_only
from roomfit.errors import InputError
from roomfit.scene.room import Room
from roomfit.scene.scene import Scene, distances_m
from roomfit.tracing.images_polyhedron import polyhedron_images
from roomfit.tracing.images_set import ImageSet
from roomfit.tracing.images_shoebox import (
    image_positions_m,
    lattice_indices,
    wall_hits,
)
from roomfit.tracing.images_walls import mirrors_of
from roomfit.typing import FloatArray, IntArray

# No order of reflections can be reached within any length worth the name.
_ANY_ORDER = 10_000


@dataclass(frozen=True, slots=True, eq=False)
class UnfoldedPaths:
    """Specular paths of every pair, straightened, with all that a pressure needs.

    From its image a path runs straight along `vector_m` to the receiver. When the source moves by
    dS and the receiver by dR, without another wall coming into play, it runs along
    ``vector_m + dR - unfolding dS``, exactly. A bounce stands for one or several hits at the same
    angle: its cosine of incidence is that between the path and `normal`.

    Attributes
    ----------
    pair_first : int64 array, shape (n_pairs + 1,)
        Pair i owns the paths ``pair_first[i]:pair_first[i + 1]``, shortest first.
    vector_m : float array, shape (n_paths, 3)
    unfolding : float array, shape (n_paths, 3, 3)
    bounce_first : int64 array, shape (n_paths + 1,)
        Path i owns the bounces ``bounce_first[i]:bounce_first[i + 1]``.
    material : int64 array, shape (n_bounces,)
    normal : float array, shape (n_bounces, 3)
        Of the wall as the receiver sees it, mirrored by all later hits; a unit vector.
    hits : int64 array, shape (n_bounces,)
        How many hits a bounce stands for.
    """

    pair_first: IntArray
    vector_m: FloatArray
    unfolding: FloatArray
    bounce_first: IntArray
    material: IntArray
    normal: FloatArray
    hits: IntArray

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            read_only(getattr(self, name))


def unfolded_paths(scene: Scene, longest_m: float) -> UnfoldedPaths:
    """Return all specular paths of every pair up to a length.

    Parameters
    ----------
    scene : Scene
        Any room; in one that is no box, only images that are seen from the receiver.
    longest_m : float

    Raises
    ------
    InputError
        A source stands where a receiver is, or there are more images than the memory or the work
        allows.
    """
    distances = distances_m(scene)
    if distances.size and distances.min() < 1e-6:
        source, receiver = scene.pairs[int(np.argmin(distances))]
        raise InputError(
            "a source stands where a receiver is",
            where=f"{scene.sources[source].name} and {scene.receivers[receiver].name}",
        )
    find = _of_a_polyhedron if scene.room.shoebox_m is None else _of_a_box
    return _joined(find(scene, longest_m))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The paths of one pair; `path` says to which each bounce belongs, in rising order."""

    vector_m: FloatArray
    unfolding: FloatArray
    path: IntArray
    material: IntArray
    normal: FloatArray
    hits: IntArray


def _of_a_box(scene: Scene, longest_m: float) -> list[_Part]:
    parts = []
    for s, r in scene.pairs:
        source, receiver = scene.sources[s].position_m, scene.receivers[r].position_m
        parts.append(_box_part(scene.room, source, receiver, longest_m))
    return parts


def _box_part(room: Room, source_m: FloatArray, receiver_m: FloatArray, longest_m: float) -> _Part:
    """Return paths whose hits on one wall, all at one angle, are one bounce."""
    lengths = np.array(room.shoebox_m, dtype=np.float64)
    index = lattice_indices(lengths, source_m, receiver_m, _ANY_ORDER, longest_m)
    vector = receiver_m - image_positions_m(index, lengths, source_m)
    near = np.argsort(np.linalg.norm(vector, axis=1), kind="stable")
    index, vector = index[near], vector[near]
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    hits = np.column_stack([wall_hits(index, wall) for wall in range(6)])
    path, wall = np.nonzero(hits)
    material = np.asarray(room.surface_material[wall], dtype=np.int64)
    unfolding = np.asarray(turned[:, :, None] * np.eye(3))
    return _Part(vector, unfolding, path, material, np.eye(3)[wall // 2], hits[path, wall])


def _of_a_polyhedron(scene: Scene, longest_m: float) -> list[_Part]:
    mirrors = mirrors_of(scene.room)
    parts: list[_Part | None] = [None] * len(scene.pairs)
    for s in np.unique(scene.pairs[:, 0]):
        own = np.flatnonzero(scene.pairs[:, 0] == s)
        receivers = np.array([scene.receivers[r].position_m for r in scene.pairs[own, 1]])
        found = polyhedron_images(
            *(scene.room, scene.sources[s].position_m, receivers, _ANY_ORDER, longest_m),
            with_reflections=True,
            with_unfolding=True,
            mirrors=mirrors,
        )
        for pair, images in zip(own, found, strict=True):
            parts[pair] = _polyhedron_part(images)
    return [p for p in parts if p is not None]


def _polyhedron_part(images: ImageSet) -> _Part:
    reflections, unfolding, normals = images.reflections, images.unfolding, images.normals
    if reflections is None or unfolding is None or normals is None:
        raise ValueError("images without reflections, unfolding or normals")
    counts = np.diff(reflections.offsets)
    return _Part(
        images.length_m[:, None] * images.arrival,
        unfolding,
        np.repeat(np.arange(len(counts)), counts),
        np.asarray(reflections.material, dtype=np.int64),
        normals,
        np.ones(len(normals), dtype=np.int64),
    )


def _joined(parts: list[_Part]) -> UnfoldedPaths:
    n_paths = [len(p.vector_m) for p in parts]
    bounces = np.concatenate([np.bincount(p.path, minlength=len(p.vector_m)) for p in parts])
    return UnfoldedPaths(
        np.concatenate(([0], np.cumsum(n_paths))),
        np.concatenate([p.vector_m for p in parts]),
        np.concatenate([p.unfolding for p in parts]),
        np.concatenate(([0], np.cumsum(bounces))),
        np.concatenate([p.material for p in parts]),
        np.concatenate([p.normal for p in parts]),
        np.concatenate([p.hits for p in parts]).astype(np.int64),
    )
