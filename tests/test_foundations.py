"""Bands, air, absorption: the few definitions that everything else rests on."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from absorption_reference import Absorption, amplitude_reflection, surviving_energy
from roomfit.air import Air, attenuation_per_m, speed_of_sound_m_s
from roomfit.bands import OCTAVES_HZ, THIRD_OCTAVES_HZ, Bands, bands_between
from roomfit.errors import InputError

coefficients = arrays(np.float64, (3, 2), elements=st.floats(0.0, 1.0))
hits = arrays(np.uint16, (5, 3), elements=st.integers(0, 40))


@given(hits, coefficients)
def test_every_hit_multiplies_by_what_the_wall_gives_back(n, a):
    """The power form equals the product written out hit by hit."""
    expected = np.ones((len(n), a.shape[1]))
    for path, material in np.ndindex(n.shape):
        for _ in range(n[path, material]):
            expected[path] *= 1.0 - a[material]
    # at most 120 factors, each rounded once: 120 * 2**-52 = 2.7e-14 in either form; the smallest
    # numbers have fewer digits
    np.testing.assert_allclose(surviving_energy(n, a), expected, rtol=1e-13, atol=1e-300)


@given(coefficients)
def test_absorption_is_energy_and_amplitude_its_root(a):
    # one root and one square, each rounded once
    np.testing.assert_allclose(amplitude_reflection(a) ** 2, 1.0 - a, rtol=1e-15, atol=1e-300)


def test_a_black_wall_that_is_never_struck_takes_nothing():
    assert surviving_energy(np.array([[0, 3]]), np.array([[1.0], [0.0]])) == 1.0


@pytest.mark.parametrize("bad", [-0.01, 1.01, np.nan, 35.0])
def test_an_absorption_outside_0_to_1_is_refused_with_its_place(bad):
    table = np.array([[0.1, 0.2], [0.3, bad]])
    with pytest.raises(InputError, match=r"out of range(?s:.*)'wall' at 250 Hz"):
        Absorption(("floor", "wall"), bands_between("octave", 125, 250), table)


@pytest.mark.parametrize(
    ("kind", "table", "ratio"),
    [("octave", OCTAVES_HZ, 2.0), ("third-octave", THIRD_OCTAVES_HZ, 2.0 ** (1 / 3))],
)
def test_standard_bands_touch_and_have_their_nominal_centres(kind, table, ratio):
    """IEC 61260-1: an octave is 10**0.3; nominal centres lie within 2 % of the exact ones."""
    bands = bands_between(kind, table[0], table[-1])
    np.testing.assert_allclose(bands.upper_hz[:-1], bands.lower_hz[1:], rtol=1e-12)
    np.testing.assert_allclose(bands.upper_hz / bands.lower_hz, ratio, rtol=2.5e-3)
    np.testing.assert_allclose(bands.exact_centres_hz, bands.centres_hz, rtol=0.02)


def test_a_frequency_that_is_no_centre_is_refused():
    with pytest.raises(InputError, match=r"not a centre(?s:.*)300 Hz"):
        Bands("octave", np.array([125.0, 300.0]))


def test_sound_in_dry_air_at_0_degrees_has_the_textbook_speed():
    """331.45 m/s with 0.03 % CO2; the 0.04 % of today slow it by about 0.01 m/s."""
    assert speed_of_sound_m_s(Air(0.0, 0.0)) == pytest.approx(331.45, abs=0.03)


def test_speed_outside_of_cramers_range_joins_it_without_a_step():
    below, above = (speed_of_sound_m_s(Air(temperature_c=t)) for t in (29.999, 30.001))
    # 0.6 m/s per degree times 0.002 degrees
    assert above - below == pytest.approx(0.0012, abs=0.0005)
    assert speed_of_sound_m_s(Air(speed_of_sound_m_s=341.0)) == 341.0


def test_no_attenuation_means_none():
    assert not attenuation_per_m(Air(attenuation="none"), bands_between("octave", 31.5, 8000)).any()


@pytest.mark.parametrize(
    ("field", "value"),
    [("temperature_c", 60.0), ("humidity_percent", 101.0), ("pressure_kpa", 1013.25)],
)
def test_air_that_cannot_be_is_refused(field, value):
    with pytest.raises(InputError, match="out of range"):
        Air(**{field: value})
