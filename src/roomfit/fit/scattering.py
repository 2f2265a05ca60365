"""How much the walls of a room scatter: as specified, or as the energies of responses prefer.

Energies are compared in paths of few rays, which are weighed for every coefficient that is tried
and traced again where few of them would carry the weight. Coefficients to be fitted, and those
that are unspecified together, take their mean over a grid by evidence, with its spread; and walls
specified as smooth are tried with a coefficient, which raises a doubt where the data gain much. The
paths of the final trace get a weight in every band, for scattering and for directivity.
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
from roomfit.base.typing import BoolArray, FloatArray, IntArray, Progress
from roomfit.fit.measurements import Measurements
from roomfit.materials.priors import MaterialPrior, Scattering, in_bands
from roomfit.model.binned import BinnedPaths, bin_paths
from roomfit.model.energy import EnergyTerm
from roomfit.model.observation import energy_terms, with_paths
from roomfit.model.parameters import Parameters, physical_values
from roomfit.model.patterns import Directivities, directivity_factors, known_directivities
from roomfit.model.problem import Objective, Values
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
# Of one value for all that is unspecified, and in the middle bands alone.
_ASSUMED, _ASSUMED_BANDS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5), 2
# Of twelve boxes that scatter by .05 to .3 errors are then 1.2 times their standard deviations.
_TEMPERED = 0.45
# What is expected before: walls are smooth with that probability; else coefficients are log-normal
# about that median, within that factor two of three times.
_SMOOTH, _EXPECTED, _WITHIN = 0.2, 0.15, 2.2
# Coefficients are compared by energies with three windows counted as one, in place of 1.35: where
# the model is wrong in a way that all windows share, likelihoods claim more than they know.
_CAUTION = 0.45
# More unknown coefficients than these get one value in common.
_MAX_SEPARATE = 3
# Enough to distinguish coefficients that differ by a factor of two, and quick to trace again.
_FIT_S = 0.3

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
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and their standard deviations, 0 of what is specified.

    Both (n_materials, n_bands). First all unknown ones move together over a grid; with
    ``common=False`` then one after the other, until none moves or two rounds are done. The value is
    the mean by evidence, of what scatters where the smooth wall is not the likelier of the two.
    """
    _LOG.info("choosing the scattering")
    values, unknown = np.array(sorted(set(grid))), np.flatnonzero(fitted)
    sweeps = 0 if common else 2
    n_fits, n_done = len(values) * (1 + sweeps * unknown.size), 0
    chosen = np.array(start, dtype=np.float64)
    sd = np.zeros_like(chosen)

    def move(group: IntArray) -> bool:
        """Give some coefficients together another value; return whether it is far from theirs."""
        nonlocal n_done
        total = []
        for value in values:
            trial = chosen.copy()
            trial[group] = value
            n_done += 1
            if progress is not None:
                progress(min(n_done / n_fits, 1.0))
            total.append(float(fit(trial).sum()))
        value, spread = _mean_by_evidence(values, np.array(total))
        changed = bool(np.any(np.abs(chosen[group] - value) > 0.5 * spread))
        chosen[group], sd[group] = value, spread
        return changed

    move(unknown)
    for _ in range(sweeps):
        changed = [move(one) for one in unknown[:, None]]
        if not any(changed):
            break
    if progress is not None:
        progress(1.0)
    return chosen, sd


def _mean_by_evidence(values: FloatArray, log_evidence: FloatArray) -> tuple[float, float]:
    """Return the mean of a coefficient and its standard deviation, by likelihoods on a grid."""
    scatters = values > 0.0
    some = values[scatters]
    width = np.gradient(np.log(some)) if some.size > 1 else np.ones(1)
    z = np.log(some / _EXPECTED) / np.log(_WITHIN)
    law = np.exp(-0.5 * z**2) * width
    weights = np.full(values.size, _SMOOTH)
    weights[scatters] = law / law.sum() * (1.0 if scatters.all() else 1.0 - _SMOOTH)
    weights *= np.exp(_TEMPERED * (log_evidence - log_evidence.max()))
    weights /= weights.sum()
    mean = float(weights @ values)
    # a value of the grid stands for all that are nearer to it than to others
    wide = np.where(scatters, np.gradient(values), 0.5 * some[0])
    sd = float(np.sqrt(weights @ ((values - mean) ** 2 + wide**2 / 12.0)))
    if weights[~scatters].sum() > 0.5:
        return 0.0, sd
    return float(weights[scatters] @ some / weights[scatters].sum()), sd


class ChosenScattering(NamedTuple):
    """Scattering coefficients that were chosen by likelihood on a grid, or assumed."""

    materials: tuple[str, ...]
    value: tuple[float, ...]  # one a material
    sd: tuple[float, ...]
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

    And its standard deviation by material, 0 elsewhere. What is unspecified has one coefficient;
    without responses that of the settings, and then its deviation is as large.
    """
    n_bands, sd, found = len(measurements.bands), np.zeros(len(priors)), []
    for is_fitted in (False, True):
        own = np.array([k.fit_scattering for k in priors])
        grid: Sequence[float] = GRID
        until_s, bands = _FIT_S, slice(0, n_bands)
        if not is_fitted:
            own = np.array([k.scattering is None for k in priors]) & ~own
            grid, until_s = _ASSUMED, _TRIAL_S
            first = max((n_bands - _ASSUMED_BANDS) // 2, 0)
            bands = slice(first, min(first + _ASSUMED_BANDS, n_bands))
        if not own.any():
            continue
        shortened = _shortened(trace_settings, settings.n_scattering_rays, until_s)
        trial = _energy_fit(measurements, priors, settings, shortened, start, bands)
        value = sd[own] = np.full(np.count_nonzero(own), settings.default_scattering)
        if trial is not None:
            common = not is_fitted or value.size > _MAX_SEPARATE
            shown = progress if is_fitted else None
            ways = choose_scattering(*trial, own, grid=grid, common=common, progress=shown)
            value, sd[own] = (x[own, 0].round(3) for x in ways)
        elif is_fitted:
            raise InputError(
                "scattering cannot be fitted without responses",
                where="materials",
                found='scattering = "fit" and room parameters only',
                needed="impulse responses, or scattering as a number",
                hint="write scattering = 0.1, or add recordings",
            )
        names = tuple(k.name for k, is_own in zip(priors, own, strict=True) if is_own)
        of = dict(zip(names, value.tolist(), strict=True))
        priors = tuple(
            replace(k, scattering=np.full(n_bands, of[k.name])) if k.name in of else k
            for k in priors
        )
        both = tuple(value.tolist()), tuple(sd[own].tolist())
        found.append(ChosenScattering(names, *both, is_fitted, trial is not None))
    return priors, sd, tuple(found)


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
                    values, _ = physical_values(found[1], fitted.vector)
                    lost = _lost_by_rays(term, values)
                    out[band] = _CAUTION * (fitted.log_likelihood + lost)
        return out

    default = np.full(len(priors), settings.default_scattering)
    return fit, specified_scattering(known, default, len(own))


def _lost_by_rays(term: EnergyTerm, values: Values) -> float:
    """Return what the noise of the rays costs a log-likelihood in expectation.

    The more walls scatter, the more of the energy is that of rays, and the less likely by that.
    """
    parts = term.variance_parts(values)
    whole = np.sum(list(parts.values()), axis=0)
    lost = 0.5 * np.log(whole / (whole - parts["rays"]))
    return float(np.sum(lost / term.correlation_length(values)))


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
