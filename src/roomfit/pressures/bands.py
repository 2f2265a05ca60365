"""Bands of a room made ready to be fitted by pressures.

Energies are fitted first; they suffice to find outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.forks import in_forks
from roomfit.fit.outliers import LEAST_BY_ENERGIES, file_misfits, outlier_files, variance_inflation
from roomfit.fit.paths import trim_memory
from roomfit.model.binned import BinnedPaths, in_band
from roomfit.model.directivity import (
    BandDirectivities,
    directed_band,
    energy_objective,
    row_bases,
)
from roomfit.model.energy import EnergyTerm, first_windows
from roomfit.model.observation import energy_terms, fitted_in_band
from roomfit.model.parameters import Parameters
from roomfit.model.problem import Objective
from roomfit.model.pulses import band_grid
from roomfit.model.weighing import shared_zeros
from roomfit.pressures.data_term import RINGING_PERIODS, CoherentTerm
from roomfit.pressures.geometry import Geometry, campaign_geometry
from roomfit.pressures.response import ImagePaths, chosen_paths, image_paths, images_of
from roomfit.pressures.sequential import BEFORE_THE_LAST_PASS_SD, CoherentBand
from roomfit.pressures.state import State, answers, under_cavity_priors
from roomfit.solver import BandFit, fit_band, score_band

# Shortest window in units of 1 / B: finer ones than energies need tell of phases.
_WINDOW_PERIODS = 0.75
# Of the lowest band: so much after the last pressure an image may still ring into its window.
_REACH_PERIODS = 5.0


def rebuild(state: State) -> State:
    """Return the same files and paths with bands made anew, as `with_outliers` leaves them.

    The energies of every band are fitted by themselves, in the windows that pressures need. Fits of
    bands made before are where these begin.
    """
    trim_memory()
    limit, unknown = state.settings.max_rounds, state.directivity_parameters
    # what the free numbers of a directivity mean changes with its prior
    starts = (answers(state) if unknown is None else ()) or (None,) * len(state.bands)
    # every band has the same unknowns, in whichever files it hears
    geometry = campaign_geometry(
        state.scene,
        state.priors,
        state.fitted,
        positions=state.settings.positions != "fixed",
        delays=state.settings.reflection_delays,
        speed_sd=state.speed_sd,
        origin=state.origin,
    )
    of = state.scene, state.bands, state.priors, state.files, state.binned, state.start
    made = energy_terms(*of, periods=_WINDOW_PERIODS)
    images = state.images
    if images is None:
        pairs = np.array([m.pair for m in state.fitted])
        reach_s = state.settings.coherent_until_s
        reach_s += _REACH_PERIODS / float(state.bands.centres_hz[0])
        images = image_paths(state.paths, pairs, 0.0, speed_of_sound_m_s(state.scene.air) * reach_s)
    bases = None if unknown is None else row_bases(unknown, state.scene, state.paths, state.binned)

    def ready(
        b: int, windows: EnergyTerm, parameters: Parameters
    ) -> tuple[Objective, CoherentTerm, BandDirectivities | None]:
        directivity, coherent = None, _as_pressures(state, b, windows, geometry, images)
        if unknown is not None and bases is not None:
            files = fitted_in_band(state.files, b)
            directivity = directed_band(unknown, state.scene, bases, windows, files)
            coherent = coherent.aimed(directivity.aims)
        energies = energy_objective(windows, parameters, directivity, state.others[b])
        return energies, coherent, directivity

    parts = {b: ready(b, *found) for b, found in enumerate(made) if found is not None}

    def fitted(b: int) -> BandFit:
        before, energies = starts[b], parts[b][0]
        if before is None:
            return fit_band(energies, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)
        return score_band(energies, before, max_rounds=limit, settled_sd=BEFORE_THE_LAST_PASS_SD)

    each: list[CoherentBand | None] = [None] * len(state.bands)
    for b, fit in zip(parts, in_forks(fitted, list(parts)), strict=True):
        energies, coherent, directivity = parts[b]
        each[b] = CoherentBand(energies, fit, coherent, directivity)
    misfits = [
        file_misfits(fitted_in_band(state.files, b), own.coherent.energies, own.energy_fit, None)
        for b, own in enumerate(each)
        if own is not None
    ]
    outliers = outlier_files(misfits, LEAST_BY_ENERGIES)
    return with_outliers(replace(state, each=tuple(each), images=images, outliers=outliers))


def _as_pressures(
    state: State, band: int, windows: EnergyTerm, geometry: Geometry, images: ImagePaths
) -> CoherentTerm:
    """Return the windows of a band as pressures."""
    files = fitted_in_band(state.files, band)
    own = np.flatnonzero([m in files for m in state.fitted])
    return coherent_term(
        state.bands,
        band,
        windows,
        float(attenuation_per_m(state.scene.air, state.bands)[band]),
        images_of(images, own, None if state.weights is None else state.weights[band]),
        state.binned,
        replace(geometry, columns=geometry.columns[own]),
        state.settings.coherent_until_s,
    )


def coherent_term(
    bands: Bands,
    band: int,
    energies: EnergyTerm,
    attenuation_per_m: float,
    images: ImagePaths,
    binned: BinnedPaths,
    geometry: Geometry,
    end_s: float = np.inf,
) -> CoherentTerm:
    """Return the partly coherent windows of a band from the same as energies, not coherent yet."""
    observed = tuple(first_windows(o, end_s) for o in energies.observations)
    c = geometry.speed_m_s
    one = Bands(bands.kind, bands.centres_hz[band : band + 1])
    first = min(float(o.edges_s[0]) for o in observed)
    last = max(float(o.edges_s[-1]) for o in observed)
    grid = band_grid(one, first, last)
    length_m = images.lengths_m()
    near = length_m <= c * (last + RINGING_PERIODS / energies.centre_hz)
    weight = images.weight * np.exp(-attenuation_per_m * length_m)
    images, travel = chosen_paths(replace(images, weight=weight), near), length_m[near] / c
    bin_edges_s = in_band(BinnedPaths(binned.edges_s, ()), energies.centre_hz).edges_s
    bins = (np.searchsorted(bin_edges_s, travel, side="right") - 1).astype(np.int32)
    n_bins = [o.spreading.shape[1] for o in observed]
    bins[bins >= np.repeat(n_bins, np.diff(images.offsets))] = -1
    nothing = chosen_paths(images, np.zeros(travel.size, dtype=np.bool_))
    return CoherentTerm(
        energies,
        observed,
        geometry,
        replace(images, coherence=shared_zeros(travel.size)),
        nothing,
        bins,
        np.zeros(0, dtype=np.int32),
        grid,
    )


def with_outliers(state: State) -> State:
    """Return the same bands with larger variances for files that others contradict.

    By energies, or by pressures where these were fitted, which know more.
    """
    bands = list(state.each)
    outliers = {**state.outliers, **state.outliers_by_pressures}
    for b, own in enumerate(bands):
        if own is not None and outliers:
            files, n_data = fitted_in_band(state.files, b), own.energy_fit.measured.size
            factor = variance_inflation(own.coherent.energies, files, outliers, n_data)
            energies = replace(own.energies, inflation=factor)
            fit = score_band(
                energies,
                own.energy_fit.vector,
                max_rounds=state.settings.max_rounds,
                settled_sd=BEFORE_THE_LAST_PASS_SD,
            )
            bands[b] = replace(own, energies=energies, energy_fit=fit)
    if state.directivity_parameters is not None:
        bands = under_cavity_priors(state, bands)
    return replace(state, each=tuple(bands))
