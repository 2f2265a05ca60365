"""How sure walls are: the model's own error, unspecified noise, clocks, and what is too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from images_reference import l_shaped_room
from impedance_cases import nearest
from roomfit.base.air import Air
from roomfit.base.errors import InputError
from roomfit.impedance.data import Observed, level_at, model_error
from roomfit.impedance.diagnostics import estimated_noise
from roomfit.impedance.fit import polish
from roomfit.impedance.identify import ImpedanceSettings, identify_impedance, wave_problem
from roomfit.impedance.laws import absorption_normal
from roomfit.impedance.problem import (
    Whitened,
    marginal_likelihood_error,
    robust_covariance,
    start_of,
)
from roomfit.impedance.result import material_impedance
from roomfit.impedance.wave_model import (
    Nuisances,
    at_rest,
    check_cost,
    predicted_pressure,
    wave_model,
)
from roomfit.room.scene import Point, Scene
from simulated_rooms.hall import hall_room
from simulated_rooms.impedance_box import box_scene, noisy, rms_by_material, true_r0

EXACT = Nuisances(position_sd_m=0.0, speed_sd=0.0)
# data by the image model itself
ROUGH = ImpedanceSettings(random_starts=0, model_error=0.02)
TAU_S = 0.005
F_HZ = np.arange(200.0, 801.0, 20.0)


def box_data():
    """Six pairs in the box by the model itself, without noise, and the walls."""
    scene = box_scene()
    empty = Observed(F_HZ, TAU_S, np.ones((6, len(F_HZ))))
    r0 = true_r0(empty, scene.room.materials)
    model = wave_model(scene, F_HZ, TAU_S)
    return scene, predicted_pressure(model, r0, at_rest(model)), r0


def normal_numbers(rng, shape):
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2.0)


@pytest.mark.parametrize("factor", [0.05, 0.1, 0.25])
def test_the_error_of_the_model_is_found_from_what_a_linear_fit_leaves(factor):
    """Rows with errors of a known size, observed through a fit that took a fifth of them away.

    1200 rows of which 240 are fitted: the size has a spread of some 1 / sqrt(2 960) = 2.3 %, to
    which noise and the prior add; 15 % is never left by chance.
    """
    rng = np.random.default_rng(1)
    scene, p, _ = box_data()
    share = model_error(F_HZ, 4.0 * 60.0 / 94.0, 343.0, factor)
    observed = Observed(F_HZ, TAU_S, p, np.full(p.shape, 1e-4 * np.abs(p).max()))
    problem = wave_problem(scene, observed, None, EXACT)
    error = normal_numbers(rng, p.shape) * share * level_at(observed) / problem.sd
    rows = np.sqrt(2.0) * np.concatenate([error.real.ravel(), error.imag.ravel()])
    jacobian = rng.normal(size=(len(rows), len(rows) // 5))
    normal = jacobian.T @ jacobian
    left = rows - jacobian @ np.linalg.solve(normal, jacobian.T @ rows)
    linear = Whitened(left, jacobian, normal)
    assert marginal_likelihood_error(problem, linear) == pytest.approx(factor, rel=0.15)
    # what was fitted is as far off as its covariance says: 72 numbers, 240 squares of normal ones
    covariance = robust_covariance(problem, linear, factor, float(jacobian.shape[1]))
    off = np.linalg.solve(normal, jacobian.T @ rows)
    squares = np.mean(off**2 / np.diag(covariance))
    assert 0.7 < squares < 1.35


def test_where_noise_hides_the_error_of_the_model_half_of_the_allowance_is_believed():
    scene, p, _ = box_data()
    observed = noisy(F_HZ, TAU_S, p, 0.0, np.random.default_rng(2))
    problem = wave_problem(scene, observed, None, EXACT)
    rng = np.random.default_rng(3)
    rows = rng.normal(size=2 * p.size)
    jacobian = rng.normal(size=(len(rows), 5))
    linear = Whitened(rows, jacobian, jacobian.T @ jacobian)
    # a grid of 10 % steps
    assert marginal_likelihood_error(problem, linear) == pytest.approx(0.08, rel=0.15)
    assert marginal_likelihood_error(replace(problem, model_error=0.0), linear) == 0.0


def test_noise_that_is_unspecified_is_found_as_a_function_of_frequency():
    """Noise that grows tenfold from 200 to 800 Hz, and one pair with a spectral line of its own."""
    rng = np.random.default_rng(4)
    scene, p, r0 = box_data()
    truth = 0.01 * np.sqrt(np.mean(np.abs(p) ** 2)) * (F_HZ / 400.0) ** 1.66
    data = p + truth * normal_numbers(rng, p.shape)
    data[2, 15] += 0.1 * np.abs(p).max()
    settings = ImpedanceSettings(model_error=0.002)
    problem = wave_problem(scene, Observed(F_HZ, TAU_S, data), None, EXACT, settings)
    fit = polish(problem, start_with(problem, r0))
    found = estimated_noise(fit)
    assert found.shape == p.shape and np.ptp(found, axis=0).max() == 0.0
    # medians of 24 numbers and more: 20 % of spread each, some of it averaged out
    assert np.all(np.abs(np.log(found[0] / truth)) < 0.6)
    assert np.sqrt(np.mean(np.log(found[0] / truth) ** 2)) < 0.3
    # numbers that were fitted take from the residual what they explain, all but a hundredth at most
    model = 0.5 * np.mean(problem.sd**2, axis=0)
    n = len(fit.residual)
    squares = {
        effective: estimated_noise(replace(fit, effective=effective * n))[0] ** 2 + model
        for effective in (0.0, 0.5, 1.0)
    }
    np.testing.assert_allclose(squares[0.5], 2.0 * squares[0.0], rtol=1e-9)
    np.testing.assert_allclose(squares[1.0], 100.0 * squares[0.0], rtol=1e-9)


def start_with(problem, r0):
    """Return unknowns whose curves are the best of theirs to some R0."""
    x = start_of(problem)
    for place, curve, own in zip(problem.layout.curves, problem.curves, r0, strict=True):
        x[place] = nearest(curve, own)
    return x


def test_files_that_were_cut_one_by_one_have_each_a_clock_of_their_own():
    rng = np.random.default_rng(5)
    scene, p, r0 = box_data()
    late_s = 5e-5 * rng.normal(size=6)
    f = F_HZ - 0.5j / (np.pi * TAU_S)
    observed = noisy(F_HZ, TAU_S, p * np.exp(-2j * np.pi * f * late_s[:, None]), 40.0, rng)
    answer = identify_impedance(
        scene, observed, None, Nuisances(0.0, 0.0, delay_sd_s=1e-4, delay="pair"),
        rng=rng, settings=ROUGH,
    )  # fmt: skip
    assert answer.verdict.word == "identified"
    delays = [n for n in answer.nuisances if n.name.startswith("delay of S")]
    assert delays[1].name == "delay of S1 to R1"
    for found, truth in zip(delays, late_s, strict=True):
        assert abs(found.value - truth) < 5e-6
    assert rms_by_material(np.array([m.r0 for m in answer.materials]) - r0, F_HZ).max() <= 0.03
    with pytest.raises(InputError, match="unknown kind of delay"):
        Nuisances(delay="file")


def test_a_window_that_would_take_an_hour_is_refused_with_one_that_would_not():
    """Reflections grow with the fourth power of the window: what is advised is then accepted."""
    f = np.arange(100.0, 1001.0, 2.0)
    with pytest.raises(InputError, match="more reflections") as caught:
        wave_model(box_scene(), f, 0.06)
    advised_ms = float(str(caught.value).split("at most ")[1].split(" ms")[0])
    assert 10.0 < advised_ms < 60.0
    check_cost(box_scene(), len(f), 1e-3 * advised_ms, 7.0)
    with pytest.raises(InputError, match="more reflections"):
        check_cost(box_scene(), len(f), 1.02e-3 * advised_ms, 7.0)


@pytest.mark.slow
def test_a_hall_of_thousands_of_walls_is_refused_before_its_paths_are_looked_for():
    hall = hall_room()
    corners = hall.mesh.vertices_m
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    points = (
        Point("S", middle + np.array([1.0, 0.0, 1.0])),
        Point("R", middle + np.array([-3.0, 2.0, 1.0])),
    )
    scene = Scene(hall, points[:1], points[1:], np.array([[0, 0]]), Air())
    with pytest.raises(InputError, match="a room of fewer walls"):
        wave_model(scene, F_HZ, 0.015)


@pytest.mark.parametrize("size", [0.0, 0.02, 0.1, 0.5])
def test_the_interval_of_absorption_holds_it_even_where_a_wall_is_nearly_matched(size):
    """20,000 true walls about what was found: 95 % lie within, by a spread of 0.2 %."""
    rng = np.random.default_rng(9)
    spread = 0.05**2 * np.array([[[1.0, 0.3], [0.3, 0.7]]])
    reported = material_impedance("wall", "spline", np.array([size + 0.0j]), spread)
    off = rng.multivariate_normal([0.0, 0.0], spread[0], size=20_000)
    true = absorption_normal(size + off[:, 0] + 1j * off[:, 1])
    low, high = reported.absorption_normal_lower95[0], reported.absorption_normal_upper95[0]
    # squares are skewed near a matched wall
    assert 0.93 <= np.mean((low <= true) & (true <= high)) <= 0.985


def coloured_data(rng):
    """Data of the box whose two sources each have a spectrum of their own."""
    scene, p, r0 = box_data()
    size, phase = rng.normal(size=(2, 2, len(F_HZ)))
    clear = noisy(F_HZ, TAU_S, p, 40.0, rng)
    spectrum = np.exp(0.5 * size + 1j * phase)[scene.pairs[:, 0]]
    data = Observed(F_HZ, TAU_S, clear.pressure * spectrum, clear.noise * np.abs(spectrum))
    return scene, data, r0


def test_files_that_were_each_made_equally_loud_tell_walls_with_spectra_unknown_as_well():
    """Each file by a gain of its own, on top of the spectra of two sources."""
    rng = np.random.default_rng(7)
    scene, data, r0 = coloured_data(rng)
    loudest = np.abs(data.pressure).max(axis=1)[:, None]
    data = Observed(F_HZ, TAU_S, data.pressure / loudest, data.noise / loudest)
    answer = identify_impedance(
        scene, data, None, Nuisances(0.0, 0.0, "pair-spectrum"),
        rng=rng, settings=ROUGH,
    )  # fmt: skip
    assert answer.verdict.word == "identified"
    assert rms_by_material(np.array([m.r0 for m in answer.materials]) - r0, F_HZ).max() <= 0.04
    # the error is not taken to be less than the median of its prior
    assert answer.model_error >= 0.01
    assert sum(n.name.startswith("gain") for n in answer.nuisances) == 6


def test_a_room_that_is_not_convex_gives_back_its_walls():
    """Data of paths up to 1.4 times the length that the fit takes, from positions 10 mm off."""
    rng = np.random.default_rng(8)
    shape = l_shaped_room()
    room = replace(
        shape,
        materials=("plaster", "wool"),
        surface_material=np.array(
            [int(s.name == "ceiling") for s in shape.mesh.surfaces], dtype=np.int64
        ),
    )
    positions_m = np.array(
        [(1.0, 1.0, 1.2), (2.2, 4.1, 1.6), (2.1, 3.2, 1.7), (4.6, 0.8, 0.9), (1.3, 2.4, 0.6)]
    )
    pairs = np.array([(0, 0), (0, 1), (1, 2), (1, 0), (0, 2)])

    def scene(at):
        points = [Point(f"P{i}", p) for i, p in enumerate(at)]
        air = Air(speed_of_sound_m_s=343.0, attenuation="none")
        return Scene(room, tuple(points[:2]), tuple(points[2:]), pairs, air)

    f, tau_s = np.arange(300.0, 801.0, 25.0), 0.004
    longer = wave_model(
        scene(positions_m + 0.01 * rng.normal(size=positions_m.shape)), f, 1.4 * tau_s
    )
    model = replace(longer, tau_s=tau_s)
    r0 = true_r0(Observed(f, tau_s, np.ones((1, len(f)))), room.materials)
    p = predicted_pressure(model, r0, at_rest(model))
    answer = identify_impedance(
        scene(positions_m), noisy(f, tau_s, p, 40.0, rng), rng=rng, settings=ImpedanceSettings(0)
    )
    assert answer.verdict.word == "identified"
    # as A10 of docs/impedance.md, with a third of its data
    off = rms_by_material(np.array([m.r0 for m in answer.materials]) - r0, f)
    assert off.max() <= 0.03
