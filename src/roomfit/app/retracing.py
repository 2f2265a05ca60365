"""Paths for any scattering: weighed anew while that can be trusted, traced again where not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from roomfit.app.binning import BinnedPaths, bin_paths
from roomfit.app.measuring import MeasuredPair
from roomfit.app.problems import band_problems
from roomfit.bands import Bands
from roomfit.identification.reweighted import BandFit, fit_band
from roomfit.identification.solvers import few_gauss_newton_steps, gauss_newton
from roomfit.materials.knowledge import MaterialKnowledge
from roomfit.materials.scattering import Scattering
from roomfit.response.scattering import LEAST_SAMPLE_SHARE, rows_for_band, with_scattering
from roomfit.scene.scene import Scene
from roomfit.tracing.join import trace
from roomfit.tracing.paths import Paths
from roomfit.tracing.settings import TraceSettings
from roomfit.typing import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TracedRows:
    """A trace, and its paths sorted into fine time bins."""

    paths: Paths
    binned: BinnedPaths


class Retracer:
    """Rows for any scattering: weighed anew from a trace at hand, or traced where that fails.

    Keeps the last few traces, because a search comes back to the same coefficients band by band.
    """

    def __init__(
        self,
        trace_at: Callable[[Scattering], TracedRows],
        *,
        least_share: float = LEAST_SAMPLE_SHARE,
        kept: int = 2,
    ) -> None:
        self._trace_at = trace_at
        self._least_share = least_share
        self._kept = kept
        self._traced: list[TracedRows] = []  # never more than `kept`
        self.n_traces = 0

    def at(self, scattering: Scattering) -> TracedRows:
        """Return paths and bins for a scattering, from the trace that leaves the largest sample.

        Parameters
        ----------
        scattering : Scattering
            Of one band, materials in the order of the room.
        """
        best_share, best = 0.0, None
        for traced in self._traced:
            if not _within_reach(traced.paths, scattering):
                continue
            band = rows_for_band(traced.binned.rows, traced.paths, scattering)
            if band.sample_share > best_share:
                best_share, best = band.sample_share, (traced, band.rows)
        if best is None or best_share < self._least_share:
            self._traced = [*self._traced, self._trace_at(scattering)][-self._kept :]
            self.n_traces += 1
            return self._traced[-1]
        traced, rows = best
        paths = with_scattering(traced.paths, scattering)
        return TracedRows(paths, BinnedPaths(traced.binned.edges_s, rows))


def _within_reach(paths: Paths, scattering: Scattering) -> bool:
    """Whether paths were drawn with some of both kinds of reflection wherever s is to change."""
    sampled, wanted = paths.sampling_scattering, scattering.coefficients
    inside = (sampled > 0.0) & (sampled < 1.0)
    return bool(np.all(inside | (sampled == wanted)))


def scene_retracer(
    scene: Scene, bands: Bands, settings: TraceSettings, *, least_share: float = LEAST_SAMPLE_SHARE
) -> Retracer:
    """Return a `Retracer` that traces a scene with given settings."""

    def trace_at(scattering: Scattering) -> TracedRows:
        paths = trace(scene, settings, scattering).paths
        return TracedRows(paths, bin_paths(scene, bands, paths, settings.duration_s))

    return Retracer(trace_at, least_share=least_share)


def energy_fits(
    scene: Scene,
    bands: Bands,
    knowledge: tuple[MaterialKnowledge, ...],
    measured: tuple[MeasuredPair, ...],
    retracer: Retracer,
    start: FloatArray,
    coefficients: FloatArray,
) -> tuple[BandFit | None, ...]:
    """Fit the energy model of every band with its own scattering; None where there is no problem.

    Parameters
    ----------
    start : float array, shape (n_bands,)
        As for `band_problems`.
    coefficients : float array, shape (n_materials, n_bands)
        Scattering.
    """
    fits: list[BandFit | None] = [None] * len(bands)
    columns, own = np.unique(coefficients, axis=1, return_inverse=True)
    for number, column in enumerate(columns.T):
        binned = retracer.at(Scattering(scene.room.materials, column)).binned
        problems = band_problems(scene, bands, knowledge, measured, binned, start)
        for band, problem in enumerate(problems):
            if problem is not None and own.reshape(-1)[band] == number:
                fits[band] = fit_band(problem, gauss_newton, few_gauss_newton_steps)
    return tuple(fits)


def log_likelihoods(fits: tuple[BandFit | None, ...]) -> FloatArray:
    """Return the log likelihood of every band, 0 where nothing was fitted, shape (n_bands,)."""
    return np.array([0.0 if fit is None else fit.log_likelihood for fit in fits])
