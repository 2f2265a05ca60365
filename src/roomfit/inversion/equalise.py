"""Measurements with the colour of their loudspeakers taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from roomfit.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import Bands
from roomfit.geometry.mesh import volume_m3
from roomfit.measurement import MeasuredPair
from roomfit.response.coherent import image_energies, image_paths
from roomfit.scene import Scene
from roomfit.signals.loudspeaker import SourceMagnitude, equalise, power_gain, source_magnitude
from roomfit.signals.response import ImpulseResponse
from roomfit.tracing.paths import Paths
from roomfit.typing import FloatArray

# So long after the direct sound a response is compared with its image sources.
_DIRECT_SOUND_S = 0.1
SCHROEDER_FACTOR = 2.0


def equalise_sources(
    scene: Scene,
    bands: Bands,
    measured: tuple[MeasuredPair, ...],
    paths: Paths,
    absorption: FloatArray,
    *,
    schroeder_factor: float = SCHROEDER_FACTOR,
) -> tuple[MeasuredPair, ...]:
    """Return the measurements as sources without colour would have given them.

    Pressures that add depend on how each reflection's pulse looks within the band, and a
    loudspeaker that is 4 dB louder at one end of an octave than at the other changes that for all
    of them. Its colour is what all fitted files of the source have in common beyond what the image
    sources say; where that is nothing a measurement is returned as it is. Measurements of absolute
    level stay as they are: their loudspeaker is known, and taken out already.

    Parameters
    ----------
    measured : tuple of MeasuredPair
    paths : Paths
        With image sources.
    absorption : float array, shape (n_materials, n_bands)
        A first guess.
    schroeder_factor : float
        Schroeder frequencies up to which the guess is not trusted, since single modes stand out; 0
        where pressures have told the absorption of the lowest bands.
    """
    fitted = [
        m for m in measured if m.measurement.use == "fit" and m.measurement.level != "absolute"
    ]
    # octave filters begin an octave below the centre, others nearer
    lowest_hz = float(bands.lower_hz[0] ** 2 / bands.exact_centres_hz[0])
    colours: dict[str, SourceMagnitude] = {}
    for source in dict.fromkeys(m.measurement.source for m in fitted):
        own = [m for m in fitted if m.measurement.source == source]
        colours[source] = source_magnitude(
            [m.response for m in own],
            [_expected(scene, bands, m, paths, absorption) for m in own],
            [m.direct_s + _DIRECT_SOUND_S for m in own],
            lowest_hz,
            schroeder_factor * _schroeder_hz(scene, own),
        )
    return tuple(
        _without(m, colours[m.measurement.source], bands)
        if m.measurement.source in colours
        and m.measurement.level != "absolute"
        and np.any(colours[m.measurement.source].level_db)
        else m
        for m in measured
    )


def _schroeder_hz(scene: Scene, measured: list[MeasuredPair]) -> float:
    """Return ``2000 (T / V) ** 0.5`` by the median of all bands' and files' decays."""
    constants = np.concatenate([m.noise.tail_time_constant_s for m in measured])
    falling = constants[constants > 0.0]
    decay_s = 6.0 * np.log(10.0) * float(np.median(falling)) if falling.size else 0.0
    return 2000.0 * float(np.sqrt(decay_s / volume_m3(scene.room.mesh)))


def _expected(
    scene: Scene, bands: Bands, m: MeasuredPair, paths: Paths, absorption: FloatArray
) -> ImpulseResponse:
    """Return the pressure by the image sources of a pair, on the clock of its response."""
    rate_hz, n = m.response.sampling_rate_hz, m.response.pressure.size
    shares = _band_shares(bands, fft.rfftfreq(2 * n, 1.0 / rate_hz))
    attenuation = attenuation_per_m(scene.air, bands)
    total = np.zeros(n + 1, dtype=np.complex128)
    c = speed_of_sound_m_s(scene.air)
    images = image_paths(paths, np.array([m.pair]), 0.0, c * (n / rate_hz - m.response.time_zero_s))
    length_m = np.linalg.norm(images.image_to_receiver_m, axis=1)
    at = np.round((length_m / c + m.response.time_zero_s) * rate_hz).astype(np.int64)
    inside = (at >= 0) & (at < n)
    for band, share in enumerate(shares):
        energy = image_energies(images, np.minimum(absorption[:, band], 1.0))
        roots = np.sqrt(energy * np.exp(-attenuation[band] * length_m))[inside]
        total += share * fft.rfft(np.bincount(at[inside], roots, n), 2 * n)
    return replace(m.response, pressure=fft.irfft(total, 2 * n)[:n])


def _band_shares(bands: Bands, frequencies_hz: FloatArray) -> FloatArray:
    """Return how much each band's absorption has a say at each frequency, adding to one."""
    centres = np.log2(bands.exact_centres_hz)
    octaves = np.clip(np.log2(np.maximum(frequencies_hz, 1.0)), centres[0], centres[-1])
    own = np.eye(len(bands))
    return np.stack([np.interp(octaves, centres, row) for row in own])


def _without(m: MeasuredPair, colour: SourceMagnitude, bands: Bands) -> MeasuredPair:
    gain = power_gain(colour, np.asarray(bands.centres_hz))
    noise = replace(m.noise, floor=m.noise.floor * gain, tail_energy=m.noise.tail_energy * gain)
    return replace(m, response=equalise(m.response, colour), noise=noise)
