"""The paths of all measured pairs, with the scattering that is specified or that data prefer."""

from __future__ import annotations

import ctypes
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import Finding
from roomfit.base.typing import FloatArray, Progress, part
from roomfit.fit.measurements import Measurements, time_scales
from roomfit.fit.scattering import (
    ChosenScattering,
    band_factors,
    chosen_scattering,
    specified_scattering,
    tried_scattering,
)
from roomfit.fit.trace_plan import TracePlan, plan_trace
from roomfit.materials.priors import MaterialPrior
from roomfit.model.binned import BinnedPaths, bin_paths, reweighed
from roomfit.model.directivity import FittedDirectivity
from roomfit.model.patterns import Directivities, directivity_factors
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.trace import trace

_LOG = logging.getLogger("roomfit")


def trim_memory() -> None:
    """Give back what was freed and glibc keeps for later: arrays of up to 32 MB each."""
    if sys.platform == "linux":
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)


@dataclass(frozen=True, slots=True, eq=False)
class TracedPaths:
    """Paths, the same in fine bins, and the scattering they were traced with."""

    paths: Paths
    binned: BinnedPaths
    settings: TraceSettings
    factors: FloatArray | None  # (n_bands, n_paths), on the weight of every path in every band
    scattering: FloatArray  # (n_materials, n_bands)
    # (n_materials,), standard deviation that these have in common, 0 where it was specified
    scattering_sd: FloatArray
    findings: tuple[Finding, ...]  # of the plan, rays and their weights
    chosen_scattering: tuple[ChosenScattering, ...] = ()  # where it was not specified
    # of walls specified as smooth: their names, and what bands gain if they scatter, (n_bands,)
    scattering_trial: tuple[tuple[str, ...], FloatArray] | None = None


def redirected(
    measurements: Measurements,
    traced: TracedPaths,
    found: Sequence[FittedDirectivity],
) -> TracedPaths:
    """Return the same paths with the weights that fitted directivities give them.

    Without factors, which only fits of pressures need: they are in the weights of the rows.
    """
    scene, bands, paths = measurements.scene, measurements.bands, traced.paths
    source_of_pair = scene.pairs[:, 0].tolist()
    known = {name: p for d in found for name, p in d.patterns().items()}
    sources = [known.get(s.name) for s in scene.sources]

    def factors() -> Iterator[FloatArray]:
        """Give those of one band after the other: of all bands they are larger than the paths."""
        for band in range(len(bands)):
            own = directivity_factors(paths, sources, source_of_pair, band)
            yield own if traced.factors is None else traced.factors[band] * own

    binned = reweighed(scene, bands, traced.binned, factors())
    return replace(traced, factors=None, binned=binned)


def traced_with(traced: TracedPaths) -> dict[str, float]:
    """Return how long, with how many rays and in how many groups of bands was traced."""
    names = ("duration_s", "n_rays", "receiver_radius_m")
    used = {name: getattr(traced.settings, name) for name in names}
    return used | {"scattering_groups": len(traced.paths.sampling_scattering)}


def traced_by(
    plan: TracePlan,
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
    directivities: Directivities,
    progress: Progress | None,
) -> TracedPaths:
    """Return the paths that a plan gives, with the factors of scattering and directivity."""
    used, n_pairs = plan.settings, len(scene.pairs)
    _LOG.info("tracing")
    how = n_pairs, used.duration_s, used.image_order, used.n_rays
    _LOG.debug("%d pairs for %.2f s: image sources to order %d, %d rays a source", *how)
    found = trace(scene, used, plan.scattering, progress)
    _LOG.debug("%d paths", len(found.paths.pair))
    scattering = specified_scattering(priors, plan.scattering.coefficients, len(bands))
    factors, degenerate = band_factors(directivities, scene, bands, found.paths, scattering)
    binned = bin_paths(scene, bands, found.paths, used.duration_s, factors)
    doubts = (*plan.findings, *found.findings, *degenerate)
    none = np.zeros(len(priors))
    return TracedPaths(found.paths, binned, used, factors, scattering, none, doubts)


def traced_paths(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    start: FloatArray,
    progress: Progress | None,
    images_until_s: float | None = None,
) -> TracedPaths:
    """Trace every measured pair for as long as its decay is to be compared."""

    def planned() -> TracePlan:
        return plan_trace(
            measurements.scene,
            priors,
            *time_scales(measurements),
            settings,
            images_until_s=images_until_s,
            by_values=not measurements.responses,
        )

    plan = planned()
    how = settings, plan.settings, start
    early = part(progress, 0.0, 0.5)
    priors, sd, chosen = chosen_scattering(measurements, priors, *how, early)
    plan = planned() if chosen else plan
    is_tried = not (chosen or settings.quick)
    tried = tried_scattering(measurements, priors, *how) if is_tried else None
    trim_memory()
    done = part(progress, 0.5 if any(c.is_fitted for c in chosen) else 0.0, 1.0)
    room = measurements.scene, measurements.bands, priors, measurements.directivities
    traced = traced_by(plan, *room, done)
    trim_memory()
    return replace(traced, scattering_sd=sd, chosen_scattering=chosen, scattering_trial=tried)
