"""Sound paths: what tracing returns and every response weighs, and the settings of a trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from roomfit.base.arguments import check_known, check_range, check_shape
from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray, IntArray
from roomfit.materials.priors import OBJECT_STEP_M


@dataclass(frozen=True, slots=True, eq=False)
class Paths:
    """Recorded paths from sources to receivers; absorption has not touched them.

    The energy that path i brings to its receiver in a band is ``weight_per_m2[i]`` times
    ``exp(-m length)`` for the air, times the product over materials of ``(1 - a) ** hits``, where
    hits counts specular and diffuse ones together. Energies are absolute: the direct sound of a
    source of unit power is ``1 / (4 pi r**2)``.

    Notes
    -----
    The image of a source at S stands at ``A S + b``, from the receiver along
    ``V = -length * arrival``, and when source and receiver move by dS and dR, without another wall
    coming into play, along ``V + A dS - dR``, exactly and for moves of any size. To first order
    the length grows by ``arrival . dR - departure . dS``, because ``departure = A^T arrival``:
    without A, departure and arrival do for that.
    """

    n_pairs: int  #: Of the scene; some may have no path
    materials: tuple[str, ...]
    pair: IntArray  #: int32 (n_paths,)
    length_m: FloatArray  #: (n_paths,), exact; of a ray, to the point nearest to the receiver
    #: (n_paths,), spreading and Monte-Carlo weight at the sampling scattering coefficient: for an
    #: image path ``product (1 - s) ** hits / (4 pi r**2)``, the mean over groups, for a ray
    #: ``chord / (n_rays * sphere volume)``
    weight_per_m2: FloatArray
    hits_specular: IntArray  #: uint16 (n_paths, n_materials), wall hits without scattering
    hits_diffuse: IntArray  #: uint16 (n_paths, n_materials), scattered ones
    #: float32 (n_paths, 3), unit vectors: away from the source
    departure: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    #: float32 (n_paths, 3), unit vectors in which sound travels on arrival
    arrival: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    batch: IntArray  #: int32 (n_paths,), independent Monte-Carlo batch; -1 for exact image paths
    n_batches: int
    #: (n_groups, n_materials), coefficients of the trace; weights are those of the mixture of
    #: groups, see `roomfit.model.scattering.scattering_weights`
    sampling_scattering: FloatArray
    #: float32 (n_paths, 3, 3), product A of a path's reflections (the last hit's leftmost), for
    #: image paths on request; zeros for rays
    image_transform: NDArray[np.float32] | None = None
    #: bool (n_pairs, n_materials), which materials are objects in the room of each pair; None: none
    objects: BoolArray | None = None

    def __post_init__(self) -> None:
        n = len(self.length_m)
        m = len(self.materials)
        shapes: dict[str, tuple[int | None, ...]] = {
            "pair": (n,),
            "length_m": (n,),
            "weight_per_m2": (n,),
            "hits_specular": (n, m),
            "hits_diffuse": (n, m),
            "departure": (n, 3),
            "arrival": (n, 3),
            "batch": (n,),
            "sampling_scattering": (None, m),
        }
        if self.objects is not None:
            shapes["objects"] = (self.n_pairs, m)
        if self.image_transform is not None:
            shapes["image_transform"] = (n, 3, 3)
        # Paths can be gigabytes and are made by this package only: shapes are checked and the
        # arrays set read-only in place, not copied.
        for name, shape in shapes.items():
            check_shape(f"paths: {name}", getattr(self, name), shape)
            getattr(self, name).setflags(write=False)

    def __len__(self) -> int:
        return len(self.length_m)


# Arrays of `Paths` with one row a path; the others are optional or not of paths.
_PER_PATH = (
    *("pair", "length_m", "weight_per_m2", "hits_specular", "hits_diffuse"),
    *("departure", "arrival", "batch"),
)


def path_columns(paths: Paths) -> list[Any]:
    """Return the arrays of paths with one row a path, in the order of `Paths`."""
    return [getattr(paths, name) for name in _PER_PATH]


def paths_of_pairs(paths: Paths) -> list[IntArray]:
    """Return the indices of the paths of every pair, rising: one search for all pairs."""
    order = np.argsort(paths.pair, kind="stable")
    ends = np.cumsum(np.bincount(paths.pair, minlength=paths.n_pairs))
    return np.split(order, ends[:-1])


def hits(paths: Paths) -> IntArray:
    """Return all wall hits of each path, specular and diffuse, uint16, (n_paths, n_materials)."""
    return np.asarray(paths.hits_specular + paths.hits_diffuse)


def losses(paths: Paths, own: IntArray) -> IntArray:
    """Return how often paths lose the share ``a`` of each material, uint16, (n, n_materials).

    At every hit on a wall, and of an object that stands in the room of the pair, which is met with
    equal probability wherever sound travels, at every `OBJECT_STEP_M` of the path's length.
    """
    # rows are taken four times as fast as they are indexed
    found = np.asarray(paths.hits_specular.take(own, axis=0))
    found += paths.hits_diffuse.take(own, axis=0)
    if paths.objects is not None:
        steps = np.minimum(np.round(paths.length_m[own] / OBJECT_STEP_M), np.iinfo(np.uint16).max)
        found += steps.astype(np.uint16)[:, None] * paths.objects[paths.pair[own]]
    return found


def select(paths: Paths, keep: BoolArray | IntArray) -> Paths:
    """Return the chosen paths, by mask or index, with all that is known of them."""
    own = np.flatnonzero(keep) if keep.dtype == np.bool_ else keep
    columns: dict[str, Any] = {name: getattr(paths, name).take(own, axis=0) for name in _PER_PATH}
    transform = None if paths.image_transform is None else paths.image_transform.take(own, axis=0)
    return replace(paths, **columns, image_transform=transform)


def concatenate(parts: Sequence[Paths]) -> Paths:
    """Return all paths of several traces of one scene as one.

    Where some part has image transforms, the paths of the others get zeros.
    """
    first = parts[0]
    for other in parts[1:]:
        if (other.materials, other.n_pairs) != (
            first.materials,
            first.n_pairs,
        ) or not np.array_equal(other.sampling_scattering, first.sampling_scattering):
            raise InputError(
                "paths of different scenes cannot be joined",
                found=f"materials {first.materials} and {other.materials}",
                needed="the same materials, pairs and scattering in all parts",
                hint="trace all parts with the same room, pairs and scattering",
            )

    columns: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in _PER_PATH
    }
    transform = None
    if any(p.image_transform is not None for p in parts):
        transform = np.concatenate(
            [
                np.zeros((len(p), 3, 3), dtype=np.float32)
                if p.image_transform is None
                else p.image_transform
                for p in parts
            ]
        )
    return replace(
        first,
        **columns,
        n_batches=max(p.n_batches for p in parts),
        image_transform=transform,
    )


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """Exact specular paths from one source to one receiver, shortest first."""

    length_m: FloatArray  # (n_paths,)
    hits: IntArray  # uint16 (n_paths, n_materials)
    departure: FloatArray  # (n_paths, 3), unit vectors away from the source
    arrival: FloatArray  # (n_paths, 3), unit vectors in which sound travels on arrival
    image_transform: FloatArray | None = None  # (n_paths, 3, 3), see `Paths`, on request
    # The hits of each path in their order, path after path, on request: path i has the entries
    # ``first_hit[i]:first_hit[i + 1]`` of `triangle`, which are triangles of the mesh
    first_hit: IntArray | None = None  # (n_paths + 1,)
    triangle: IntArray | None = None  # (n_hits,)


def unfolded_normals(normal: FloatArray, first: IntArray) -> FloatArray:
    """Return the normals of walls in the receiver's frame, mirrored by all later hits.

    Their product with the arrival is the cosine of incidence, for moved sources and receivers, too.

    Shapes: `normal` (n_hits, 3), `first` (n_paths + 1,).
    """
    unfolded = np.empty_like(normal)
    later = np.tile(np.eye(3), (len(first) - 1, 1, 1))
    for back in range(1, int(np.max(np.diff(first), initial=0)) + 1):
        path = np.flatnonzero(np.diff(first) >= back)
        hit = first[path + 1] - back
        own = np.einsum("pij,pj->pi", later[path], normal[hit])
        unfolded[hit] = own
        # A (1 - 2 n n^T) = A - 2 (A n) n^T
        later[path] -= 2.0 * own[:, :, None] * normal[hit][:, None, :]
    return unfolded


Directions = Literal["fibonacci", "sobol"]


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """Settings of one trace. What ends a ray is time or hits, never energy."""

    duration_s: float  #: Sound travels this long, counted from emission
    n_rays: int = 20_000  #: Rays per source, all batches together; 0 leaves rays out
    image_order: int = 2  #: Highest order of image sources; -1: even the direct sound is of rays
    receiver_radius_m: float = 0.5  #: Radius of the spheres that catch rays
    max_hits: int = 65_535  #: A ray ends after so many wall hits, at most 65535
    #: Scrambled Sobol points, new ones for each batch, or one Fibonacci spiral dealt out to the
    #: batches, which then are not independent
    directions: Directions = "sobol"
    n_batches: int = 16  #: Independent parts whose spread measures the Monte-Carlo noise
    seed: int = 1  #: Same seed, same paths, bit by bit, for any number of threads
    image_until_s: float | None = None  #: Where image sources end; None for the whole duration
    keep_image_transforms: bool = False  #: Image paths keep the product of their reflections

    def __post_init__(self) -> None:
        limits: tuple[tuple[str, float, float, float], ...] = (
            ("duration_s", self.duration_s, 1e-4, 100.0),
            ("n_rays", self.n_rays, 0, 10**9),
            ("image_order", self.image_order, -1, 1000),
            ("receiver_radius_m", self.receiver_radius_m, 1e-3, 100.0),
            ("max_hits", self.max_hits, 1, 65_535),
            ("n_batches", self.n_batches, 1, 10_000),
            ("seed", self.seed, 0, 2**63 - 1),
        )
        if self.image_until_s is not None:
            limits = (*limits, ("image_until_s", self.image_until_s, 0.0, 100.0))
        for name, value, low, high in limits:
            check_range(name, value, low, high, where="trace settings")
        check_known("unknown set of directions", self.directions, ("sobol", "fibonacci"))
