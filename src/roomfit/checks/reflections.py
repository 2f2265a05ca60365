"""First reflections that stand alone, beside the absorption that was fitted to everything.

A reflection of one wall whose window holds next to nothing else says what that wall returns,
whatever the late decay says. Taken relative to the direct sound of the same file it needs no gain
and no response of the loudspeaker, only its directivity.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import Z95
from roomfit.base.typing import FloatArray, IntArray
from roomfit.checks.evidence import Evidence, Law
from roomfit.fit.measurements import Measurements
from roomfit.fit.paths import TracedPaths
from roomfit.model.binned import rows_at
from roomfit.model.observation import has_data_in_band, timing_sd_s
from roomfit.model.weighing import EnergyRows, first_rows, weigh
from roomfit.room.scene import Room
from roomfit.signals.filters import (
    SpreadingKernel,
    energy_bandwidth_hz,
    energy_share,
    spreading_kernel,
    spreading_matrix,
    spreading_reach_s,
    statistical_bandwidth_hz,
    window_energies,
)
from roomfit.signals.measurement import MeasuredPair
from roomfit.tracing.paths import Paths, paths_of_pairs

# Of the energy of a window, as predicted for a wall that absorbs nothing: so that the absorption
# that was fitted does not choose which reflections are looked at.
LEAST_SHARE = 0.7
_LEAST_DIRECT_SHARE = 0.8
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
_FEWEST = 2
_SHOEBOX = ("west", "east", "south", "north", "floor", "ceiling")


LAWS = {
    Code.REFLECTION_DISAGREES: Law(
        "isolated first reflections return what the fitted absorption lets them",
        "whether the 95 % intervals of absorption by reflections and by the fit lie apart",
        0.05,  # of one wall and band; 1 in 180 where both intervals are as wide
    )
}


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
    # and directivity removed. Noise and interference may make it negative. Its level re direct
    # with spreading removed is ten times its logarithm
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


def isolated_reflections(
    measured: Measurements, traced: TracedPaths, absorption: FloatArray
) -> tuple[IsolatedReflection, ...]:
    """Return the first reflections that stand alone, with what they and the fit say returns.

    Of every fitted response, in every band: image sources of first order whose window (their
    arrival and `max(1 ms, 1 / B)` plus two standard deviations of its time either side, B the
    band's statistical bandwidth) would hold `LEAST_SHARE` of their energy if the wall absorbed
    nothing, 10 dB clear of the noise. The direct sound of the same response must stand alone, too.

    Parameters
    ----------
    absorption : float array, shape (n_materials, n_bands)
        Of all other paths, and of the prediction.
    """
    kernel = spreading_kernel(measured.bands)
    found: list[IsolatedReflection] = []
    of_pair = paths_of_pairs(traced.paths)
    for m in measured.responses:
        first = _direct_and_first(traced.paths, of_pair[m.pair])
        if first is None:
            continue
        for band in [b for b in range(len(measured.bands)) if has_data_in_band(m, b)]:
            found += _isolated(measured, traced, m, absorption, band, kernel, first)
    return tuple(found)


def _direct_and_first(paths: Paths, own: IntArray) -> tuple[IntArray, IntArray] | None:
    """Return the direct path of a pair's own and the first reflections, and what each struck.

    Shapes (n,) and (n, n_materials); None without either.
    """
    own = own[paths.batch[own] < 0]
    struck = paths.hits_specular[own] + paths.hits_diffuse[own]
    direct, single = (np.flatnonzero(struck.sum(axis=1) == n) for n in (0, 1))
    if direct.size != 1 or not single.size:
        return None
    few = np.concatenate((direct, single))
    return own[few], struck[few]


def _isolated(
    measured: Measurements,
    traced: TracedPaths,
    m: MeasuredPair,
    absorption: FloatArray,
    band: int,
    kernel: SpreadingKernel,
    candidates: tuple[IntArray, IntArray],
) -> list[IsolatedReflection]:
    own, struck = candidates
    scene, paths = measured.scene, traced.paths
    c = speed_of_sound_m_s(scene.air)
    material = np.argmax(struck, axis=1)
    one = Bands(measured.bands.kind, measured.bands.centres_hz[band : band + 1])
    bandwidth_hz = float(statistical_bandwidth_hz(one)[0])
    half_s = max(1e-3, 1.0 / bandwidth_hz) + 2.0 * timing_sd_s(scene, m)
    arrival_s = paths.length_m[own] / c
    windows = np.stack((arrival_s - half_s, arrival_s + half_s), axis=1)
    inside = windows[:, 1] < min(traced.settings.duration_s, float(m.noise.usable_end_s[band]))
    attenuation = float(attenuation_per_m(scene.air, measured.bands)[band])
    # energies without absorption and scattering of the wall itself, (n,), and of all else
    arriving = rows_at(traced.binned, float(measured.bands.centres_hz[band]))[m.pair]
    weight = _weights(paths, own, arriving)
    kept = np.where(struck.sum(axis=1) > 0, 1.0 - traced.scattering[material, band], 1.0)
    share = np.array(
        [energy_share(kernel, band, [t], w)[0, 0] for t, w in zip(arrival_s, windows, strict=True)]
    )
    hard = share * weight / np.maximum(kept, 1e-6) * np.exp(-attenuation * paths.length_m[own])
    expected = np.where(struck.sum(axis=1) > 0, kept * (1.0 - absorption[material, band]), 1.0)
    edges, first = np.unique(windows, return_inverse=True)
    first = first.reshape(windows.shape)

    def summed(pieces: FloatArray) -> FloatArray:
        whole = np.concatenate(([0.0], np.cumsum(pieces)))
        return np.asarray(whole[first[:, 1]] - whole[first[:, 0]])

    bins_s = traced.binned.edges_s
    centres_s = 0.5 * (bins_s[1:] + bins_s[:-1])
    n = int(np.searchsorted(centres_s, edges[-1] + spreading_reach_s(kernel, band)))
    rows = first_rows(arriving, n)
    alpha, air = absorption[:, band : band + 1], np.array([attenuation])
    energy = weigh(rows, alpha, air, derivative=False).energy[0]
    spreading = spreading_matrix(kernel, band, centres_s[: energy.size], edges)
    others = np.maximum(summed(spreading @ energy) - expected * hard, 0.0)
    energy_measured = summed(window_energies(one, m.response, edges)[0])
    rate_hz = m.response.sampling_rate_hz
    per_second = m.noise.floor[band] * rate_hz**2 / (2.0 * float(energy_bandwidth_hz(one)[0]))
    noise = np.full(own.size, per_second * 2.0 * half_s)

    gain = (energy_measured[0] - noise[0]) / (hard[0] + others[0])
    if gain <= 0.0 or hard[0] < _LEAST_DIRECT_SHARE * (hard[0] + others[0]):
        return []
    clear = (hard >= LEAST_SHARE * (hard + others)) & (gain * hard >= _CLEAR_OF_NOISE * noise)
    clear &= inside & (kept > 0.0)
    clear[0] = False
    degrees = bandwidth_hz * 2.0 * half_s
    late_s = np.maximum(windows - arrival_s[0], 0.0)
    rung = _RINGING * hard[0] * -np.diff(np.exp(-late_s / _RINGING_S), axis=1)[:, 0]
    relative = others / hard
    ratio, back = noise / (gain * hard), expected
    variance = (2.0 * relative * back + relative**2) / degrees + (rung / hard) ** 2
    variance += (ratio**2 + 2.0 * ratio * (back + relative)) / degrees
    variance += back**2 * (_MODEL_ERROR**2 + 2.0 * others[0] / hard[0] / degrees)
    returned = ((energy_measured - noise) / gain - others) / hard
    source, receiver = (str(getattr(m.measurement, k)) for k in ("source", "receiver"))
    towards = (paths.departure[own] - paths.arrival[own]).astype(np.float64)
    return [
        IsolatedReflection(
            source,
            receiver,
            _wall(scene.room, towards[i], int(material[i])),
            scene.room.materials[material[i]],
            band,
            float(returned[i]),
            float(np.sqrt(variance[i])),
            float(back[i]),
        )
        for i in np.flatnonzero(clear)
    ]


def _weights(paths: Paths, own: IntArray, rows: EnergyRows) -> FloatArray:
    """Return the weights of image paths in a band, as its rows have them, with all its factors."""
    weight = paths.weight_per_m2[own]
    if rows.path is not None:
        image = np.flatnonzero(rows.batch < 0)
        of_row = np.intersect1d(rows.path[image], own, assume_unique=True, return_indices=True)
        weight[of_row[2]] = rows.weight_per_m2[image[of_row[1]]]
    return weight


def _wall(room: Room, towards: FloatArray, material: int) -> str:
    """Return the name of the wall that a first reflection meets, from its turn towards it."""
    if room.shoebox_m is None:
        return room.materials[material]
    axis = int(np.argmax(np.abs(towards)))
    return _SHOEBOX[2 * axis + int(towards[axis] > 0.0)]


def wall_returns(
    reflections: Sequence[IsolatedReflection], measured: Measurements, scattering: FloatArray
) -> tuple[WallReflectance, ...]:
    """Return the absorption of each wall and band by its isolated reflections, two or more.

    Their mean, weighed by variance, the variance raised where they scatter by more than it says. To
    its standard deviation come 1 dB for the directivity, independent from source to source, and 0.1
    for the angles at which the wall is struck.

    Parameters
    ----------
    scattering : float array, shape (n_materials, n_bands)
    """
    known = {s for s, d in measured.directivities.items() if d is not None}
    groups: dict[tuple[str, str, int], list[IsolatedReflection]] = {}
    for r in reflections:
        groups.setdefault((r.wall, r.material, r.band), []).append(r)
    out = []
    for (wall, material, band), own in groups.items():
        if len(own) < _FEWEST:
            continue
        values = np.array([r.returned for r in own])
        weight = np.array([r.sd**-2.0 for r in own])
        mean = float(values @ weight / weight.sum())
        excess = float(weight @ (values - mean) ** 2) / (len(own) - 1)
        variance = max(excess, 1.0) / float(weight.sum())
        sources = {r.source for r in own}
        # a factor: of the geometric mean of what is measured and predicted
        size = np.log(10.0) / 10.0 * _DIRECTIVITY_SD_DB
        variance += max(mean, 0.0) * own[0].predicted * size**2 / len(sources)
        kept = 1.0 - float(scattering[measured.scene.room.materials.index(material), band])
        sd = float(np.hypot(np.sqrt(variance) / kept, _ANGLE_SD))
        out.append(
            WallReflectance(wall, material, band, len(own), 1.0 - mean / kept, sd, sources <= known)
        )
    return tuple(out)


def reflection_findings(
    returns: Sequence[WallReflectance],
    bands: Bands,
    materials: Sequence[str],
    fitted: tuple[FloatArray, FloatArray, FloatArray],
) -> Iterator[Finding]:
    """Yield a finding for each wall whose reflections contradict its fitted absorption.

    Where the 95 % intervals of both lie apart: by chance less often than once in 20 walls and
    bands, once in 180 where both intervals are as wide. Those of reflections allow for angles and
    for an error of the model that simulated rooms do not have: no right answer was doubted there
    (docs/decisions/0031-decay-and-reflections.md).

    Serious where the directivity of the sources is specified or fitted, else a warning; of a wall
    that has both kinds of bands each is a finding of its own.

    Parameters
    ----------
    fitted : three float arrays, shape (n_materials, n_bands)
        Absorption and its 95 % interval.
    """
    by_wall: dict[tuple[str, str, bool], list[WallReflectance]] = {}
    for r in returns:
        _, lower, upper = (float(x[materials.index(r.material), r.band]) for x in fitted)
        if r.absorption - Z95 * r.sd > upper or r.absorption + Z95 * r.sd < lower:
            by_wall.setdefault((r.wall, r.material, r.has_directivity), []).append(r)
    for own in by_wall.values():
        yield _finding(own, bands, fitted, materials)


def _finding(
    own: Sequence[WallReflectance],
    bands: Bands,
    fitted: tuple[FloatArray, FloatArray, FloatArray],
    names: Sequence[str],
) -> Finding:
    """Return the finding of one wall, over its bands."""
    i, parts, values, off_db = names.index(own[0].material), [], [], []
    for r in own:
        low, high = (float(np.clip(r.absorption + z * r.sd, 0.0, 1.0)) for z in (-Z95, Z95))
        early = float(np.clip(r.absorption, 0.0, 1.0))
        answer = [float(x[i, r.band]) for x in fitted]
        parts.append(
            f"{bands.centres_hz[r.band]:g} Hz {early:.2f} ({low:.2f} to {high:.2f}, {r.number} of "
            f"them) against {answer[0]:.2f} ({answer[1]:.2f} to {answer[2]:.2f})"
        )
        kept = np.clip(1.0 - np.array([early, answer[0]]), 0.01, 1.0)
        off_db.append(f"{10.0 * np.log10(kept[0] / kept[1]):+.1f}")
        values.append([round(v, 4) for v in (early, low, high, *answer)])
    known = own[0].has_directivity
    name = own[0].wall if own[0].wall == own[0].material else f"{own[0].wall} ({own[0].material})"
    advice = (
        "Its absorption is not called identifiable there: the late decay may have outvoted the "
        "reflections, by another scattering, or its absorption depends on the angle."
        if known
        else "No directivity is specified of some source: one that radiates "
        f"{', '.join(off_db)} dB towards this wall, relative to the receivers, would do the same. "
        "Specify it, or have it fitted, before you trust either."
    )
    return Finding(
        Code.REFLECTION_DISAGREES,
        About(materials=[own[0].material], bands_hz=[float(bands.centres_hz[r.band]) for r in own]),
        f"First reflections from {name} that stand alone contradict the fitted absorption: "
        f"{'; '.join(parts)}. {advice}",
        {
            "wall": own[0].wall,
            "material": own[0].material,
            "bands_hz": [float(bands.centres_hz[r.band]) for r in own],
            "reflections_lower_upper_fitted_lower_upper": values,
            "number": [r.number for r in own],
        },
        graded="serious" if known else "warning",
    )
