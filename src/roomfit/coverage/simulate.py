"""Synthetic recordings of a room whose absorption is known, simulated independently of the fit.

Boxes whose walls are smooth and rooms that are convex: pressures of an own enumeration of image
sources. Boxes that scatter: these, thinned, and noise that an own tracer of rays modulates. All
else: a trace of roomfit's with other seeds, whose image sources add as pressures and whose rays
fill with Gaussian noise. Responses are then recorded as by a measuring chain, and tables of room
parameters derived from them; both are written as files that a campaign names.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import Bands
from roomfit.base.cache import write_text_atomically
from roomfit.base.table import Table, csv_of
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.coverage.synthetic_room import CoveragePlan, SyntheticRoom
from roomfit.demo.boxes import (
    ECHOGRAM_BIN_S,
    PRESSURE_SQUARED,
    SyntheticBox,
    diffuse_echogram,
    loudspeaker,
    modulated_noise,
    octave_shares,
    pressure_response,
    spectrum_of_impulses,
    specular_box,
)
from roomfit.demo.polyhedra import SyntheticPolyhedron, convex_cells, pressure_responses
from roomfit.files.campaign import Campaign, MeasuredTable
from roomfit.files.iso3382 import NAMES
from roomfit.files.responses.recordings import ResponseSpec
from roomfit.fit.traced_room import coherent_paths
from roomfit.model.eyring import eyring_time_s
from roomfit.model.patterns import Pattern, UnknownDirectivity
from roomfit.room.mesh import surface_area_m2, volume_m3
from roomfit.room.scene import Scene, material_areas_m2
from roomfit.settings import Settings
from roomfit.signals.decay import PARAMETER_NAMES, decay_curve, room_parameters
from roomfit.signals.filters import filter_pressure
from roomfit.signals.iso3382 import ValueName
from roomfit.signals.response import ImpulseResponse, padded
from roomfit.tracing.paths import Paths, hits

_OVERSAMPLING = 8
_NOTHING = 1e-30
Pair = tuple[str, str]
Pressures = dict[Pair, FloatArray]
"""After an impulse at time 0, (n_samples,): a unit source's direct sound is 1 / (4 pi r)."""


def traced_pressures(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pairs: tuple[Pair, ...],
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> Pressures:
    """Return the pressure of every pair after an impulse at time 0.

    Image sources are followed as far as the fit's own, with another enumeration for moved points;
    rays are others, and three times as many. What rays bring is Gaussian noise with their energy.
    """
    sources = [s.name for s in synthetic.sources]
    receivers = [r.name for r in synthetic.receivers]
    index = np.array([(sources.index(s), receivers.index(r)) for s, r in pairs])
    air = replace(plan.campaign.air, speed_of_sound_m_s=synthetic.speed_of_sound_m_s)
    scene = Scene(plan.room, synthetic.sources, synthetic.receivers, index, air)
    priors = tuple(
        replace(k, scattering=row, fit_scattering=False)
        for k, row in zip(plan.priors, synthetic.scattering, strict=True)
    )
    own_rays = Settings(seed=int(rng.integers(2**62)))
    bands = plan.campaign.bands
    drawn = {name: Pattern(np.tile(b, (len(bands), 1))) for name, b in synthetic.b.items()}
    directivities = {**plan.directivities, **drawn}
    paths, factors = coherent_paths(scene, bands, priors, directivities, duration_s, own_rays)
    energy = _energies(plan, synthetic, paths, factors)
    times_s = paths.length_m / synthetic.speed_of_sound_m_s + hits(paths) @ synthetic.delays_s
    images = paths.batch < 0
    found = {}
    for number, pair in enumerate(pairs):
        own = (paths.pair == number) & (times_s < duration_s)
        found[pair] = _pressure(
            plan, times_s, energy, own, images, round(duration_s * rate_hz), rate_hz, rng
        )
    return found


def _energies(
    plan: CoveragePlan, synthetic: SyntheticRoom, paths: Paths, factors: FloatArray | None
) -> FloatArray:
    """Return the energy of every path in every band of the grid, 1/m2, shape (n_grid, n_paths)."""
    struck = hits(paths).astype(np.float64)
    attenuation = attenuation_per_m(plan.campaign.air, plan.grid)
    out: FloatArray = np.empty((len(plan.grid), len(paths)))
    for band, near in enumerate(plan.nearest):
        left = np.log(np.maximum(1.0 - synthetic.absorption[:, band], _NOTHING))
        lost = struck @ left - attenuation[band] * paths.length_m
        out[band] = paths.weight_per_m2 * np.exp(lost)
        if factors is not None:
            out[band] *= factors[near]
    return out


def _pressure(
    plan: CoveragePlan,
    times_s: FloatArray,
    energy: FloatArray,
    own: BoolArray,
    images: BoolArray,
    n_samples: int,
    rate_hz: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the pressure of one pair: its image paths as impulses, its rays as noise."""
    mirrored, caught = np.flatnonzero(own & images), np.flatnonzero(own & ~images)
    amplitudes, centres_hz = np.sqrt(PRESSURE_SQUARED * energy[:, mirrored]), plan.grid.centres_hz
    spectrum = spectrum_of_impulses(
        times_s[mirrored], amplitudes.__getitem__, centres_hz, n_samples, rate_hz, _OVERSAMPLING
    )
    specular = np.asarray(np.fft.irfft(spectrum, 2 * n_samples)[:n_samples])
    if not caught.size:
        return specular
    n_bins = int(np.ceil(n_samples / rate_hz / ECHOGRAM_BIN_S)) + 1
    bins = (times_s[caught] / ECHOGRAM_BIN_S).astype(np.int64)
    echogram = np.array([np.bincount(bins, row, n_bins) for row in energy[:, caught]])
    flat = np.zeros(len(plan.grid))
    return np.asarray(
        specular + modulated_noise(echogram, n_samples, rate_hz, centres_hz, flat, rng)
    )


BOX, SCATTERING_BOX = "images of a box", "images and scattered noise of a box"
CONVEX, TRACED = "images of a convex room", "another trace"
# Image sources of one pair at most; files of rooms that ring longer are cut there.
_MOST_IMAGES = {BOX: 1_500_000, SCATTERING_BOX: 1_000_000, CONVEX: 40_000, TRACED: np.inf}
_SHORTEST_S, _LONGEST_S = 0.3, 3.0
# Specular decays of boxes last up to 1.7 times as long as Eyring's.
_LONGER_THAN_EYRING = 1.4
# Spheres that catch the own tracer's rays.
_CLEAR_OF_WALLS_M = 0.3


def synthetic_sound(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pairs: tuple[Pair, ...],
    rate_hz: float,
    rng: np.random.Generator,
) -> tuple[str, Pressures]:
    """Return how the sound of all pairs was simulated, and its pressures.

    They last until the slowest band has fallen to its noise, as long as the recordings at most,
    and as long as their image sources can be enumerated.
    """
    synthesis = synthesis_of(plan, synthetic)
    duration_s = _duration_s(plan, synthetic, synthesis)
    if synthesis == TRACED:
        found = traced_pressures(plan, synthetic, pairs, duration_s, rate_hz, rng)
    elif synthesis == CONVEX:
        found = _convex(plan, synthetic, pairs, duration_s, rate_hz)
    else:
        found = _box(plan, synthetic, pairs, duration_s, rate_hz, rng)
    return synthesis, found


def synthesis_of(plan: CoveragePlan, synthetic: SyntheticRoom) -> str:
    """Return how the sound of a room is simulated."""
    known = [plan.directivities.get(s.name) for s in synthetic.sources]
    first_order = all(d is None or isinstance(d, Pattern | UnknownDirectivity) for d in known)
    even = first_order and not any(d is not None for d in known)
    smooth = not np.any(synthetic.scattering)
    if plan.room.shoebox_m is not None:
        if smooth and first_order:
            return BOX
        lengths = np.array(plan.room.shoebox_m)
        clear = all(
            np.min(np.minimum(p.position_m, lengths - p.position_m)) > _CLEAR_OF_WALLS_M
            for p in synthetic.receivers
        )
        return SCATTERING_BOX if even and clear else TRACED
    convex = smooth and even and convex_cells(plan.room) is not None
    return CONVEX if convex else TRACED


def _duration_s(plan: CoveragePlan, synthetic: SyntheticRoom, synthesis: str) -> float:
    """Eyring's time of the slowest fitted band, down to its noise."""
    areas = material_areas_m2(plan.room)
    mean = (areas @ synthetic.absorption / areas.sum())[plan.columns]
    m = attenuation_per_m(plan.campaign.air, plan.campaign.bands)
    volume = volume_m3(plan.room.mesh)
    surface, c = surface_area_m2(plan.room.mesh), synthetic.speed_of_sound_m_s
    t60_s = eyring_time_s(mean, volume, surface, c, m)
    ratio_db = float(plan.snr_db.max(initial=60.0)) + 10.0
    wanted_s = _LONGER_THAN_EYRING * float(t60_s.max()) * ratio_db / 60.0
    reach_m = (0.75 / np.pi * volume * _MOST_IMAGES[synthesis]) ** (1.0 / 3.0)
    longest_s = min(_LONGEST_S, plan.length_s, reach_m / synthetic.speed_of_sound_m_s)
    return float(min(max(wanted_s, _SHORTEST_S), longest_s))


def _box(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pairs: tuple[Pair, ...],
    duration_s: float,
    rate_hz: float,
    rng: np.random.Generator,
) -> Pressures:
    owner = plan.room.surface_material
    lengths = plan.room.shoebox_m
    assert lengths is not None  # noqa: S101 - `synthesis_of` says that it is a box
    box = SyntheticBox(
        lengths,
        plan.grid.centres_hz,
        synthetic.absorption[owner],
        attenuation_per_m(plan.campaign.air, plan.grid),
        synthetic.speed_of_sound_m_s,
        tuple(synthetic.delays_s[owner].tolist()),
    )
    scattering = synthetic.scattering.mean(axis=1)[owner]
    at = {p.name: p.position_m for p in synthetic.receivers}
    flat: FloatArray = np.zeros(len(plan.grid))
    found = {}
    for source in synthetic.sources:
        start_m, own = source.position_m, [r for s, r in pairs if s == source.name]
        if not np.any(scattering):
            known = plan.directivities.get(source.name)
            b = known.b if isinstance(known, Pattern) else synthetic.b.get(source.name)
            for r in own:
                found[source.name, r] = pressure_response(
                    box, start_m, at[r], duration_s, rate_hz, flat, b
                )
        elif own:
            receivers_m = np.array([at[r] for r in own])
            echo = diffuse_echogram(box, scattering, start_m, receivers_m, duration_s, rng)
            smooth = specular_box(box, scattering)
            for r, energy in zip(own, echo, strict=True):
                specular = pressure_response(smooth, start_m, at[r], duration_s, rate_hz, flat)
                found[source.name, r] = specular + modulated_noise(
                    energy, specular.size, rate_hz, box.centres_hz, flat, rng
                )
    return found


def _convex(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pairs: tuple[Pair, ...],
    duration_s: float,
    rate_hz: float,
) -> Pressures:
    cells = convex_cells(plan.room)
    assert cells is not None  # noqa: S101 - `synthesis_of` says that it is convex
    room = SyntheticPolyhedron(
        cells,
        plan.grid.centres_hz,
        synthetic.absorption,
        attenuation_per_m(plan.campaign.air, plan.grid),
        synthetic.speed_of_sound_m_s,
        tuple(synthetic.delays_s.tolist()),
    )
    at = {p.name: p.position_m for p in synthetic.receivers}
    found = {}
    for source in synthetic.sources:
        own = [r for s, r in pairs if s == source.name]
        if own:
            receivers_m = np.array([at[r] for r in own])
            pressures = pressure_responses(
                room, source.position_m, receivers_m, duration_s, rate_hz, np.zeros(len(plan.grid))
            )
            found.update({(source.name, r): p for r, p in zip(own, pressures, strict=True)})
    return found


_WRITTEN: dict[ValueName, str] = {name: key for key, name in NAMES.items()}
_PAD_S = 0.05


def synthetic_table(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pressures: Pressures,
    rate_hz: float,
    rng: np.random.Generator,
) -> str:
    """Return a table of the same pairs, parameters and stated spreads as the user's.

    Values come from the synthetic responses by roomfit's own analysis, in the fitted bands; to each
    an error of its stated spread is added. Where a response does not hold a parameter the cell
    stays empty.
    """
    bands = plan.campaign.bands
    rows = []

    def add(source: str, receiver: str, key: str, values: FloatArray) -> None:
        rows.append((source, receiver, key, *values))

    source_m = {s.name: s.position_m for s in synthetic.sources}
    receiver_m = {r.name: r.position_m for r in synthetic.receivers}
    for source, receiver, spreads in plan.tabulated:
        response = padded(ImpulseResponse(pressures[source, receiver], rate_hz), _PAD_S)
        distance_m = float(np.linalg.norm(receiver_m[receiver] - source_m[source]))
        direct_s = distance_m / synthetic.speed_of_sound_m_s
        parameters = room_parameters(decay_curve(bands, response, direct_s))
        found: dict[ValueName, FloatArray] = {n: parameters.of(n) for n in PARAMETER_NAMES}
        found["G_dB"] = _strength_db(bands, response)
        for name, spread in spreads.items():
            error = np.where(np.isfinite(spread), spread, 0.0) * rng.standard_normal(len(bands))
            add(source, receiver, _WRITTEN[name], _possible(name, found[name] + error))
            if np.isfinite(spread).any():
                add(source, receiver, f"{_WRITTEN[name]}_sd", spread)
    columns = ("source", "receiver", "parameter", *(f"{f:g}" for f in bands.centres_hz))
    return csv_of(Table("", columns, rows, form=".6g"))


def _strength_db(bands: Bands, response: ImpulseResponse) -> FloatArray:
    """Return G: energy over that of the direct sound at 10 m, ISO 3382-1, equation A.2."""
    impulse: FloatArray = np.zeros(len(response.pressure))
    impulse[impulse.size // 2] = 1.0 / (4.0 * np.pi * 10.0)
    free = ImpulseResponse(impulse, response.sampling_rate_hz)
    energy, reference = (np.sum(filter_pressure(bands, r) ** 2, axis=1) for r in (response, free))
    return np.asarray(10.0 * np.log10(energy / reference))


def _possible(name: ValueName, values: FloatArray) -> FloatArray:
    """Clip or leave out what an added error has driven out of the possible range."""
    if name == "D50_percent":
        return np.clip(values, 0.0, 100.0)
    if name.endswith("_dB"):
        return values
    return np.where(values > 0.0, values, np.nan)


# Every file begins so long before emission.
_LEAD_S = 0.02
_BLOCK_S = 0.01
_RATES_HZ = (16_000.0, 32_000.0, 48_000.0, 96_000.0)
_SAMPLES_PER_EDGE = 2.8


def synthetic_rate_hz(bands: Bands) -> float:
    """Return the least usual sampling rate that leaves the highest band alone."""
    wanted = _SAMPLES_PER_EDGE * float(bands.upper_hz[-1])
    return next((rate for rate in _RATES_HZ if rate >= wanted), _RATES_HZ[-1])


def wanted_pairs(plan: CoveragePlan) -> tuple[Pair, ...]:
    """Return every pair of which a response or a table is fitted, once."""
    pairs = [(m.source, m.receiver) for m in plan.campaign.measurements]
    pairs += [(source, receiver) for source, receiver, _ in plan.tabulated]
    return tuple(dict.fromkeys(pairs))


def synthetic_campaign(
    plan: CoveragePlan,
    synthetic: SyntheticRoom,
    pressures: Pressures,
    folder: Path,
    rng: np.random.Generator,
) -> Campaign:
    """Write WAV files and a table into a folder; return the campaign that reads them.

    It says of room, positions, air and materials what the user's own says.
    """
    import soundfile

    rate_hz = synthetic_rate_hz(plan.campaign.bands)
    files = []
    for i, m in enumerate(plan.campaign.measurements):
        samples = recorded(
            pressures[m.source, m.receiver],
            rate_hz,
            plan.grid,
            synthetic.level_db[i],
            _LEAD_S + synthetic.latency_s[i],
            plan.snr_db[i],
            rng,
        )
        path = folder / f"{i:04d}.wav"
        soundfile.write(path, samples.astype(np.float32), int(rate_hz), subtype="FLOAT")
        emission = m.response.time_zero == "emission"
        spec = ResponseSpec(
            path, time_zero=m.response.time_zero, latency_s=_LEAD_S if emission else 0.0
        )
        files.append(replace(m, response=spec))
    tables: tuple[MeasuredTable, ...] = ()
    if plan.tabulated:
        text = synthetic_table(plan, synthetic, pressures, rate_hz, rng)
        tables = (
            MeasuredTable(write_text_atomically(folder / "table.csv", text), None, None, "fit"),
        )
    return replace(plan.campaign, measurements=tuple(files), tables=tables)


def recorded(
    pressure: FloatArray,
    rate_hz: float,
    grid: Bands,
    level_db: FloatArray,
    delay_s: float,
    snr_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return a response behind a loudspeaker with levels of its own, late, and in noise.

    The noise of each band lies so far below the loudest 10 ms, or four periods of the band's
    width, of the sound in that band.

    Parameters
    ----------
    pressure : float array, shape (n_samples,)
    grid : Bands
        Adjacent bands that cover those of interest.
    level_db, snr_db : float arrays, shape (n_grid,)
    delay_s : float
        0 or more, of any fraction of a sample.
    """
    n = pressure.size + int(np.ceil((delay_s + _BLOCK_S) * rate_hz))
    frequencies = np.linspace(0.0, 0.5 * rate_hz, n + 1)
    spectrum = np.fft.rfft(pressure, 2 * n)
    spectrum *= loudspeaker(grid.centres_hz, level_db, frequencies)
    spectrum *= np.exp(-2j * np.pi * frequencies * delay_s)
    clean = np.fft.irfft(spectrum, 2 * n)[:n]
    return np.asarray(clean + _noise(spectrum, n, rate_hz, grid, snr_db, rng))


def _noise(
    spectrum: np.ndarray[tuple[int], np.dtype[np.complex128]],
    n: int,
    rate_hz: float,
    grid: Bands,
    snr_db: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Return stationary noise whose level runs smoothly from band to band."""
    frequencies = np.linspace(0.0, 0.5 * rate_hz, n + 1)
    density = []
    widths_hz = grid.upper_hz - grid.lower_hz
    shares = octave_shares(grid.centres_hz, frequencies)
    for share, width_hz, ratio_db in zip(shares, widths_hz, snr_db, strict=True):
        filtered = np.fft.irfft(spectrum * share, 2 * n)[:n] ** 2
        size = max(1, round(max(_BLOCK_S, 4.0 / width_hz) * rate_hz))
        sums = np.concatenate(([0.0], np.cumsum(filtered)))
        blocks = np.diff(sums[::size]) / size
        loudest = float(blocks.max()) if blocks.size else float(filtered.mean())
        density.append(loudest * 10.0 ** (-0.1 * ratio_db) * 0.5 * rate_hz / width_hz)
    at = np.log(np.maximum(frequencies, 1.0))
    level = np.interp(at, np.log(grid.centres_hz), np.log(np.maximum(density, 1e-300)))
    white = np.fft.rfft(rng.standard_normal(2 * n))
    return np.asarray(np.fft.irfft(white * np.exp(0.5 * level), 2 * n)[:n])
