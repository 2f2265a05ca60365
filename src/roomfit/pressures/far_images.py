"""Image sources of every order: how long they can be had, and what their pressures add up to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.fit.scattering import band_factors
from roomfit.fit.trace_plan import in_lattice
from roomfit.materials.priors import Scattering
from roomfit.model.binned import BinnedPaths, bin_paths, rows_at
from roomfit.model.observation import spread_over_time
from roomfit.model.weighing import power_table, window_of_rows
from roomfit.pressures.response import energy_of_pressures, root_energies
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.tracing.image_sources import affordable_duration_s, trace_images
from roomfit.tracing.paths import Paths, TraceSettings, concatenate, select

# A fit asks for image sources as far as its windows go, if they can be had; in a box, where they
# cost little, as far as energies are compared.
_UNTIL_S, _LEAST_S = 0.22, 0.03
# Image sources of all pairs together: 1 GB. Of 200 pairs each has 20,000, .2 s of 70 m3.
_MOST_OF_ALL = 4e6
_ANY_ORDER = 1000

Retrace = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


def images_until_s(scene: Scene, duration_s: float, settings: Settings) -> float:
    """Return how long image sources of every order can be had; 0 where it is not worth while."""
    c = speed_of_sound_m_s(scene.air)
    volume = volume_m3(scene.room.mesh)
    n_images = min(settings.most_coherent_images, _MOST_OF_ALL / len(scene.pairs))
    affordable_s = (n_images * volume * 0.75 / np.pi) ** (1.0 / 3.0) / c
    longest_s = min(duration_s, float(affordable_s))
    if not in_lattice(scene.room, settings):
        if len(scene.room.mesh.triangles) > settings.most_triangles_for_images:
            return 0.0
        longest_s = affordable_duration_s(scene, min(longest_s, _UNTIL_S))
    return longest_s if longest_s >= _LEAST_S else 0.0


def has_every_order(settings: TraceSettings) -> bool:
    """Return whether image sources of every order reach far enough to be added as pressures."""
    return settings.image_order >= _ANY_ORDER


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


def interference(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    chosen: BoolArray,
) -> FloatArray:
    """Return what the pressures of image sources add to their energies, shape (n_bands, n_bins).

    In the unit of path energies, over time as the filters show them; less than 0 where pressures
    cancel, and 0 in a band that is not chosen. Images arrive when their lengths say, and walls turn
    no phase. Rays, which stand for what has no image, add energies alone.

    Shapes: `absorption` (n_materials, n_bands), `chosen` (n_bands,).
    """
    edges_s, found = binned.edges_s, np.zeros((len(bands), binned.edges_s.size - 1))
    speed_m_s, air_per_m = speed_of_sound_m_s(scene.air), attenuation_per_m(scene.air, bands)
    for band in np.flatnonzero(chosen):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        rows = rows_at(binned, bands.centres_hz[band])[pair]
        image = np.flatnonzero(rows.batch < 0).astype(np.int32)
        length_m = rows.length_m[image]
        weight = rows.weight_per_m2[image] * np.exp(-air_per_m[band] * length_m)
        powers = power_table(np.sqrt(1.0 - absorption[:, band])[None], rows.max_hits)[0]
        roots = root_energies(weight, image, rows.hits, powers)
        together = energy_of_pressures(length_m / speed_m_s, roots, edges_s, one)
        alone = np.bincount(window_of_rows(rows)[image], roots**2, edges_s.size - 1).astype(float)
        found[band] = together - spread_over_time(one, alone[None])[0]
    return found
