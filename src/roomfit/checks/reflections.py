"""First reflections that stand alone, beside the absorption that was fitted to everything.

A reflection of one wall whose window holds next to nothing else says what that wall returns,
whatever the late decay says. Taken relative to the direct sound of the same file it needs no gain
and no response of the loudspeaker, only its directivity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import Z95
from roomfit.base.typing import FloatArray, IntArray
from roomfit.checks.evidence import Evidence
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.model.binned import rows_at
from roomfit.model.observation import has_data_in_band, timing_sd_s
from roomfit.model.weighing import EnergyRows, first_rows, weigh
from roomfit.signals import filters
from roomfit.signals.measurement import MeasuredPair
from roomfit.tracing.paths import Paths, paths_of_pairs

# Of the energy of a window, as predicted for a wall that absorbs nothing: so that the absorption
# that was fitted does not choose which reflections are looked at.
LEAST_SHARE, _LEAST_DIRECT_SHARE = 0.7, 0.8
# A reflection without loss lies this far above the noise at least, as a factor.
_CLEAR_OF_NOISE = 10.0
# As for windows: `EnergyTerm.model_error`, and the share of the direct sound that rings for 2 ms.
_MODEL_ERROR, _RINGING, _RINGING_S = 0.2, 0.1, 2e-3
# Standard deviation in dB of a source's energy between two directions. One without a directivity is
# taken for omnidirectional, as by the fit, and the finding says what else would explain it.
_DIRECTIVITY_SD_DB = 1.0
# Absorption at the few angles of these reflections differs from the mean over all angles: of one
# measured absorber by .09 to .31 at 45 degrees (docs/decisions/0031-decay-and-reflections.md).
_ANGLE_SD = 0.1
# Of a serious doubt, and of their chi-square: some ten gave .89 (.46 to 1) for a wall of .17.
_FEWEST, _LEVEL = 8, 0.01
_SHOEBOX = ("west", "east", "south", "north", "floor", "ceiling")


def check(evidence: Evidence) -> Iterator[Finding]:
    """Yield a finding for each wall whose reflections contradict its fitted absorption."""
    measured, traced = evidence.measured, evidence.traced
    reflections = isolated_reflections(measured, traced, evidence.absorption)
    returns = wall_returns(reflections, measured, traced.scattering)
    fitted = (evidence.absorption, evidence.lower95, evidence.upper95)
    yield from reflection_findings(returns, measured.bands, evidence.materials, fitted)


class IsolatedReflection(NamedTuple):
    """One first reflection that stands alone in its window, in one band."""

    source: str
    receiver: str
    wall: str  # west, east, south, north, floor or ceiling of a shoebox, else the material
    material: str
    band: int
    # share of the incident energy that comes back specularly, (1 - alpha) (1 - s): energy of the
    # window less all else that is expected in it, over that of the direct sound, spreading, air
    # and directivity removed. Noise and interference may make it negative
    returned: float
    sd: float  # of `returned`: interference, noise, model, ringing; without directivity and angle
    predicted: float  # (1 - alpha) (1 - s) of the absorption that was fitted


class WallReflectance(NamedTuple):
    """What all isolated reflections of one wall say in one band, beside the fit."""

    wall: str
    material: str
    band: int
    number: int
    absorption: float  # from the reflections alone
    sd: float  # of it, directivity and angle included
    has_directivity: bool  # whether that of every source is specified or fitted
    agree: bool  # whether there are 8 or more, which scatter no more than their variances say


def isolated_reflections(
    measured: Measurements, traced: TracedPaths, absorption: FloatArray
) -> tuple[IsolatedReflection, ...]:
    """Return the first reflections that stand alone, with what they and the fit say returns.

    Of every fitted response, in every band: image sources of first order whose window (their
    arrival and `max(1 ms, 1 / B)` plus two standard deviations of its time either side) would hold
    `LEAST_SHARE` of their energy if the wall absorbed nothing, 10 dB clear of the noise. The direct
    sound of the same response must stand alone, too.
    """
    kernel = filters.spreading_kernel(measured.bands)
    found: list[IsolatedReflection] = []
    paths, of_pair = traced.paths, paths_of_pairs(traced.paths)
    for m in measured.responses:
        own = of_pair[m.pair][paths.batch[of_pair[m.pair]] < 0]
        struck = (paths.hits_specular[own] + paths.hits_diffuse[own]).sum(axis=1)
        first = np.append(own[struck == 0], own[struck == 1])  # behind the direct path
        stands = np.count_nonzero(struck == 0) == 1 and first.size > 1
        for band in range(len(measured.bands)) if stands else ():
            if has_data_in_band(m, band):
                found += _isolated(measured, traced, m, absorption, band, kernel, first)
    return tuple(found)


def _isolated(
    measured: Measurements,
    traced: TracedPaths,
    m: MeasuredPair,
    absorption: FloatArray,
    band: int,
    kernel: filters.SpreadingKernel,
    own: IntArray,
) -> list[IsolatedReflection]:
    """Return those of a response's paths that stand alone in a band, the direct sound with them."""
    paths, room = traced.paths, measured.scene.room
    one = Bands(measured.bands.kind, measured.bands.centres_hz[band : band + 1])
    bandwidth_hz = float(filters.statistical_bandwidth_hz(one)[0])
    half_s = max(1e-3, 1.0 / bandwidth_hz) + 2.0 * timing_sd_s(measured.scene, m)
    arrival_s = paths.length_m[own] / speed_of_sound_m_s(measured.scene.air)
    windows = arrival_s[:, None] + np.array([-half_s, half_s])
    # of each path the share that its wall returns, and the energy if it returned all
    material = np.argmax(paths.hits_specular[own] + paths.hits_diffuse[own], axis=1)
    kept = 1.0 - traced.scattering[material, band]
    kept[0] = 1.0
    back = kept * (1.0 - absorption[material, band])
    back[0] = 1.0
    attenuation = float(attenuation_per_m(measured.scene.air, measured.bands)[band])
    arriving = rows_at(traced.binned, float(measured.bands.centres_hz[band]))[m.pair]
    weight = _weights(paths, own, arriving) / np.maximum(kept, 1e-6)
    share = float(filters.energy_share(kernel, band, [0.0], [-half_s, half_s])[0, 0])
    hard = share * weight * np.exp(-attenuation * paths.length_m[own])

    edges, at = np.unique(windows, return_inverse=True)
    at = at.reshape(windows.shape)

    def summed(pieces: FloatArray) -> FloatArray:
        whole = np.concatenate(([0.0], np.cumsum(pieces)))
        return np.asarray(whole[at[:, 1]] - whole[at[:, 0]])

    bins_s = traced.binned.edges_s
    centres_s = 0.5 * (bins_s[1:] + bins_s[:-1])
    n = int(np.searchsorted(centres_s, edges[-1] + filters.spreading_reach_s(kernel, band)))
    alpha, air = absorption[:, band : band + 1], np.array([attenuation])
    energy = weigh(first_rows(arriving, n), alpha, air)[0]
    spreading = filters.spreading_matrix(kernel, band, centres_s[: energy.size], edges)
    others = np.maximum(summed(spreading @ energy) - back * hard, 0.0)
    recorded = summed(filters.window_energies(one, m.response, edges)[0])
    rate_hz = m.response.sampling_rate_hz
    per_second = m.noise.floor[band] * rate_hz**2 / float(filters.energy_bandwidth_hz(one)[0])
    noise = per_second * half_s

    gain = (recorded[0] - noise) / (hard[0] + others[0])
    if gain <= 0.0 or hard[0] < _LEAST_DIRECT_SHARE * (hard[0] + others[0]):
        return []
    end_s = min(traced.settings.duration_s, float(m.noise.usable_end_s[band]))
    clear = (hard >= LEAST_SHARE * (hard + others)) & (gain * hard >= _CLEAR_OF_NOISE * noise)
    clear &= (windows[:, 1] < end_s) & (kept > 0.0)
    clear[0] = False
    returned = ((recorded - noise) / gain - others) / hard
    degrees = 2.0 * half_s * bandwidth_hz
    # by interference, noise and an error of the model, relative to the path without loss
    rest, quiet = others / hard, noise / (gain * hard)
    variance = (2.0 * rest * back + rest**2) / degrees
    variance += (quiet**2 + 2.0 * quiet * (back + rest)) / degrees
    variance += back**2 * (_MODEL_ERROR**2 + 2.0 * rest[0] / degrees)
    late_s = np.maximum(windows - arrival_s[0], 0.0)
    variance += (_RINGING * hard[0] / hard * np.diff(np.exp(-late_s / _RINGING_S))[:, 0]) ** 2
    towards = (paths.departure[own] - paths.arrival[own]).astype(np.float64)
    found = []
    for i in np.flatnonzero(clear):
        name = wall = room.materials[material[i]]
        if room.shoebox_m is not None:  # which the sound turns towards
            axis = int(np.argmax(np.abs(towards[i])))
            wall = _SHOEBOX[2 * axis + int(towards[i, axis] > 0.0)]
        numbers = float(returned[i]), float(np.sqrt(variance[i])), float(back[i])
        found.append(IsolatedReflection(*m.measurement.pair_name[:2], wall, name, band, *numbers))
    return found


def _weights(paths: Paths, own: IntArray, rows: EnergyRows) -> FloatArray:
    """Return the weights of image paths in a band, as its rows have them, with all its factors."""
    weight = paths.weight_per_m2[own]
    if rows.path is not None:
        image = np.flatnonzero(rows.batch < 0)
        of_row = np.intersect1d(rows.path[image], own, assume_unique=True, return_indices=True)
        weight[of_row[2]] = rows.weight_per_m2[image[of_row[1]]]
    return weight


def wall_returns(
    reflections: Sequence[IsolatedReflection], measured: Measurements, scattering: FloatArray
) -> tuple[WallReflectance, ...]:
    """Return the absorption of each wall and band by its isolated reflections, two or more.

    Their mean, weighed by variance, which is raised where they scatter by more than it says; and by
    1 dB for the directivity of each source, and 0.1 for the angles at which the wall is struck.
    """
    known = {s for s, d in measured.directivities.items() if d is not None}
    groups: dict[tuple[str, str, int], list[IsolatedReflection]] = {}
    for r in reflections:
        groups.setdefault((r.wall, r.material, r.band), []).append(r)
    out = []
    for key, own in groups.items():
        if len(own) < 2:
            continue
        values, weight = np.array([r.returned for r in own]), np.array([r.sd**-2.0 for r in own])
        mean = float(values @ weight / weight.sum())
        excess = float(weight @ (values - mean) ** 2) / (len(own) - 1)
        variance = max(excess, 1.0) / float(weight.sum())
        sources = {r.source for r in own}
        # a factor: of the geometric mean of what is measured and predicted
        size = np.log(10.0) / 10.0 * _DIRECTIVITY_SD_DB
        variance += max(mean, 0.0) * own[0].predicted * size**2 / len(sources)
        kept = 1.0 - float(scattering[measured.scene.room.materials.index(key[1]), key[2]])
        sd = float(np.hypot(np.sqrt(variance) / kept, _ANGLE_SD))
        agree = len(own) >= _FEWEST and bool(chdtrc(len(own) - 1, excess * (len(own) - 1)) > _LEVEL)
        out.append(WallReflectance(*key, len(own), 1.0 - mean / kept, sd, sources <= known, agree))
    return tuple(out)


def reflection_findings(
    returns: Sequence[WallReflectance],
    bands: Bands,
    materials: Sequence[str],
    fitted: tuple[FloatArray, FloatArray, FloatArray],
) -> Iterator[Finding]:
    """Yield a finding for each wall whose reflections contradict its fitted absorption.

    Where the 95 % intervals of both lie apart; those of reflections allow for angles and for an
    error of the model that simulated rooms do not have
    (docs/decisions/0031-decay-and-reflections.md). Serious where the directivity of the sources is
    specified or fitted and 8 or more reflections agree, else a warning.

    `fitted`: absorption and its 95 % interval, each of shape (n_materials, n_bands).
    """
    by_wall: dict[tuple[str, str, bool, bool], list[tuple[WallReflectance, list[float]]]] = {}
    for r in returns:
        answer = [float(x[materials.index(r.material), r.band]) for x in fitted]
        if r.absorption - Z95 * r.sd > answer[2] or r.absorption + Z95 * r.sd < answer[1]:
            key = r.wall, r.material, r.has_directivity, r.agree
            by_wall.setdefault(key, []).append((r, answer))
    for (wall, material, known, agree), own in by_wall.items():
        parts, values, off_db = [], [], []
        bands_hz = [float(bands.centres_hz[r.band]) for r, _ in own]
        for r, answer in own:
            reach = r.absorption + r.sd * np.array([0.0, -Z95, Z95])
            early, low, high = np.clip(reach, 0.0, 1.0).tolist()
            parts.append(
                f"{bands.centres_hz[r.band]:g} Hz {early:.2f} ({low:.2f} to {high:.2f}, {r.number} "
                f"of them) against {answer[0]:.2f} ({answer[1]:.2f} to {answer[2]:.2f})"
            )
            kept = np.clip(1.0 - np.array([early, answer[0]]), 0.01, 1.0)
            off_db.append(f"{10.0 * np.log10(kept[0] / kept[1]):+.1f}")
            values.append([round(v, 4) for v in (early, low, high, *answer)])
        advice = (
            "Its absorption is not called identifiable there: the late decay may have outvoted the "
            "reflections, by another scattering, or its absorption depends on the angle."
            if known and agree
            else f"They are fewer than {_FEWEST} or differ from each other: no more than a hint."
            if known
            else "No directivity is specified of some source: one that radiates "
            f"{', '.join(off_db)} dB towards this wall, relative to the receivers, would do the "
            "same. Specify it, or have it fitted, before you trust either."
        )
        name = wall if wall == material else f"{wall} ({material})"
        yield Finding(
            Code.REFLECTION_DISAGREES,
            About(materials=[material], bands_hz=bands_hz),
            f"First reflections from {name} that stand alone contradict the fitted absorption: "
            f"{'; '.join(parts)}. {advice}",
            {
                "wall": wall,
                "material": material,
                "bands_hz": bands_hz,
                "reflections_lower_upper_fitted_lower_upper": values,
                "number": [r.number for r, _ in own],
            },
            graded="serious" if known and agree else "warning",
        )
