"""Our analysis of real responses against published values and another program."""

from __future__ import annotations

import csv
import warnings
from pathlib import Path

import numpy as np
import pytest

from roomfit.base.air import Air, attenuation_per_m
from roomfit.base.bands import Bands, bands_between
from roomfit.base.findings import Code
from roomfit.files.responses import read_response
from roomfit.files.schema import ResponseSpec
from roomfit.signals.decay import (
    RoomParameters,
    check_decay_range,
    check_is_response,
    decay_curve,
    room_parameters,
)
from roomfit.signals.response import ImpulseResponse, find_onset

OCTAVES = bands_between("octave", 125.0, 4000.0)


def analysed(
    response: ImpulseResponse, bank: Bands = OCTAVES, *, keep_noise: bool = False
) -> RoomParameters:
    check_is_response(response)
    curve = decay_curve(bank, response, find_onset(response), keep_noise=keep_noise)
    check_decay_range(curve)
    return room_parameters(curve)


def positions(folder: Path) -> dict[str, np.ndarray]:
    with (folder / "positions.csv").open() as rows:
        return {
            row["name"]: np.array([float(row[axis]) for axis in ("x_m", "y_m", "z_m")])
            for row in csv.DictReader(rows)
        }


def dechorate(real_data: Path, microphone: int) -> tuple[ImpulseResponse, float]:
    """One response and the stated distance of its microphone."""
    folder = real_data / "dechorate"
    where = positions(folder)
    response, findings = read_response(ResponseSpec(folder / f"S1_M{microphone}.wav"))
    assert findings == ()
    return response, float(np.linalg.norm(where["S1"] - where[f"M{microphone}"]))


def test_the_sports_centre_has_its_published_reverberation_times(real_data):
    """Published with the noise left in: so done, every octave agrees within 0.6 %.

    Without the noise, as a fit needs it, 500 Hz to 4 kHz still agree within 3 %; at 125 and 250 Hz
    the noise of the hall had lengthened the published times by more than a quarter.
    """
    published = np.array([7.388, 8.472, 6.795, 6.518, 4.797, 4.089])
    path = real_data / "openair_iso3382" / "ir_sportscentre_omni.wav"
    response, _ = read_response(ResponseSpec(path))
    kept = analysed(response, keep_noise=True)
    np.testing.assert_allclose(kept.of("T30_s"), published, rtol=0.006)
    freed = analysed(response)
    np.testing.assert_allclose(freed.of("T30_s")[2:], published[2:], rtol=0.03)
    edt = np.array([4.667, 5.942, 6.007, 5.941, 5.038, 3.735])
    np.testing.assert_allclose(freed.of("EDT_s"), edt, rtol=0.05)


def test_the_living_room_has_its_published_clarity(real_data):
    """C80 of 27 to 37 dB, 250 Hz to 8 kHz within 0.5 dB with the noise left in.

    Without it, 125 Hz to 8 kHz within 0.52 dB. At 63 Hz nobody agrees (18.5 dB published, pyrato
    17.3, we 20.5, with the noise 16.9): that band holds more drift of the recorder than late sound.
    """
    published = np.array([18.5, 23.1, 27.0, 31.7, 35.5, 36.8, 33.5, 36.1])
    response, findings = read_response(
        ResponseSpec(real_data / "openair_iso3382" / "living_room_1.wav")
    )
    assert [finding.code for finding in findings] == [Code.DC_OFFSET]
    bank = bands_between("octave", 63.0, 8000.0)
    kept = analysed(response, bank, keep_noise=True).of("C80_dB")
    np.testing.assert_allclose(kept[2:], published[2:], atol=0.5)
    freed = analysed(response, bank)
    np.testing.assert_allclose(freed.of("C80_dB")[1:], published[1:], atol=0.52)
    t30 = np.array([0.274, 0.365, 0.303, 0.259, 0.227, 0.211, 0.204, 0.181])
    np.testing.assert_allclose(freed.of("T30_s"), t30, rtol=0.04)


def test_the_mean_reverberation_time_of_the_acoustic_laboratory(real_data):
    """T20 of dEchorate, mean of six: .29 .42 .56 .58 .55 .55 s as specified, within 6 %.

    Stated as approximate; the six scatter by 9 % at 125 Hz and 3 to 6 % above.
    """
    reported = np.array([0.29, 0.42, 0.56, 0.58, 0.55, 0.55])
    values = [analysed(dechorate(real_data, m)[0]).of("T20_s") for m in range(1, 7)]
    np.testing.assert_allclose(np.mean(values, axis=0), reported, rtol=0.06)


def test_the_seminar_room_has_its_measured_reverberation_times(real_data):
    """BRAS CR2, LS1 to MP1: T20 and T30 within 5 % of the published ones, EDT within 9 %."""
    folder = real_data / "bras_cr2"
    response, findings = read_response(ResponseSpec(folder / "scene9_RIR_LS1_MP1_Dodecahedron.wav"))
    assert findings == ()
    found = analysed(response)
    with (folder / "measured_LS1_per_pair_octave.csv").open() as rows:
        published = {
            row[2]: np.array(row[3:], dtype=float)
            for row in csv.reader(rows)
            if row[:2] == ["LS1", "MP1"]
        }
    np.testing.assert_allclose(found.of("T20_s"), published["T20"], rtol=0.05)
    np.testing.assert_allclose(found.of("T30_s"), published["T30"], rtol=0.05)
    np.testing.assert_allclose(found.of("EDT_s"), published["EDT"], rtol=0.09)
    # published -2.31 dB at 500 Hz, pyrato -2.04, we -1.66: with a limit of 76, 80, 84 ms we find
    # -1.95, -1.66, -1.33, so filters of other lengths disagree here
    np.testing.assert_allclose(found.of("C80_dB"), published["C80"], atol=0.7)


def test_air_attenuation_has_the_values_of_iso_9613(real_data):
    """Three rows of the standard's table, 50 Hz to 10 kHz, within 1 %.

    The standard's table names nominal frequencies and means exact base-ten ones: taken at the
    nominal ones, the same formula misses it by up to 1.7 %.
    """
    table = real_data / "tables" / "iso9613_1_air_absorption_dB_per_km.csv"
    bands = bands_between("third-octave", 50.0, 10_000.0)
    with table.open(encoding="latin-1") as rows:
        header, *lines = list(csv.reader(rows))
    np.testing.assert_array_equal(np.array(header[2:], dtype=float), bands.centres_hz)
    assert len(lines) == 3
    for line in lines:
        air = Air(temperature_c=float(line[0]), humidity_percent=float(line[1]))
        per_km = 10.0 * np.log10(np.e) * 1000.0 * attenuation_per_m(air, bands)
        np.testing.assert_allclose(per_km, np.array(line[2:], dtype=float), rtol=0.01)


@pytest.mark.slow
def test_pyrato_finds_the_same_times_in_the_same_responses(real_data):
    """pyrato 1.1, one time shift a band, filters of order 6, truncated where noise begins.

    T20 and T30 of each response agree within 4 % from 500 Hz up, and within 10 % below, where a
    band of a short decay holds few independent values and the two banks weigh them differently.
    """
    pyfar = pytest.importorskip("pyfar")
    pyrato = pytest.importorskip("pyrato")
    paths = [
        real_data / "openair_iso3382" / "ir_sportscentre_omni.wav",
        real_data / "bras_cr2" / "scene9_RIR_LS1_MP1_Dodecahedron.wav",
        real_data / "dechorate" / "S1_M1.wav",
        real_data / "dechorate" / "S1_M4.wav",
    ]
    for path in paths:
        response, _ = read_response(ResponseSpec(path))
        found = analysed(response)
        signal = pyfar.Signal(response.pressure, response.sampling_rate_hz)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            filtered = pyfar.dsp.filter.fractional_octave_bands(
                signal, 1, frequency_range=(120.0, 4100.0), order=6
            )
            curve = pyrato.edc.energy_decay_curve_lundeby(filtered, channel_independent=True)
            for name in ("T20", "T30"):
                theirs = pyrato.parameters.reverberation_time_linear_regression(curve, name)
                ratio = found.of(f"{name}_s") / np.asarray(theirs).reshape(-1)
                assert np.all(np.abs(ratio[2:] - 1.0) < 0.04), (path.name, name, ratio)
                assert np.all(np.abs(ratio[:2] - 1.0) < 0.10), (path.name, name, ratio)
