"""How much the walls of a campaign scatter: as told, as the data prefer, or other than told.

Paths for any scattering: weighed anew while that can be trusted, traced again where not.

How much walls scatter: chosen by the likelihood, and suspected where nobody thought of it.

What paths weigh in each band: how walls scatter there, and how sources radiate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from roomfit._checks import read_only
from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.findings import Code, Finding
from roomfit.inversion.measurements import Measurements
from roomfit.materials.priors import MaterialPrior, Scattering, in_bands
from roomfit.measurement import MeasuredPair
from roomfit.objective.observation import band_problems
from roomfit.response.binned import BinnedPaths, bin_paths
from roomfit.response.directivity import Directivities, directivity_factors, known_directivities
from roomfit.response.scattering import (
    LEAST_EFFECTIVE_FRACTION,
    effective_sample_size,
    rows_for_band,
    scattering_weights,
    with_scattering,
)
from roomfit.scene import Scene
from roomfit.settings import Settings
from roomfit.signals.noise import NoiseEstimate
from roomfit.solvers.least_squares import BandFit, few_gauss_newton_steps, fit_band, gauss_newton
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.trace import trace
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress


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
        least_share: float = LEAST_EFFECTIVE_FRACTION,
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
            if band.effective_sample_fraction > best_share:
                best_share, best = band.effective_sample_fraction, (traced, band.rows)
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
    scene: Scene,
    bands: Bands,
    settings: TraceSettings,
    *,
    least_share: float = LEAST_EFFECTIVE_FRACTION,
) -> Retracer:
    """Return a `Retracer` that traces a scene with given settings."""

    def trace_at(scattering: Scattering) -> TracedRows:
        paths = trace(scene, settings, scattering).paths
        return TracedRows(paths, bin_paths(scene, bands, paths, settings.duration_s))

    return Retracer(trace_at, least_share=least_share)


def energy_fits(
    scene: Scene,
    bands: Bands,
    priors: tuple[MaterialPrior, ...],
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
        problems = band_problems(scene, bands, priors, measured, binned, start)
        for band, problem in enumerate(problems):
            if problem is not None and own.reshape(-1)[band] == number:
                fits[band] = fit_band(problem, gauss_newton, few_gauss_newton_steps)
    return tuple(fits)


def log_likelihoods(fits: tuple[BandFit | None, ...]) -> FloatArray:
    """Return the log likelihood of every band, 0 where nothing was fitted, shape (n_bands,)."""
    return np.array([0.0 if fit is None else fit.log_likelihood for fit in fits])


GRID = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7)
# Walls that were taken for smooth are tried with these.
TRIALS = (0.1, 0.3)
# A model that explains the data by less than this in log likelihood is not thought better.
_SUSPICIOUS = 5.0
# Half of the 95 % point of chi-square with one degree of freedom.
_WITHIN_95 = 1.92
_MOST_SWEEPS = 2

# Takes coefficients (n_materials, n_bands); gives the best log likelihood of each band, (n_bands,).
ScatteringFit = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class ScatteringChoice:
    """The scattering that explains the data best, and what else would do.

    Attributes
    ----------
    coefficients : float array, shape (n_materials, n_bands)
    lower, upper : float arrays, shape (n_materials, n_bands)
        The least and the largest grid value whose log likelihood is within 1.92 of the best, all
        else as chosen; equal to the coefficient where that was told.
    log_likelihood : float array, shape (n_bands,)
        At the choice.
    evaluations : int
        How often `fit` was called.
    """

    coefficients: FloatArray
    lower: FloatArray
    upper: FloatArray
    log_likelihood: FloatArray
    evaluations: int

    def __post_init__(self) -> None:
        for name in ("coefficients", "lower", "upper", "log_likelihood"):
            object.__setattr__(self, name, read_only(np.array(getattr(self, name))))


def choose_scattering(
    fit: ScatteringFit,
    start: FloatArray,
    fitted: BoolArray,
    *,
    grid: Sequence[float] = GRID,
    common: bool = True,
    per_band: bool = False,
    progress: Progress | None = None,
) -> ScatteringChoice:
    """Return the scattering coefficients with the highest profile likelihood on a grid.

    First all unknown coefficients move together. With ``common=False`` they are then moved one
    after the other, each over the whole grid, until none moves or two rounds are done.

    Parameters
    ----------
    fit : callable
        Best log likelihood of every band for given coefficients, whatever the model.
    start : float array, shape (n_materials, n_bands)
        Where a coefficient is told, its value; elsewhere anything.
    fitted : bool array, shape (n_materials,)
        Which materials' coefficients are unknown.
    grid : sequence of float
        Values to try.
    common : bool
        One value for all unknown coefficients.
    per_band : bool
        Let every band choose its own; otherwise the sum over bands decides.

    Raises
    ------
    InputError
        No coefficient is unknown, or the grid is empty or leaves 0 to 1.
    """
    values = np.array(sorted(set(grid)))
    if not np.any(fitted):
        raise InputError("no scattering is to be fitted", needed="at least one unknown coefficient")
    if not values.size or not np.all((values >= 0.0) & (values <= 1.0)):
        raise InputError(
            "no such scattering coefficients", found=str(tuple(grid)), needed="values from 0 to 1"
        )
    unknown = np.flatnonzero(fitted)
    groups = [unknown] if common else [unknown, *unknown[:, None]]
    rounds = 0 if common else _MOST_SWEEPS
    n_fits = len(values) * (1 + rounds * unknown.size)
    search = _Search(fit, np.array(start, dtype=np.float64), values, per_band, n_fits, progress)
    search.move(groups[0])
    for _ in range(rounds):
        moved = [search.move(group) for group in groups[1:]]  # every one, not only to the first
        if not any(moved):
            break
    if progress is not None:
        progress(1.0)
    return ScatteringChoice(
        search.at, search.lower, search.upper, search.log_likelihood, search.evaluations
    )


class _Search:
    """The present coefficients and what is known about them."""

    def __init__(
        self,
        fit: ScatteringFit,
        start: FloatArray,
        values: FloatArray,
        per_band: bool,
        n_fits: int,
        progress: Progress | None,
    ) -> None:
        self.fit, self.values, self.per_band = fit, values, per_band
        self.at, self.lower, self.upper = start, start.copy(), start.copy()
        self.log_likelihood: FloatArray = np.full(start.shape[1], -np.inf)
        self.evaluations = 0
        self.n_fits, self.progress = n_fits, progress

    def move(self, group: IntArray) -> bool:
        """Move some coefficients together to the best value of the grid; say whether they moved."""
        before = self.at.copy()
        profile = np.array([self._at(group, value) for value in self.values])
        judged = profile
        if not self.per_band:
            judged = np.repeat(profile.sum(axis=1)[:, None], profile.shape[1], axis=1)
        best = np.argmax(judged, axis=0)
        self.at[group] = self.values[best]
        bands = np.arange(best.size)
        self.log_likelihood = profile[best, bands]
        good = judged >= judged[best, bands] - _WITHIN_95
        self.lower[group] = self.values[np.argmax(good, axis=0)]
        self.upper[group] = self.values[len(good) - 1 - np.argmax(good[::-1], axis=0)]
        return not np.array_equal(before, self.at)

    def _at(self, group: IntArray, value: float) -> FloatArray:
        trial = self.at.copy()
        trial[group] = value
        self.evaluations += 1
        if self.progress is not None:
            self.progress(min(self.evaluations / self.n_fits, 1.0))
        return np.asarray(self.fit(trial), dtype=np.float64)


def suspected_scattering(
    fit: ScatteringFit,
    materials: tuple[str, ...],
    assumed: FloatArray,
    log_likelihood: FloatArray,
    *,
    trials: Sequence[float] = TRIALS,
) -> tuple[Finding, ...]:
    """Return a finding where walls taken for smooth had better be taken for scattering.

    Parameters
    ----------
    fit : callable
        As in `choose_scattering`.
    assumed : float array, shape (n_materials, n_bands)
        Coefficients of the fit; those that are 0 everywhere are tried.
    log_likelihood : float array, shape (n_bands,)
        Of the fit with these.
    trials : sequence of float
        Coefficients to try for all smooth walls at once.

    Returns
    -------
    tuple of Finding
        `Code.SCATTERING_UNDERESTIMATED` where a trial gains more than 5 in log likelihood, all
        bands together, and no band loses as much, which speaks for something else than scattering:
        a loudspeaker that rings, for instance. Empty otherwise, and where no wall is smooth.
    """
    smooth = ~np.any(assumed > 0.0, axis=1)
    if not smooth.any():
        return ()
    gains = []
    for value in trials:
        trial = np.where(smooth[:, None], value, assumed)
        gain = fit(trial) - log_likelihood
        gains.append(float(np.sum(gain)) if np.all(gain > -_SUSPICIOUS) else -np.inf)
    best = int(np.argmax(gains))
    if not gains[best] > _SUSPICIOUS:
        return ()
    names = [name for name, is_smooth in zip(materials, smooth, strict=True) if is_smooth]
    return (
        Finding(
            Code.SCATTERING_UNDERESTIMATED,
            f"The measurement is explained better if {', '.join(names)} scatter: a coefficient of "
            f"{trials[best]:g} raises the log likelihood by {gains[best]:.0f}. Walls that "
            "are told to be smooth make up for it, and nothing is called identifiable. Tell their "
            'scattering, or let it be fitted with scattering = "fit".',
            {"materials": names, "scattering": float(trials[best]), "gain": gains[best]},
        ),
    )


# Enough to tell coefficients apart that differ by a factor of two, and quick to trace again.
_N_RAYS = 20_000
_LONGEST_S = 0.3
# Beyond so many unknown coefficients they get one value in common.
_MOST_APART = 3
_TRIAL = (0.15,)
_ASSUMED = (0.05, 0.2, 0.4)
_TRIAL_BANDS = 2
# The higher a band, the less its energies scatter by interference, and the better they tell whether
# anything arrives between the image sources; higher still, sources are directional.
_DOUBT_BANDS = 3
_HIGHEST_DOUBT_HZ = 4500.0
_TRIAL_RAYS, _TRIAL_S = 8_000, 0.2


def chosen_scattering(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
    progress: Progress | None,
) -> tuple[tuple[MaterialPrior, ...], tuple[Finding, ...]]:
    """Return the priors with the likeliest value where ``scattering = "fit"`` stands.

    Energies alone are compared, in paths that are weighed anew for every trial.

    Parameters
    ----------
    trace_settings : TraceSettings
        As planned for the campaign; fewer rays are used here.
    start : float array, shape (n_bands,)

    Raises
    ------
    InputError
        The campaign has no response to fit.
    """
    fitted = np.array([k.fit_scattering for k in priors])
    if not fitted.any():
        return priors, ()
    observed = tuple(m for m in measurements.responses if m.measurement.use == "fit")
    if not observed:
        raise InputError(
            "scattering cannot be fitted without responses",
            where="materials",
            found='scattering = "fit" and room parameters only',
            needed="impulse responses, or scattering as a number",
        )
    scene, bands = measurements.scene, measurements.bands
    retracer = scene_retracer(scene, bands, _quick(trace_settings))
    specified = np.stack(
        [
            np.full(len(bands), settings.default_scattering)
            if k.scattering is None
            else k.scattering
            for k in priors
        ]
    )

    def fit(coefficients: FloatArray) -> FloatArray:
        return log_likelihoods(
            energy_fits(scene, bands, priors, observed, retracer, start, coefficients)
        )

    common = int(np.count_nonzero(fitted)) > _MOST_APART
    choice = choose_scattering(fit, specified, fitted, common=common, progress=progress)
    chosen = tuple(
        replace(k, scattering=row) if k.fit_scattering else k
        for k, row in zip(priors, choice.coefficients, strict=True)
    )
    names = [k.name for k in priors if k.fit_scattering]
    ranges = ", ".join(
        f"{k.name} {choice.coefficients[i, 0]:g} ({choice.lower[i, 0]:g} to {choice.upper[i, 0]:g})"
        for i, k in enumerate(priors)
        if k.fit_scattering
    )
    sentence = f"Scattering that explains the data best, among eight values: {ranges}."
    return chosen, (Finding(Code.SCATTERING_FITTED, sentence, {"materials": names}),)


def _quick(settings: TraceSettings) -> TraceSettings:
    until_s = min(settings.duration_s, _LONGEST_S)
    return replace(settings, n_rays=_N_RAYS, duration_s=until_s, keep_image_transforms=False)


def _noise_in(noise: NoiseEstimate, chosen: slice) -> NoiseEstimate:
    return NoiseEstimate(*(getattr(noise, f.name)[chosen] for f in fields(NoiseEstimate)))


def assumed_scattering(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
) -> tuple[tuple[MaterialPrior, ...], tuple[Finding, ...]]:
    """Return the priors with a scattering coefficient where it is unspecified.

    One coefficient for all of them: the likeliest of five where there are responses; 0.1 where
    there are none, or where it explains them as well.

    Parameters
    ----------
    start : float array, shape (n_bands,)
    """
    unspecified = np.array([k.scattering is None and not k.fit_scattering for k in priors])
    if not unspecified.any():
        return priors, ()
    names = ", ".join(k.name for k in priors if k.scattering is None)
    sentence = (
        f"The scattering of {names} is unspecified; {settings.default_scattering:g} was assumed."
    )
    value = settings.default_scattering
    bands = measurements.bands
    first = max((len(bands) - _TRIAL_BANDS) // 2, 0)
    middle = slice(first, min(first + _TRIAL_BANDS, len(bands)))
    trial = _trial(measurements, priors, settings, trace_settings, start, middle)
    if trial is not None:
        fit, specified = trial
        grid = (0.0, *sorted({*_ASSUMED, settings.default_scattering}))
        choice = choose_scattering(fit, specified, unspecified, grid=grid)
        value = float(choice.coefficients[unspecified][0, 0])
        low, high = (float(x[unspecified][0, 0]) for x in (choice.lower, choice.upper))
        value = settings.default_scattering if low <= settings.default_scattering <= high else value
        others = f"{low:g} to {high:g} do as well" if low < high else "others do worse"
        sentence = (
            f"The scattering of {names} is unspecified; {value:g} was assumed, which explains the "
            f"responses well ({others})."
        )
    known = tuple(
        replace(k, scattering=np.full(len(bands), value)) if missing else k
        for k, missing in zip(priors, unspecified, strict=True)
    )
    evidence = {"materials": names.split(", "), "scattering": value}
    return known, (Finding(Code.SCATTERING_ASSUMED, sentence, evidence),)


def scattering_checks(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
) -> tuple[Finding, ...]:
    """Return a finding where walls specified as smooth had better scatter.

    Tried in the three highest bands up to 4 kHz with one coefficient for all of them. Of walls that
    are smooth, a model that is otherwise right raises the doubt in fewer than one room in a
    hundred: a likelihood ratio has the mean 1 under the model in its denominator, so that it
    exceeds e^5 with a probability below e^-5 (A. Wald, Sequential Analysis, 1947, section 3.2).

    Parameters
    ----------
    start : float array, shape (n_bands,)
    """
    smooth = [k.scattering is not None and not np.any(k.scattering > 0.0) for k in priors]
    if not any(smooth):
        return ()
    bands = measurements.bands
    last = max(int(np.searchsorted(bands.centres_hz, _HIGHEST_DOUBT_HZ)), 1)
    chosen = slice(max(last - _DOUBT_BANDS, 0), last)
    trial = _trial(measurements, priors, settings, trace_settings, start, chosen, n_rays=_N_RAYS)
    if trial is None:
        return ()
    fit, specified = trial
    return suspected_scattering(
        fit, measurements.scene.room.materials, specified, fit(specified), trials=_TRIAL
    )


def _trial(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    settings: Settings,
    trace_settings: TraceSettings,
    start: FloatArray,
    chosen: slice,
    *,
    n_rays: int = _TRIAL_RAYS,
) -> tuple[ScatteringFit, FloatArray] | None:
    """Return a quick fit of the energies in some bands, and the specified coefficients there.

    None where there are no responses to fit.
    """
    observed = tuple(m for m in measurements.responses if m.measurement.use == "fit")
    if not observed:
        return None
    own = Bands(measurements.bands.kind, measurements.bands.centres_hz[chosen])
    known = in_bands(priors, np.arange(chosen.start, chosen.stop))
    responses = tuple(replace(m, noise=_noise_in(m.noise, chosen)) for m in observed)
    scene = measurements.scene
    few = replace(_quick(trace_settings), n_rays=n_rays)
    few = replace(few, duration_s=min(few.duration_s, _TRIAL_S))
    retracer = scene_retracer(scene, own, few)
    specified = np.stack(
        [
            np.full(len(own), settings.default_scattering) if k.scattering is None else k.scattering
            for k in known
        ]
    )

    def fit(coefficients: FloatArray) -> FloatArray:
        return log_likelihoods(
            energy_fits(scene, own, known, responses, retracer, start[chosen], coefficients)
        )

    return fit, specified


def specified_scattering(
    priors: tuple[MaterialPrior, ...], traced: FloatArray, n_bands: int
) -> FloatArray:
    """Return what each wall scatters in each band; where unspecified, as it was traced."""
    rows = [
        np.full(n_bands, s0) if k.scattering is None else k.scattering
        for k, s0 in zip(priors, traced, strict=True)
    ]
    return np.stack(rows)


def band_factors(
    directivities: Directivities, scene: Scene, bands: Bands, paths: Paths, scattering: FloatArray
) -> tuple[FloatArray | None, tuple[Finding, ...]]:
    """Return the factor of every path in every band, shape (n_bands, n_paths).

    None where all are 1: walls scatter in every band as they did in the trace, and all sources
    are omnidirectional.

    Parameters
    ----------
    scattering : float array, shape (n_materials, n_bands)

    Raises
    ------
    InputError
        A directivity cannot be read, or a wall was traced smooth and is to scatter.
    """
    factors: FloatArray = np.ones((len(bands), len(paths)))
    findings: tuple[Finding, ...] = ()
    differs = np.any(scattering != paths.sampling_scattering[:, None])
    if differs:
        for band in range(len(bands)):
            wanted = Scattering(paths.materials, scattering[:, band])
            factors[band] = scattering_weights(paths, wanted)
        findings = _degenerate_weight_findings(bands, paths, factors)
    sources = known_directivities(directivities, scene.sources)
    if any(s is not None for s in sources):
        for band in range(len(bands)):
            factors[band] *= directivity_factors(paths, sources, scene.pairs[:, 0].tolist(), band)
    elif not differs:
        return None, ()
    return factors, findings


def _degenerate_weight_findings(
    bands: Bands, paths: Paths, factors: FloatArray
) -> tuple[Finding, ...]:
    """Return a finding for bands in which few rays carry nearly all of the weight."""
    rays = paths.batch >= 0
    n = int(np.count_nonzero(rays))
    if n == 0:
        return ()
    fractions = np.array([effective_sample_size(row[rays]) / n for row in factors])
    degenerate = np.flatnonzero(fractions < LEAST_EFFECTIVE_FRACTION)
    if not degenerate.size:
        return ()
    listed = ", ".join(
        f"{bands.centres_hz[j]:g} Hz ({100 * fractions[j]:.0f} %)" for j in degenerate
    )
    return (
        Finding(
            Code.IMPORTANCE_WEIGHTS_DEGENERATE,
            f"Scattering differs so much from its mean over the bands that few rays carry the "
            f"energy at {listed} of them: predictions are noisy there. Fit these bands by "
            "themselves.",
            {"bands_hz": [float(bands.centres_hz[j]) for j in degenerate]},
        ),
    )
