"""Bands before the first pass: sources equalised, images found anew where points have moved."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy import fft

from roomfit.base.air import attenuation_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands
from roomfit.base.forks import in_forks
from roomfit.base.typing import FloatArray, IntArray
from roomfit.fit.directivity import (
    DirectivityScore,
    contradicted_sources,
    directivity_score,
    with_fitted_sources,
)
from roomfit.fit.paths import TracedPaths, trim_memory
from roomfit.model.directivity import directed_band, row_bases
from roomfit.model.eyring import schroeder_hz
from roomfit.model.observation import fitted_in_band
from roomfit.pressures.bands import rebuild
from roomfit.pressures.geometry import moved_scene
from roomfit.pressures.response import image_energies, image_paths
from roomfit.pressures.sequential import CoherentBand, forward_pass
from roomfit.pressures.state import State, current_absorption, cut_at, release, vectors
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import Scene
from roomfit.signals.loudspeaker import SourceMagnitude, equalise, power_gain, source_magnitude
from roomfit.signals.measurement import MeasuredPair
from roomfit.signals.response import ImpulseResponse
from roomfit.tracing.paths import Paths, paths_of_pairs

# Bands up to here determine positions within a few millimetres, in spite of hidden images.
_RETRACE_BELOW_HZ = 1000.0
# Bands up to here are those in which a first guess of the walls does not determine the magnitude
# response of a loudspeaker.
_RETRACE_ENERGIES_BELOW_HZ = 250.0
# After the direct sound: how long a response is compared with its image sources.
_COMPARED_S = 0.1
_SCHROEDER_FACTOR = 2.0


def initialise(state: State, traced: TracedPaths) -> State:
    """Return the bands ready to be fitted, paths found anew where positions must have moved."""
    settings, files, retrace = state.settings, state.files, state.retrace
    state = replace(
        state,
        paths=traced.paths,
        weights=traced.factors,
        binned=cut_at(traced.binned, state.late_end_s),
        origin=None,
        each=(),
        starts=(),
        images=None,
    )
    state = rebuild(state)
    coloured = False
    if state.directivity_parameters is None:
        even = _even(state, files, current_absorption(state), _SCHROEDER_FACTOR)
        coloured = any(new is not old for new, old in zip(even, files, strict=True))
        if coloured:
            state = release(replace(state, files=even))
            state = rebuild(state)
    moves = retrace is not None and settings.positions != "fixed"
    if not (moves or coloured) or settings.quick:
        return state
    highest_hz = _RETRACE_BELOW_HZ if moves else _RETRACE_ENERGIES_BELOW_HZ
    low = [
        band if f <= highest_hz else None
        for band, f in zip(state.each, state.bands.centres_hz, strict=True)
    ]
    fits = forward_pass(low, settings, None)
    guess = current_absorption(state, fits)
    known = [f.found for f in fits if f is not None and f.found is not None]
    if retrace is not None and moves and known and state.geometry is not None:
        place, origin = moved_scene(state.scene, state.geometry, known[-1].mean)
        paths, weights, binned = retrace(place)
        binned = cut_at(binned, state.late_end_s)
        moved = {"paths": paths, "weights": weights, "binned": binned, "origin": origin}
        state = replace(state, images=None, **cast(Any, moved))
    state = replace(release(state), first=vectors(fits))
    del low, fits
    if coloured:
        state = replace(state, files=_even(state, files, guess, 0.0))
    return rebuild(state)


def with_sources_examined(state: State, traced: TracedPaths) -> State:
    """Return the bands anew with unknown directivities where energies contradict that of a source.

    Of all sources taken for omnidirectional: a measurement rarely has two kinds. It comes before
    all else is fitted: where a loudspeaker is taken for omnidirectional, positions, scattering and
    the laws of the measurement chain are bent to explain what it does to the levels of reflections.
    """
    if not state.fits_contradicted or state.tested_sources is None:
        return state
    found = contradicted_sources(state.tested_sources, source_scores(state))
    if not found:
        return state
    fitted = with_fitted_sources(state.directivity_parameters, state.tested_sources)
    again = replace(
        state, directivity_parameters=fitted, tested_sources=None, contradicted=found, first=()
    )
    return initialise(again, traced)


def source_scores(state: State) -> dict[int, DirectivityScore]:
    """Return by band what contradicts that sources taken for omnidirectional are."""
    tested = state.tested_sources
    if tested is None:
        return {}
    bases = row_bases(tested, state.scene, state.paths, state.binned)

    def score(band: tuple[int, CoherentBand]) -> DirectivityScore:
        b, own = band
        files = fitted_in_band(state.files, b)
        directivity = directed_band(tested, state.scene, bases, own.coherent.energies, files)
        return directivity_score(own.energies, own.energy_fit, directivity)

    there = [(b, own) for b, own in enumerate(state.each) if own is not None]
    return dict(zip((b for b, _ in there), in_forks(score, there), strict=True))


def _even(
    state: State, files: tuple[MeasuredPair, ...], absorption: FloatArray, factor: float
) -> tuple[MeasuredPair, ...]:
    trim_memory()
    return equalise_sources(
        state.scene, state.bands, files, state.paths, absorption, schroeder_factor=factor
    )


def equalise_sources(
    scene: Scene,
    bands: Bands,
    measured: tuple[MeasuredPair, ...],
    paths: Paths,
    absorption: FloatArray,
    *,
    schroeder_factor: float = _SCHROEDER_FACTOR,
) -> tuple[MeasuredPair, ...]:
    """Return the measurements with the magnitude response of each source divided out.

    Pressures that add depend on how each reflection's pulse looks within the band, and a
    loudspeaker that is 4 dB louder at one end of an octave than at the other changes that for all
    of them. Its magnitude response is what all fitted responses of the source have in common beyond
    those of the image sources; where that is flat a measurement is returned as it is. So are
    measurements of absolute level, whose source is calibrated and equalised already.

    Shapes: `absorption` (n_materials, n_bands).
    """
    fitted = [
        m for m in measured if m.measurement.use == "fit" and m.measurement.level != "absolute"
    ]
    # octave filters begin an octave below the centre, others nearer
    lowest_hz = float(bands.lower_hz[0] ** 2 / bands.exact_centres_hz[0])
    of_pair = paths_of_pairs(paths)

    def magnitude_of(source: str) -> SourceMagnitude:
        own = [m for m in fitted if m.measurement.source == source]
        return source_magnitude(
            [m.response for m in own],
            [_expected(scene, bands, m, paths, of_pair, absorption) for m in own],
            [m.direct_s + _COMPARED_S for m in own],
            lowest_hz,
            schroeder_factor * _median_schroeder_hz(scene, own),
        )

    sources = list(dict.fromkeys(m.measurement.source for m in fitted))
    magnitudes = dict(zip(sources, in_forks(magnitude_of, sources), strict=True))
    out = []
    for m in measured:
        magnitude = magnitudes.get(m.measurement.source)
        if m.measurement.level == "absolute" or magnitude is None or not magnitude.level_db.any():
            out.append(m)
            continue
        gain = power_gain(magnitude, np.asarray(bands.centres_hz))
        noise = replace(m.noise, floor=m.noise.floor * gain, tail_energy=m.noise.tail_energy * gain)
        out.append(replace(m, response=equalise(m.response, magnitude), noise=noise))
    return tuple(out)


def _median_schroeder_hz(scene: Scene, measured: list[MeasuredPair]) -> float:
    """Return the Schroeder frequency by the median of all bands' and responses' decays."""
    constants = np.concatenate([m.noise.tail_time_constant_s for m in measured])
    falling = constants[constants > 0.0]
    decay_s = 6.0 * np.log(10.0) * np.median(falling) if falling.size else 0.0
    return float(schroeder_hz(np.asarray(decay_s), volume_m3(scene.room.mesh)))


def _expected(
    scene: Scene,
    bands: Bands,
    m: MeasuredPair,
    paths: Paths,
    of_pair: list[IntArray],
    absorption: FloatArray,
) -> ImpulseResponse:
    """Return the pressure of the image sources of a pair, on the time axis of its response."""
    rate_hz, n = m.response.sampling_rate_hz, m.response.pressure.size
    weights = _band_weights(bands, fft.rfftfreq(2 * n, 1.0 / rate_hz))
    attenuation = attenuation_per_m(scene.air, bands)
    total = np.zeros(n + 1, dtype=np.complex128)
    c = speed_of_sound_m_s(scene.air)
    last_m = c * (n / rate_hz - m.response.time_zero_s)
    images = image_paths(paths, np.array([m.pair]), 0.0, last_m, of_pair)
    length_m = images.lengths_m()
    at = np.round((length_m / c + m.response.time_zero_s) * rate_hz).astype(np.int64)
    inside = (at >= 0) & (at < n)
    for band, weight in enumerate(weights):
        energy = image_energies(images, np.minimum(absorption[:, band], 1.0))
        roots = np.sqrt(energy * np.exp(-attenuation[band] * length_m))[inside]
        total += weight * fft.rfft(np.bincount(at[inside], roots, n), 2 * n)
    return replace(m.response, pressure=fft.irfft(total, 2 * n)[:n])


def _band_weights(bands: Bands, frequencies_hz: FloatArray) -> FloatArray:
    """Return the weight of each band's absorption at each frequency, (n_bands, n), of sum 1."""
    centres = np.log2(bands.exact_centres_hz)
    octaves = np.clip(np.log2(np.maximum(frequencies_hz, 1.0)), centres[0], centres[-1])
    own = np.eye(len(bands))
    return np.stack([np.interp(octaves, centres, row) for row in own])
