"""Image sources of every order: how long they can be had, and what their pressures add up to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from roomfit.base.typing import FloatArray
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.fit.scattering import band_factors
from roomfit.fit.trace_plan import in_lattice
from roomfit.materials.priors import Scattering
from roomfit.model.binned import BinnedPaths, bin_paths
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths, concatenate, select

Retrace = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


def fit_until_s(scene: Scene, traced: TracedPaths, settings: Settings) -> float:
    """Return until when windows are fitted.

    What is left in a smooth box travels between two hard walls along paths that few rays find.
    """
    smooth = not np.any(traced.paths.sampling_scattering)
    until_s = traced.settings.image_until_s
    return until_s if until_s and smooth and in_lattice(scene.room, settings) else np.inf


def retracing(measured: Measurements, traced: TracedPaths) -> Retrace | None:
    """Return what finds the image sources of moved points, with the rays of the first trace.

    None where all images stay, as in a box, or too few are known.
    """
    settings, bands = traced.settings, measured.bands
    until_s = settings.image_until_s
    if not settings.n_rays:
        until_s = until_s or settings.duration_s
    # of a box with one surface a wall, images strike the same walls wherever the points move
    if until_s is None or measured.scene.room.shoebox_m is not None:
        return None
    rays = select(traced.paths, traced.paths.batch >= 0)
    scattering = Scattering(rays.materials, rays.sampling_scattering)

    def again(moved: Scene) -> tuple[Paths, FloatArray | None, BinnedPaths]:
        images = trace_images(
            moved, settings.image_order, until_s, scattering, with_image_transforms=True
        )
        both = concatenate([images, rays])
        factors, _ = band_factors(measured.directivities, moved, bands, both, traced.scattering)
        return both, factors, bin_paths(moved, bands, both, settings.duration_s, factors)

    return again
