"""What boxes reflect diffusely, by rays of an own tracer in plain numpy, as noise.

Energy is conserved at every hit; random numbers are others than those of `roomfit.tracing`. All
that is not specular is noise whose power in time follows the rays.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roomfit.base.typing import BoolArray, FloatArray
from roomfit.demo.boxes import SyntheticBox, loudspeaker, octave_shares

ECHOGRAM_BIN_S = 0.5e-3
_RADIUS_M = 0.3
_N_RAYS = 100_000
_RAYS_AT_ONCE = 20_000
# Energies are 1/(4 pi r^2) where the square of the pressure is 1/(4 pi r)^2.
PRESSURE_SQUARED = 1.0 / (4.0 * np.pi)


def diffuse_echogram(
    synthetic: SyntheticBox,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    duration_s: float,
    rng: np.random.Generator,
    *,
    n_rays: int = _N_RAYS,
) -> FloatArray:
    """Return the energy that arrives after at least one diffuse reflection, by rays.

    Rays are reflected by the walls and caught by spheres of 0.3 m.

    At each wall a ray is scattered by Lambert's law with probability s and reflected specularly
    otherwise; it keeps ``1 - a`` of its energy in either case, band by band.

    Shape (n_receivers, n_bands, n_bins). Shapes: `scattering` (6,), `receivers_m` (n_receivers, 3).
    """
    n_bins = round(duration_s / ECHOGRAM_BIN_S)
    energy = np.zeros((len(receivers_m), synthetic.absorption.shape[1], n_bins))
    for start in range(0, n_rays, _RAYS_AT_ONCE):
        n = min(_RAYS_AT_ONCE, n_rays - start)
        _add_rays(synthetic, scattering, source_m, receivers_m, n, rng, energy)
    volume = 4.0 / 3.0 * np.pi * _RADIUS_M**3
    return np.asarray(energy / (n_rays * volume))


def _add_rays(
    synthetic: SyntheticBox,
    scattering: FloatArray,
    source_m: FloatArray,
    receivers_m: FloatArray,
    n: int,
    rng: np.random.Generator,
    energy: FloatArray,
) -> None:
    """Add the chords of some rays, times what is left of their energy."""
    lengths = np.array(synthetic.lengths_m)
    rays = _Rays(
        np.tile(np.asarray(source_m, dtype=np.float64), (n, 1)),
        _unit(rng.standard_normal((n, 3))),
        np.ones((n, synthetic.absorption.shape[1])),
        np.zeros(n),
        np.zeros(n, dtype=np.bool_),
    )
    reach = synthetic.speed_of_sound_m_s * energy.shape[2] * ECHOGRAM_BIN_S
    while len(rays.position):
        position, course, left, travelled, diffuse = rays
        with np.errstate(divide="ignore"):
            gap = np.where(course > 0.0, lengths - position, position) / np.abs(course)
        axis = np.argmin(gap, axis=1)
        every = np.arange(len(position))
        flight = np.maximum(gap[every, axis], 0.0)
        _catch(synthetic, receivers_m, rays, flight, energy)
        travelled = travelled + flight
        position = np.clip(position + flight[:, None] * course, 0.0, lengths)
        high = course[every, axis] > 0.0
        wall = 2 * axis + high
        left = left * (1.0 - synthetic.absorption[wall])
        course[every, axis] *= -1.0
        drawn = rng.random(len(position)) < scattering[wall]
        course[drawn] = _lambert(axis[drawn], high[drawn], rng)
        on = travelled < reach
        after = (position, course, left, travelled, diffuse | drawn)
        rays = _Rays(*(column[on] for column in after))


class _Rays(NamedTuple):
    """Rays on their way; the first axis of every array is the ray."""

    position: FloatArray  # (n, 3), m
    course: FloatArray  # (n, 3), unit vectors
    left: FloatArray  # (n, n_bands), share of the energy
    travelled: FloatArray  # (n,), m
    diffuse: BoolArray  # (n,), whether some wall has scattered it


def _catch(
    synthetic: SyntheticBox,
    receivers_m: FloatArray,
    rays: _Rays,
    flight: FloatArray,
    energy: FloatArray,
) -> None:
    """Record the crossings of one flight of every ray that some wall has scattered."""
    n_bins = energy.shape[2]
    for receiver, centre in enumerate(receivers_m):
        way = centre - rays.position
        nearest = np.einsum("ij,ij->i", way, rays.course)
        square = _RADIUS_M**2 - (np.einsum("ij,ij->i", way, way) - nearest**2)
        met = np.flatnonzero(rays.diffuse & (square > 0.0) & (nearest > 0.0) & (nearest < flight))
        arrived = rays.travelled[met] + nearest[met]
        index = (arrived / synthetic.speed_of_sound_m_s / ECHOGRAM_BIN_S).astype(np.int64)
        met, index, arrived = (x[index < n_bins] for x in (met, index, arrived))
        chord = 2.0 * np.sqrt(square[met])
        for band, attenuation in enumerate(synthetic.attenuation_per_m):
            weight = chord * rays.left[met, band] * np.exp(-attenuation * arrived)
            energy[receiver, band] += np.bincount(index, weight, n_bins)


def _lambert(axis: np.ndarray, high: BoolArray, rng: np.random.Generator) -> FloatArray:
    """Draw directions off walls across given axes: a point of the sphere added to the normal."""
    normal = np.zeros((axis.size, 3))
    normal[np.arange(axis.size), axis] = np.where(high, -1.0, 1.0)
    return _unit(normal + _unit(rng.standard_normal((axis.size, 3))))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def specular_box(synthetic: SyntheticBox, scattering: FloatArray) -> SyntheticBox:
    """Return the box whose walls reflect only the specular part, ``(1 - a) (1 - s)``.

    `scattering` has the shape (6,).
    """
    kept = (1.0 - synthetic.absorption) * (1.0 - scattering)[:, None]
    return replace(synthetic, absorption=1.0 - kept)


def modulated_noise(
    echogram: FloatArray,
    n_samples: int,
    sampling_rate_hz: float,
    centres_hz: FloatArray,
    level_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return noise whose power in time follows an echogram, band by band, shape (n_samples,).

    Added to the pressure of the images of `specular_box`, it makes that of walls that scatter. It
    is white before it passes the band shares and the loudspeaker as they do.

    Shapes: `echogram` (n_bands, n_bins), `centres_hz, level_db` (n_bands,).
    """
    times_s = np.arange(n_samples) / sampling_rate_hz
    bins = np.minimum((times_s / ECHOGRAM_BIN_S).astype(int), echogram.shape[1] - 1)
    power = PRESSURE_SQUARED * echogram / (ECHOGRAM_BIN_S * sampling_rate_hz)
    white = rng.standard_normal(n_samples)
    frequencies = np.linspace(0.0, 0.5 * sampling_rate_hz, n_samples + 1)
    spectrum = np.zeros(n_samples + 1, dtype=np.complex128)
    for share, of_band in zip(octave_shares(centres_hz, frequencies), power, strict=True):
        spectrum += share * np.fft.rfft(white * np.sqrt(of_band[bins]), 2 * n_samples)
    spectrum *= loudspeaker(centres_hz, level_db, frequencies)
    return np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])
