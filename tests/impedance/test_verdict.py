"""How sure walls are: the model's own error, unspecified noise, clocks, and what is too much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from images_reference import l_shaped_room
from roomfit.base.air import Air
from roomfit.base.errors import InputError
from roomfit.impedance.data import Observed
from roomfit.impedance.identify import ImpedanceSettings, identify_impedance
from roomfit.impedance.laws import absorption_normal, absorption_random, impedance_of_r0
from roomfit.impedance.result import material_impedance
from roomfit.impedance.wave_model import (
    Nuisances,
    at_rest,
    check_cost,
    predicted_pressure,
    wave_model,
)
from roomfit.room.scene import Point, Scene
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
    check_cost(box_scene(), len(f), 1e-3 * advised_ms)
    with pytest.raises(InputError, match="more reflections"):
        check_cost(box_scene(), len(f), 1.02e-3 * advised_ms)


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
    model = longer._replace(tau_s=tau_s)
    r0 = true_r0(Observed(f, tau_s, np.ones((1, len(f)))), room.materials)
    p = predicted_pressure(model, r0, at_rest(model))
    answer = identify_impedance(
        scene(positions_m), noisy(f, tau_s, p, 40.0, rng), rng=rng, settings=ImpedanceSettings(0)
    )
    assert answer.verdict.word == "identified"
    # as A10 of docs/impedance.md, with a third of its data
    off = rms_by_material(np.array([m.r0 for m in answer.materials]) - r0, f)
    assert off.max() <= 0.03


SPREAD = np.array([[4.0, 1.0], [1.0, 2.0]])


@pytest.mark.parametrize("r0", [0.6 - 0.3j, -0.2 + 0.5j, 0.05 + 0.02j])
def test_small_errors_of_r0_reach_as_far_as_the_derivatives_say(r0):
    """1.96 standard deviations of each quantity by 20,000 draws, known to 2 %."""
    covariance = 1e-6 * SPREAD
    found = material_impedance("wall", "spline", np.array([r0]), covariance[None])
    off = np.random.default_rng(1).multivariate_normal([0.0, 0.0], covariance, size=20_000)
    drawn = r0 + off[:, 0] + 1j * off[:, 1]
    for name, values in (
        ("r0", drawn),
        ("absorption_normal", absorption_normal(drawn)),
        ("absorption_random", absorption_random(drawn)),
        ("admittance", (1.0 - drawn) / (1.0 + drawn)),
        ("impedance", impedance_of_r0(drawn)),
    ):
        middle = getattr(found, name)[0]
        low, high = getattr(found, f"{name}_lower95")[0], getattr(found, f"{name}_upper95")[0]
        own = np.trace(covariance) if name == "absorption_normal" else 0.0
        for part, extra in (("real", own), ("imag", 0.0)):
            reach = 1.96 * np.std(getattr(values, part))
            above = float(getattr(np.asarray(high - middle), part))
            below = float(getattr(np.asarray(middle - low), part))
            assert above == pytest.approx(reach, rel=0.03, abs=1e-9), (name, part)
            assert below == pytest.approx(reach + extra, rel=0.03, abs=1e-9), (name, part)
    assert found.identified[0] and found.impedance_shown[0]
