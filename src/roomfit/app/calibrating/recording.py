"""Made responses as a measuring chain would have written them, and a campaign that names them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roomfit.app.calibrating.plan import CalibrationPlan
from roomfit.app.calibrating.sound import Pair, Sound
from roomfit.app.calibrating.tables import made_table
from roomfit.app.calibrating.truth import Truth
from roomfit.bands import Bands
from roomfit.files.campaign.campaign import Campaign, MeasuredTable
from roomfit.files.responses.spec import ResponseSpec
from roomfit.files.store import write_text_atomically
from roomfit.testproblems.pressure_box import loudspeaker, octave_shares
from roomfit.typing import FloatArray

# Every file begins so long before emission.
_LEAD_S = 0.02
_BLOCK_S = 0.01
_RATES_HZ = (16_000.0, 32_000.0, 48_000.0, 96_000.0)
_SAMPLES_PER_EDGE = 2.8


def made_rate_hz(bands: Bands) -> float:
    """Return the least usual sampling rate that leaves the highest band alone."""
    wanted = _SAMPLES_PER_EDGE * float(bands.upper_hz[-1])
    return next((rate for rate in _RATES_HZ if rate >= wanted), _RATES_HZ[-1])


def wanted_pairs(plan: CalibrationPlan) -> tuple[Pair, ...]:
    """Return every pair of which a response or a table is fitted, once."""
    pairs = [(m.source, m.receiver) for m in plan.campaign.measurements]
    pairs += [(v.source, v.receiver) for v in plan.tabulated]
    return tuple(dict.fromkeys(pairs))


def made_campaign(
    plan: CalibrationPlan, truth: Truth, sound: Sound, folder: Path, rng: np.random.Generator
) -> Campaign:
    """Write WAV files and a table into a folder; return the campaign that reads them.

    It says of room, places, air and materials what the user's own says.
    """
    import soundfile

    rate_hz = made_rate_hz(plan.campaign.bands)
    files = []
    for i, m in enumerate(plan.campaign.measurements):
        samples = recorded(
            sound.pressure[m.source, m.receiver],
            rate_hz,
            plan.grid,
            truth.level_db[i],
            _LEAD_S + truth.latency_s[i],
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
        text = made_table(plan, truth, sound, rate_hz, rng)
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
    width, of what is heard in that band.

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
        heard = np.fft.irfft(spectrum * share, 2 * n)[:n] ** 2
        size = max(1, round(max(_BLOCK_S, 4.0 / width_hz) * rate_hz))
        sums = np.concatenate(([0.0], np.cumsum(heard)))
        blocks = np.diff(sums[::size]) / size
        loudest = float(blocks.max()) if blocks.size else float(heard.mean())
        density.append(loudest * 10.0 ** (-0.1 * ratio_db) * 0.5 * rate_hz / width_hz)
    at = np.log(np.maximum(frequencies, 1.0))
    level = np.interp(at, np.log(grid.centres_hz), np.log(np.maximum(density, 1e-300)))
    white = np.fft.rfft(rng.standard_normal(2 * n))
    return np.asarray(np.fft.irfft(white * np.exp(0.5 * level), 2 * n)[:n])
