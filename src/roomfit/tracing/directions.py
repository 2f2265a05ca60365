"""In which directions the rays of a source start."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from roomfit.tracing.settings import TraceSettings
from roomfit.typing import FloatArray

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def start_directions(settings: TraceSettings, source: int) -> FloatArray:
    """Return the unit vectors in which the rays of one source start, shape (n_rays, 3).

    Ray i belongs to batch ``i % n_batches``. Sources differ in their Sobol points; the Fibonacci
    spiral is the same for all.
    """
    if settings.directions == "fibonacci":
        return fibonacci_directions(settings.n_rays)
    return sobol_directions(settings.n_rays, settings.n_batches, (settings.seed, source))


def fibonacci_directions(n_rays: int) -> FloatArray:
    """Return the Fibonacci sphere: one spiral of points of equal area, shape (n_rays, 3).

    Point i has ``z = 1 - (2 i + 1) / n`` and azimuth ``i`` times the golden angle.
    """
    i = np.arange(n_rays)
    return _on_sphere(1.0 - (2.0 * i + 1.0) / max(n_rays, 1), i * _GOLDEN_ANGLE)


def sobol_directions(n_rays: int, n_batches: int, seed: tuple[int, ...]) -> FloatArray:
    """Return scrambled Sobol points on the sphere, another scramble for each batch.

    Each point alone is uniform on the sphere, so each batch gives an unbiased estimate, and
    batches are independent, so their spread measures the error. A batch takes the first points of
    its sequence: any number will do, but one whose number of rays is a power of two covers the
    sphere most evenly.

    Parameters
    ----------
    n_rays : int
        All batches together; they differ in size by at most one ray.
    n_batches : int
    seed : tuple of int
        Feeds the scrambles.

    Returns
    -------
    float array, shape (n_rays, 3)
        Ray i is point ``i // n_batches`` of batch ``i % n_batches``.
    """
    directions = np.empty((n_rays, 3))
    for batch in range(min(n_batches, n_rays)):
        rng = np.random.default_rng((*seed, batch))
        own = directions[batch::n_batches]
        points = qmc.Sobol(2, scramble=True, rng=rng).random_base2(
            max(len(own) - 1, 0).bit_length()
        )
        u = points[: len(own)]
        own[:] = _on_sphere(1.0 - 2.0 * u[:, 0], 2.0 * np.pi * u[:, 1])
    return directions


def _on_sphere(z: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return unit vectors; equal areas in (z, azimuth) are equal areas on the sphere."""
    across = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.stack((across * np.cos(azimuth), across * np.sin(azimuth), z), axis=1)
