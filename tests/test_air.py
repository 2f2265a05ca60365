"""The air: its formulas against published tables, another program and a law of scaling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.air import (
    Air,
    attenuation_per_m,
    cramer_speed_m_s,
    iso9613_attenuation_db_per_m,
    pressure_decay_per_m,
    relative_speed_sd,
    speed_of_sound_m_s,
)
from roomfit.base.bands import bands_between

REFERENCE_PA = 101_325.0
OCTAVES_HZ = 1000.0 * 10.0 ** (0.3 * np.arange(-4, 4))  # exact, 63 Hz to 8 kHz


@pytest.mark.parametrize(
    ("temperature_c", "humidity_percent", "published_db_per_km"),
    [
        (10.0, 70.0, [0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117.0]),
        (20.0, 70.0, [0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6]),
        (30.0, 70.0, [0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3]),
        (15.0, 20.0, [0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202.0]),
        (15.0, 50.0, [0.1, 0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129.0]),
        (15.0, 80.0, [0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8]),
    ],
)
def test_attenuation_is_that_of_the_published_table(
    temperature_c, humidity_percent, published_db_per_km
):
    """ISO 9613-2:1996, table 2, which was computed by ISO 9613-1; half its last digit,
    and 0.01 since one of its values (4.15) was rounded down.
    """
    found = 1000.0 * iso9613_attenuation_db_per_m(
        OCTAVES_HZ, temperature_c, humidity_percent, REFERENCE_PA
    )
    published = np.array(published_db_per_km)
    np.testing.assert_allclose(found[published < 100], published[published < 100], atol=0.06)
    np.testing.assert_allclose(found[published > 100], published[published > 100], atol=0.51)


def test_energies_and_pressures_fall_by_the_decibels_of_the_standard():
    """ISO 9613-2:1996, table 2: 22.9 dB over a kilometre at 4 kHz, 20 degrees C and 70 %."""
    air = Air(20.0, 70.0)
    energy = attenuation_per_m(air, bands_between("octave", 4000, 4000))[0]
    pressure = pressure_decay_per_m(air, np.array([1000.0 * 10.0**0.6]))[0]
    assert 10.0 * np.log10(np.exp(-1000.0 * energy)) == pytest.approx(-22.9, abs=0.06)
    assert 20.0 * np.log10(np.exp(-1000.0 * pressure)) == pytest.approx(-22.9, abs=0.06)
    assert not attenuation_per_m(
        replace(air, attenuation="none"), bands_between("octave", 125, 4000)
    ).any()


def test_speed_outside_of_the_fitted_range_goes_on_as_the_root_of_temperature():
    """From the value at the edge; pressures beyond theirs change nothing."""
    for edge_c, beyond_c in ((0.0, -15.0), (30.0, 45.0)):
        edge, beyond = (speed_of_sound_m_s(Air(t, 20.0)) for t in (edge_c, beyond_c))
        expected = np.sqrt((beyond_c + 273.15) / (edge_c + 273.15))
        assert beyond / edge == pytest.approx(expected, rel=1e-9)
    assert speed_of_sound_m_s(Air(pressure_kpa=60.0)) == speed_of_sound_m_s(Air(pressure_kpa=75.0))
    assert speed_of_sound_m_s(Air(speed_of_sound_m_s=350.0)) == 350.0
    # measured in dry air at 0 degrees C: 331.45 m/s, Cramer's own 331.46
    assert speed_of_sound_m_s(Air(0.0, 0.0)) == pytest.approx(331.46, abs=0.05)


@pytest.mark.parametrize("ratio", [0.5, 0.84, 1.18])
def test_attenuation_scales_with_pressure_as_collisions_do(ratio):
    """With as many molecules of water per molecule of air, alpha / p depends on f / p only.

    So many are there when relative humidity goes with the pressure: the pressure of saturation
    depends on temperature alone.
    """
    f = np.geomspace(50.0, 10_000.0, 40)
    at_reference = iso9613_attenuation_db_per_m(f, 17.0, 40.0, REFERENCE_PA)
    scaled = iso9613_attenuation_db_per_m(ratio * f, 17.0, ratio * 40.0, ratio * REFERENCE_PA)
    np.testing.assert_allclose(scaled, ratio * at_reference, rtol=1e-12)


@pytest.mark.parametrize("temperature_c", [-20.0, 3.5, 20.0, 50.0])
@pytest.mark.parametrize("humidity_percent", [0.0, 12.0, 50.0, 100.0])
def test_attenuation_is_that_of_pyfar_at_the_reference_pressure(temperature_c, humidity_percent):
    """The same equations, so equal to rounding.

    Not at other pressures: pyfar 0.8.1 multiplies the molar concentration of water by the pressure
    where (B.1) divides by it.
    """
    constants = pytest.importorskip("pyfar").constants
    f = np.geomspace(50.0, 10_000.0, 40)
    theirs, _, _ = constants.air_attenuation(temperature_c, f, humidity_percent / 100.0)
    ours = iso9613_attenuation_db_per_m(f, temperature_c, humidity_percent, REFERENCE_PA)
    np.testing.assert_allclose(ours, np.asarray(theirs).reshape(-1), rtol=1e-12)


@pytest.mark.parametrize("temperature_c", [0.0, 11.0, 20.0, 30.0])
@pytest.mark.parametrize("humidity", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("pressure_pa", [75e3, 101_325.0, 102e3])
def test_speed_is_that_of_pyfar(temperature_c, humidity, pressure_pa):
    constants = pytest.importorskip("pyfar").constants
    theirs = constants.speed_of_sound_cramer(
        temperature_c, humidity, atmospheric_pressure=pressure_pa
    )
    ours = cramer_speed_m_s(temperature_c, humidity, pressure_pa)
    assert ours == pytest.approx(float(theirs), rel=1e-12)


def test_bands_below_50_hz_have_the_attenuation_at_50_hz():
    """Two of them at once, too."""
    low = attenuation_per_m(Air(), bands_between("third-octave", 31.5, 100))
    assert low[0] == low[1] > 0.0
    assert np.all(np.diff(low[1:]) >= 0.0)


@pytest.mark.parametrize("temperature_c", [5.0, 15.0, 25.0])
def test_the_spread_of_the_speed_is_its_slope_by_temperature(temperature_c):
    """Finite difference of Cramer's speed in dry air, which departs from an ideal gas by 1 %."""
    warm, cold = (
        speed_of_sound_m_s(Air(temperature_c=temperature_c + step, humidity_percent=0.0))
        for step in (1.0, -1.0)
    )
    found = relative_speed_sd(Air(temperature_c=temperature_c), 2.0)
    assert found == pytest.approx(2.0 * (warm - cold) / (warm + cold), rel=0.01)
