"""Directional sources: sound power kept, slopes, files, and energies in a room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from images_reference import box_room, scene_of
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.files.directivity import read_directivity
from roomfit.materials.priors import uniform_scattering
from roomfit.model.patterns import (
    MeasuredDirectivity,
    Pattern,
    aimed,
    amplitude_and_slope,
    axial_index_db,
    directivity_factors,
    loudspeaker_axes,
    measured_directivity,
    measured_factor,
    pattern_basis,
    sphere_mean,
)
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.rays import fibonacci_directions
from roomfit.tracing.trace import trace

SPHERE = fibonacci_directions(4000)
MANY = fibonacci_directions(500)
OCTAVES = bands_between("octave", 500, 2000)
component = st.floats(-3.0, 3.0)


def first_order_factor(source: Pattern, departure: FloatArray) -> FloatArray:
    """Return the energy in some directions, by the readable form."""
    return (1.0 + departure @ source.b) ** 2 / (1.0 + source.b @ source.b / 3.0)


@given(st.tuples(component, component, component))
def test_a_first_order_source_keeps_its_sound_power(b):
    """The mean over 4000 even directions is 1, to the spiral's error for a quadratic, 1e-3."""
    factor = first_order_factor(Pattern(np.array(b)), SPHERE)
    assert factor.mean() == pytest.approx(1.0, abs=1e-3)
    amplitude, _ = amplitude_and_slope(np.array(b), SPHERE)
    # rounding of the amplitude, 1e-16, is more than that of its square near the zero
    np.testing.assert_allclose(amplitude**2, factor, rtol=1e-12, atol=1e-15)


def test_a_cardioid_sends_three_times_its_mean_ahead_and_nothing_behind():
    """(1 + 1)**2 / (1 + 1/3) = 3."""
    ends = np.array([[0.0, 0.6, 0.8], [0.0, -0.6, -0.8], [1.0, 0.0, 0.0]])
    factor = first_order_factor(aimed([0.0, 3.0, 4.0], 1.0), ends)
    np.testing.assert_allclose(factor, [3.0, 0.0, 0.75], atol=1e-12)


@given(st.tuples(component, component, component))
def test_the_slope_by_b_is_that_of_finite_differences(b):
    """Central differences of 1e-5: 1e-9 of rounding over the step, 1e-10 of curvature."""
    at = np.array(b)
    amplitude, by_b = amplitude_and_slope(at, MANY)
    slope = 2.0 * amplitude[:, None] * by_b
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        high, low = (first_order_factor(Pattern(at + s * step), MANY) for s in (1.0, -1.0))
        np.testing.assert_allclose(slope[:, k], (high - low) / 2e-5, atol=1e-7)


@pytest.fixture(scope="module")
def paths() -> Paths:
    """Two sources and one receiver in a box."""
    scene = scene_of(box_room(), [[1.2, 1.5, 1.1], [5.0, 1.0, 1.4]], [[4.1, 2.9, 1.2]])
    settings = TraceSettings(0.05, 2000, 2, 0.4)
    return trace(scene, settings, uniform_scattering(scene.room.materials, 0.2)).paths


def cardioid(b: float, points: FloatArray) -> FloatArray:
    """Energy of a first-order source that faces x."""
    return np.asarray((1.0 + b * points[:, 0]) ** 2)


def test_a_measured_directivity_is_that_of_the_source_measured():
    """A first-order source in 500 directions, turned: within 1 % of its largest factor of 2.3."""
    axes = loudspeaker_axes([1.0, 2.0, 0.5], [0.0, 0.3, 1.0])
    energy = 7.0 * np.stack([cardioid(0.6, MANY), np.ones(len(MANY))], axis=1)
    measured = measured_directivity(MANY, energy, np.array([500.0, 1000.0]), axes)
    expected = first_order_factor(aimed([1.0, 2.0, 0.5], 0.6), SPHERE)
    np.testing.assert_allclose(measured_factor(measured, SPHERE, 0), expected, atol=0.023)
    np.testing.assert_allclose(measured_factor(measured, SPHERE, 1), 1.0, atol=1e-6)
    np.testing.assert_allclose(sphere_mean(measured.factor), 1.0, rtol=1e-12)


def sofa_file(folder: Path, kind: str, *, turned: bool = False) -> Path:
    """Write a first-order source with b = 0.6 below 1.2 kHz and none above."""
    sofar = pytest.importorskip("sofar")
    frequencies = np.array([500.0, 1000.0, 2000.0])
    sofa = sofar.Sofa(kind)
    points = MANY @ loudspeaker_axes([0.0, 1.0, 0.0]) if turned else MANY
    if turned:
        sofa.SourceView, sofa.SourceUp = [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
        sofa.SourceView_Type = "cartesian"
    sofa.ReceiverPosition, sofa.ReceiverPosition_Type = 1.4 * points, "cartesian"
    sofa.ReceiverPosition_Units = "metre"
    amplitude = np.stack([1.0 + 0.6 * MANY[:, 0]] * 2 + [np.ones(len(MANY))], axis=1)
    sofa.N = frequencies
    phase = np.exp(1j * np.linspace(0.0, 9.0, amplitude.size)).reshape(amplitude.shape)
    sofa.Data_Real, sofa.Data_Imag = (amplitude * phase).real[None], (amplitude * phase).imag[None]
    path = folder / "source.sofa"
    sofar.write_sofa(str(path), sofa)
    return path


@pytest.mark.parametrize("turned", [False, True])
def test_a_sofa_file_of_transfer_functions_is_read_and_turned(tmp_path, turned):
    """Phases do not count; the file's own view is its front."""
    path = sofa_file(tmp_path, "FreeFieldDirectivityTF", turned=turned)
    measured = read_directivity(path, OCTAVES, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    expected = first_order_factor(aimed([0.0, 0.0, 1.0], 0.6), SPHERE)
    for band in (0, 1):
        np.testing.assert_allclose(measured_factor(measured, SPHERE, band), expected, atol=0.023)
    np.testing.assert_allclose(measured_factor(measured, SPHERE, 2), 1.0, atol=1e-6)
    with pytest.raises(InputError, match="no value for a band"):
        read_directivity(path, bands_between("octave", 125, 500))


def test_a_sofa_file_of_impulse_responses_is_read(tmp_path):
    """An impulse is the same at all frequencies; receivers stand around the source."""
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa("GeneralFIR")
    sofa.SourcePosition, sofa.SourcePosition_Type = [0.0, 0.3, 1.0], "cartesian"
    sofa.SourcePosition_Units = "metre"
    sofa.ReceiverPosition = 1.4 * MANY + np.array([0.0, 0.3, 1.0])
    sofa.ReceiverPosition_Type = "cartesian"
    sofa.ReceiverPosition_Units = "metre"
    samples = np.zeros((1, len(MANY), 256))
    samples[0, :, 20] = 1.0 + 0.6 * MANY[:, 0]
    sofa.Data_IR, sofa.Data_SamplingRate = samples, 44_100.0
    sofa.Data_Delay = np.zeros((1, len(MANY)))
    path = tmp_path / "source.sofa"
    sofar.write_sofa(str(path), sofa)
    measured = read_directivity(path, OCTAVES, [0.0, -1.0, 0.0])
    expected = first_order_factor(aimed([0.0, -1.0, 0.0], 0.6), SPHERE)
    for band in range(3):
        np.testing.assert_allclose(measured_factor(measured, SPHERE, band), expected, atol=0.023)


def test_factors_of_several_sources_go_to_their_own_paths(paths):
    """Sources are found through the pairs, whatever their order."""
    factors = directivity_factors(paths, [aimed([1, 0, 0], 1.0), None], [1, 0], 0)
    np.testing.assert_array_equal(factors[paths.pair == 0], 1.0)
    assert factors[paths.pair == 1].std() > 0.1


@given(st.tuples(component, component, component))
def test_a_pattern_about_an_aim_keeps_its_sound_power_and_is_alike_all_around(b):
    """Third order on 4000 even directions: the spiral's error for its square is below 2e-2 of it.

    All three polynomials are 1 on the axis but for their scale, and alternate behind.
    """
    aim, at = np.array([0.0, 0.6, 0.8]), np.array(b)
    basis = pattern_basis(SPHERE, aim)
    np.testing.assert_allclose((basis**2).mean(axis=0), 1.0 / 3.0, atol=2e-3)
    amplitude, _ = amplitude_and_slope(at, basis)
    assert (amplitude**2).mean() == pytest.approx(1.0, abs=2e-2)
    ends = pattern_basis(np.array([aim, -aim, [1.0, 0.0, 0.0]]), aim)
    scale = np.sqrt((2.0 * np.arange(1, 4) + 1.0) / 3.0)
    np.testing.assert_allclose(ends[:2], [scale, scale * [-1.0, 1.0, -1.0]], atol=1e-12)
    axis = amplitude_and_slope(at, ends)[0][0] ** 2
    assert axial_index_db(at) == pytest.approx(10.0 * np.log10(max(axis, 1e-12)), abs=0.01) or (
        axis < 1e-6
    )


def test_a_table_of_directions_is_read_linearly_between_its_lines_and_at_its_ends():
    """Front and back for every azimuth, and left from either side of where azimuths begin."""
    table = np.arange(4.0)[:, None] + np.array([0.0, 10.0, 30.0, 70.0, 0.0])
    table[0], table[-1] = 5.0, -7.0
    source = MeasuredDirectivity(np.array([1e3]), table[None] + 7.0, np.eye(3))

    def at(*direction: float) -> float:
        return float(measured_factor(source, np.array([direction]), 0)[0]) - 7.0

    assert at(1.0, 0.0, 0.0) == 5.0 and at(-1.0, 0.0, 0.0) == at(-1.0, 1e-300, 0.0) == -7.0
    # polar angles every 60, azimuths every 90 degrees: left, top, right, bottom
    for polar in (60.0, 80.0, 110.0):
        x, y = np.cos(np.radians(polar)), np.sin(np.radians(polar))
        i, rest = (1, polar / 60.0 - 1.0)
        for j, (left, top) in enumerate(((1, 0), (0, 1), (-1, 0), (0, -1))):
            wanted = (1.0 - rest) * table[i, j] + rest * table[i + 1, j]
            assert at(x, y * left, y * top) == pytest.approx(wanted)
        half = np.sqrt(0.5) * y
        wanted = 0.5 * (1.0 - rest) * (table[i, 2] + table[i, 3])
        wanted += 0.5 * rest * (table[i + 1, 2] + table[i + 1, 3])
        assert at(x, -half, -half) == pytest.approx(wanted)
    assert at(0.0, 1.0, -1e-300) == at(0.0, 1.0, 0.0) == pytest.approx(1.5)


def test_the_mean_over_the_sphere_is_one_and_linear_in_its_polar_angle_s_cosine():
    """Also of few lines; the last azimuth is the first, and counts once."""
    for n in (2, 3, 20):
        cosine = np.cos(np.linspace(0.0, np.pi, n))
        azimuth = np.array([1.0, 3.0, 8.0, 1.0])
        factor = np.stack([np.ones((n, 4)), cosine[:, None] + azimuth])
        np.testing.assert_allclose(sphere_mean(factor), [1.0, 4.0], atol=1e-12)
