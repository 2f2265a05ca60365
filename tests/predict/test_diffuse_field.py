"""Decay times and nothing else: mean absorption by four formulas, materials by their priors."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.files.questions import areas_by_axis_m2
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import unknown_material
from roomfit.model.eyring import eyring_time_s
from roomfit.predict.diffuse_field import (
    FORMULAS,
    absorption_area_m2,
    diffuse_absorption,
)
from roomfit.room.scene import shoebox_room
from small_campaign import run_command

BANDS = bands_between("octave", 500, 1000)
AREAS_M2 = np.array([[30.0, 0.0], [36.0, 0.0], [40.0, 40.0]])  # walls and ceiling, floor
C = 343.98


def found(decay_s, priors, areas_m2=AREAS_M2, volume_m3=120.0, m=(0.0, 0.0)):
    return diffuse_absorption(
        np.atleast_2d(decay_s), BANDS, priors, areas_m2, volume_m3,
        speed_of_sound_m_s=C, attenuation_per_m=np.array(m),
    )  # fmt: skip


@pytest.mark.parametrize("formula", FORMULAS)
def test_the_derivative_of_the_area_is_that_of_finite_differences(formula):
    alpha = np.array([0.12, 0.43])
    _, derivative = absorption_area_m2(formula, alpha, AREAS_M2)
    for k, step in enumerate(1e-6 * np.eye(2)):
        up, down = (absorption_area_m2(formula, alpha + s, AREAS_M2)[0] for s in (step, -step))
        assert derivative[k] == pytest.approx((up - down) / 2e-6, rel=1e-7)


def test_eyring_is_the_inverse_of_eyring_s_time_with_air():
    """A room of one material with a broad prior: the datum of 5 % decides, as if alone."""
    air = np.array([0.001, 0.002])
    times = eyring_time_s(np.full(2, 0.2), 120.0, 146.0, C, air)
    answer = found(times, (unknown_material("room", 2),), np.full((3, 1), 146.0 / 3), m=air)
    eyring = answer.mean[FORMULAS.index("Eyring")]
    # a prior of 1.5 in logit moves a datum of .06 in logit by (.06 / 1.5)^2 of its distance, 0.3
    np.testing.assert_allclose(eyring[0], 0.2, atol=2e-4)
    assert np.all((eyring[1] < 0.2) & (eyring[2] > 0.2))
    np.testing.assert_allclose(eyring[2] - eyring[1], 2 * 1.96 * 0.055 * 0.2 * 0.9, rtol=0.15)


def test_formulas_are_in_the_order_that_theory_says():
    """ln(1 - a) < -a: Sabine's absorption is larger. Uneven walls: Arau's room decays slower.

    And Fitzroy's the slowest: a harmonic mean is below a geometric one.
    """
    priors = (
        material_prior("walls", BANDS, prior=(0.05, 0.01)),
        material_prior("floor", BANDS, prior=(0.6, 0.05)),
    )
    answer = found([0.6, 0.6], priors)
    sabine, eyring, arau, fitzroy = answer.mean[:, 0]
    assert np.all(sabine > eyring)
    assert np.all(arau > eyring)
    # between them the priors, which are narrow, leave little
    assert np.all(fitzroy > arau - 0.01)


def test_fitzroy_s_time_is_the_mean_of_the_times_that_each_pair_of_walls_would_give():
    alpha = np.array([0.12, 0.43])
    area, _ = absorption_area_m2("Fitzroy", alpha, AREAS_M2)
    total, inverse = AREAS_M2.sum(), 0.0
    for across in AREAS_M2:
        own = across @ alpha / across.sum()
        inverse += across.sum() / total / (-total * np.log(1.0 - own))
    assert 1.0 / area == pytest.approx(inverse, rel=1e-12)


def test_intervals_allow_for_what_formulas_disagree_on_and_for_nothing_where_they_agree():
    """Alike: 5 % of the time alone. A soft floor: by the two areas' ratio."""
    alike = found(
        [0.9, 0.9], (material_prior("room", BANDS, prior=(0.15, 0.1)),), np.full((3, 1), 48.0)
    )
    _, eyring, _, fitzroy = alike.mean[:, 2] - alike.mean[:, 1]
    np.testing.assert_allclose(eyring, fitzroy, rtol=1e-9)
    priors = tuple(
        material_prior(n, BANDS, prior=(a, s))
        for n, a, s in (("walls", 0.05, 0.02), ("floor", 0.6, 0.2))
    )
    uneven = found([0.6, 0.6], priors)
    eyring = uneven.mean[FORMULAS.index("Eyring")]
    own = uneven.absorption[FORMULAS.index("Eyring"), :, 0, 0]
    areas = {f: absorption_area_m2(f, own, AREAS_M2)[0] for f in FORMULAS}
    apart = np.log(areas["Eyring"] / areas["Fitzroy"])
    assert apart > 0.2
    relative = (eyring[2] - eyring[1]) / eyring[0]
    # less than the datum alone would leave, for the priors know something too
    assert np.all(
        (relative > 0.2 * 2 * 1.96 * apart) & (relative < 2 * 1.96 * np.hypot(apart, 0.05))
    )


def test_priors_decide_the_split_and_the_mean_stays():
    """A known floor leaves all to the walls; the mean is that of the broad priors within 5 %.

    By 3 % it moves since the floor is the softer then, and formulas disagree by more.
    """
    known = (unknown_material("walls", 2), material_prior("floor", BANDS, absorption=0.3))
    broad = tuple(unknown_material(n, 2) for n in ("walls", "floor"))
    given, free = (found([0.9, 0.9], priors) for priors in (known, broad))
    np.testing.assert_allclose(given.absorption[:, 1], 0.3, rtol=1e-6)
    np.testing.assert_allclose(given.mean[:2, 0], free.mean[:2, 0], rtol=0.05)
    width = free.absorption[:, :, 2] - free.absorption[:, :, 1]
    assert np.all(width > 3.0 * (free.mean[:, 2] - free.mean[:, 1])[:, None])


def test_more_positions_narrow_the_interval_to_five_percent_and_no_further():
    rng = np.random.default_rng(3)
    one = (unknown_material("room", 2),)
    areas = np.full((3, 1), 146.0 / 3)
    few, many = (found(0.9 * (1 + 0.2 * rng.normal(size=(n, 2))), one, areas) for n in (3, 300))
    relative = [answer.decay_sd_s / answer.decay_s for answer in (few, many)]
    assert np.all(relative[0] > relative[1])
    np.testing.assert_allclose(relative[1], 0.05, rtol=0.05)


def test_areas_across_the_axes_are_those_of_a_box():
    room = shoebox_room(
        (6.0, 5.0, 3.0), {"walls": "plaster", "floor": "carpet", "ceiling": "plaster"}
    )
    np.testing.assert_allclose(
        areas_by_axis_m2(room), [[30.0, 0.0], [36.0, 0.0], [30.0, 30.0]], atol=1e-9
    )


TABLE = "position;500;1000\nseat 1;0,62;0,58\nseat 2;0,66;\n"


@pytest.mark.parametrize("room", [True, False])
def test_the_command_prints_every_formula_with_a_room_or_volume_and_surface(
    tmp_path, monkeypatch, capsys, room
):
    (tmp_path / "t30.csv").write_text(TABLE)
    text = '[reverberation]\nfile = "t30.csv"\n'
    text += "[room]\nshoebox = [6, 5, 3]\n" if room else "volume_m3 = 90\nsurface_m2 = 126\n"
    campaign = tmp_path / "campaign.toml"
    campaign.write_text(text)
    assert run_command(monkeypatch, "reverberation", campaign) == 0
    shown = capsys.readouterr().out
    assert all(f"Absorption by {formula}" in shown for formula in FORMULAS)
    assert ("west" in shown) == room
    assert "nothing more is known of any of them" in " ".join(shown.split())
    out = tmp_path / "page"
    assert run_command(monkeypatch, "reverberation", campaign, "--out", out) == 0
    assert run_command(monkeypatch, "reverberation", campaign, "--out", out) == 2  # not empty
    rows = list(csv.DictReader((out / "reverberation.csv").open()))
    (own,) = [
        r for r in rows if (r["formula"], r["material"], r["band_hz"]) == ("Eyring", "", "500")
    ]
    assert float(own["lower95"]) < float(own["absorption"]) < float(own["upper95"])
    assert len(rows) == len(FORMULAS) * 2 * (7 if room else 2)  # materials and the mean
    assert run_command(monkeypatch, "identify", campaign, "--out", tmp_path / "out") == 2
    assert ("roomfit reverberation" in capsys.readouterr().err) == room


def test_walls_may_absorb_next_to_nothing_but_not_less():
    """Sabine's decay by the air and by a third of a square metre of walls, and by less than air."""
    m, room = np.full(2, 0.01), (unknown_material("room", 2),)
    for area_m2 in (0.3, -0.3):
        decay_s = 24.0 * np.log(10.0) * 120.0 / (C * (area_m2 + 4.0 * 120.0 * m))
        if area_m2 > 0.0:
            sabine = found(decay_s, room, np.full((3, 1), 40.0), m=m).mean[FORMULAS.index("Sabine")]
            assert np.all((sabine[1] <= area_m2 / 120.0) & (area_m2 / 120.0 <= sabine[2]))
            continue
        with pytest.raises(InputError, match="no absorption of walls"):
            found(decay_s, room, np.full((3, 1), 40.0), m=m)


def test_a_decay_longer_than_air_permits_is_refused():
    with pytest.raises(InputError, match="no absorption of walls"):
        found([9.0, 9.0], (unknown_material("room", 2),), np.full((3, 1), 40.0), m=(0.01, 0.01))
