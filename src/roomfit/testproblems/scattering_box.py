"""Impulse responses of a box whose walls scatter, from a road that shares nothing with the model.

What is reflected specularly all the way comes from image sources that add as pressures. All else is
noise whose power in time follows rays of an own tracer, in plain numpy: walls of a box only, energy
conserved at every hit, other seeds and other random numbers than those of `roomfit.tracing`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import bands_between
from roomfit.files.store import write_text_atomically
from roomfit.testproblems.measured_box import (
    SAMPLING_RATE_HZ,
    BoxPlan,
    MeasuredBox,
    campaign_text,
)
from roomfit.testproblems.pressure_box import (
    BoxTruth,
    add_noise,
    loudspeaker,
    octave_shares,
    pressure_response,
)
from roomfit.typing import BoolArray, FloatArray, Progress

_DURATION_S = 0.8
_BIN_S = 0.5e-3
_RADIUS_M = 0.3
_N_RAYS = 100_000
_RAYS_AT_ONCE = 20_000
# Energies are 1/(4 pi r^2) where the square of the pressure is 1/(4 pi r)^2.
_PRESSURE_SQUARED = 1.0 / (4.0 * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseEchogram:
    """Energy that arrives after at least one diffuse reflection.

    Attributes
    ----------
    energy : float array, shape (n_receivers, n_bands, n_bins)
        In each bin, 1/m2 for a source of unit power.
    bin_s : float
    """

    energy: FloatArray
    bin_s: float


def diffuse_echogram(
    truth: BoxTruth,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    rng: np.random.Generator,
    *,
    n_rays: int = _N_RAYS,
) -> DiffuseEchogram:
    """Follow rays that the walls of a box reflect, and note which cross spheres of 0.3 m.

    At each wall a ray goes on by Lambert's law with probability s and like a ball otherwise; it
    keeps ``1 - a`` of its energy in either case, band by band.

    Parameters
    ----------
    scattering : float array, shape (6,)
        Of the walls in the order of `truth`.
    receivers_m : float array, shape (n_receivers, 3)
        0.3 m or more from every wall.
    """
    n_bins = round(duration_s / _BIN_S)
    energy = np.zeros((len(receivers_m), truth.absorption.shape[1], n_bins))
    for start in range(0, n_rays, _RAYS_AT_ONCE):
        n = min(_RAYS_AT_ONCE, n_rays - start)
        _add_rays(truth, scattering, source_m, receivers_m, n, rng, energy)
    volume = 4.0 / 3.0 * np.pi * _RADIUS_M**3
    return DiffuseEchogram(energy / (n_rays * volume), _BIN_S)


def _add_rays(
    truth: BoxTruth,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    n: int,
    rng: np.random.Generator,
    energy: FloatArray,
) -> None:
    """Add the chords of some rays, times what is left of their energy."""
    lengths = np.array(truth.lengths_m)
    place = np.tile(np.asarray(source_m, dtype=np.float64), (n, 1))
    course = _unit(rng.standard_normal((n, 3)))
    left = np.ones((n, truth.absorption.shape[1]))
    travelled, diffuse = np.zeros(n), np.zeros(n, dtype=np.bool_)
    reach = truth.speed_of_sound_m_s * energy.shape[2] * _BIN_S
    while len(place):
        with np.errstate(divide="ignore"):
            gap = np.where(course > 0.0, lengths - place, place) / np.abs(course)
        axis = np.argmin(gap, axis=1)
        every = np.arange(len(place))
        flight = np.maximum(gap[every, axis], 0.0)
        _catch(truth, receivers_m, place, course, flight, travelled, left, diffuse, energy)
        travelled = travelled + flight
        place = np.clip(place + flight[:, None] * course, 0.0, lengths)
        high = course[every, axis] > 0.0
        wall = 2 * axis + high
        left = left * (1.0 - truth.absorption[wall])
        course[every, axis] *= -1.0
        drawn = rng.random(len(place)) < scattering[wall]
        course[drawn] = _lambert(axis[drawn], high[drawn], rng)
        diffuse = diffuse | drawn
        on = travelled < reach
        place, course, left = place[on], course[on], left[on]
        travelled, diffuse = travelled[on], diffuse[on]


def _catch(
    truth: BoxTruth,
    receivers_m: FloatArray,
    place: FloatArray,
    course: FloatArray,
    flight: FloatArray,
    travelled: FloatArray,
    left: FloatArray,
    diffuse: BoolArray,
    energy: FloatArray,
) -> None:
    """Note the crossings of one flight of every ray that some wall has scattered."""
    n_bins = energy.shape[2]
    for receiver, centre in enumerate(receivers_m):
        way = centre - place
        nearest = np.einsum("ij,ij->i", way, course)
        square = _RADIUS_M**2 - (np.einsum("ij,ij->i", way, way) - nearest**2)
        met = np.flatnonzero(diffuse & (square > 0.0) & (nearest > 0.0) & (nearest < flight))
        arrived = travelled[met] + nearest[met]
        index = (arrived / truth.speed_of_sound_m_s / _BIN_S).astype(np.int64)
        met, index, arrived = (x[index < n_bins] for x in (met, index, arrived))
        chord = 2.0 * np.sqrt(square[met])
        for band, attenuation in enumerate(truth.attenuation_per_m):
            weight = chord * left[met, band] * np.exp(-attenuation * arrived)
            energy[receiver, band] += np.bincount(index, weight, n_bins)


def _lambert(axis: np.ndarray, high: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Draw directions off walls across given axes: a point of the sphere added to the normal."""
    normal = np.zeros((axis.size, 3))
    normal[np.arange(axis.size), axis] = np.where(high, -1.0, 1.0)
    return _unit(normal + _unit(rng.standard_normal((axis.size, 3))))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def scattered_response(
    truth: BoxTruth,
    scattering: FloatArray,
    source_m: FloatArray,
    receiver_m: FloatArray,
    echogram: FloatArray,
    duration_s: float,
    sampling_rate_hz: float,
    level_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the sound pressure at the receiver: thinned image sources and modulated noise.

    Each image keeps ``1 - s`` of its energy at every wall. The noise is white, its power follows
    the echogram of each band, and both pass the same band shares and the same loudspeaker.

    Parameters
    ----------
    scattering : float array, shape (6,)
    echogram : float array, shape (n_bands, n_bins)
        Of this receiver, from `diffuse_echogram`.
    duration_s, sampling_rate_hz, level_db
        As for `pressure_response`.
    """
    kept = (1.0 - truth.absorption) * (1.0 - scattering)[:, None]
    specular = pressure_response(
        *(replace(truth, absorption=1.0 - kept), source_m, receiver_m),
        *(duration_s, sampling_rate_hz, level_db),
    )
    noise = modulated_noise(
        *(echogram, _BIN_S, specular.size, sampling_rate_hz, truth.centres_hz, level_db, rng)
    )
    return np.asarray(specular + noise)


def modulated_noise(
    echogram: FloatArray,
    bin_s: float,
    n_samples: int,
    sampling_rate_hz: float,
    centres_hz: FloatArray,
    level_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return noise whose power in time follows an echogram, band by band, shape (n_samples,).

    Parameters
    ----------
    echogram : float array, shape (n_bands, n_bins)
        Energy of each bin, 1/m2 for a source of unit power.
    bin_s : float
    centres_hz, level_db : float arrays, shape (n_bands,)
        As for `pressure_response`.
    """
    times_s = np.arange(n_samples) / sampling_rate_hz
    bins = np.minimum((times_s / bin_s).astype(int), echogram.shape[1] - 1)
    power = _PRESSURE_SQUARED * echogram / (bin_s * sampling_rate_hz)
    white = rng.standard_normal(n_samples)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(n_samples + 1, dtype=np.complex128)
    for share, of_band in zip(octave_shares(centres_hz, frequencies), power, strict=True):
        spectrum += share * np.fft.rfft(white * np.sqrt(of_band[bins]), 2 * n_samples)
    spectrum *= loudspeaker(centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])


def write_scattering_box(
    plan: BoxPlan,
    scattering: FloatArray,
    folder: Path,
    rng: np.random.Generator,
    *,
    told: str = "0.0",
    position_error_m: float = 0.01,
    noise_db: float = -60.0,
    n_rays: int = _N_RAYS,
    progress: Progress | None = None,
) -> MeasuredBox:
    """Simulate measured responses of a box whose walls scatter and write them as a campaign.

    Parameters
    ----------
    scattering : float array, shape (6,)
        Of west, east, south, north, floor and ceiling, the same in every octave.
    told : str
        What the campaign says of every wall's scattering, as written there.
    folder, rng, position_error_m, noise_db
        As for `write_measured_box`.
    n_rays : int
        A source.
    """
    import soundfile

    bands, air = bands_between("octave", 63, 8000), Air()
    attenuation, c = attenuation_per_m(air, bands), speed_of_sound_m_s(air)
    truth = BoxTruth(plan.lengths_m, bands.centres_hz, plan.absorption, attenuation, c)
    true_at = {
        name: np.array(place) + position_error_m * rng.standard_normal(3)
        for name, place in (*plan.sources_m.items(), *plan.receivers_m.items())
    }
    receivers = np.array([true_at[r] for r in plan.receivers_m])
    for number, s in enumerate(plan.sources_m):
        level_db = rng.normal(0.0, 3.0, len(bands))
        echogram = diffuse_echogram(
            *(truth, scattering, true_at[s], receivers, _DURATION_S, rng), n_rays=n_rays
        )
        for receiver, r in enumerate(plan.receivers_m):
            pressure = scattered_response(
                *(truth, scattering, true_at[s], true_at[r], echogram.energy[receiver]),
                *(_DURATION_S, SAMPLING_RATE_HZ, level_db, rng),
            )
            samples = add_noise(pressure, noise_db, rng).astype(np.float32)
            file = folder / f"{s}_{r}.wav"
            soundfile.write(file, samples, int(SAMPLING_RATE_HZ), subtype="FLOAT")
        if progress is not None:
            progress((number + 1) / len(plan.sources_m))
    pairs = [(s, r) for s in plan.sources_m for r in plan.receivers_m]
    text = campaign_text(plan, pairs, position_error_m, scattering=told)
    campaign = write_text_atomically(folder / "campaign.toml", text)
    return MeasuredBox(campaign, plan.materials, bands.centres_hz, plan.absorption)
