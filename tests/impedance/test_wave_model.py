"""Pressures of image sources that carry phase: against exact waves, closed forms, differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import wofz

from impedance_cases import exact, nearest
from roomfit.base.air import Air
from roomfit.impedance.data import Observed, complex_frequency_hz, deviation
from roomfit.impedance.fit import Problem, data_rows, prior_rows, start_of
from roomfit.impedance.laws import (
    Spline,
    absorption_random,
    causal_curve,
    impedance_of_r0,
    spline,
)
from roomfit.impedance.wave_model import (
    Nuisances,
    State,
    at_rest,
    boundary_loss,
    plane_reflection,
    predicted_pressure,
    wave_model,
    wavenumber_per_m,
)
from roomfit.room.scene import Point, Scene
from simulated_rooms.exact_box import damped_wavenumber_per_m, exact_box_pressure
from simulated_rooms.impedance_box import (
    LENGTHS_M,
    PAIRS,
    RECEIVERS_M,
    SOURCES_M,
    SURFACES,
    WALLS,
    box_scene,
    true_r0,
)
from simulated_rooms.polyhedral_rooms import room_of, slanted_cells
from simulated_rooms.wall_impedances import miki_layer, panel, r0_of_impedance, resonator
from simulated_rooms.wave_images import image_pressure, locally_reacting


def test_a_passive_wall_gives_back_no_more_than_it_gets_at_any_angle():
    rng = np.random.default_rng(1)
    radius, phase = rng.random((2, 100))
    r0 = np.sqrt(radius) * np.exp(2j * np.pi * phase)
    # as many angles as it takes to meet grazing ones
    sizes = [np.abs(plane_reflection(r0, cosine)).max() for cosine in rng.random(1000)]
    # two divisions and two products of numbers of size 1
    assert max(sizes) <= 1.0 + 1e-14


def test_reflection_in_r0_is_that_of_the_impedance():
    z = np.array([0.3 + 2j, 70 - 30j, 1.0, 5 - 1j])
    for cosine in (0.0, 0.2, 1.0):
        expected = (z * cosine - 1.0) / (z * cosine + 1.0)
        found = plane_reflection(r0_of_impedance(z), cosine)
        np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_allclose(impedance_of_r0(r0_of_impedance(z)), z, rtol=1e-12)


def test_the_boundary_loss_is_that_of_the_error_function():
    rng = np.random.default_rng(2)
    w = 20.0 * (rng.normal(size=4000) + 1j * rng.normal(size=4000))
    w = w[w.imag > -2.0]  # below, the surface wave grows past any use
    expected = 1.0 + 1j * np.sqrt(np.pi) * w * wofz(w)
    found = boundary_loss(w)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def test_absorption_at_random_incidence_is_the_closed_form_of_a_real_impedance():
    """Paris's integral for a resistance r: 8/r (1 + 1/(1+r) - 2/r log(1+r))."""
    r = np.array([1.6, 3.0, 20.0])
    expected = 8.0 / r * (1.0 + 1.0 / (1.0 + r) - 2.0 / r * np.log(1.0 + r))
    np.testing.assert_allclose(absorption_random(r0_of_impedance(r)), expected, rtol=1e-9)
    assert expected[0] == pytest.approx(0.951, abs=1e-3)  # the known maximum


def band_errors(model, observed, p):
    f = observed.frequency_hz
    edges = ((100, 200), (200, 400), (400, 700), (700, 1001))
    error = []
    for low, high in edges:
        own = (f >= low) & (f < high)
        off, whole = (p - observed.pressure)[:, own], observed.pressure[:, own]
        error.append(np.sqrt(np.mean(np.abs(off) ** 2) / np.mean(np.abs(whole) ** 2)))
    return np.array(error)


def own_field(frequency_hz, tau_s=0.015):
    """Six pairs by this repository's own exact solver, and the observation they make."""
    empty = Observed(frequency_hz, tau_s, np.ones((len(PAIRS), len(frequency_hz))))
    r0 = true_r0(empty, ("slots", *["plaster"] * 4, "wool"))
    k = damped_wavenumber_per_m(frequency_hz, tau_s, 343.0)
    ends = np.array(PAIRS)
    field = exact_box_pressure(
        LENGTHS_M, (1 - r0) / (1 + r0), k,
        np.array(SOURCES_M)[ends[:, 0]], np.array(RECEIVERS_M)[ends[:, 1]],
    )  # fmt: skip
    return Observed(frequency_hz, tau_s, field)


def check_image_sources(observed, walls):
    """Measured: 1.4, 1.2, 0.6, 0.4 %; plane waves 12, 9, 2.6, 1.3 %."""
    scene = box_scene(walls)
    model = wave_model(scene, observed.frequency_hz, observed.tau_s)
    r0 = true_r0(observed, scene.room.materials)
    spherical = predicted_pressure(model, r0, at_rest(model))
    assert np.all(band_errors(model, observed, spherical) <= [0.025, 0.016, 0.009, 0.006])
    plane = predicted_pressure(model, r0, at_rest(model), spherical=False)
    assert np.all(band_errors(model, observed, plane) > [0.05, 0.04, 0.015, 0.008])


@pytest.mark.parametrize("name", ["exact_M3", "exact_M2"])
def test_image_sources_with_spherical_reflection_come_near_the_exact_field(real_data, name):
    check_image_sources(exact(real_data, name), {"ceiling": "wool"} if "M2" in name else WALLS)


def test_image_sources_with_spherical_reflection_come_near_the_field_of_our_own_solver():
    """Every third frequency, without any file: the solver's values are pinned below."""
    check_image_sources(own_field(np.arange(100.0, 1001.0, 30.0)), WALLS)


# The field of the first pair by another program, at 100, 250, 500 and 1000 Hz.
SPOTS = (
    0.0115314 + 0.0077796j,
    -0.0088679 - 0.0411527j,
    0.0001364 + 0.0083390j,
    0.0218192 - 0.0151983j,
)


def test_the_exact_solver_gives_the_fields_of_another_one(real_data):
    observed = exact(real_data)
    chosen = [0, 15, 40, 90]
    found = own_field(observed.frequency_hz[chosen], observed.tau_s).pressure
    rms = np.sqrt(np.mean(np.abs(observed.pressure) ** 2))
    assert np.abs(found - observed.pressure[:, chosen]).max() <= 1e-4 * rms


def test_the_exact_solver_gives_four_values_of_another_one():
    """Without its files; a wall taken for another moves each by more than a hundredth."""
    found = own_field(np.array([100.0, 250.0, 500.0, 1000.0])).pressure
    rms = np.sqrt(np.mean(np.abs(found) ** 2))
    assert np.abs(found[0] - SPOTS).max() <= 1e-4 * rms


def hexahedron_scene(move=None):
    room = room_of(slanted_cells())
    low, high = room.mesh.vertices_m.min(axis=0), room.mesh.vertices_m.max(axis=0)
    at = [low + np.array(s) * (high - low) for s in ((0.3, 0.35, 0.4), (0.6, 0.55, 0.5))]
    if move is not None:
        at = [at[0] + move[0], at[1] + move[1]]
    air = Air(speed_of_sound_m_s=343.0, attenuation="none")
    return Scene(room, (Point("s", at[0]),), (Point("r", at[1]),), np.array([[0, 0]]), air)


def test_moved_paths_are_those_found_at_the_moved_positions():
    """In a slanted room, by unfolded normals; plane against spherical in numpy and scipy."""
    f = np.array([150.0, 400.0])
    move = np.array([[1e-3, -2e-3, 1.5e-3], [-1e-3, 2e-3, 1e-3]])
    model = wave_model(hexahedron_scene(), f, 0.004)
    moved = wave_model(hexahedron_scene(move), f, 0.004)
    z = np.array([5 + 3j, 4 - 2j])
    r0 = np.tile(r0_of_impedance(z), (len(model.scene.room.materials), 1))
    state = State(move[:1], move[1:], 0.0)
    found = predicted_pressure(model, r0, state)
    walls = {
        m: locally_reacting(z, wavenumber_per_m(model, state)) for m in model.scene.room.materials
    }
    there = image_pressure(moved, walls, at_rest(moved))
    here = predicted_pressure(model, r0, at_rest(model))
    # few paths come and go with the walls' edges; they are far and weak
    assert np.abs(found - there).max() < 0.02 * np.abs(there - here).max()


@pytest.mark.parametrize("kind", ["pair", "spectrum", "levels"])
def test_derivatives_are_those_of_central_differences(kind):
    rng = np.random.default_rng(3)
    f, tau = np.array([120.0, 330.0, 620.0, 910.0]), 0.005
    scene = box_scene(n_pairs=4)
    model = wave_model(scene, f, tau)
    p = rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))
    observed = Observed(f, tau, 0.01 * p, has_phase=kind != "levels")
    at = complex_frequency_hz(observed)
    curves = (
        causal_curve(at),
        Spline("constant", np.ones((4, 1))),
        spline(f),
    )
    gain = "spectrum" if kind == "spectrum" else "pair"
    nuisances = Nuisances(0.01, 0.01, gain, delay_sd_s=1e-4)
    problem = Problem(model, observed, deviation(scene, observed), curves, nuisances)
    starts = (0.5 + 0.2j, 0.9 - 0.1j, 0.3 - 0.4j)
    x = start_of(problem)
    for place, curve, r0 in zip(problem.layout.curves, curves, starts, strict=True):
        x[place] = curve.start(r0)
    x += 0.3 * rng.normal(size=problem.layout.size) * (np.arange(problem.layout.size) > 5)
    correction = 1e-3 * p

    def rows(at):
        return data_rows(problem, at, correction)

    def half_squares(at):
        return 0.5 * np.sum(rows(at)[0] ** 2)

    (residual, jacobian), h = rows(x), 1e-5
    for i, step in enumerate(h * np.eye(problem.layout.size)):
        if kind == "spectrum":
            # Kaufman's Jacobian has the exact slope of the cost, not of each row
            numeric = (half_squares(x + step) - half_squares(x - step)) / (2 * h)
            exact_slope = jacobian[:, i] @ residual
            scale = np.abs(jacobian.T @ residual).max()
        else:
            numeric = (rows(x + step)[0] - rows(x - step)[0]) / (2 * h)
            exact_slope, scale = jacobian[:, i], np.abs(jacobian[:, i]).max()
        # levels do not depend on a phase: nothing but rounding is left there
        scale = max(scale, 1e-3 * np.abs(jacobian).max())
        np.testing.assert_allclose(numeric, exact_slope, rtol=0, atol=1e-6 * scale)


def test_prior_rows_have_the_slope_of_central_differences():
    f = np.arange(100.0, 501.0, 10.0)
    observed = Observed(f, 0.005, np.ones((2, len(f))))
    scene = box_scene(n_pairs=2)
    model = wave_model(scene, f, 0.005)
    curves = (spline(f), spline(f), causal_curve(complex_frequency_hz(observed)))
    problem = Problem(model, observed, np.ones((2, len(f))), curves, Nuisances(gain="common"))
    x = start_of(problem)
    x[problem.layout.curves[1]] = curves[1].start(0.999 + 0.0j)
    x += 0.02 * np.random.default_rng(5).normal(size=problem.layout.size)
    rough = np.array([0.1, 0.01, 1.0])
    h, (_, slope) = 1e-6, prior_rows(problem, x, rough)
    numeric = np.column_stack(
        [
            (prior_rows(problem, x + h * e, rough)[0]
             - prior_rows(problem, x - h * e, rough)[0]) / (2 * h)
            for e in np.eye(problem.layout.size)
        ]
    )  # fmt: skip
    scale = np.abs(slope).max(axis=1, keepdims=True)
    np.testing.assert_array_less(np.abs(numeric - slope) / scale, 1e-5)


def test_sums_and_single_reflections_are_those_of_plain_numpy_and_scipy():
    """Of a box with six walls, springy and stiff, spherical waves and plane ones."""
    f = np.array([90.0, 300.0, 800.0])
    model = wave_model(box_scene({s: s for s in SURFACES}, n_pairs=2), f, 0.006)
    k = wavenumber_per_m(model, at_rest(model))
    z = np.random.default_rng(4).uniform(-3.0, 3.0, size=(6, 3)) * 1j
    z += np.array([0.1, 0.5, 1.0, 5.0, 20.0, 90.0])[:, None]
    for wave in (k, None):
        walls = {s: locally_reacting(own, wave) for s, own in zip(SURFACES, z, strict=True)}
        expected = image_pressure(model, walls, at_rest(model))
        r0 = r0_of_impedance(z)
        found = predicted_pressure(model, r0, at_rest(model), spherical=wave is not None)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


# Walls that are passive and causal, and any that are smooth.


def damped(low=100.0, high=1000.0, step=25.0, tau_s=0.010):
    return np.arange(low, high + 1.0, step) - 0.5j / (np.pi * tau_s)


def strictly_causal():
    curve = causal_curve(damped())
    return replace(curve, basis=0.0 * curve.basis)


@pytest.mark.parametrize("tau_s", [0.005, 0.015, 0.2])
def test_the_slope_of_a_causal_curve_is_that_of_central_differences(tau_s):
    curve = causal_curve(damped(tau_s=tau_s))
    x = curve.start()
    x += 0.03 * np.random.default_rng(1).normal(size=len(x))
    numeric = np.column_stack(
        [(curve.values(x + e)[0] - curve.values(x - e)[0]) / 2e-6 for e in 1e-6 * np.eye(len(x))]
    )
    slope = curve.values(x)[1]
    np.testing.assert_allclose(numeric, slope, atol=1e-7 * np.abs(slope).max())
    chosen = np.array([3, 8, 20])
    np.testing.assert_array_equal(curve.at(chosen).values(x)[0], curve.values(x)[0][chosen])
    # sums of another number of rows may be made in another order
    np.testing.assert_allclose(curve.at(chosen).values(x)[1], slope[chosen], rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("seed", range(6))
def test_whatever_its_density_a_causal_curve_is_a_wall_that_energy_and_time_allow(seed):
    """Pick's matrix, whose eigenvalues are none of them negative exactly for such functions.

    Of R at s and at its conjugates, ``(1 - R_i R_j*) / (s_i + s_j*)``; to the error of the sum that
    stands for the integral, a thousandth.
    """
    f = damped(step=50.0)
    curve = causal_curve(f)
    rng = np.random.default_rng(seed)
    n = len(curve.log_coefficients)
    x = curve.start()
    x[:n] += 0.1 * np.cumsum(rng.normal(size=n)) / np.sqrt(n) + 0.03 * rng.normal(size=n)
    s = 2j * np.pi * f.real + 1.0 / 0.010
    r = np.append(curve.values(x)[0], curve.values(x)[0].conj())
    s = np.append(s, s.conj())
    pick = (1.0 - np.outer(r, r.conj())) / (s[:, None] + s.conj())
    pick = pick * 2.0 * np.sqrt(np.outer(s.real, s.real))
    assert np.linalg.eigvalsh(pick).min() > -1e-3
    assert np.abs(r).max() < 1.0


@pytest.mark.parametrize("power", [-0.25, 0.0, 0.25])
def test_a_density_that_is_a_power_of_frequency_has_that_power_as_its_admittance(power):
    """``s**p`` over its size in the middle of the band: the integral in closed form.

    Beyond three octaves on either side the density is level: that is worth a few per cent at the
    ends of the band.
    """
    f = damped()
    admittance = 0.2 * np.exp(0.5j * np.pi * power)
    curve = causal_curve(f)
    r0 = curve.values(curve.start(complex((1.0 - admittance) / (1.0 + admittance))))[0]
    found = (1.0 - r0) / (1.0 + r0)
    s = (2j * np.pi * f.real + 100.0) / (2.0 * np.pi * np.sqrt(100.0 * 1000.0))
    np.testing.assert_allclose(found, 0.2 * s**power, rtol=0.1 if power else 3e-3)


def test_walls_of_every_law_are_causal_curves_or_nearly_so():
    """Panels, resonators and springy walls to 0.003; layers by Miki are off causality by .006."""
    f, curve = damped(), strictly_causal()
    for z, most in (
        (panel(f, 0.5, 4.0, 0.05, 343.0), 0.003),
        (resonator(f, 0.3, 0.3, 0.08, 3e3, 343.0), 0.006),
        (70.0 - 10.0j * 200.0 / f, 0.003),
        (miki_layer(f, 2e4, 0.04, 0.0, 343.0), 0.009),
    ):
        r0 = r0_of_impedance(z)
        found = curve.values(nearest(curve, r0, 1e-5))[0]
        assert np.sqrt(np.mean(np.abs(found - r0) ** 2)) < most


def test_a_rigid_wall_cannot_answer_before_it_is_struck_but_may_answer_late():
    """|R0| = .97 turned ahead as if it stood 10 mm nearer, and turned back.

    The second is a wall set back, or one that yields; the first is what points moved away from a
    wall look like, and no course of a density comes near it.
    """
    curve, k = strictly_causal(), 2.0 * np.pi * damped().real / 343.0
    off = []
    for moved_m in (0.01, -0.01):
        r0 = 0.97 * np.exp(2j * k * moved_m)
        found = curve.values(nearest(curve, r0, 1e-5))[0]
        off.append(np.sqrt(np.mean(np.abs(found - r0) ** 2)))
    assert off[0] > 0.08
    assert off[1] < 0.02
