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
from roomfit.checks.evidence import Evidence
from roomfit.fit.compare import predicted_curve
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.fit.scattering import Retracer
from roomfit.materials.priors import MaterialPrior, uniform_scattering
from roomfit.model.binned import BinnedPaths
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


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding where the decay that was fitted is not reproduced."""
    measured, traced, answers = evidence.measured, evidence.traced, evidence.fits.answers
    settings, absorption = evidence.settings, evidence.absorption
    by_pressures = [b.window_decays_s if b.model == "coherent" else {} for b in answers]
    fitted = [b.model != "prior" for b in answers]
    misses = decay_misses(measured.bands, evidence.pairs, fitted, by_pressures)
    covariance = evidence.logit_covariance
    misses = certain_misses(measured, traced, misses, absorption, covariance, settings)
    if misses:
        by_scattering = {} if settings.quick else _decays_by_scattering(evidence, misses)
        yield _finding(evidence, misses, by_scattering)


class DecayMiss(NamedTuple):
    """The decay of one band that the fitted pairs had and the answer does not have."""

    band: int
    # of each parameter that is missed, the mean over pairs of predicted minus measured, in just
    # noticeable differences (5 %), with the standard deviation of that mean
    jnd: dict[str, tuple[float, float]]
    number: int  # of pairs at most

    @property
    def worst(self) -> str:
        """The parameter that is missed most."""
        return max(self.jnd, key=lambda name: abs(self.jnd[name][0]))


def decay_misses(
    bands: Bands,
    pairs: Sequence[ComparedPair],
    fitted: Sequence[bool],
    by_pressures: Sequence[Mapping[str, FloatArray]] = (),
) -> tuple[DecayMiss, ...]:
    """Return the bands in which T20, T30 or EDT of the fitted pairs is not reproduced.

    Where the mean over pairs of predicted minus measured is 2 just noticeable differences or more,
    and 3 of its standard deviations: by ISO 3382-2:2008, A.1 and A.2 with n = 10 (factors of EDT
    continued by their power of the range), or as observed over three pairs and more. T30 alone does
    not count: its last decibels hang in a room of smooth walls on a few flutter echoes. EDT counts
    over three pairs and more: near a source the direct sound makes it as short as it likes.

    Between smooth, parallel walls pressures do not add as energies do. A band that was fitted by
    pressures is therefore missed only where its own windows, `by_pressures`, miss the same part,
    too: by parameter, measured and fitted values of each file, (2, n_files).
    """
    bandwidth_hz, found = bands.upper_hz - bands.lower_hz, []

    def is_missed(mean: float, sd: float) -> bool:
        return abs(mean) >= max(_LARGEST_MISS_JND, _MISS_SDS * sd)

    for band in np.flatnonzero(fitted).tolist():
        missed, number = {}, 0
        windows = by_pressures[band] if by_pressures else {}
        for name, factor in DECAY_SCATTER.items():
            rows = [p.parameters[name] for p in pairs if p.use == "fit" and name in p.parameters]
            both = np.array([(c.measured[band], c.jnd[band]) for c in rows]).reshape(-1, 2).T
            times_s, jnd = both[:, np.isfinite(both).all(axis=0)]
            if name == "EDT_s" and jnd.size < _FEWEST_FOR_SCATTER:
                continue
            mean, sd = mean_miss(jnd, factor / np.sqrt(bandwidth_hz[band] * times_s))
            if not is_missed(mean, sd):
                continue
            number = max(number, jnd.size)
            if name in windows:
                both = windows[name][:, np.isfinite(windows[name]).all(axis=0)]
                scatter = factor / np.sqrt(bandwidth_hz[band] * both[0])
                if not is_missed(*mean_miss((both[1] / both[0] - 1.0) / 0.05, scatter)):
                    continue
            missed[name] = mean, float(sd)
        if not missed.keys() <= {"T30_s"}:
            found.append(DecayMiss(band, missed, number))
    return tuple(found)


def mean_miss(jnd: FloatArray, scatter: FloatArray) -> tuple[float, float]:
    """Return a mean over pairs, in JND, and its standard deviation, infinite without pairs.

    Shapes: `jnd` and `scatter`, the relative standard deviation by theory, (n_pairs,).
    """
    if not jnd.size:
        return 0.0, np.inf
    sd = float(np.median(scatter)) / 0.05 / np.sqrt(jnd.size)
    if jnd.size >= _FEWEST_FOR_SCATTER:
        sd = max(sd, float(jnd.std(ddof=1)) / np.sqrt(jnd.size))
    return float(jnd.mean()), sd


def _mean_times_s(
    measured: Measurements, binned: BinnedPaths, absorption: FloatArray, chosen: Sequence[int]
) -> dict[str, FloatArray]:
    """Return T20, T30 and EDT that paths predict in some bands, mean over eight fitted pairs."""
    own = list(chosen)
    bands = Bands(measured.bands.kind, measured.bands.centres_hz[own])
    found = [
        room_parameters(predicted_curve(measured.scene, bands, binned, i, absorption[:, own]))
        for i in _drawn_pairs(measured)
    ]
    return {
        name: np.mean([f.of(name) for f in found], axis=0) for name in ("T20_s", "T30_s", "EDT_s")
    }


def _drawn_pairs(measured: Measurements) -> list[int]:
    """Return the pairs whose decay times are averaged: eight of those fitted, or all of fewer."""
    tabulated = {v.pair_name for v in measured.values}
    pairs = {m.pair for m in measured.responses if m.measurement.use == "fit"}
    pairs |= {i for i, name in enumerate(pair_names(measured.scene)) if name in tabulated}
    return sorted(pairs)[:: -(-len(pairs) // _MOST_DRAWN_PAIRS)]


def _resampled(
    measured: Measurements, binned: BinnedPaths, counts: IntArray, chosen: Sequence[int]
) -> BinnedPaths:
    """Return bins with each batch of rays so many times, of the averaged pairs and bands."""
    by_band, pairs = binned.by_band, _drawn_pairs(measured)
    centres_hz = [float(measured.bands.centres_hz[band]) for band in chosen if by_band]
    found = {f: list(by_band[f]) for f in centres_hz} if by_band else {0.0: list(binned.rows)}
    for own in found.values():
        for i in pairs:
            weight = own[i].weight_per_m2 * counts[own[i].batch]
            own[i] = replace(own[i], weight_per_m2=weight)
    if not by_band:
        return BinnedPaths(binned.edges_s, tuple(found[0.0]))
    return BinnedPaths(binned.edges_s, binned.rows, {f: tuple(x) for f, x in found.items()})


def certain_misses(
    measurements: Measurements,
    traced: TracedPaths,
    misses: Sequence[DecayMiss],
    absorption: FloatArray,
    logit_covariance: FloatArray,
    settings: Settings,
) -> tuple[DecayMiss, ...]:
    """Return the misses that are beyond what the answer's own uncertainty does to the decay.

    The late decay of a room of smooth walls hangs on the least absorbing of them, and on few rays.
    Absorptions are drawn from their law and ray batches with replacement, and the spread of the
    mean decay time is added. `logit_covariance` (n_bands, n_materials, n_materials), 0 where fixed.
    """
    if not misses:
        return ()
    chosen, rng = [m.band for m in misses], np.random.default_rng(settings.seed)
    free, n = logit(absorption, 1e-9), max(traced.paths.n_batches, 1)
    drawn = []
    for _ in range(_DECAY_DRAWS):
        trial = np.array(absorption)
        for band in chosen:
            covariance = logit_covariance[band]
            moved = rng.multivariate_normal(
                free[:, band], covariance, method="eigh", check_valid="ignore"
            )
            trial[:, band] = np.where(np.diag(covariance) > 0.0, expit(moved), trial[:, band])
        counts = np.append(rng.multinomial(n, np.full(n, 1.0 / n)), 1)  # batch -1: images
        binned = _resampled(measurements, traced.binned, counts, chosen)
        drawn.append(_mean_times_s(measurements, binned, trial, chosen))
    kept = []
    for i, miss in enumerate(misses):
        jnd = {}
        for name, (mean, sd) in miss.jnd.items():
            times_s = np.array([one[name][i] for one in drawn])
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


def _decays_by_scattering(
    evidence: Evidence, misses: Sequence[DecayMiss]
) -> dict[float, FloatArray]:
    """Return what the same absorption would miss with one scattering on all walls, by coefficient.

    Of the parameter that is missed most in each band, in JND, by few rays of omnidirectional
    sources.
    """
    measured, used, settings = evidence.measured, evidence.traced.settings, evidence.settings
    chosen, absorption = [m.band for m in misses], evidence.absorption
    fitted = _mean_times_s(measured, evidence.traced.binned, absorption, chosen)
    rays = settings.n_scattering_rays, used.receiver_radius_m, settings.seed
    shortened = TraceSettings(
        used.duration_s, n_rays=rays[0], receiver_radius_m=rays[1], seed=rays[2]
    )
    retracer, found = Retracer(measured.scene, measured.bands, shortened), {}
    for s in _TRIED_SCATTERING:
        binned = retracer.at(uniform_scattering(evidence.materials, s))
        times_s = _mean_times_s(measured, binned, absorption, chosen)
        each = [(i, m.worst, m.jnd[m.worst][0]) for i, m in enumerate(misses)]
        ratios = [(20.0 + jnd) * times_s[n][i] / fitted[n][i] for i, n, jnd in each]
        found[s] = np.array(ratios) - 20.0
    return found


def _finding(
    evidence: Evidence, misses: Sequence[DecayMiss], by_scattering: dict[float, FloatArray]
) -> Finding:
    """Return that the decay that was fitted is not reproduced, and what explains it."""
    bands, areas_m2 = evidence.measured.bands, material_areas_m2(evidence.measured.scene.room)
    means, by_eyring = areas_m2 @ evidence.absorption / areas_m2.sum(), evidence.eyring
    notes = []
    for miss in misses:
        each = (f"{n.split('_')[0]} {5.0 * v:+.0f} %" for n, (v, _) in miss.jnd.items())
        notes.append(
            f"{', '.join(each)}; mean absorption {means[miss.band]:.2f}, by Eyring from "
            f"the measured decay {by_eyring[miss.band]:.2f}"
        )
    numbers = [m.band for m in misses]
    bands_hz = bands.centres_hz[numbers].tolist()
    causes = _causes(evidence.priors, [m.jnd[m.worst][0] for m in misses], by_scattering)
    text = (
        "The decay of the fitted pairs is not reproduced (predicted against measured, mean "
        f"over pairs): {bands_in_words(bands, numbers, notes)}. {' '.join(causes)} No "
        "absorption is called identifiable there."
    )
    evidence_of_it = {
        "bands_hz": bands_hz,
        "jnd": [{n: round(v, 2) for n, (v, _) in m.jnd.items()} for m in misses],
        "sd_jnd": [{n: round(sd, 2) for n, (_, sd) in m.jnd.items()} for m in misses],
        "pairs": [m.number for m in misses],
        "mean_absorption": [round(float(means[b]), 4) for b in numbers],
        "mean_absorption_by_eyring": [round(float(by_eyring[b]), 4) for b in numbers],
        "jnd_by_scattering": {f"{s:g}": np.round(x, 2).tolist() for s, x in by_scattering.items()},
    }
    return Finding(Code.DECAY_NOT_REPRODUCED, About(bands_hz=bands_hz), text, evidence_of_it)


def _causes(
    priors: tuple[MaterialPrior, ...],
    worst: Sequence[float],
    by_scattering: Mapping[float, FloatArray],
) -> list[str]:
    """Return sentences on what would make a decay that is missed by so many JND in each band."""
    specified = ", ".join(k.name for k in priors if k.known is not None or k.specified)
    of, causes = f"the absorption specified of {specified} is too", []
    if max(worst) > 0.0:
        long = "Predicted too long: a material, furniture or an opening that absorbs is missing"
        causes.append(f"{long}, or {of} low." if specified else f"{long}.")
    if min(worst) < 0.0:
        causes.append(
            f"Predicted too short: {of} high."
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
