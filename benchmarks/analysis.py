"""Our analysis of real responses beside published values and pyrato's.

    python benchmarks/analysis.py DATA

DATA is a folder with the published responses under the names used below. Prints one table for each
response: published, ours without noise (as the fit uses it), ours with the noise left in, and
pyrato's with one time shift a band and filters of order 6.
"""

from __future__ import annotations

import argparse
import csv
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyfar
import pyrato

from roomfit.base.bands import Bands, bands_between
from roomfit.base.typing import FloatArray
from roomfit.files.responses import read_response
from roomfit.files.responses.recordings import ResponseSpec
from roomfit.signals.decay import ParameterName, decay_curve, room_parameters
from roomfit.signals.response import ImpulseResponse, find_onset

Published = Mapping[str, FloatArray]
NAMES: dict[ParameterName, str] = {
    "T30_s": "T30",
    "T20_s": "T20",
    "EDT_s": "EDT",
    "C80_dB": "C80",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    data: Path | None = parser.parse_args().data
    if data is None:
        print("no folder of measurements given: nothing to do")
        return
    warnings.simplefilter("ignore")
    for title, path, bands, published in responses(data):
        compare(title, path, bands, published)


def responses(data: Path) -> list[tuple[str, Path, Bands, Published]]:
    """Return title, file, bands and published values of every response."""
    octaves = bands_between("octave", 125.0, 4000.0)
    wide = bands_between("octave", 63.0, 8000.0)
    sports = {
        "T30_s": np.array([7.388, 8.472, 6.795, 6.518, 4.797, 4.089]),
        "EDT_s": np.array([4.667, 5.942, 6.007, 5.941, 5.038, 3.735]),
    }
    living = {
        "T30_s": np.array([0.274, 0.365, 0.303, 0.259, 0.227, 0.211, 0.204, 0.181]),
        "C80_dB": np.array([18.5, 23.1, 27.0, 31.7, 35.5, 36.8, 33.5, 36.1]),
    }
    laboratory = {"T20_s": np.array([0.29, 0.42, 0.56, 0.58, 0.55, 0.55])}
    found = [
        (
            "sports centre (OpenAIR)",
            data / "openair_iso3382" / "ir_sportscentre_omni.wav",
            octaves,
            sports,
        ),
        ("living room (OpenAIR)", data / "openair_iso3382" / "living_room_1.wav", wide, living),
        (
            "seminar room (BRAS CR2, LS1 to MP1)",
            data / "bras_cr2" / "scene9_RIR_LS1_MP1_Dodecahedron.wav",
            octaves,
            bras(data / "bras_cr2" / "measured_LS1_per_pair_octave.csv"),
        ),
    ]
    for microphone in range(1, 7):
        path = data / "dechorate" / f"S1_M{microphone}.wav"
        found.append((f"acoustic laboratory (dEchorate, M{microphone})", path, octaves, laboratory))
    return found


def bras(path: Path) -> Published:
    units = {"T20": "T20_s", "T30": "T30_s", "EDT": "EDT_s", "C80": "C80_dB"}
    with path.open() as rows:
        return {
            units[row[2]]: np.array(row[3:], dtype=float)
            for row in csv.reader(rows)
            if row[:2] == ["LS1", "MP1"]
        }


def compare(title: str, path: Path, bands: Bands, published: Published) -> None:
    response, findings = read_response(ResponseSpec(path))
    started = time.perf_counter()
    onset_s = find_onset(response)
    curve = decay_curve(bands, response, onset_s)
    freed = room_parameters(curve)
    seconds = time.perf_counter() - started
    kept = room_parameters(decay_curve(bands, response, onset_s, keep_noise=True))
    theirs = by_pyrato(response, bands)

    print(f"\n{title}: {len(response.pressure) / response.sampling_rate_hz:.2f} s, ", end="")
    print(f"analysed in {1000 * seconds:.0f} ms; {', '.join(f.code for f in findings) or 'clean'}")
    row("Hz", bands.centres_hz, "{:8.0f}")
    row("usable decay, dB", curve.usable_db, "{:8.1f}")
    for name in NAMES:
        digits = "{:8.2f}" if name.endswith("dB") else "{:8.3f}"
        if name in published:
            row(f"{name} published", published[name], digits)
        row(f"{name} ours", freed.of(name), digits)
        row(f"{name} ours, noise kept", kept.of(name), digits)
        row(f"{name} pyrato", theirs[name], digits)


def by_pyrato(response: ImpulseResponse, bands: Bands) -> dict[str, FloatArray]:
    """Return pyrato's values with the settings that its defaults should have had."""
    signal = pyfar.Signal(response.pressure, response.sampling_rate_hz)
    filtered = pyfar.dsp.filter.fractional_octave_bands(
        signal,
        1,
        frequency_range=(0.97 * bands.centres_hz[0], 1.03 * bands.centres_hz[-1]),
        order=6,
    )
    curve = pyrato.edc.energy_decay_curve_lundeby(filtered, channel_independent=True)
    values = {"C80_dB": np.asarray(pyrato.parameters.clarity(curve, 80)).reshape(-1)}
    for name, short in NAMES.items():
        if name != "C80_dB":
            values[name] = np.array(
                [decay_time_by_pyrato(curve[b], short) for b in range(len(bands))]
            )
    return values


def decay_time_by_pyrato(curve: pyfar.TimeData, short: str) -> float:
    """Return its decay time of one band, NaN where it finds no usable curve and raises."""
    try:
        return float(pyrato.parameters.reverberation_time_linear_regression(curve, short).item())
    except ValueError:
        return float("nan")


def row(label: str, values: FloatArray, digits: str) -> None:
    print(f"  {label:<24}" + "".join(digits.format(v) for v in values))


if __name__ == "__main__":
    main()
