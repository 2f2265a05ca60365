"""How much the walls of a room scatter: as specified, or as the energies of responses prefer.

Energies are compared in paths of few rays, which are weighed for every coefficient that is tried
and traced again where few of them would carry the weight. Coefficients to be fitted take the value
of the highest likelihood on a grid; unspecified ones take one value together; and walls specified
as smooth are tried with a coefficient, which raises a doubt where the data gain much. The paths of
the final trace get a weight in every band, for scattering and for directivity.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import Bands, bands_in_words
from roomfit.base.errors import InputError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import Z95
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress
from roomfit.fit.choice import choose
from roomfit.fit.measurements import Measurements
from roomfit.materials.priors import MaterialPrior, Scattering, in_bands
from roomfit.model.binned import BinnedPaths, bin_paths
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_terms, with_paths
from roomfit.model.parameters import Parameters
from roomfit.model.patterns import Directivities, directivity_factors, known_directivities
from roomfit.model.problem import Objective
from roomfit.model.scattering import (
    LEAST_EFFECTIVE_FRACTION,
    effective_sample_size,
    rows_for_band,
    scattering_weights,
)
from roomfit.room.scene import Scene, select_pairs
from roomfit.settings import Settings
from roomfit.solver import COMPARED_SD, fit_band
from roomfit.tracing.paths import Paths, TraceSettings, select
from roomfit.tracing.trace import trace

_LOG = logging.getLogger("roomfit")

# Takes coefficients (n_materials, n_bands); gives the best log likelihood of each band, (n_bands,).
ScatteringFit = Callable[[FloatArray], FloatArray]

GRID = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7)
# Half of the 95 % point of chi-square with one degree of freedom.
_WITHIN_95 = 1.92
# Coefficients are compared by energies with three windows counted as one, in place of 1.35: where
# the model is wrong in a way that all windows share, likelihoods claim more than they know.
_CAUTION = 0.45
# More unknown coefficients than these get one value in common.
_MAX_SEPARATE = 3
# Enough to distinguish coefficients that differ by a factor of two, and quick to trace again.
_FIT_S = 0.3

# For unspecified coefficients: values, middle bands, rays and duration.
_ASSUMED = (0.05, 0.2, 0.4)
_ASSUMED_BANDS, _ASSUMED_RAYS = 2, 8_000

# Walls specified as smooth are tried with this coefficient.
TRIAL = 0.15
# The higher a band, the less its energies fluctuate by interference, and the better they determine
# whether anything arrives between the image sources; higher still, sources are directional.
_TRIAL_BANDS, _HIGHEST_TRIAL_HZ = 3, 4500.0
_TRIAL_S = 0.2
# So many responses tell how walls scatter; of more, every second, third and so on is tried.
_MOST_TRIED = 50


class Retracer:
    """Binned paths for any scattering: weighed from a trace at hand, or traced where that fails.

    Keeps the last two traces, because a search comes back to the same coefficients band by band.
    """

    def __init__(self, scene: Scene, bands: Bands, settings: TraceSettings) -> None:
        self._scene, self._bands, self._settings = scene, bands, settings
        self._traced: list[tuple[Paths, BinnedPaths]] = []

    def at(self, scattering: Scattering) -> BinnedPaths:
        """Return paths in bins, from the trace whose effective sample is the largest."""
        best_fraction, best = 0.0, None
        for paths, binned in self._traced:
            # both kinds of reflection must have been drawn wherever the coefficient is to change
            (sampled,) = paths.sampling_scattering  # of one group, as traced below
            is_drawn = (sampled > 0.0) & (sampled < 1.0)
            if not np.all(is_drawn | (sampled == scattering.coefficients)):
                continue
            rows, fraction = rows_for_band(binned.rows, paths, scattering)
            if fraction > best_fraction:
                best_fraction, best = fraction, BinnedPaths(binned.edges_s, rows)
        if best is not None and best_fraction >= LEAST_EFFECTIVE_FRACTION:
            return best
        images = None
        for known, _ in self._traced[-1:]:
            images = select(known, known.batch < 0)
        paths = trace(self._scene, self._settings, scattering, known_images=images).paths
        binned = bin_paths(self._scene, self._bands, paths, self._settings.duration_s)
        self._traced = [*self._traced, (paths, binned)][-2:]
        return binned


def choose_scattering(
    fit: ScatteringFit,
    start: FloatArray,
    fitted: BoolArray,
    *,
    grid: Sequence[float] = GRID,
    common: bool = True,
    progress: Progress | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the coefficients of the highest likelihood, the least and the largest that do as well.

    All (n_materials, n_bands), on a grid. First all unknown ones move together; with
    ``common=False`` then one after the other, until none moves or two rounds are done.
    """
    _LOG.info("choosing the scattering")
    values, unknown = np.array(sorted(set(grid))), np.flatnonzero(fitted)
    sweeps = 0 if common else 2
    n_fits, n_done = len(values) * (1 + sweeps * unknown.size), 0
    chosen = np.array(start, dtype=np.float64)
    lower, upper = chosen.copy(), chosen.copy()

    def move(group: IntArray) -> bool:
        """Move some coefficients together to the best value; return whether that changed them."""
        nonlocal n_done
        total = []
        for value in values:
            trial = chosen.copy()
            trial[group] = value
            n_done += 1
            if progress is not None:
                progress(min(n_done / n_fits, 1.0))
            total.append(float(fit(trial).sum()))
        best, alike = choose(values.tolist(), total, _WITHIN_95)
        changed = bool(np.any(chosen[group] != best))
        chosen[group], lower[group], upper[group] = best, alike[0], alike[-1]
        return changed

    move(unknown)
    for _ in range(sweeps):
        changed = [move(one) for one in unknown[:, None]]
        if not any(changed):
            break
    if progress is not None:
        progress(1.0)
    return chosen, lower, upper


class ChosenScattering(NamedTuple):
    """Scattering coefficients that were chosen by likelihood on a grid, or assumed."""

    materials: tuple[str, ...]
    value: tuple[float, ...]  # one a material
    lower: tuple[float, ...]  # least that does as well
    upper: tuple[float, ...]
    is_fitted: bool  # asked for; otherwise assumed, since nothing was specified
    has_data: bool  # whether responses were compared


def chosen_scattering(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
    progress: Progress | None,
) -> tuple[tuple[MaterialPrior, ...], FloatArray, tuple[ChosenScattering, ...]]:
    """Return the priors with the most likely scattering where it is unspecified or to be fitted.

    And its standard deviation by material, 0 elsewhere: a quarter of the range of those as likely.
    What is unspecified has one coefficient: that of the settings where it explains the responses as
    well as the most likely of five, or where there are none; then its deviation is as large.
    """
    n_bands, sd, found = len(measurements.bands), np.zeros(len(priors)), []
    for is_fitted in (False, True):
        own = np.array([k.fit_scattering for k in priors])
        grid: Sequence[float] = GRID
        value = settings.default_scattering
        how, bands = (settings.n_scattering_rays, _FIT_S), slice(0, n_bands)
        if not is_fitted:
            own = np.array([k.scattering is None for k in priors]) & ~own
            grid, how = (0.0, *sorted({*_ASSUMED, value})), (_ASSUMED_RAYS, _TRIAL_S)
            first = max((n_bands - _ASSUMED_BANDS) // 2, 0)
            bands = slice(first, min(first + _ASSUMED_BANDS, n_bands))
        if not own.any():
            continue
        shortened = _shortened(trace_settings, *how)
        trial = _energy_fit(measurements, priors, settings, shortened, start, bands)
        best = low = high = np.full(np.count_nonzero(own), value)
        sd[own] = value
        if trial is not None:
            common = not is_fitted or best.size > _MAX_SEPARATE
            shown = progress if is_fitted else None
            ways = choose_scattering(*trial, own, grid=grid, common=common, progress=shown)
            best, low, high = (x[own, 0] for x in ways)
            sd[own] = [_grid_sd(grid, *ends) for ends in zip(low, high, strict=True)]
            if not is_fitted and low[0] <= value <= high[0]:
                best = np.full(best.size, value)
        elif is_fitted:
            raise InputError(
                "scattering cannot be fitted without responses",
                where="materials",
                found='scattering = "fit" and room parameters only',
                needed="impulse responses, or scattering as a number",
                hint="write scattering = 0.1, or add recordings",
            )
        names = tuple(k.name for k, is_own in zip(priors, own, strict=True) if is_own)
        of = dict(zip(names, best.tolist(), strict=True))
        priors = tuple(
            replace(k, scattering=np.full(n_bands, of[k.name])) if k.name in of else k
            for k in priors
        )
        values, least, most = (tuple(x.tolist()) for x in (best, low, high))
        found.append(ChosenScattering(names, values, least, most, is_fitted, trial is not None))
    return priors, sd, tuple(found)


def _grid_sd(grid: Sequence[float], lower: float, upper: float) -> float:
    """Return the standard deviation of a value known to lie between two of a grid, both included.

    The 95 % interval reaches half of the way to the next values on either side.
    """
    values = np.array(sorted(set(grid)))
    edges = np.concatenate((values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]))
    first, last = (int(np.argmin(np.abs(values - v))) for v in (lower, upper))
    return float(edges[last + 1] - edges[first]) / (2.0 * Z95)


def tried_scattering(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
) -> tuple[tuple[str, ...], FloatArray] | None:
    """Return walls specified as smooth, and what bands gain if all scatter by `TRIAL`, (n_bands,).

    In the three highest bands up to 4 kHz. None without such walls or responses.
    """
    walls = [k for k in priors if k.object_volume_m3 is None]
    if not any(k.scattering is not None and not np.any(k.scattering > 0.0) for k in walls):
        return None
    last = max(int(np.searchsorted(measurements.bands.centres_hz, _HIGHEST_TRIAL_HZ)), 1)
    chosen = slice(max(last - _TRIAL_BANDS, 0), last)
    shortened = _shortened(trace_settings, settings.n_scattering_rays, _TRIAL_S)
    trial = _energy_fit(measurements, priors, settings, shortened, start, chosen)
    if trial is None:
        return None
    fit, assumed = trial
    smooth = ~np.any(assumed > 0.0, axis=1)
    if not smooth.any():
        return None
    without = fit(assumed)
    gains = fit(np.where(smooth[:, None], TRIAL, assumed)) - without
    each = zip(walls, smooth, strict=False)
    return tuple(k.name for k, is_smooth in each if is_smooth), gains


def _shortened(settings: TraceSettings, n_rays: int, until_s: float) -> TraceSettings:
    until_s = min(settings.duration_s, until_s)
    return replace(settings, n_rays=n_rays, duration_s=until_s, keep_image_transforms=False)


def _energy_fit(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
    chosen: slice,
) -> tuple[ScatteringFit, FloatArray] | None:
    """Return a fit of the energies in some bands, 0 without data, and the specified coefficients.

    None where there are no responses to fit.
    """
    observed = [m for m in measurements.responses if m.measurement.use == "fit"]
    if not observed:
        return None
    own = Bands(measurements.bands.kind, measurements.bands.centres_hz[chosen])
    known = in_bands(priors, np.arange(chosen.start, chosen.stop))
    observed = observed[:: -(-len(observed) // _MOST_TRIED)]
    pairs = np.unique([m.pair for m in observed])
    scene, responses = select_pairs(measurements.scene, pairs), []
    for m in observed:
        noise = replace(
            m.noise, **{f.name: getattr(m.noise, f.name)[chosen] for f in fields(m.noise)}
        )
        pair = int(np.searchsorted(pairs, m.pair))
        responses.append(replace(m, pair=pair, noise=noise, fit_end_s=m.fit_end_s[chosen]))
    retracer = Retracer(scene, own, trace_settings)
    windows: list[tuple[EnergyTerm, Parameters] | None] = []  # the same for every coefficient
    air_per_m = attenuation_per_m(scene.air, own)

    def fit(coefficients: FloatArray) -> FloatArray:
        out = np.zeros(len(own))
        columns, column_of_band = np.unique(coefficients, axis=1, return_inverse=True)
        for number, column in enumerate(columns.T):
            binned = retracer.at(Scattering(scene.room.materials, column))
            if not windows:
                made = energy_terms(scene, own, known, tuple(responses), binned, start[chosen])
                windows.extend(None if w is None else (replace(w[0], rows=()), w[1]) for w in made)
            for band, found in enumerate(windows):
                if found is not None and column_of_band.reshape(-1)[band] == number:
                    term = with_paths(found[0], binned, float(air_per_m[band]))
                    fitted = fit_band(Objective(found[1], (term,)), settled_sd=COMPARED_SD)
                    out[band] = _CAUTION * fitted.log_likelihood
        return out

    default = np.full(len(priors), settings.default_scattering)
    return fit, specified_scattering(known, default, len(own))


def specified_scattering(
    priors: tuple[MaterialPrior, ...], traced: FloatArray, n_bands: int
) -> FloatArray:
    """Return the scattering (n_materials, n_bands), that of the trace where it is unspecified."""
    both = zip(priors, np.atleast_2d(traced)[0], strict=True)
    return np.stack(
        [np.full(n_bands, s0) if k.scattering is None else k.scattering for k, s0 in both]
    )


def band_factors(
    directivities: Directivities, scene: Scene, bands: Bands, paths: Paths, scattering: FloatArray
) -> tuple[FloatArray | None, tuple[Finding, ...]]:
    """Return the factor of every path in every band, (n_bands, n_paths); None where all are 1.

    With a finding where weights are degenerate. Shapes: `scattering` (n_materials, n_bands).
    """
    findings: tuple[Finding, ...] = ()
    traced = paths.sampling_scattering
    sources = known_directivities(directivities, scene.sources)
    is_directed = any(s is not None for s in sources)
    differs = len(traced) > 1 or np.any(scattering != traced[0][:, None])
    if not (differs or is_directed):
        return None, ()
    factors: FloatArray = np.ones((len(bands), len(paths)))
    if differs:
        for factor, own in zip(factors, scattering.T, strict=True):
            factor[:] = scattering_weights(paths, Scattering(paths.materials, own))
        findings = _degenerate_weight_findings(bands, paths, factors)
    if is_directed:
        for band, factor in enumerate(factors):
            factor *= directivity_factors(paths, sources, scene.pairs[:, 0].tolist(), band)
    return factors, findings


def _degenerate_weight_findings(
    bands: Bands, paths: Paths, factors: FloatArray
) -> tuple[Finding, ...]:
    """Return a finding for bands in which few rays carry nearly all of the weight."""
    rays = paths.batch >= 0
    n = int(np.count_nonzero(rays))
    fractions = np.array([effective_sample_size(row[rays]) / max(n, 1) for row in factors])
    few = np.flatnonzero((fractions < LEAST_EFFECTIVE_FRACTION) & (n > 0))
    if not few.size:
        return ()
    bands_hz, notes = bands.centres_hz[few].tolist(), [f"{100 * fractions[j]:.0f} %" for j in few]
    text = (
        "Scattering differs so much from what rays were traced with, the mean over groups of "
        "bands, that few of them carry the energy: their effective share is "
        f"{bands_in_words(bands, few, notes)}. Predictions are noisy there; fit these bands by "
        "themselves."
    )
    code, about = Code.IMPORTANCE_WEIGHTS_DEGENERATE, About(bands_hz=bands_hz)
    return (Finding(code, about, text, {"bands_hz": bands_hz}),)
