"""Predicted decays: a room traced as far as needed, and the numbers of every pair with noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.cache import Cache
from roomfit.eyring import eyring_time_s
from roomfit.findings import About, Code, Finding
from roomfit.geometry.mesh import surface_area_m2, volume_m3
from roomfit.inversion.compare import predicted_curve
from roomfit.inversion.scattering import band_factors, specified_scattering
from roomfit.inversion.trace_plan import cached_trace, plan_trace
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.objective.room_parameters import predicted_values, scatter_parts, value_terms
from roomfit.response.binned import BinnedPaths, bin_paths, rows_at
from roomfit.response.directivity import known_directivities
from roomfit.response.energy import (
    EnergyRows,
    regrouped_rows,
    rows_in_air,
    weigh_points,
    window_of_rows,
)
from roomfit.scene import (
    Scene,
    distances_m,
    material_areas_m2,
    pair_names,
    pair_states,
    select_pairs,
)
from roomfit.settings import Settings
from roomfit.signals.decay import (
    FIT_RANGES_DB,
    DecayCurve,
    decay_curve_db,
    echogram_decay_curve,
    room_parameters,
)
from roomfit.signals.iso3382 import (
    VALUE_NAMES,
    MeasuredValues,
    value_gradients,
    values_of_bins,
)
from roomfit.signals.speech import (
    SPEECH_BANDS_HZ,
    modulation_gradients,
    modulation_transfer,
    speech_transmission,
    sti_gradients,
    sti_missing,
    transfer_of_bins,
)
from roomfit.typing import BoolArray, FloatArray, IntArray, Progress, part
from roomfit.uncertainty.posterior import AbsorptionPosterior

# T30 is read from 5 to 35 dB below the start of the decay.
_NEEDED_DB = 36.0
_ATTEMPTS = 4
_LONGER = 1.5
_LONGEST_S = 30.0


def follow_decay(
    scene: Scene,
    known: AbsorptionPosterior,
    absorption: FloatArray,
    measured_decay_s: float,
    settings: Settings,
    cache: Cache | None,
    progress: Progress | None,
) -> tuple[BinnedPaths, tuple[object, ...], tuple[Finding, ...]]:
    """Trace until every band of every pair has fallen by 36 dB, in up to four attempts.

    How long is estimated from Eyring's formula and the measured decay, the longer of both; where
    walls differ much, sound between the hard ones lasts longer still, and the trace is repeated.

    Parameters
    ----------
    known : AbsorptionPosterior
        Bands, scattering and directivities.
    absorption : float array, shape (n_materials, n_bands)
    measured_decay_s : float
        Longest measured reverberation time, 0 where none is known.

    Returns
    -------
    binned : BinnedPaths
    weighed_by : tuple
        What, besides scene and bands, decides them: key of what is kept of them.
    findings : tuple of Finding
    """
    bands, directivities = known.bands, known.directivities or {}
    priors = _scattering_priors(known)
    longest_s = max(measured_decay_s, float(scene_decay_s(scene, bands, absorption).max()))
    found: list[Finding] = []
    for attempt in range(_ATTEMPTS):
        plan = plan_trace(scene, priors, min(longest_s, _LONGEST_S), 0.0, settings)
        done = part(progress, attempt / _ATTEMPTS, (attempt + 1) / _ATTEMPTS)
        traced = cached_trace(scene, plan.settings, plan.scattering, cache, done)
        found += traced.findings
        paths = traced.value.paths
        scattering = specified_scattering(priors, plan.scattering.coefficients, len(bands))
        factors, degenerate = band_factors(directivities, scene, bands, paths, scattering)
        binned = bin_paths(scene, bands, paths, plan.settings.duration_s, factors)
        short = _short_bands(scene, bands, binned, absorption)
        if not short or longest_s >= _LONGEST_S:
            break
        longest_s *= _LONGER
    if progress is not None:
        progress(1.0)
    weighed_by = (plan.settings, scattering, known_directivities(directivities, scene.sources))
    doubts = (*plan.findings, *traced.value.findings, *found, *degenerate)
    return binned, weighed_by, (*doubts, *_short_finding(bands, short))


def scene_decay_s(scene: Scene, bands: Bands, absorption: FloatArray) -> FloatArray:
    """Return the reverberation time of a scene by Eyring's formula in every band, (n_bands,)."""
    mesh = scene.room.mesh
    state = int(pair_states(scene)[0]) if len(scene.pairs) else 0
    areas = material_areas_m2(scene.room, state)
    mean = np.maximum(areas @ absorption / areas.sum(), 1e-4)
    room = (volume_m3(mesh), surface_area_m2(mesh), speed_of_sound_m_s(scene.air))
    return eyring_time_s(mean, *room, attenuation_per_m(scene.air, bands))


def _scattering_priors(known: AbsorptionPosterior) -> tuple[MaterialPrior, ...]:
    """Return priors that hold nothing but the scattering, as the plan of a trace reads them."""
    n = len(known.bands)
    rows = np.full((len(known.materials), n), np.nan)
    if known.scattering is not None:
        rows = known.scattering
    return tuple(
        replace(unknown_material(name, n), scattering=None if np.isnan(row).any() else row)
        for name, row in zip(known.materials, rows, strict=True)
    )


def _short_bands(
    scene: Scene, bands: Bands, binned: BinnedPaths, absorption: FloatArray
) -> Sequence[int]:
    """Return the bands in which the decay of some pair is not followed far enough."""
    attenuation = attenuation_per_m(scene.air, bands)
    direct_s = distances_m(scene) / speed_of_sound_m_s(scene.air)
    usable_db = np.array(
        [
            predicted_curve(bands, binned, i, absorption, attenuation, float(t)).usable_db
            for i, t in enumerate(direct_s)
        ]
    )
    return [int(j) for j in np.flatnonzero(usable_db.min(axis=0) < _NEEDED_DB)]


def _short_finding(bands: Bands, short: Sequence[int]) -> tuple[Finding, ...]:
    if not short:
        return ()
    centres = [float(bands.centres_hz[j]) for j in short]
    return (
        Finding(
            Code.DECAY_NOT_FOLLOWED,
            About(bands_hz=centres),
            f"The trace does not follow the decay over 35 dB at "
            f"{', '.join(f'{f:g}' for f in centres)} Hz: T30 is not predicted there. Some walls "
            "absorb next to nothing.",
            {"bands_hz": centres},
        ),
    )


# Differences between absorptions are read from so many rows, in bins of a millisecond.
_ROWS_OF_A_DRAW, _ROWS_OF_A_CASE = 5_000, 600
# What comes after this fall of the decay is extrapolated.
_FOLLOWED_DB = 55.0
_BINS_TOGETHER = 10
_PICTURE_POINTS = 160
_LOWEST_DB = -200.0
# Times are compared by their ratio, all else by the difference.
RELATIVE: BoolArray = np.array([name in FIT_RANGES_DB for name in VALUE_NAMES])


@dataclass(frozen=True, slots=True, eq=False)
class PredictedDecay:
    """Decay curves in dB relative to the whole energy, shape (n_bands, n_times)."""

    time_s: FloatArray  # (n_times,), after emission
    predicted_db: FloatArray
    lower_db: FloatArray  # 95 % of the draws of absorption lie between these two
    upper_db: FloatArray
    measured_db: FloatArray | None = None  # NaN beyond its usable part
    before_db: FloatArray | None = None  # before a change of materials


@dataclass(frozen=True, slots=True, eq=False)
class PairNumbers:
    """Predictions for one pair, names in the order of `VALUE_NAMES`."""

    values: FloatArray  # (n_names, n_bands); NaN where the decay is not followed far enough
    draws: FloatArray  # (n_draws, n_names, n_bands), under each draw of the absorption
    noise_sd: FloatArray  # (n_names, n_bands), of interfering reflections and the number of rays
    decay: PredictedDecay
    # (n_names, n_bands), variance of the noise that no change of walls alters, of pressures beside
    # their energies and of the number of rays; after a change, covariance with the noise before
    common_noise: FloatArray
    # the speech transmission index as one name in one band, where the bands give it
    sti: PairNumbers | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FewRows:
    """Paths of one pair, fewer and in wide bins: for differences between many absorptions."""

    edges_s: FloatArray  # (n_bins + 1,)
    direct_s: float
    by_band: tuple[EnergyRows, ...]  # with the air in their weights


# By band the absorptions that were weighed last, (n_points, n_materials), and what they gave: room
# parameters (n_points, n_names) and modulation transfers. Of a slider that moves, one band is new.
LatestBands = dict[int, tuple[FloatArray, FloatArray, FloatArray]]


def few_rows(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    absorption: FloatArray,
    most: int | None = None,
) -> FewRows:
    """Return few rows of one pair, for absorptions near and far from one.

    5,000 of 290,000 tell a change of T30 by 45 just noticeable differences within a quarter of one.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
    most : int, optional
        At most about so many; left out, 5,000, or more for rooms of many materials.
    """
    most = max(_ROWS_OF_A_DRAW, _ROWS_OF_A_CASE * (len(absorption) + 2)) if most is None else most
    edges_s = np.append(binned.edges_s[:-1][::_BINS_TOGETHER], binned.edges_s[-1])
    first = np.arange(0, binned.edges_s.size - 1, _BINS_TOGETHER)
    attenuation = attenuation_per_m(scene.air, bands)
    rows = [
        _few(
            rows_in_air(regrouped_rows(rows_at(binned, f)[pair], first), float(attenuation[band])),
            absorption[:, band],
            most,
        )
        for band, f in enumerate(bands.centres_hz)
    ]
    direct_s = float(distances_m(scene)[pair] / speed_of_sound_m_s(scene.air))
    return FewRows(edges_s, direct_s, tuple(rows))


def _few(rows: EnergyRows, absorption: FloatArray, most: int) -> EnergyRows:
    """Return few rows that bring the energies of all of them in several cases.

    The cases are an absorption, each of its walls changed, and all of them. In every stretch of ten
    bins rows are drawn with the largest share that they have of the energy in any case, and are
    weighed accordingly; then weights move as little as it takes to bring the energies of all rows.

    Notes
    -----
    Systematic sampling with unequal probabilities, and the regression estimator: J.-C. Deville,
    C.-E. Sarndal, "Calibration estimators in survey sampling", J. Am. Stat. Assoc. 87, 376-382
    (1992).
    """
    if len(rows) <= most:
        return rows
    far = np.where(absorption < 0.4, 0.6, 0.15)
    cases = np.vstack(
        [absorption, np.where(np.eye(len(far), dtype=np.bool_), far, absorption), far]
    )
    energy = np.exp(rows.hits @ np.log(np.maximum(1.0 - cases.T, 1e-9)))
    energy *= rows.weight_per_m2[:, None]
    after = np.cumsum(energy[::-1], axis=0)[::-1]
    is_low = np.all(after < 10.0 ** (-0.1 * _FOLLOWED_DB) * after[0], axis=1)
    last = int(window_of_rows(rows)[np.argmax(is_low)]) if is_low.any() else rows.n_windows
    ends = rows.offsets[np.append(np.arange(0, last, _BINS_TOGETHER), last)]
    weight, n_each = np.zeros(len(rows)), most / (ends.size - 1)
    for begin, end in pairwise(ends.tolist()):
        total = energy[begin:end].sum(axis=0)
        share = energy[begin:end] * np.divide(1.0, total, out=0.0 * total, where=total > 0.0)
        size = share.max(axis=1, initial=0.0)
        chance = np.zeros(size.size)
        for _ in range(4):  # what is certain leaves more for the others
            is_sure, left = chance >= 1.0, max(n_each - np.sum(chance >= 1.0), 1.0)
            rest = np.where(is_sure, 0.0, size)
            chance = np.where(is_sure, 1.0, left * rest / max(rest.sum(), 1e-300))
        chance = np.minimum(chance, 1.0)
        taken = np.diff(np.floor(np.cumsum(chance) + 0.5), prepend=0.0) > 0.0
        z, c = share[taken], 1.0 / chance[taken]
        shift = np.linalg.lstsq(z.T @ (c[:, None] * z), (total > 0.0) - c @ z, rcond=1e-6)[0]
        weight[begin:end][taken] = c * np.clip(1.0 + z @ shift, 0.2, 5.0)
    kept = np.flatnonzero(weight)
    counts = np.bincount(window_of_rows(rows)[kept], minlength=rows.n_windows)
    return EnergyRows(
        rows.materials,
        rows.n_windows,
        np.concatenate(([0], np.cumsum(counts))),
        rows.weight_per_m2[kept] * weight[kept],
        rows.hits[kept],
        rows.length_m[kept],
        rows.batch[kept],
    )


def few_energies(few: FewRows, absorptions: FloatArray) -> FloatArray:
    """Return the energies of a pair under several absorptions, (n_points, n_bands, n_bins).

    Parameters
    ----------
    absorptions : float array, shape (n_points, n_materials, n_bands)
    """
    own = [_band_energies(rows, absorptions[:, :, b]) for b, rows in enumerate(few.by_band)]
    return np.stack(own, axis=1)


def _band_energies(rows: EnergyRows, absorptions: FloatArray) -> FloatArray:
    energies = weigh_points(rows, absorptions)
    # a wall that absorbs all leaves later bins empty: too little to matter, but not nothing
    return np.asarray(np.maximum(energies, 1e-30 * energies.sum(axis=1, keepdims=True)))


def few_values(few: FewRows, energies: FloatArray) -> FloatArray:
    """Return the room parameters of such energies, shape (n_points, n_names, n_bands)."""
    bands = zip(few.by_band, energies.transpose(1, 0, 2), strict=True)
    return np.stack([_band_values(few, rows, own) for rows, own in bands], axis=2)


def _band_values(few: FewRows, rows: EnergyRows, energies: FloatArray) -> FloatArray:
    n = int(np.searchsorted(rows.offsets, len(rows)))  # bins with a row
    own = np.ascontiguousarray(energies[:, :n])
    return values_of_bins(own, np.ones(1), few.edges_s[: n + 1], few.direct_s)


def _latest_values(
    few: FewRows, absorptions: FloatArray, latest: LatestBands, *, with_transfer: bool
) -> tuple[FloatArray, FloatArray]:
    """Return `few_values` and modulation transfers, of bands that have not changed from memory.

    Returns
    -------
    values : float array, shape (n_points, n_names, n_bands)
    transfer : float array, shape (n_points, n_bands, 14)
        Or (n_points, n_bands, 0) where it is not wanted.
    """
    found = []
    for band, rows in enumerate(few.by_band):
        own, known = absorptions[:, :, band].copy(), latest.get(band)
        if known is None or not np.array_equal(known[0], own):
            energies = _band_energies(rows, own)
            transfer = np.empty((len(own), 0))
            if with_transfer:
                transfer = transfer_of_bins(energies, few.edges_s)
            known = latest[band] = (own, _band_values(few, rows, energies), transfer)
        found.append(known)
    return np.stack([f[1] for f in found], axis=2), np.stack([f[2] for f in found], axis=1)


def few_sti(
    few: FewRows,
    bands: Bands,
    energies: FloatArray,
    values: FloatArray,
    speech_db: FloatArray | None,
) -> FloatArray:
    """Return the speech transmission index of such energies, (n_points,); NaN in other bands.

    Parameters
    ----------
    bands : Bands
        Of the energies.
    values : float array, shape (n_points, n_names, n_bands)
        From `few_values`.
    speech_db : float array, shape (2, 7), optional
        As of `roomfit.predict`.
    """
    if sti_missing(bands):
        return np.full(len(energies), np.nan)
    at = speech_bands(bands)
    transfer = transfer_of_bins(energies[:, at], few.edges_s)
    return speech_transmission(transfer, levels_at_listener(speech_db, values[:, -1, at]))


def moved_sti(before: PairNumbers, there: FloatArray, base: FloatArray) -> FloatArray:
    """Return the index before, carried over by the difference, (n,); NaN where it has none.

    Parameters
    ----------
    there, base : float arrays, shape (n,) and any that fits
        From `few_sti`.
    """
    index = np.nan if before.sti is None else before.sti.values[0, 0]
    return np.asarray(np.clip(index + there - base, 0.0, 1.0))


def moved(values: FloatArray, there: FloatArray, base: FloatArray) -> FloatArray:
    """Return values carried over from one absorption to others as few rows tell.

    Times by their ratio, all else by the difference. Shapes (..., n_names, n_bands).
    """
    ratio = np.divide(there, base, out=np.ones_like(there), where=base != 0.0)
    return np.asarray(np.where(RELATIVE[:, None], values * ratio, values + (there - base)))


def pair_numbers(
    scene: Scene,
    bands: Bands,
    binned: BinnedPaths,
    pair: int,
    few: FewRows,
    absorption: FloatArray,
    draws: FloatArray,
    speech_db: FloatArray | None = None,
) -> PairNumbers:
    """Return the predictions for one pair of the scene.

    Parameters
    ----------
    few : FewRows
        Of the pair, for the draws.
    absorption : float array, shape (n_materials, n_bands)
    draws : float array, shape (n_draws, n_materials, n_bands)
    speech_db : float array, shape (2, 7), optional
        As of `roomfit.predict`.
    """
    alone = select_pairs(scene, slice(pair, pair + 1))
    bands_of = {f: (rows[pair],) for f, rows in binned.by_band.items()}
    own = BinnedPaths(binned.edges_s, (binned.rows[pair],), bands_of)
    attenuation = attenuation_per_m(scene.air, bands)
    curve = predicted_curve(bands, own, 0, absorption, attenuation, few.direct_s)
    values = np.vstack(
        [
            room_parameters(curve).values,
            predicted_values(alone, bands, own, absorption, ("G_dB",))[0],
        ]
    )
    times = np.linspace(0.0, float(curve.time_s[-1]), _PICTURE_POINTS)
    energies = few_energies(few, np.stack([absorption, *draws]))
    found = few_values(few, energies)
    shapes = np.stack(
        [
            levels_at(echogram_decay_curve(bands, energy, few.edges_s, few.direct_s), times)
            for energy in energies
        ]
    )
    decay_db = levels_at(curve, times)
    low, high = np.quantile(shapes[1:] - shapes[0], (0.025, 0.975), axis=0)
    drawn = moved(values, found[1:], found[0])
    decay = PredictedDecay(times, decay_db, decay_db + low, decay_db + high)
    if sti_missing(bands):
        noise_sd, common = _noise(alone, bands, own, absorption, None)
        return PairNumbers(values, drawn, noise_sd[:-1], decay, common[:-1])
    speech = speech_bands(bands)
    transfer = modulation_transfer(curve)[speech]
    levels_db = levels_at_listener(speech_db, values[-1, speech])
    index = speech_transmission(transfer, levels_db)
    of_draws = few_sti(few, bands, energies, found, speech_db)
    by_transfer, by_level = np.zeros((len(bands), len(transfer[0]))), np.zeros(len(bands))
    by_transfer[speech], by_level[speech] = sti_gradients(transfer, levels_db)
    weights = np.column_stack([by_transfer, by_level])
    noise_sd, common = _noise(alone, bands, own, absorption, weights)
    # bands scatter by themselves; one trace serves all
    sti = PairNumbers(
        index.reshape(1, 1),
        np.clip(index + of_draws[1:] - of_draws[0], 0.0, 1.0).reshape(-1, 1, 1),
        np.sqrt(np.sum(noise_sd[-1] ** 2, keepdims=True))[:, None],
        decay,
        common[-1:].sum(keepdims=True),
    )
    return PairNumbers(values, drawn, noise_sd[:-1], decay, common[:-1], sti)


def speech_bands(bands: Bands) -> IntArray:
    """Return where the octaves from 125 Hz to 8 kHz stand among bands that have them, (7,)."""
    return np.searchsorted(bands.centres_hz, SPEECH_BANDS_HZ)


def levels_at_listener(speech_db: FloatArray | None, strength_db: FloatArray) -> FloatArray | None:
    """Return levels of speech and noise where the strength G is known, shape (..., 2, 7).

    Parameters
    ----------
    speech_db : float array, shape (2, 7), or None
        Speech at 1 m in the free field, 20 dB above what G refers to, and noise at the listener.
    strength_db : float array, shape (..., 7)
    """
    if speech_db is None:
        return None
    speech = speech_db[0] - 20.0 + strength_db
    return np.stack([speech, np.broadcast_to(speech_db[1], speech.shape)], axis=-2)


def changed_numbers(
    before: PairNumbers,
    few: FewRows,
    bands: Bands,
    absorptions: FloatArray,
    base: tuple[FloatArray, FloatArray],
    speech_db: FloatArray | None,
    latest: LatestBands,
) -> PairNumbers:
    """Return the predictions for one pair after its walls have changed, in milliseconds.

    Carried over from those before by what fewer paths tell, as draws are: for times by their ratio,
    for all else by the difference. Interference goes with the number of its independent parts: the
    standard deviation of a time as its square root, see `value_covariances`; those of C50, C80, G
    and the speech transmission index stay, and that of D50 follows C50. The picture of the decay is
    that before.

    Parameters
    ----------
    absorptions : float array, shape (1 + n_draws, n_materials, n_bands)
        The most likely one first.
    base : tuple of float arrays, shapes (n_names, n_bands) and ()
        `few_values` and `few_sti` at the absorption of `before`.
    speech_db : float array, shape (2, 7), optional
        As of `roomfit.predict`.
    latest : dict
        What was weighed last; changed.
    """
    sti = before.sti
    there, transfer = _latest_values(few, absorptions, latest, with_transfer=sti is not None)
    values = moved(before.values, there, base[0])
    noise_sd, d50 = before.noise_sd.copy(), VALUE_NAMES.index("D50_percent")
    times = [*np.flatnonzero(RELATIVE), VALUE_NAMES.index("TS_ms")]
    with np.errstate(divide="ignore", invalid="ignore"):  # unknown values
        ratio = values[0] / before.values
        noise_sd[times] *= np.sqrt(ratio[times])
        noise_sd[d50] *= ratio[d50] * (100.0 - values[0, d50]) / (100.0 - before.values[d50])
    if sti is not None:
        at = speech_bands(bands)
        levels_db = levels_at_listener(speech_db, there[:, -1, at])
        index = moved_sti(before, speech_transmission(transfer[:, at], levels_db), base[1])
        sti = replace(sti, values=index[:1, None], draws=index[1:, None, None])
    return PairNumbers(values[0], values[1:], noise_sd, before.decay, before.common_noise, sti)


def levels_at(curve: DecayCurve, times: FloatArray) -> FloatArray:
    """Return a decay curve in dB at given times, -200 at least; shape (n_bands, n_times)."""
    levels = np.maximum(decay_curve_db(curve), _LOWEST_DB)
    return np.stack([np.interp(times, curve.time_s, row) for row in levels])


def _noise(
    alone: Scene,
    bands: Bands,
    own: BinnedPaths,
    absorption: FloatArray,
    weights: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Return by how much values scatter though the absorption is known, (n_names + 1, n_bands).

    And the part of the variance that is common to other absorptions, see `PairNumbers`.

    Last stands the weighted sum of modulation transfers and level, zero without `weights`.

    Parameters
    ----------
    weights : float array, shape (n_bands, 14 + 1), or None
    """
    source, receiver = alone.pairs[0]
    sd = np.zeros((len(VALUE_NAMES) + 1, len(bands)))
    common = np.zeros_like(sd)
    for band in range(len(bands)):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        chosen = absorption[:, band : band + 1]
        expected = predicted_values(alone, one, own, chosen)[0]
        as_measured = MeasuredValues(
            alone.sources[source].name,
            alone.receivers[receiver].name,
            one.centres_hz,
            dict(zip(VALUE_NAMES, expected, strict=True)),
            state=pair_names(alone)[0][2],
        )
        (term,) = value_terms(alone, one, (as_measured,), own)
        if term is None or term.observations[0].names != VALUE_NAMES:
            sd[:, band] = np.nan
            continue
        read = partial(_read, None if weights is None else weights[band])
        _, interference, added, tracing = scatter_parts(term, 0, chosen[:, 0], read)
        steady = added**2 + np.diag(tracing)
        sd[: added.size, band] = np.sqrt(np.diag(interference) + steady)
        common[: added.size, band] = steady
    return sd, common


def _read(
    weights: FloatArray | None, curve: DecayCurve, *, derivative: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return the values of a band and their derivatives; below them the weighted sum, if any."""
    values, gradients = value_gradients(curve, 0, VALUE_NAMES, derivative=derivative)
    if weights is None:
        return values, gradients
    transfer, by_energy = modulation_gradients(curve, 0)
    together = float(weights[:-1] @ transfer + weights[-1] * values[-1])
    if derivative:
        row = weights[:-1] @ by_energy + weights[-1] * gradients[-1]
        gradients = np.vstack([gradients, row])
    return np.append(values, together), gradients
