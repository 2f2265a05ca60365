"""Image sources of a scene as paths: the lattice for boxes, a tree of beams for other rooms.

Every image of a box's lattice is visible from everywhere; a tree of beams finds the visible images
of any room of flat walls, convex or not, with or without sheets. The expected number of images and
counts of work decide how far image sources are worth their cost.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numba
import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.errors import InputError
from roomfit.base.kernels import each_in_threads
from roomfit.base.typing import FloatArray, IntArray, Progress
from roomfit.materials.priors import Scattering, coefficients_in_order
from roomfit.room.mesh import mean_free_path_m, surface_area_m2, volume_m3
from roomfit.room.scene import Room, Scene, check_apart, object_pairs, triangle_material
from roomfit.tracing.beams import DONE, Found, Limits, beam_tree
from roomfit.tracing.lattice import Lattice, box_images, count_of_box_images, lattice_of
from roomfit.tracing.paths import ImageSet, Paths
from roomfit.tracing.reflectors import Blockers, Walls, mirrors_of
from roomfit.tracing.states import as_one_state, in_every_state

# Images of a box, all pairs together.
_WORTH_THREADS = 1e5
# Bytes that an image and a hit take, growing and in the sets made of them.
_BYTES = 400


class Budget(NamedTuple):
    """What the images of one source may cost."""

    memory_bytes: float = 4 * 2**30
    work: float = 5e9  # walls tested against beams; some ten minutes on one core


USUAL_BUDGET = Budget()


def polyhedron_images(
    room: Room,
    source_m: FloatArray,
    receivers_m: FloatArray,
    limits: Limits,
    *,
    with_image_transforms: bool = False,
    mirrors: tuple[Walls, Blockers] | None = None,
) -> list[ImageSet]:
    """Return for each receiver the visible images of a source, by one tree of beams for all.

    An image counts where every reflection point lies on its wall and nothing obstructs the path.
    Lengths, hits and angles are exact. In a room of few walls all images within some ten mean free
    paths are a matter of seconds; in a room of thousands of walls, those of order 1 or 2.

    Shapes: `source_m` (3,), `receivers_m` (n_receivers, 3).

    A path through an edge, within the tolerance of `Walls`, is found from both its walls and kept
    once. One that passes the edge of an obstructing wall that closely is not stopped.
    """
    walls, blockers = mirrors_of(room) if mirrors is None else mirrors
    source = np.array(source_m, dtype=np.float64)
    receivers = np.array(receivers_m, dtype=np.float64).reshape(-1, 3)
    found, ending, work = beam_tree(walls, blockers, source, receivers, limits)
    if ending != DONE:
        n = len(found.receiver)
        raise InputError(
            "too many image sources of one source",
            found=f"{n} and more, after {work:.3g} walls tested against beams",
            needed="a search that ends within memory and work",
            hint="lower image_order or duration_s and leave the rest to rays",
        )
    first = np.concatenate(([0], np.cumsum(found.order)))
    owner = triangle_material(room)
    sets = []
    for number, receiver in enumerate(receivers):
        own = _one_of_each(np.flatnonzero(found.receiver == number), found, walls.tolerance_m)
        to_receiver = receiver - found.position_m[own]
        images = _image_set(found, first, own, to_receiver, owner, len(room.materials))
        sets.append(images if with_image_transforms else replace(images, image_transform=None))
    return sets


def limits_of(order: int, max_length_m: float, budget: Budget = USUAL_BUDGET) -> Limits:
    """Return the limits of a tree of beams: most hits of a path, its length, and the budget."""
    largest = 2.0**62
    n_hits = budget.memory_bytes / _BYTES
    return Limits(
        int(order), float(max_length_m), int(min(budget.work, largest)), int(min(n_hits, largest))
    )


def _one_of_each(own: IntArray, found: Found, tolerance_m: float) -> IntArray:
    """Return some images, lowest order first, without those at the position of an earlier one.

    Two images at one position are one path that touches an edge, found from both its walls.
    """
    own = own[np.argsort(found.order[own], kind="stable")]
    if own.size < 2:
        return own
    from scipy.spatial import cKDTree  # heavy, and a box needs none

    tree = cKDTree(found.position_m[own])
    near = tree.query_pairs(10.0 * tolerance_m, output_type="ndarray")
    return np.delete(own, np.unique(near.max(axis=1)) if len(near) else [])


def _image_set(
    found: Found,
    first: IntArray,
    own: IntArray,
    to_receiver: FloatArray,
    owner: IntArray,
    n_materials: int,
) -> ImageSet:
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
    triangle = found.triangle[entry]
    hits = np.bincount(path * n_materials + owner[triangle], minlength=len(own) * n_materials)
    return ImageSet(
        length,
        hits.reshape(-1, n_materials).astype(np.uint16),
        departure,
        arrival,
        matrix,
        np.concatenate(([0], np.cumsum(counts))),
        triangle,
    )


_ANY_ORDER = 1000  # within any length worth the name
# Steps in which a duration is tried; a step costs some 1.1**5 = 1.6 times the one before.
_STEP = 1.1
# Work and images grow as powers of the duration: at least the third, at most these, and later on by
# higher ones. What is too long costs the whole budget, a step too few less than another one.
_STEEPEST, _STEEPER = (6.0, 3.5), (0.6, 0.0)


def expected_images(volume_m3: float, length_m: float) -> float:
    """Return how many images are visible within a distance, on average over a closed room.

    Whatever its shape, visible images fill space with one for each volume of the room:
    ``4/3 pi length**3 / volume``.
    """
    return 4.0 / 3.0 * math.pi * length_m**3 / volume_m3


def affordable_duration_s(
    scene: Scene, longest_s: float, *, work: float = 1e7, images: float = 2e5
) -> float:
    """Return the duration up to which the images of any one source keep to a budget of work.

    Counted, not timed, so that the same scene gives the same answer on any machine.
    """
    speed = speed_of_sound_m_s(scene.air)
    share = _budget_shares(scene, work, images)
    last = math.ceil(math.log(100.0) / math.log(_STEP))

    def duration_s(step: int) -> float:
        return min(longest_s / 100.0 * _STEP**step, longest_s)

    # the affordable step lies from `low` up and below `high`
    low, high = 0, last + 1
    before, power, step = np.zeros(2), np.array(_STEEPEST), last - math.ceil(math.log(8.0, _STEP))
    while high - low > 1:
        found = np.maximum(share(_ANY_ORDER, duration_s(step) * speed), 1e-9)
        if found.max() > 1.0:
            high = step
            step = (low + high) // 2
            continue
        if np.all((before > 0.0) & (found > before)):
            power = np.log(found / before) / math.log(duration_s(step) / duration_s(low))
            power = np.clip(power + _STEEPER, 3.0, _STEEPEST)
        low, before = step, found
        # as far as these powers say that the budget reaches
        further = math.floor(float(np.min(-np.log(found) / (power * math.log(_STEP)))))
        step = min(low + max(further, 1), high - 1)
    return duration_s(low)


def affordable_order(
    scene: Scene, most: int, duration_s: float, *, work: float = 1e7, images: float = 2e5
) -> int:
    """Return the order up to which the images of any one source keep to a budget of work.

    For rooms of thousands of walls, where each order costs a hundred times the one before it.
    Counted, not timed, so that the same scene gives the same answer on any machine.
    """
    length_m = duration_s * speed_of_sound_m_s(scene.air)
    share = _budget_shares(scene, work, images)
    order = 0
    while order < most and share(order + 1, length_m).max() <= 1.0:
        order += 1
    return order


def _budget_shares(scene: Scene, work: float, images: float) -> Callable[[int, float], FloatArray]:
    """Return what of a budget the images of any one source take: shares of work and of images.

    Of images within an order and a length, m; infinite where the search was given up. Sources share
    the processors.
    """
    reflectors = reflectors_of(scene.room)
    if isinstance(reflectors, Lattice):
        return partial(_lattice_shares, scene, reflectors, work, images)
    walls, blockers = reflectors
    # images count for their hits in the tree: a generous bound keeps it from growing
    budget = Budget(100.0 * images * _BYTES, work)
    sources = [int(s) for s in np.unique(scene.pairs[:, 0])]

    def largest(order: int, length_m: float) -> FloatArray:
        def of_source(i: int) -> FloatArray:
            own = scene.pairs[scene.pairs[:, 0] == sources[i], 1]
            receivers = np.array([scene.receivers[r].position_m for r in own])
            start = np.array(scene.sources[sources[i]].position_m)
            limits = limits_of(order, length_m, budget)
            found, ending, spent = beam_tree(walls, blockers, start, receivers, limits)
            if ending != DONE:
                return np.full(2, np.inf)
            return np.array([spent / work, len(found.receiver) / images])

        of_each = [np.zeros(2), *each_in_threads(of_source, len(sources))]
        return np.asarray(np.max(of_each, axis=0))

    return largest


def _lattice_shares(
    scene: Scene, lattice: Lattice, work: float, images: float, order: int, length_m: float
) -> FloatArray:
    """Return the same of a box, where a triangle looked up is the work."""
    count = count_of_box_images(lattice.box.lengths_m, order, length_m)
    count *= int(np.bincount(scene.pairs[:, 0]).max(initial=0))
    n_hits = min(order, length_m / mean_free_path_m(scene.room.mesh))
    return np.array([count * n_hits * len(lattice.triangle) / 6.0 / work, count / images])


def trace_images(
    scene: Scene,
    order: int,
    duration_s: float,
    scattering: Scattering,
    *,
    with_image_transforms: bool = False,
    budget: Budget = USUAL_BUDGET,
    progress: Progress | None = None,
) -> Paths:
    """Return the exact specular paths of every pair, shortest first within a pair."""
    if scene.room.states:
        single, of_parts = as_one_state(scene, scattering)
        traced = trace_images(
            single,
            order,
            duration_s,
            of_parts,
            with_image_transforms=with_image_transforms,
            budget=budget,
            progress=progress,
        )
        in_all = in_every_state(traced, single, scene, scattering)
        return replace(in_all, objects=object_pairs(scene))
    coefficients = np.atleast_2d(coefficients_in_order(scattering, scene.room.materials))
    check_apart(scene)
    max_length_m = duration_s * speed_of_sound_m_s(scene.air)
    sources = [int(s) for s in np.unique(scene.pairs[:, 0])]
    reflectors = reflectors_of(scene.room)
    limits = limits_of(order, max_length_m, budget)
    few = _check_cost(scene, reflectors, limits, budget, with_image_transforms)
    of_source = partial(
        images_of_source, scene, reflectors, limits, with_image_transforms=with_image_transforms
    )
    sets: list[ImageSet | None] = [None] * len(scene.pairs)
    # kernels release the interpreter, so that sources share the processors as threads, which a few
    # thousand images of a box are not worth
    with nullcontext() if few else ThreadPoolExecutor(numba.get_num_threads()) as pool:
        of_each = map(of_source, sources) if pool is None else pool.map(of_source, sources)
        for done, (source, found) in enumerate(zip(sources, of_each, strict=True)):
            own = np.flatnonzero(scene.pairs[:, 0] == source)
            for pair, images in zip(own, found, strict=True):
                sets[pair] = _in_single_precision(images)
            if progress is not None:
                progress((done + 1) / len(sources))
    return _as_paths([s for s in sets if s is not None], scene, coefficients)


def reflectors_of(room: Room) -> Lattice | tuple[Walls, Blockers]:
    """Return what the images of a room are found by: its lattice where it is a box, or mirrors."""
    return lattice_of(room) or mirrors_of(room)


def images_of_source(
    scene: Scene,
    reflectors: Lattice | tuple[Walls, Blockers],
    limits: Limits,
    source: int,
    *,
    with_image_transforms: bool = False,
    with_triangles: bool = False,
) -> list[ImageSet]:
    """Return a source's images for each of its pairs, in their order."""
    room, start = scene.room, scene.sources[source].position_m
    receivers = np.array([scene.receivers[r].position_m for s, r in scene.pairs if s == source])
    options = {"with_image_transforms": with_image_transforms}
    if not isinstance(reflectors, Lattice):
        return polyhedron_images(room, start, receivers, limits, mirrors=reflectors, **options)
    options["with_triangles"] = with_triangles
    n, far_m = limits.order, limits.length_m
    return [box_images(room, reflectors, start, at, n, far_m, **options) for at in receivers]


def _check_cost(
    scene: Scene,
    reflectors: Lattice | tuple[Walls, Blockers],
    limits: Limits,
    budget: Budget,
    with_image_transforms: bool,
) -> bool:
    """Refuse more images than the memory allows; return whether they are few, of a box."""
    room, is_box = scene.room, isinstance(reflectors, Lattice)
    if isinstance(reflectors, Lattice):
        count = count_of_box_images(reflectors.box.lengths_m, limits.order, limits.length_m)
        # columns of the paths and of the set that they are made from
        per_image = 110.0 + 6.0 * len(room.materials) + 72.0 * with_image_transforms
    else:
        count, per_image = _expected_cost(room, limits.order, limits.length_m)
    count *= len(scene.pairs)
    if count * per_image > budget.memory_bytes:
        raise InputError(
            "too many image sources for the memory",
            found=f"about {count:.3g} images, {count * per_image / 2**30:.3g} GiB",
            needed=f"at most {budget.memory_bytes / 2**30:.3g} GiB",
            hint="fewer pairs at a time; or lower most_images and most_coherent_images of a "
            "campaign, image_order or duration_s of a trace, and leave the rest to rays",
        )
    return is_box and count < _WORTH_THREADS


def _expected_cost(room: Room, order: int, max_length_m: float) -> tuple[float, float]:
    """Return expected images of a pair and bytes of each, from the volume of the room alone."""
    volume = max(volume_m3(room.mesh), 1e-9)
    free_path_m = 4.0 * volume / surface_area_m2(room.mesh)
    # so far, an order hardly cuts: twice the mean number of hits is rare
    length_m = min(max_length_m, 0.5 * order * free_path_m)
    per_image = 250.0 + 6.0 * len(room.materials) + 12.0 * length_m / free_path_m
    return expected_images(volume, length_m), per_image


def _as_paths(sets: list[ImageSet], scene: Scene, scattering: FloatArray) -> Paths:
    counts = [len(s.length_m) for s in sets]
    length = np.concatenate([np.zeros(0), *(s.length_m for s in sets)])
    no_hits = np.zeros((0, len(scene.room.materials)), dtype=np.uint16)
    hits = np.concatenate([no_hits, *(s.hits for s in sets)])
    kept = np.concatenate([np.zeros(0), *(_unscattered(s.hits, scattering) for s in sets)])
    nowhere = np.zeros((0, 3), dtype=np.float32)
    transforms = [s.image_transform for s in sets if s.image_transform is not None]
    return Paths(
        len(scene.pairs),
        scene.room.materials,
        np.repeat(np.arange(len(sets)), counts).astype(np.int32),
        length,
        kept / (4.0 * np.pi * length**2),
        hits,
        np.zeros_like(hits),
        np.concatenate([nowhere, *(s.departure for s in sets)], dtype=np.float32),
        np.concatenate([nowhere, *(s.arrival for s in sets)], dtype=np.float32),
        np.full(len(length), -1, dtype=np.int32),
        0,
        scattering,
        np.concatenate(transforms, dtype=np.float32) if transforms else None,
        object_pairs(scene),
    )


def thinned_images(images: Paths, scattering: Scattering) -> Paths:
    """Return image paths as `trace_images` gives them for another scattering."""
    coefficients = np.atleast_2d(coefficients_in_order(scattering, images.materials))
    kept = _unscattered(images.hits_specular, coefficients)
    weight = kept / (4.0 * np.pi * images.length_m**2)
    return replace(images, weight_per_m2=weight, n_batches=0, sampling_scattering=coefficients)


def _unscattered(hits: IntArray, scattering: FloatArray) -> FloatArray:
    """Return the share of each path that no hit scatters, in the mean over groups, (n_paths,)."""
    if not np.any(scattering):
        return np.ones(len(hits))
    return np.asarray(np.mean([np.prod((1.0 - s) ** hits, axis=1) for s in scattering], axis=0))


def _in_single_precision(images: ImageSet) -> ImageSet:
    """Return what paths keep, as they keep it: all sets are in memory until the last is found."""
    transform = images.image_transform
    return replace(
        images,
        first_hit=None,
        triangle=None,
        departure=images.departure.astype(np.float32),
        arrival=images.arrival.astype(np.float32),
        image_transform=None if transform is None else transform.astype(np.float32),
    )
