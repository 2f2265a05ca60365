"""What is to be fitted by pressures, its paths, and its bands made ready."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias, cast

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray
from roomfit.fit.bands import other_terms
from roomfit.fit.directivity import (
    SourceGain,
    directivities_under_cavity_priors,
    directivity_parameters,
    is_fittable,
    moved_start,
    omnidirectional,
)
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.fit.scattering import band_factors
from roomfit.fit.trace_plan import in_lattice
from roomfit.materials.priors import MaterialPrior, Scattering
from roomfit.model.binned import BinnedPaths, bin_paths, regrouped
from roomfit.model.directivity import DirectivityParameters, directed, with_directivities
from roomfit.model.parameters import physical_values
from roomfit.model.problem import DataTerm
from roomfit.model.weighing import first_rows
from roomfit.pressures.geometry import Geometry, prior_speed_sd
from roomfit.pressures.response import ImagePaths
from roomfit.pressures.sequential import CoherentBand, CoherentBandFit
from roomfit.room.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.measurement import MeasuredPair
from roomfit.solver import score_band
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths, concatenate, select

Retrace: TypeAlias = Callable[[Scene], tuple[Paths, FloatArray | None, BinnedPaths]]
"""Traces a scene whose positions have moved: paths, their factors in each band, the same binned."""


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """What is to be fitted, its paths, and its bands made ready."""

    scene: Scene
    bands: Bands
    priors: tuple[MaterialPrior, ...]
    # measurements, as sources of a flat magnitude response would have given them
    files: tuple[MeasuredPair, ...]
    start: FloatArray  # (n_bands,)
    settings: Settings
    speed_sd: float  # prior relative standard deviation of the speed of sound
    late_end_s: float  # where the last window ends at the latest
    others: tuple[tuple[DataTerm, ...], ...]  # by band, data beside the responses
    directivity_parameters: DirectivityParameters | None  # of sources whose directivity is fitted
    tested_sources: DirectivityParameters | None  # those that are taken for omnidirectional
    fits_contradicted: bool  # whether directivities of these are fitted where data contradict it
    # (n_materials, n_bands) and (n_materials,): coefficients, and the standard deviation they share
    scattering: tuple[FloatArray, FloatArray]
    retrace: Retrace | None  # None where positions are not fitted, or images all stay
    paths: Paths
    weights: FloatArray | None  # (n_bands, n_paths)
    binned: BinnedPaths
    # free numbers of the geometry for which the paths were traced; None for those specified
    origin: FloatArray | None = None
    each: tuple[CoherentBand | None, ...] = ()  # the bands
    starts: tuple[FloatArray | None, ...] = ()  # answers by energies of bands that were let go of
    first: tuple[FloatArray | None, ...] = ()  # answers by pressures of an earlier pass
    images: ImagePaths | None = None  # of these paths, what all bands share; None: not made yet
    # how many times worse than others energies, and pressures, explain a file
    outliers: Mapping[MeasuredPair, float] = field(default_factory=dict)
    outliers_by_pressures: Mapping[MeasuredPair, float] = field(default_factory=dict)
    contradicted: tuple[SourceGain, ...] = ()  # of tested sources that the data contradict

    @property
    def geometry(self) -> Geometry | None:
        """The unknowns of arrival times, the same in all bands; None without data."""
        return next((b.coherent.geometry for b in self.each if b is not None), None)

    @property
    def fitted(self) -> tuple[MeasuredPair, ...]:
        """The files that are fitted in some band."""
        return tuple(m for m in self.files if m.measurement.use == "fit")


def unfitted(
    measured: Measurements,
    priors: tuple[MaterialPrior, ...],
    traced: TracedPaths,
    start: FloatArray,
    settings: Settings,
    retrace: Retrace | None = None,
) -> State:
    """Return what is to be fitted by partly coherent image sources, nothing of it yet."""
    unknown, until_s = directivity_parameters(measured, settings), traced.settings.image_until_s
    # what is left in a smooth box travels between two hard walls along paths that few rays find
    smooth = not np.any(traced.paths.sampling_scattering)
    ends = until_s and smooth and in_lattice(measured.scene.room, settings)
    return State(
        measured.scene,
        measured.bands,
        priors,
        measured.responses,
        start,
        settings,
        prior_speed_sd(measured.scene.air, settings),
        until_s if until_s and ends else np.inf,
        other_terms(measured, traced),
        unknown,
        omnidirectional(measured) if unknown is None else None,
        is_fittable(measured, settings),
        (traced.scattering, traced.scattering_sd),
        retrace,
        traced.paths,
        traced.factors,
        traced.binned,
    )


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


def release(state: State) -> State:
    """Return a state without its bands, whose answers are kept: if no other name holds them."""
    return replace(state, each=(), starts=answers(state))


def vectors(fits: Sequence[CoherentBandFit | None]) -> tuple[FloatArray | None, ...]:
    return tuple(None if f is None else f.fit.vector for f in fits)


def answers(state: State) -> tuple[FloatArray | None, ...]:
    found = tuple(None if b is None else b.energy_fit.vector for b in state.each)
    return found or state.starts


def current_absorption(state: State, fits: Sequence[CoherentBandFit | None] = ()) -> FloatArray:
    """Return absorption by pressures where fitted, else by energies, else the start.

    Shape (n_materials, n_bands).
    """
    out = np.tile(state.start, (len(state.priors), 1))
    for i, band in enumerate(state.each):
        if band is not None:
            parameters, vector = band.energies.parameters, band.energy_fit.vector
            out[:, i] = physical_values(parameters, vector)[0]["absorption"]
    for i, fit in enumerate(fits):
        if fit is not None:
            out[:, i] = physical_values(fit.parameters, fit.fit.vector)[0]["absorption"]
    return out


def cut_at(binned: BinnedPaths, end_s: float) -> BinnedPaths:
    """Return the bins that end by a time, with their rows."""
    n = max(int(np.searchsorted(binned.edges_s, end_s + 1e-9, side="right")) - 1, 1)
    if n >= binned.edges_s.size - 1:
        return binned
    return regrouped(binned, binned.edges_s[: n + 1], lambda rows: first_rows(rows, n))


def under_cavity_priors(
    state: State, bands: Sequence[CoherentBand | None]
) -> list[CoherentBand | None]:
    """Fit the energies again under what other bands say of the directivity."""
    directivities = directivities_under_cavity_priors(
        cast(DirectivityParameters, state.directivity_parameters),
        state.bands,
        [None if own is None else own.directivity for own in bands],
        [None if own is None else own.energy_fit for own in bands],
    )
    out: list[CoherentBand | None] = []
    for own, directivity in zip(bands, directivities, strict=True):
        if own is None or own.directivity is None or directivity is None:
            out.append(own)
            continue
        start = moved_start(own.energy_fit, own.directivity.unknown, directivity.unknown)
        energies = replace(
            own.energies,
            parameters=with_directivities(own.energies.parameters, directivity.unknown),
            terms=(directed(own.coherent.energies, directivity), *own.energies.terms[1:]),
        )
        fit = score_band(energies, start, max_rounds=state.settings.max_rounds)
        out.append(CoherentBand(energies, fit, own.coherent, directivity))
    return out
