"""Image sources of a scene as paths: the lattice for boxes, a tree of beams for the rest."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from roomfit.air import speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.geometry.measures import surface_area_m2, volume_m3
from roomfit.materials.scattering import Scattering, coefficients_in_order
from roomfit.scene.scene import Scene, distances_m
from roomfit.tracing.images_budget import expected_images
from roomfit.tracing.images_polyhedron import WORK_LIMIT, polyhedron_images
from roomfit.tracing.images_set import ImageSet
from roomfit.tracing.images_shoebox import count_of_shoebox_images, shoebox_images
from roomfit.tracing.images_walls import Blockers, Walls, mirrors_of
from roomfit.tracing.paths import Paths, Reflections
from roomfit.typing import FloatArray, Progress


def trace_images(
    scene: Scene,
    order: int,
    duration_s: float,
    scattering: Scattering,
    *,
    with_reflections: bool = False,
    with_unfolding: bool = False,
    memory_limit_bytes: float = 4 * 2**30,
    work_limit: float = WORK_LIMIT,
    progress: Progress | None = None,
) -> Paths:
    """Return the exact specular paths of every pair, shortest first within a pair.

    Parameters
    ----------
    scene : Scene
        A room with `shoebox_m` gets the lattice, any other a tree of beams.
    order : int
        Most hits of a path; 0 for the direct sound alone.
    duration_s : float
        Paths that take longer are left out.
    scattering : Scattering
        Thins a path by ``1 - s`` a hit; materials in any order.
    with_reflections : bool
        Keep the ordered hits with their angles.
    with_unfolding : bool
        Keep the product of each path's reflections, with which the paths of moved sources and
        receivers are known without another search, see `Paths`.
    memory_limit_bytes : float
        A trace that would need more is refused, early where the volume tells.
    work_limit : float
        Most walls to hold against beams for one source of a room that is no box; see
        `roomfit.tracing.images_budget.affordable_duration_s`.
    progress : callable, optional

    Raises
    ------
    InputError
        Other materials, a source where a receiver is, or more images than the memory or the work
        allows.
    """
    coefficients = coefficients_in_order(scattering, scene.room.materials)
    distances = distances_m(scene)
    if distances.size and distances.min() < 1e-6:
        source, receiver = scene.pairs[int(np.argmin(distances))]
        raise InputError(
            "a source stands where a receiver is",
            where=f"{scene.sources[source].name} and {scene.receivers[receiver].name}",
        )
    max_length_m = duration_s * speed_of_sound_m_s(scene.air)
    mirrors = mirrors_of(scene.room) if scene.room.shoebox_m is None else None
    wanted = _Wanted(order, max_length_m, with_reflections, with_unfolding)
    sources = [int(s) for s in np.unique(scene.pairs[:, 0])]
    if mirrors is None:
        _check_lattice(scene, wanted, memory_limit_bytes)
    else:
        _check_volume(scene, wanted, memory_limit_bytes)

    def of_source(source: int) -> list[ImageSet]:
        return _images_of_source(scene, source, mirrors, wanted, memory_limit_bytes, work_limit)

    sets: list[ImageSet | None] = [None] * len(scene.pairs)
    # kernels let go of the interpreter, so that sources share the processors as threads
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for done, (source, found) in enumerate(
            zip(sources, pool.map(of_source, sources), strict=True)
        ):
            own = np.flatnonzero(scene.pairs[:, 0] == source)
            for pair, images in zip(own, found, strict=True):
                sets[pair] = images
            if progress is not None:
                progress((done + 1) / len(sources))
    return _as_paths([s for s in sets if s is not None], scene, coefficients)


class _Wanted(NamedTuple):
    """Which images, and what of them."""

    order: int
    max_length_m: float
    with_reflections: bool
    with_unfolding: bool


def _images_of_source(
    scene: Scene,
    source: int,
    mirrors: tuple[Walls, Blockers] | None,
    wanted: _Wanted,
    memory_limit_bytes: float,
    work_limit: float,
) -> list[ImageSet]:
    """Return the images of one source for each of its pairs, in the order of the pairs."""
    room = scene.room
    start = scene.sources[source].position_m
    receivers = [scene.receivers[r].position_m for s, r in scene.pairs if s == source]
    if mirrors is not None:
        return polyhedron_images(
            *(room, start, np.array(receivers), wanted.order, wanted.max_length_m),
            with_reflections=wanted.with_reflections,
            with_unfolding=wanted.with_unfolding,
            mirrors=mirrors,
            memory_limit_bytes=memory_limit_bytes,
            work_limit=work_limit,
        )
    return [
        shoebox_images(
            *(room, start, r, wanted.order, wanted.max_length_m),
            with_reflections=wanted.with_reflections,
            with_unfolding=wanted.with_unfolding,
        )
        for r in receivers
    ]


def _check_lattice(scene: Scene, wanted: _Wanted, memory_limit_bytes: float) -> None:
    lengths_m = scene.room.shoebox_m
    if lengths_m is None:
        return
    count = count_of_shoebox_images(lengths_m, wanted.order, wanted.max_length_m)
    # columns of the paths, of the set that they are made from and of the lattice
    per_image = 150.0 + 6.0 * len(scene.room.materials) + 108.0 * wanted.with_unfolding
    _refuse_above(memory_limit_bytes, len(scene.pairs) * count, per_image)


def _check_volume(scene: Scene, wanted: _Wanted, memory_limit_bytes: float) -> None:
    """Refuse what the volume of the room tells to be too much, before anything is searched."""
    mesh = scene.room.mesh
    volume = max(volume_m3(mesh), 1e-9)
    free_path_m = 4.0 * volume / surface_area_m2(mesh)
    # so far, an order hardly cuts: twice the mean number of hits is rare
    length_m = min(wanted.max_length_m, 0.5 * wanted.order * free_path_m)
    count = expected_images(volume, length_m)
    per_image = 250.0 + 6.0 * len(scene.room.materials) + 12.0 * length_m / free_path_m
    _refuse_above(memory_limit_bytes, len(scene.pairs) * count, per_image)


def _refuse_above(memory_limit_bytes: float, count: float, per_image: float) -> None:
    needed = count * per_image
    if needed > memory_limit_bytes:
        raise InputError(
            "too many image sources for the memory",
            found=f"about {count:.3g} images, {needed / 2**30:.3g} GiB",
            needed=f"at most {memory_limit_bytes / 2**30:.3g} GiB",
            hint="lower image_order or duration_s and leave the rest to rays",
        )


def _as_paths(sets: list[ImageSet], scene: Scene, scattering: FloatArray) -> Paths:
    counts = [len(s.length_m) for s in sets]
    length = np.concatenate([np.zeros(0), *(s.length_m for s in sets)])
    no_hits = np.zeros((0, len(scene.room.materials)), dtype=np.uint16)
    hits = np.concatenate([no_hits, *(s.hits for s in sets)])
    kept = np.prod((1.0 - scattering) ** hits, axis=1)
    nowhere = np.zeros((0, 3))
    return Paths(
        len(scene.pairs),
        scene.room.materials,
        np.repeat(np.arange(len(sets)), counts).astype(np.int32),
        length,
        kept / (4.0 * np.pi * length**2),
        hits,
        np.zeros_like(hits),
        np.concatenate([nowhere, *(s.departure for s in sets)]).astype(np.float32),
        np.concatenate([nowhere, *(s.arrival for s in sets)]).astype(np.float32),
        np.full(len(length), -1, dtype=np.int32),
        0,
        scattering,
        _joined_reflections([s.reflections for s in sets if s.reflections is not None]),
        _joined_unfolding([s.unfolding for s in sets if s.unfolding is not None]),
    )


def _joined_unfolding(parts: list[FloatArray]) -> NDArray[np.float32] | None:
    return np.concatenate(parts).astype(np.float32) if parts else None


def _joined_reflections(parts: list[Reflections]) -> Reflections | None:
    if not parts:
        return None
    counts = np.concatenate([np.diff(r.offsets) for r in parts])
    return Reflections(
        np.concatenate(([0], np.cumsum(counts))),
        np.concatenate([r.material for r in parts]),
        np.concatenate([r.cosine for r in parts]),
    )
