"""What the answers of all bands leave in doubt, and which method and intervals were used, in words.

Findings where the model misfits one band or most of them, a fit or samples did not converge, the
prior dominates an answer, or a band lies below the Schroeder frequency.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands, bands_in_words
from roomfit.errors import InputError
from roomfit.eyring import schroeder_hz
from roomfit.findings import About, Code, Finding
from roomfit.inversion.compare import predicted_curve
from roomfit.inversion.measurements import Measurements
from roomfit.inversion.paths import TracedPaths
from roomfit.inversion.scattering import Retracer
from roomfit.logit import Z95, expit, logit
from roomfit.materials.priors import MaterialPrior, Scattering, are_specified, prior_logits
from roomfit.response.binned import BinnedPaths, regrouped
from roomfit.response.energy import EnergyRows
from roomfit.results import ComparedPair
from roomfit.scene import distances_m, pair_names
from roomfit.settings import Settings
from roomfit.signals.decay import room_parameters
from roomfit.tracing.paths import TraceSettings
from roomfit.typing import FloatArray, IntArray
from roomfit.uncertainty.gaussian import LARGEST_CHI2_REDUCED, BandEstimate

_FEWEST_BANDS, _LARGEST_MEDIAN_CHI2 = 3, 1.5
# Of the prior's standard deviation: an answer that keeps more of it comes from the prior.
_PRIOR_DOMINATED = 0.9
# Predicted minus measured decay, mean over pairs: in just noticeable differences, and in its own
# standard deviations; 3 of them by chance once in 20 rooms of six bands.
_LARGEST_MISS_JND, _MISS_SDS, _FEWEST_FOR_SCATTER = 2.0, 3.0, 3
_TRIED_SCATTERING = (0.0, 0.1, 0.3, 0.6)
_DECAY_DRAWS, _MOST_DRAWN_PAIRS = 12, 8
# Relative standard deviation of a decay time times the root of bandwidth, time and number.
DECAY_SCATTER = {
    "T20_s": 0.88 * (1.0 + 1.90 / 10.0) ** 0.5,
    "T30_s": 0.55 * (1.0 + 1.52 / 10.0) ** 0.5,
    "EDT_s": 1.97 * (1.0 + 2.8 / 10.0) ** 0.5,
}


def fit_findings(bands: Bands, answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding for bands that the model misfits, and one for fits that did not converge."""
    findings = []
    bad = [j for j, a in enumerate(answers) if a.chi2_reduced > LARGEST_CHI2_REDUCED]
    if bad:
        values = [f"{answers[j].chi2_reduced:.1f}" for j in bad]
        findings.append(
            Finding(
                Code.MODEL_DOES_NOT_FIT,
                About(bands_hz=bands.centres_hz[bad].tolist()),
                "The model does not explain the data within their noise; the reduced chi-square is "
                f"{bands_in_words(bands, bad, values)}. No material is called identifiable there, "
                "and intervals are widened by the misfit.",
                {"bands_hz": bands.centres_hz[bad].tolist()},
            )
        )
    slow = [j for j, a in enumerate(answers) if not a.converged]
    if slow:
        findings.append(
            Finding(
                Code.FIT_NOT_CONVERGED,
                About(bands_hz=bands.centres_hz[slow].tolist()),
                "The fit did not converge within the rounds of updated weights that are allowed. "
                f"Last moved: {bands_in_words(bands, slow, [_moved(answers[j]) for j in slow])}. "
                "Allow more (max_rounds in [settings]), or fix what the data do not determine.",
                {
                    "bands_hz": bands.centres_hz[slow].tolist(),
                    "moved": [list(answers[j].moved) for j in slow],
                },
            )
        )
    return tuple(findings)


def _moved(answer: BandEstimate) -> str:
    """Return what the last round moved, in words."""
    return ", ".join(answer.moved) or answer.ending.value[0]


def description_findings(answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding where the model misfits most bands.

    One band that fits badly may have its own reason. Where the median of the reduced chi-square
    over the bands is high, a fault is in what all of them share, the description of the room, and a
    band whose own value happens to be low is not to be trusted either. In simulated rooms that were
    described correctly the median was 0.3 to 0.8, with a curtain or an open door forgotten 2.0,
    with directional loudspeakers taken for omnidirectional 1.2 to 1.6.

    Parameters
    ----------
    answers : sequence of BandEstimate, one a band
        Bands of room parameters alone, and those without data, are left out.
    """
    chi2_of_bands = [a.chi2_reduced for a in answers if a.model in ("coherent", "energy")]
    if len(chi2_of_bands) < _FEWEST_BANDS or not np.median(chi2_of_bands) > _LARGEST_MEDIAN_CHI2:
        return ()
    median = float(np.median(chi2_of_bands))
    return (
        Finding(
            Code.MODEL_MISFIT_ALL_BANDS,
            About(),
            "In most bands the model does not explain the data within their noise (median of the "
            f"reduced chi-square {median:.1f}): the description of the room is wrong in a "
            "material, an opening, scattering, a source or a position. Intervals are too narrow, "
            "and no material is called identifiable.",
            {"median_phi": median},
        ),
    )


class DecayMiss(NamedTuple):
    """The decay of one band that the fitted pairs had and the answer does not have."""

    band: int
    # of each parameter that is missed, the mean over pairs of predicted minus measured, in just
    # noticeable differences (5 %), with the standard deviation of that mean
    jnd: dict[str, tuple[float, float]]
    number: int  # of pairs at most


def decay_misses(
    bands: Bands,
    pairs: Sequence[ComparedPair],
    fitted: Sequence[bool],
    by_pressures: Sequence[Mapping[str, FloatArray]] = (),
) -> tuple[DecayMiss, ...]:
    """Return the bands in which T20, T30 or EDT of the fitted pairs is not reproduced.

    Where the mean over pairs of predicted minus measured is 2 just noticeable differences or more,
    and 3 of its own standard deviations: a single value of a band is random by interference, more
    so the lower the band. That scatter is the one of ISO 3382-2 for decays by an integrated
    impulse response [1]_ or, over three pairs and more, the one observed if it is larger. T30 alone
    does not count: its last decibels lie where next to nothing was fitted, and hang in a room of
    smooth walls on a few flutter echoes.

    Predictions add energies. Between smooth, parallel walls pressures do not add so: the right
    absorption may miss the decay by half there. A band that was fitted by pressures is therefore
    missed only where its own windows, as fitted, miss the same part of their decay, too.

    Parameters
    ----------
    pairs : sequence of ComparedPair
        Those kept for validation are left out.
    fitted : sequence of bool
        For each band; others are left out.
    by_pressures : sequence of mappings from parameter to float array, shape (2, n_files), optional
        By band, T20 and EDT of the windows of each file, measured and as pressures fit them; none
        where energies were fitted.

    References
    ----------
    .. [1] ISO 3382-2:2008, annex A, equations A.1 and A.2 with n = 10. For EDT the factors are
           continued by their power of the range of levels.
    """
    bandwidth_hz = bands.upper_hz - bands.lower_hz
    found: dict[int, DecayMiss] = {}
    for name, factor in DECAY_SCATTER.items():
        for band in np.flatnonzero(fitted).tolist():
            time_s, jnd = _of_fitted_pairs(pairs, name, band)
            mean, sd = mean_miss(jnd, factor / np.sqrt(bandwidth_hz[band] * time_s))
            if abs(mean) >= max(_LARGEST_MISS_JND, _MISS_SDS * sd):
                before = found.get(band, DecayMiss(band, {}, 0))
                found[band] = DecayMiss(
                    band, {**before.jnd, name: (mean, float(sd))}, max(before.number, jnd.size)
                )
    for band, decays_s in enumerate(by_pressures):
        for name in decays_s.keys() & found.get(band, DecayMiss(band, {}, 0)).jnd.keys():
            times_s = decays_s[name]
            measured_s, fitted_s = times_s[:, np.isfinite(times_s).all(axis=0)]
            scatter = DECAY_SCATTER[name] / np.sqrt(bandwidth_hz[band] * measured_s)
            mean, sd = mean_miss((fitted_s / measured_s - 1.0) / 0.05, scatter)
            if abs(mean) < max(_LARGEST_MISS_JND, _MISS_SDS * sd):
                rest = {n: v for n, v in found[band].jnd.items() if n != name}
                found[band] = found[band]._replace(jnd=rest)
    return tuple(found[band] for band in sorted(found) if not found[band].jnd.keys() <= {"T30_s"})


def mean_miss(jnd: FloatArray, scatter: FloatArray) -> tuple[float, float]:
    """Return a mean over pairs, in JND, and its standard deviation, infinite without pairs.

    Parameters
    ----------
    jnd : float array, shape (n_pairs,)
    scatter : float array, shape (n_pairs,)
        Relative standard deviation of each decay time by theory.
    """
    if not jnd.size:
        return 0.0, np.inf
    sd = float(np.median(scatter)) / 0.05 / np.sqrt(jnd.size)
    if jnd.size >= _FEWEST_FOR_SCATTER:
        sd = max(sd, float(jnd.std(ddof=1)) / np.sqrt(jnd.size))
    return float(jnd.mean()), sd


def _of_fitted_pairs(
    pairs: Sequence[ComparedPair], name: str, band: int
) -> tuple[FloatArray, FloatArray]:
    """Return what the fitted pairs measured, and predicted minus that in JND, where known."""
    rows = [p.parameters[name] for p in pairs if p.use == "fit" and name in p.parameters]
    both = np.array([(c.measured[band], c.jnd[band]) for c in rows]).reshape(-1, 2).T
    known = np.isfinite(both).all(axis=0)
    return both[0, known], both[1, known]


def fitted_decay_times_s(
    measurements: Measurements, binned: BinnedPaths, absorption: FloatArray, chosen: Sequence[int]
) -> dict[str, FloatArray]:
    """Return T20, T30 and EDT that paths predict, in the mean over eight fitted pairs or all.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    chosen : sequence of int
        The bands to predict.

    Returns
    -------
    dict from parameter to float array, shape (len(chosen),)
    """
    scene, all_bands, own = measurements.scene, measurements.bands, list(chosen)
    bands = Bands(all_bands.kind, all_bands.centres_hz[own])
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    tabulated = {v.pair_name for v in measurements.values}
    pairs = {m.pair for m in measurements.responses if m.measurement.use == "fit"} | {
        i for i, name in enumerate(pair_names(scene)) if name in tabulated
    }
    found = [
        room_parameters(
            predicted_curve(bands, binned, i, absorption[:, own], attenuation, float(direct_s[i]))
        )
        for i in sorted(pairs)[:: -(-len(pairs) // _MOST_DRAWN_PAIRS)]
    ]
    return {
        name: np.mean([f.of(name) for f in found], axis=0) for name in ("T20_s", "T30_s", "EDT_s")
    }


def certain_misses(
    measurements: Measurements,
    traced: TracedPaths,
    misses: Sequence[DecayMiss],
    absorption: FloatArray,
    logit_covariance: FloatArray,
    settings: Settings,
) -> tuple[DecayMiss, ...]:
    """Return the misses that are beyond what the answer's own uncertainty does to the decay.

    The late decay of a room of smooth walls hangs on the least absorbing of them, and on few rays:
    an answer within its interval, or another trace, may reproduce what the estimate does not. So
    absorptions are drawn from its law and ray batches with replacement, and the spread of the mean
    decay time is added to the standard deviation of each miss.

    Parameters
    ----------
    logit_covariance : float array, shape (n_bands, n_materials, n_materials)
        Zeros where absorption is fixed.
    """
    if not misses:
        return ()
    chosen, rng = [m.band for m in misses], np.random.default_rng(settings.seed)
    free = logit(absorption, 1e-9)
    drawn: dict[str, list[FloatArray]] = {name: [] for name in DECAY_SCATTER}
    for _ in range(_DECAY_DRAWS):
        trial = np.array(absorption)
        for band in chosen:
            covariance = logit_covariance[band]
            moved = rng.multivariate_normal(
                free[:, band], covariance, method="eigh", check_valid="ignore"
            )
            trial[:, band] = np.where(np.diag(covariance) > 0.0, expit(moved), trial[:, band])
        n = max(traced.paths.n_batches, 1)
        counts = np.append(rng.multinomial(n, np.full(n, 1.0 / n)), 1)  # batch -1: images

        def resampled(rows: EnergyRows, counts: IntArray = counts) -> EnergyRows:
            return replace(rows, weight_per_m2=rows.weight_per_m2 * counts[rows.batch])

        binned = regrouped(traced.binned, traced.binned.edges_s, resampled)
        for name, times_s in fitted_decay_times_s(measurements, binned, trial, chosen).items():
            drawn[name].append(times_s)
    kept = []
    for i, miss in enumerate(misses):
        jnd = {}
        for name, (mean, sd) in miss.jnd.items():
            times_s = np.array(drawn[name])[:, i]
            times_s = times_s[np.isfinite(times_s)]
            if times_s.size < _DECAY_DRAWS // 2:
                continue
            # in JND of the measured decay, as the miss is; too short counts as too long does
            more = float(times_s.std(ddof=1) / times_s.mean()) * (20.0 + abs(mean))
            whole = float(np.hypot(sd, more))
            if abs(mean) >= _MISS_SDS * whole:
                jnd[name] = (mean, whole)
        if not jnd.keys() <= {"T30_s"}:
            kept.append(miss._replace(jnd=jnd))
    return tuple(kept)


def decays_by_scattering(
    measurements: Measurements,
    traced: TracedPaths,
    absorption: FloatArray,
    settings: Settings,
    misses: Sequence[DecayMiss],
) -> dict[float, FloatArray]:
    """Return what the same absorption would miss with one scattering or another on all walls.

    By few rays, of omnidirectional sources; empty where nothing is missed.

    Returns
    -------
    dict from scattering coefficient to float array, shape (len(misses),)
        Of the parameter that is missed most in each band, in just noticeable differences.
    """
    if not misses:
        return {}
    scene, bands, chosen = measurements.scene, measurements.bands, [m.band for m in misses]
    worst = [max(m.jnd, key=lambda name: abs(m.jnd[name][0])) for m in misses]
    fitted = fitted_decay_times_s(measurements, traced.binned, absorption, chosen)
    shortened = TraceSettings(
        traced.settings.duration_s,
        n_rays=settings.n_scattering_rays,
        receiver_radius_m=traced.settings.receiver_radius_m,
        seed=settings.seed,
    )
    retracer, found = Retracer(scene, bands, shortened), {}
    for s in _TRIED_SCATTERING:
        coefficients = np.full(len(scene.room.materials), s)
        binned = retracer.at(Scattering(scene.room.materials, coefficients))
        times_s = fitted_decay_times_s(measurements, binned, absorption, chosen)
        found[s] = np.array(
            [
                (20.0 + m.jnd[n][0]) * times_s[n][i] / fitted[n][i] - 20.0
                for i, (m, n) in enumerate(zip(misses, worst, strict=True))
            ]
        )
    return found


def decay_findings(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    misses: Sequence[DecayMiss],
    mean_absorption: FloatArray,
    by_eyring: FloatArray,
    by_scattering: dict[float, FloatArray],
) -> tuple[Finding, ...]:
    """Return a finding where the decay that was fitted is not reproduced, and what explains it.

    Parameters
    ----------
    mean_absorption : float array, shape (n_bands,)
        Of the answer, over the area of the room.
    by_eyring : float array, shape (n_bands,)
        Mean absorption by Eyring's formula from the measured decay.
    by_scattering : mapping from scattering coefficient to float array, shape (len(misses),)
        As `decays_by_scattering` returns it.
    """
    if not misses:
        return ()
    bands = measurements.bands
    worst = [max(m.jnd.values(), key=lambda v: abs(v[0]))[0] for m in misses]
    notes = []
    for miss in misses:
        each = (f"{n.split('_')[0]} {5.0 * v:+.0f} %" for n, (v, _) in miss.jnd.items())
        notes.append(
            f"{', '.join(each)}; mean absorption {mean_absorption[miss.band]:.2f}, by Eyring from "
            f"the measured decay {by_eyring[miss.band]:.2f}"
        )
    numbers = [m.band for m in misses]
    specified = ", ".join(k.name for k in priors if k.known is not None or k.specified)
    causes = []
    if max(worst) > 0.0:
        causes.append(
            "Predicted too long: a material, furniture or an opening that absorbs is missing"
            + (f", or the absorption specified of {specified} is too low." if specified else ".")
        )
    if min(worst) < 0.0:
        causes.append(
            f"Predicted too short: the absorption specified of {specified} is too high."
            if specified
            else "Predicted too short: early reflections ask for more absorption than the decay, "
            "as where a material is described in the wrong place, or a source is directional."
        )
    largest = {s: float(np.abs(jnd).max()) for s, jnd in by_scattering.items()}
    best = min(largest, key=lambda s: largest[s], default=None)
    if best is not None and largest[best] < _LARGEST_MISS_JND:
        causes.append(
            f"With a scattering of {best:g} on all walls the same absorption reproduces it."
        )
    elif best is not None:
        tried = ", ".join(f"{s:g}" for s in by_scattering)
        causes.append(f"The same absorption with a scattering of {tried} does not reproduce it.")
    return (
        Finding(
            Code.DECAY_NOT_REPRODUCED,
            About(bands_hz=bands.centres_hz[numbers].tolist()),
            "The decay of the fitted pairs is not reproduced (predicted against measured, mean "
            f"over pairs): {bands_in_words(bands, numbers, notes)}. {' '.join(causes)} No "
            "absorption is called identifiable there.",
            {
                "bands_hz": bands.centres_hz[numbers].tolist(),
                "jnd": [{n: round(v, 2) for n, (v, _) in m.jnd.items()} for m in misses],
                "sd_jnd": [{n: round(sd, 2) for n, (_, sd) in m.jnd.items()} for m in misses],
                "pairs": [m.number for m in misses],
                "mean_absorption": [round(float(mean_absorption[b]), 4) for b in numbers],
                "mean_absorption_by_eyring": [round(float(by_eyring[b]), 4) for b in numbers],
                "jnd_by_scattering": {
                    f"{s:g}": np.round(jnd, 2).tolist() for s, jnd in by_scattering.items()
                },
            },
        ),
    )


def schroeder_findings(bands: Bands, decay_s: FloatArray, volume_m3: float) -> tuple[Finding, ...]:
    """Return a finding for the bands that begin below the Schroeder frequency.

    There single modes are resolved, and energies that add are no model of them: in simulated boxes
    the 95 % intervals of such bands covered the true value less often than those above.

    Parameters
    ----------
    decay_s : float array, shape (n_bands,)
        Reverberation time of each band; NaN where unknown.
    volume_m3 : float
    """
    limit_hz = schroeder_hz(decay_s, volume_m3)
    low = np.flatnonzero(bands.lower_hz < limit_hz)
    if not low.size:
        return ()
    limits = [f"{limit_hz[j]:.0f} Hz" for j in low]
    return (
        Finding(
            Code.BELOW_SCHROEDER_FREQUENCY,
            About(bands_hz=bands.centres_hz[low].tolist()),
            "Part of the band lies below the Schroeder frequency at "
            f"{bands_in_words(bands, low, limits)}: single modes are resolved there, which the "
            "model does not contain. Trust these intervals less.",
            {"bands_hz": bands.centres_hz[low].tolist()},
        ),
    )


def prior_intervals(priors: tuple[MaterialPrior, ...]) -> FloatArray:
    """Return the prior of absorption as its 95 % interval.

    Returns
    -------
    float array, shape (3, n_materials, n_bands)
        Median, lower and upper bound; three times the value where absorption is fixed. A material
        that is tied to another has that one's.
    """
    by_name = {k.name: k for k in priors}
    rows = []
    for prior, mean, sd in zip(priors, *prior_logits(priors), strict=True):
        own = by_name[prior.tied_to or prior.name]
        if own.known is not None:
            rows.append(np.tile(own.known, (3, 1)))
            continue
        free = mean + np.outer((0.0, -Z95, Z95), sd)
        rows.append(own.lower + (own.upper - own.lower) * expit(free))
    return np.stack(rows, axis=1)


def prior_findings(
    bands: Bands, priors: tuple[MaterialPrior, ...], answers: Sequence[BandEstimate]
) -> tuple[Finding, ...]:
    """Return a finding for each material whose answer is nearly the prior that was specified.

    Under the default prior an answer that the data do not determine has a wide interval, which
    needs no finding; a specified prior makes it narrow.
    """
    findings = []
    specified, sds = are_specified(priors), prior_logits(priors)[1]
    for i, own in enumerate(priors):
        if own.known is not None or own.tied_to is not None or not specified[i]:
            continue
        left = np.array([np.sqrt(a.logit_covariance[i, i]) for a in answers]) / sds[i]
        fitted = np.array([a.model != "prior" for a in answers])
        bad = np.flatnonzero(fitted & (left > _PRIOR_DOMINATED))
        if not bad.size:
            continue
        shares = [f"{100 * min(left[j], 1.0):.0f} %" for j in bad]
        findings.append(
            Finding(
                Code.PRIOR_DOMINATED,
                About(materials=[own.name], bands_hz=bands.centres_hz[bad].tolist()),
                f"The absorption of {own.name} is nearly its prior, of whose standard deviation so "
                f"much is left: {bands_in_words(bands, bad, shares)}. The data add next to "
                "nothing; measure pairs whose sound strikes it more often.",
                {
                    "material": own.name,
                    "bands_hz": bands.centres_hz[bad].tolist(),
                    "spread_left": [round(float(left[j]), 3) for j in bad],
                },
            )
        )
    return tuple(findings)


def sampling_findings(bands: Bands, answers: Sequence[BandEstimate]) -> tuple[Finding, ...]:
    """Return a finding for the bands whose samples did not converge."""
    samplings = {
        j: a.sampling
        for j, a in enumerate(answers)
        if a.sampling is not None and not a.sampling.converged
    }
    if not samplings:
        return ()
    bad = list(samplings)
    notes = [
        f"{s.evaluations} evaluations, autocorrelation {s.autocorrelation.max():.0f} steps, "
        f"R-hat {s.r_hat.max():.2f}"
        for s in samplings.values()
    ]
    return (
        Finding(
            Code.SAMPLING_NOT_CONVERGED,
            About(bands_hz=bands.centres_hz[bad].tolist()),
            "The samples of the posterior did not converge within the evaluations allowed: "
            f"{bands_in_words(bands, bad, notes)}. The intervals there are Gaussian.",
            {
                "bands_hz": bands.centres_hz[bad].tolist(),
                "evaluations": [s.evaluations for s in samplings.values()],
                "largest_r_hat": [round(float(s.r_hat.max()), 4) for s in samplings.values()],
            },
        ),
    )


def method_chosen(method: str) -> str:
    """Return what "auto" stands for; every other method is what was asked for."""
    return "least-squares" if method == "auto" else method


def interval_words(answers: Sequence[BandEstimate]) -> str:
    """Return how the intervals were made, in a few words."""
    kinds = {kind for a in answers for kind in a.kinds}
    words = [w for kind, w in (("sampled", "sampled"), ("profile", "profiles")) if kind in kinds]
    if "gaussian" in kinds or not words:
        words.append("Gaussian, local" if not words else "else Gaussian")
    return ", ".join(words)


def reasons(method: str, bands: Bands, answers: Sequence[BandEstimate]) -> tuple[str, ...]:
    """Return sentences on what was chosen and why.

    Parameters
    ----------
    method : str
        As specified: "auto", "least-squares", ...
    """
    sentences = []
    if method == "auto":
        sentences.append(
            "Least squares from the absorption that the decays suggest: it has exact derivatives, "
            "and the other searches compare the same squares."
        )
    tried = [a.starts for a in answers if a.starts is not None]
    if tried:
        sentences.append(
            f"Energies were fitted from {tried[0].number} further random starts in each of "
            f"{len(tried)} bands: {sum(s.agreeing for s in tried)} of "
            f"{sum(s.number for s in tried)} ended within the intervals of the answer."
        )
    proven = [a.certificate.status for a in answers if a.certificate is not None]
    if proven:
        sentences.append(
            f"The global minimum is proven in {proven.count('certified')} of {len(proven)} bands."
        )
    elif method == "auto":
        sentences.append(
            'The global minimum is not proven: method = "certified" does that for energies.'
        )
    kinds = [kind for a in answers for kind in a.kinds if kind in ("profile", "gaussian", "none")]
    if "profile" in kinds:
        sentences.append(
            f"Of {len(kinds)} intervals {sum(len(a.profiles) for a in answers)} are so wide that a "
            f"Gaussian may fail; {kinds.count('profile')} of them were skew and are those of the "
            "profile likelihood."
        )
    if method == "posterior":
        done = [a.sampling for a in answers if a.sampling is not None and a.sampling.converged]
        sentences.append(
            f"Samples converged in {len(done)} of {len(bands)} bands: "
            f"{min(s.effective for s in done):.0f} independent ones or more, R-hat at most "
            f"{max(float(s.r_hat.max()) for s in done):.3f}."
            if done
            else "The samples converged in no band."
        )
    return tuple(sentences)


def check_certifiable(
    measurements: Measurements, settings: Settings, priors: tuple[MaterialPrior, ...]
) -> None:
    """Check that a certificate is asked for only of energies of windows and independent walls.

    Raises
    ------
    InputError
        Pressures or room parameters are to be fitted: they have no bounds over boxes. Or
        materials share a product: the prior is then no sum over materials.
    """
    if settings.method != "certified":
        return
    product = next((k for k in priors if k.product is not None), None)
    if product is not None:
        raise InputError(
            "a certificate exists for materials whose priors are independent only",
            where="identify.method",
            found=f"{product.name} is of the product {product.product!r}",
            hint='leave out the product, or use method = "least-squares"',
        )
    found = []
    if settings.model == "coherent":
        found.append('model = "coherent"')
    if measurements.values:
        found.append("room parameters that are to be fitted")
    if found:
        raise InputError(
            "a certificate exists for energies of windows only",
            where="identify.method",
            found=" and ".join(found),
            needed='impulse responses alone, and model = "energy" or "auto"',
            hint="pressures and room parameters are not monotonic in absorption, so that they "
            'have no bounds over boxes: use method = "least-squares"',
        )
