"""How finely to trace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from roomfit.errors import InputError

Directions = Literal["fibonacci", "sobol"]
Estimator = Literal["spheres", "rain"]


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """Settings of one trace. What ends a ray is time or hits, never energy.

    Attributes
    ----------
    duration_s : float
        Sound travels this long, counted from emission.
    n_rays : int
        Rays per source, all batches together; 0 leaves rays out.
    image_order : int
        Highest reflection order done by image sources; -1 leaves image sources out, so that even
        the direct sound comes from rays.
    image_until_s : float or None
        Image sources end here, and rays bring all that is later; None for the whole duration.
    receiver_radius_m : float
        Radius of the spheres that catch rays.
    max_hits : int
        A ray ends after so many wall hits, at most 65535.
    directions : {"sobol", "fibonacci"}
        Scrambled Sobol points, new ones for each batch, or one Fibonacci spiral dealt out to the
        batches (its batches are not independent: it is there for the paper, and for pictures).
    n_batches : int
        Independent parts whose spread measures the Monte-Carlo noise.
    seed : int
        Same seed, same paths, bit by bit, for any number of threads.
    keep_unfolding : bool
        Image paths keep what moves their images with the source.
    estimator : {"spheres", "rain"}
        "rain": every diffuse reflection adds a path straight to every receiver that it sees, and
        spheres catch only what was last reflected specularly, or not at all. It costs half to all
        of the tracing for the same Monte-Carlo error, the less the more walls scatter, but 1.1 to
        1.6 times as many paths to weigh (`benchmarks/rays.py`).
    """

    duration_s: float
    n_rays: int = 20_000
    image_order: int = 2
    receiver_radius_m: float = 0.5
    max_hits: int = 65_535
    directions: Directions = "sobol"
    n_batches: int = 16
    seed: int = 1
    estimator: Estimator = "spheres"
    image_until_s: float | None = None
    keep_unfolding: bool = False

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
                "unknown way to bring rays to receivers",
                found=repr(self.estimator),
                needed='"spheres" or "rain"',
            )
