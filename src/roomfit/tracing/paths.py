"""Sound paths: what tracing returns and every response weighs, and the settings of a trace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from roomfit._checks import float_array, int_array
from roomfit.errors import InputError
from roomfit.typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Reflections:
    """The ordered wall hits of each path, as one long list."""

    offsets: IntArray  # int64 (n_paths + 1,), entries of path i: ``offsets[i]:offsets[i + 1]``
    material: IntArray  # int32 (n_entries,), first hit of a path first
    cosine: FloatArray  # (n_entries,), of the angle of incidence, 0 (grazing) to 1 (normal)

    def __post_init__(self) -> None:
        offsets = int_array("offsets", self.offsets, (None,), np.int64, low=0)
        n = int(offsets[-1]) if offsets.size else 0
        object.__setattr__(self, "offsets", offsets)
        object.__setattr__(self, "material", int_array("material", self.material, (n,), low=0))
        object.__setattr__(
            self, "cosine", float_array("cosine", self.cosine, (n,), low=0.0, high=1.0)
        )


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
    #: image path ``product (1 - s) ** hits / (4 pi r**2)``, for a ray ``chord / (n_rays * sphere
    #: volume)``
    weight_per_m2: FloatArray
    hits_specular: IntArray  #: uint16 (n_paths, n_materials), wall hits without scattering
    hits_diffuse: IntArray  #: uint16 (n_paths, n_materials), scattered ones
    #: float32 (n_paths, 3), unit vectors: away from the source
    departure: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    #: float32 (n_paths, 3), unit vectors in which sound travels on arrival
    arrival: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    batch: IntArray  #: int32 (n_paths,), independent Monte-Carlo batch; -1 for exact image paths
    n_batches: int
    sampling_scattering: FloatArray  #: (n_materials,), coefficients of the trace
    reflections: Reflections | None = None  #: Of image paths on request; rays have none
    #: float32 (n_paths, 3, 3), product A of a path's reflections (the last hit's leftmost), for
    #: image paths on request; zeros for rays
    image_transform: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        n = len(self.length_m)
        m = len(self.materials)
        shapes = {
            "pair": (n,),
            "length_m": (n,),
            "weight_per_m2": (n,),
            "hits_specular": (n, m),
            "hits_diffuse": (n, m),
            "departure": (n, 3),
            "arrival": (n, 3),
            "batch": (n,),
            "sampling_scattering": (m,),
        }
        # Paths can be gigabytes and are made by this package only: shapes are checked and the
        # arrays set read-only in place, not copied.
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise InputError(
                    f"paths: {name} has the wrong shape", found=f"{array.shape}", needed=f"{shape}"
                )
            array.setflags(write=False)
        if self.image_transform is not None:
            if self.image_transform.shape != (n, 3, 3):
                raise InputError(
                    "paths: image_transform has the wrong shape",
                    found=f"{self.image_transform.shape}",
                    needed=f"{(n, 3, 3)}",
                )
            self.image_transform.setflags(write=False)

    def __len__(self) -> int:
        return len(self.length_m)


# Arrays of `Paths` with one row a path; the others are optional or not of paths.
_PER_PATH = (
    *("pair", "length_m", "weight_per_m2", "hits_specular", "hits_diffuse"),
    *("departure", "arrival", "batch"),
)


def hits(paths: Paths) -> IntArray:
    """Return all wall hits of each path, specular and diffuse, uint16, (n_paths, n_materials)."""
    return np.asarray(paths.hits_specular + paths.hits_diffuse)


def select(paths: Paths, keep: BoolArray | IntArray) -> Paths:
    """Return the chosen paths, by mask or index, with all that is known of them."""
    reflections = None
    if paths.reflections is not None:
        old = paths.reflections
        index = np.flatnonzero(keep) if keep.dtype == np.bool_ else keep
        counts = np.diff(old.offsets)[index]
        offsets = np.concatenate(([0], np.cumsum(counts)))
        # entry numbers of each kept path, laid end to end
        entries = np.arange(offsets[-1]) + np.repeat(old.offsets[index] - offsets[:-1], counts)
        reflections = Reflections(offsets, old.material[entries], old.cosine[entries])
    columns: dict[str, Any] = {name: getattr(paths, name)[keep] for name in _PER_PATH}
    transform = None if paths.image_transform is None else paths.image_transform[keep]
    return replace(paths, **columns, reflections=reflections, image_transform=transform)


def concatenate(parts: Sequence[Paths]) -> Paths:
    """Return all paths of several traces of one scene as one.

    Where some part has ordered reflections or image transforms, the paths of the others get empty
    lists and zeros.

    Raises
    ------
    InputError
        The parts disagree on materials, pairs or sampling scattering.
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
                hint="trace all parts with the same room, pairs and scattering",
            )

    columns: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) for p in parts]) for name in _PER_PATH
    }
    return replace(
        first,
        **columns,
        n_batches=max(p.n_batches for p in parts),
        reflections=_reflections_of_all(parts),
        image_transform=_joined_image_transforms(parts),
    )


def _reflections_of_all(parts: Sequence[Paths]) -> Reflections | None:
    if all(p.reflections is None for p in parts):
        return None
    none = np.zeros(0, dtype=np.int32)
    lists = [
        Reflections(np.zeros(len(p) + 1, dtype=np.int64), none, np.zeros(0))
        if p.reflections is None
        else p.reflections
        for p in parts
    ]
    return join_reflections(lists)


def join_reflections(parts: Sequence[Reflections]) -> Reflections:
    """Return the reflections of all paths of several lists, one list after the other."""
    counts = np.concatenate([np.diff(r.offsets) for r in parts])
    return Reflections(
        np.concatenate(([0], np.cumsum(counts))),
        np.concatenate([r.material for r in parts]),
        np.concatenate([r.cosine for r in parts]),
    )


def _joined_image_transforms(parts: Sequence[Paths]) -> NDArray[np.float32] | None:
    if all(p.image_transform is None for p in parts):
        return None
    blank = [
        np.zeros((len(p), 3, 3), dtype=np.float32)
        if p.image_transform is None
        else p.image_transform
        for p in parts
    ]
    return np.concatenate(blank)


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """Exact specular paths from one source to one receiver, shortest first."""

    length_m: FloatArray  # (n_paths,)
    hits: IntArray  # uint16 (n_paths, n_materials)
    departure: FloatArray  # (n_paths, 3), unit vectors away from the source
    arrival: FloatArray  # (n_paths, 3), unit vectors in which sound travels on arrival
    reflections: Reflections | None = None  # on request
    image_transform: FloatArray | None = None  # (n_paths, 3, 3), see `Paths`, on request
    # (n_hits, 3), from `unfolded_normals` in the order of `reflections`: the product with `arrival`
    # is the cosine of incidence, for moved sources and receivers, too. Not for boxes.
    normals: FloatArray | None = None


def unfolded_normals(normal: FloatArray, first: IntArray) -> FloatArray:
    """Return the normals of walls in the receiver's frame, mirrored by all later hits.

    Parameters
    ----------
    normal : float array, shape (n_hits, 3)
        Unit normal of each hit's wall, either side, first hit of a path first.
    first : int array, shape (n_paths + 1,)
        Path i owns the hits ``first[i]:first[i + 1]``.
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


def reflections_in_order(
    path: IntArray, place: FloatArray, material: IntArray, cosine: FloatArray, n_paths: int
) -> Reflections:
    """Return hits given in any order as ordered lists.

    Parameters
    ----------
    path : int array, shape (n_hits,)
        To which path each hit belongs.
    place : float array, shape (n_hits,)
        Rises along the path from source to receiver.
    material, cosine : arrays, shape (n_hits,)
    """
    order = np.lexsort((place, path))
    counts = np.bincount(path, minlength=n_paths)
    return Reflections(
        np.concatenate(([0], np.cumsum(counts))),
        material[order].astype(np.int32),
        # a quotient of rounded lengths may pass 1 by an ulp
        np.minimum(cosine[order], 1.0),
    )


Directions = Literal["fibonacci", "sobol"]
Estimator = Literal["spheres", "rain"]


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
    #: "rain" (diffuse rain): every diffuse reflection adds a path straight to every visible
    #: receiver, and spheres catch only what was last reflected specularly, or not at all. It costs
    #: half to all of the tracing for the same Monte-Carlo error, the less the more walls scatter,
    #: but 1.1 to 1.6 times as many paths to weigh (`benchmarks/rays.py`).
    estimator: Estimator = "spheres"
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
            if not low <= value <= high:
                raise InputError(
                    "trace setting is out of range",
                    where=name,
                    found=f"{value:g}",
                    needed=f"{low:g} to {high:g}",
                )
        if self.directions not in ("sobol", "fibonacci"):
            raise InputError(
                "unknown set of directions",
                found=repr(self.directions),
                needed='"sobol" or "fibonacci"',
            )
        if self.estimator not in ("spheres", "rain"):
            raise InputError(
                "unknown estimator of rays at receivers",
                found=repr(self.estimator),
                needed='"spheres" or "rain"',
            )
