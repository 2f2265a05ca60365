"""Whether the decay that was fitted is reproduced by the answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.bands import Bands, bands_in_words
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import expit, logit
from roomfit.base.typing import FloatArray, IntArray
from roomfit.checks.evidence import Evidence, Law
from roomfit.fit.compare import predicted_curve
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.fit.scattering import Retracer
from roomfit.materials.priors import MaterialPrior, Scattering
from roomfit.model.binned import BinnedPaths
from roomfit.model.weighing import EnergyRows
from roomfit.result import ComparedPair
from roomfit.room.scene import material_areas_m2, pair_names
from roomfit.settings import Settings
from roomfit.signals.decay import room_parameters
from roomfit.tracing.paths import TraceSettings

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

LAWS = {
    Code.DECAY_NOT_REPRODUCED: Law(
        "the answer reproduces the mean decay of the fitted pairs",
        "mean over pairs of predicted minus measured T20 or EDT: 2 JND and more, and 3 of its "
        "standard deviations by interference, by the answer's uncertainty and by rays",
        0.05,  # of six bands together
    )
}


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the decay that was fitted is not reproduced."""
    measured, traced, answers = evidence.measured, evidence.traced, evidence.fits.answers
    settings, absorption = evidence.settings, evidence.absorption
    by_pressures = [b.window_decays_s if b.model == "coherent" else {} for b in answers]
    fitted = [b.model != "prior" for b in answers]
    misses = decay_misses(measured.bands, evidence.pairs, fitted, by_pressures)
    misses = certain_misses(
        measured, traced, misses, absorption, evidence.logit_covariance, settings
    )
    if misses:
        areas_m2 = material_areas_m2(measured.scene.room)
        mean = areas_m2 @ absorption / areas_m2.sum()
        tried = () if settings.quick else misses
        by_scattering = decays_by_scattering(measured, traced, absorption, settings, tried)
        yield decay_finding(measured, evidence.priors, misses, mean, evidence.eyring, by_scattering)


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
    smooth walls on a few flutter echoes. EDT counts over three pairs and more: near a source the
    direct sound makes it as short as it likes, which the theory of its scatter leaves out.

    Between smooth, parallel walls pressures do not add as energies do: by energies the right
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
            if name == "EDT_s" and jnd.size < _FEWEST_FOR_SCATTER:
                continue
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
    found = [
        room_parameters(predicted_curve(scene, bands, binned, i, absorption[:, own]))
        for i in _drawn_pairs(measurements)
    ]
    return {
        name: np.mean([f.of(name) for f in found], axis=0) for name in ("T20_s", "T30_s", "EDT_s")
    }


def _drawn_pairs(measurements: Measurements) -> list[int]:
    """Return the pairs whose decay times are averaged: eight of those fitted, or all of fewer."""
    tabulated = {v.pair_name for v in measurements.values}
    pairs = {m.pair for m in measurements.responses if m.measurement.use == "fit"} | {
        i for i, name in enumerate(pair_names(measurements.scene)) if name in tabulated
    }
    return sorted(pairs)[:: -(-len(pairs) // _MOST_DRAWN_PAIRS)]


def _resampled(
    measurements: Measurements, binned: BinnedPaths, counts: IntArray, chosen: Sequence[int]
) -> BinnedPaths:
    """Return bins with each batch of rays so many times, of the pairs and bands that are averaged.

    The others stay as they are: all together would be as large as the paths.
    """
    pairs = _drawn_pairs(measurements)

    def those(rows: tuple[EnergyRows, ...]) -> tuple[EnergyRows, ...]:
        own = list(rows)
        for i in pairs:
            weight = rows[i].weight_per_m2 * counts[rows[i].batch]
            own[i] = replace(rows[i], weight_per_m2=weight)
        return tuple(own)

    if not binned.by_band:
        return BinnedPaths(binned.edges_s, those(binned.rows))
    centres_hz = [float(measurements.bands.centres_hz[band]) for band in chosen]
    by_band = {f: those(binned.by_band[f]) for f in centres_hz}
    return BinnedPaths(binned.edges_s, binned.rows, by_band)


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
        binned = _resampled(measurements, traced.binned, counts, chosen)
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


def decay_finding(
    measurements: Measurements,
    priors: tuple[MaterialPrior, ...],
    misses: Sequence[DecayMiss],
    mean_absorption: FloatArray,
    by_eyring: FloatArray,
    by_scattering: dict[float, FloatArray],
) -> Finding:
    """Return that the decay that was fitted is not reproduced, and what explains it.

    Parameters
    ----------
    mean_absorption : float array, shape (n_bands,)
        Of the answer, over the area of the room.
    by_eyring : float array, shape (n_bands,)
        Mean absorption by Eyring's formula from the measured decay.
    by_scattering : mapping from scattering coefficient to float array, shape (len(misses),)
        As `decays_by_scattering` returns it.
    """
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
    causes = _causes(priors, worst, by_scattering)
    return Finding(
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
    )


def _causes(
    priors: tuple[MaterialPrior, ...],
    worst: Sequence[float],
    by_scattering: Mapping[float, FloatArray],
) -> list[str]:
    """Return sentences on what would make a decay that is missed by so many JND in each band."""
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
    return causes
