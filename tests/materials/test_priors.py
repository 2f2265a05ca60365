"""What is known of a material beforehand: what it may hold, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.materials.catalogue import material_prior
from roomfit.materials.priors import (
    DEFAULT_MEAN,
    MaterialPrior,
    are_specified,
    logit_normal,
    logit_prior,
    plain_logit_law,
    prior_logit_law,
    sampling_scattering,
    unknown_material,
)

MEAN, SD = np.zeros(3), np.ones(3)


@pytest.mark.parametrize("s", [0.05, 0.1, 0.2, 0.7])
def test_the_same_scattering_in_all_bands_is_traced_to_the_last_bit(s):
    # the mean of six times 0.1 is less than 0.1, and paths would be weighed anew for nothing
    six = MaterialPrior("wall", np.zeros(6), np.ones(6), scattering=np.full(6, s))
    assert np.mean(np.full(6, s)) != s
    assert sampling_scattering(six) == s


@pytest.mark.parametrize(
    ("specified", "words"),
    [
        ({"scattering": np.array([0.1, 0.2])}, "materials.wall.scattering has the wrong shape"),
        ({"known": np.array([0.1, np.nan, 0.2])}, "materials.wall.absorption is out of range"),
        ({"lower": 0.5, "upper": 0.5}, "lower bound is not below"),
        ({"tied_to": "wall"}, "tied to itself"),
        ({"tied_to": "floor", "known": np.full(3, 0.1)}, "has a value of its own"),
        ({"wall_delay_sd_s": 0.3}, "delay is out of range"),
    ],
)
def test_knowledge_that_cannot_be_is_refused(specified, words):
    with pytest.raises(InputError, match=words):
        MaterialPrior("wall", MEAN, SD, **specified)


def test_the_logit_prior_agrees_with_a_finite_difference():
    mean, sd = np.array([0.05, 0.5, 0.9]), np.array([0.01, 0.1, 0.02])
    logit_mean, logit_sd = logit_prior(mean, sd)
    np.testing.assert_allclose(1.0 / (1.0 + np.exp(-logit_mean)), mean, rtol=1e-12)
    step = 1e-5
    up = 1.0 / (1.0 + np.exp(-(logit_mean + step)))
    down = 1.0 / (1.0 + np.exp(-(logit_mean - step)))
    # central difference: error of the order step squared
    np.testing.assert_allclose(logit_sd * (up - down) / (2 * step), sd, rtol=1e-8)


BANDS = bands_between("octave", 500, 1000)


def test_bounds_of_a_material_hold_between_them_what_is_stated_of_it():
    """The share of the way between them has the logit law; a mean well inside is kept."""
    stated = material_prior("w", BANDS, prior=(0.3, 0.02), bounds=(0.1, 0.6))
    mean, sd = logit_prior(np.full(2, 0.4), np.full(2, 0.04))
    np.testing.assert_allclose([stated.prior_logit_mean, stated.prior_logit_sd], [mean, sd])
    assert (stated.lower, stated.upper, stated.specified) == (0.1, 0.6, True)
    broad = unknown_material("w", 2)
    for bounds, share in (
        ((0.05, 0.35), (DEFAULT_MEAN - 0.05) / 0.3),
        ((0.0, DEFAULT_MEAN / 0.899), 0.899),
        ((0.0, DEFAULT_MEAN / 0.901), 0.5),
        ((DEFAULT_MEAN - 0.0101, DEFAULT_MEAN + 0.0899), 0.101),
        ((DEFAULT_MEAN - 0.0099, DEFAULT_MEAN + 0.0901), 0.5),
        ((0.5, 0.501), 0.5),
    ):
        found = material_prior("w", BANDS, bounds=bounds)
        np.testing.assert_allclose(expit(found.prior_logit_mean), share, rtol=1e-6)
        np.testing.assert_array_equal(found.prior_logit_sd, broad.prior_logit_sd)
    for bounds in ((-0.01, 0.5), (0.5, 1.01), (0.5, 0.5009), (0.6, 0.5)):
        with pytest.raises(InputError, match="not below"):
            material_prior("w", BANDS, bounds=bounds)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"prior": (0.1, 0.1), "bounds": (0.1, 0.5)}, r"outside of its bounds.*\n.*w\.prior"),
        ({"prior": (0.5, 0.1), "bounds": (0.1, 0.5)}, "mean 0.5, sd 0.1 at 500 Hz"),
        ({"prior": ([0.3, 0.3], [0.1, 0.0])}, "mean 0.3, sd 0 at 1000 Hz"),
        ({"absorption": [0.2, 0.61], "bounds": (0.2, 0.6)}, r"own bounds(.|\n)*0\.61"),
        ({"absorption": [0.1, 0.2, 0.3]}, r"w\.absorption(.|\n)*3 values(.|\n)*2 values, or"),
        ({"prior": (0.1, [0.1, 0.2, 0.3])}, r"w\.prior\.sd"),
    ],
)
def test_what_cannot_be_stated_of_a_material_is_refused_with_its_band(arguments, words):
    with pytest.raises(InputError, match=words):
        material_prior("w", BANDS, **arguments)


def test_the_plain_law_of_an_object_is_that_of_its_absorption_to_first_order():
    """Between 0 and its bound it is another logit: the slope by finite differences."""
    wall = MaterialPrior("wall", np.array([0.3, -1.0]), np.array([0.5, 0.8]))
    object_ = MaterialPrior(
        "seats", np.array([-1.0, 0.4]), np.array([0.3, 0.2]), upper=0.4, object_volume_m3=50.0
    )
    of_product = [replace(wall, name=n, product="panel") for n in ("p", "q")]
    priors = (of_product[0], object_, of_product[1])
    mean, covariance = plain_logit_law(priors)
    own_mean, own_covariance = prior_logit_law(priors)

    def plain(x):
        return logit(0.4 * expit(x), 0.0)

    np.testing.assert_allclose(mean[1], plain(own_mean[1]), rtol=1e-12)
    np.testing.assert_array_equal(mean[[0, 2]], own_mean[[0, 2]])
    slope = (plain(own_mean[1] + 1e-5) - plain(own_mean[1] - 1e-5)) / 2e-5
    for band in range(2):
        by = np.diag([1.0, slope[band], 1.0])
        np.testing.assert_allclose(covariance[band], by @ own_covariance[band] @ by, rtol=1e-8)
        assert own_covariance[band][0, 2] > 0.0


def test_of_materials_of_a_product_the_law_of_the_unknown_is_that_given_the_known():
    """A normal law of three, by its conditional written out; the known keep theirs."""
    own, common, d = 0.3, 0.8, 0.25
    panels = [
        MaterialPrior(n, np.array([own]), np.array([common]), known=a, product="p", product_sd=d)
        for n, a in (("a", None), ("b", np.array([0.2])), ("c", None), ("e", np.array([0.5])))
    ]
    mean, covariance = prior_logit_law(tuple(panels))
    off = logit(np.array([0.2, 0.5])) - own
    # the shared part given two values that each lie off by d, and the own part of each
    precision = 1.0 / common**2 + 2.0 / d**2
    shared = float(off.sum() / d**2 / precision)
    np.testing.assert_allclose(mean[:, 0], [own + shared, own, own + shared, own])
    left = 1.0 / precision
    np.testing.assert_allclose(covariance[0][np.ix_([0, 2], [0, 2])], left + d**2 * np.eye(2))
    np.testing.assert_allclose(covariance[0][1], [0.0, common**2, 0.0, 0.0])
    plain = [unknown_material("x", 1), *(replace(p, specified=False) for p in panels)]
    assert are_specified(tuple(plain)).tolist() == [False, True, True, True, True]


def test_draws_about_a_mean_are_expit_of_the_first_order_law_and_the_mean_without_spread():
    mean, sd, z = np.array([0.2, 0.5, 1.0, 0.0]), np.array([0.1, 0.0, 0.0, 1e-5]), np.array([-1, 2])
    found = logit_normal(mean, sd, z)
    wanted = expit(logit(np.array(0.2)) + 0.1 / 0.16 * z)
    np.testing.assert_allclose(found[:, 0], wanted)
    np.testing.assert_array_equal(found[:, 1:3], [[0.5, 1.0]] * 2)
    np.testing.assert_allclose(found[:, 3], expit(logit(np.array(1e-4)) + 1e-5 / 9.999e-5 * z))
    np.testing.assert_array_equal(logit_normal(mean, sd, np.tile(z[:, None], 4)), found)
