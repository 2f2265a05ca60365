"""Posteriors as records and as draws: what they keep, and the laws that their draws follow."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.base.logit import expit, logit
from roomfit.uncertainty.gaussian import prior_absorptions, prior_only_band
from roomfit.uncertainty.posterior import (
    AbsorptionPosterior,
    covariance_from_intervals,
    plain_logit_covariance,
    prior_draws,
)

BANDS = bands_between("octave", 500, 1000)
A = np.array([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])


def arrays() -> dict[str, Any]:
    """Return every array that a posterior of three materials in two bands may hold."""
    return {
        "absorption": A.copy(),
        "lower95": 0.5 * A,
        "upper95": 1.5 * A,
        "logit_covariance": np.tile(0.04 * np.eye(3), (2, 1, 1)),
        "prior_logit_mean": logit(A),
        "prior_logit_sd": np.full((3, 2), 1.5),
        "prior_logit_covariance": np.tile(2.25 * np.eye(3), (2, 1, 1)),
        "scattering": np.array([[0.1, 0.2], [np.nan, np.nan], [0.0, 1.0]]),
        "by_pressures": np.array([True, False]),
        "chi2_reduced": np.array([0.0, 1.5]),
        "prior_specified": np.array([True, False, True]),
        "draws": np.tile(A, (4, 1, 1)),
        "areas_m2": np.array([0.0, 10.0, 20.0]),
    }


@pytest.mark.parametrize(
    ("name", "at", "value", "words"),
    [
        ("absorption", (0, 0), 1.001, "absorption"),
        ("absorption", (0, 0), -0.001, "absorption"),
        ("lower95", (1, 1), -0.001, "lower95"),
        ("upper95", (1, 1), 1.001, "upper95"),
        ("prior_logit_mean", (0, 1), 50.1, "prior_logit_mean"),
        ("prior_logit_mean", (0, 1), -50.1, "prior_logit_mean"),
        ("prior_logit_sd", (0, 1), 50.1, "prior_logit_sd"),
        ("prior_logit_sd", (0, 1), -0.1, "prior_logit_sd"),
        ("scattering", (0, 0), 1.001, "scattering"),
        ("scattering", (1, 0), 0.5, "scattering"),  # NaN beside a number is no row of NaN
        ("chi2_reduced", (0,), -0.1, "chi-square"),
        ("draws", (0, 0, 0), 1.001, "draws"),
        ("draws", (0, 0, 0), -0.001, "draws"),
        ("areas_m2", (0,), -0.1, "areas"),
        ("logit_covariance", (0, 0, 0), -0.01, "the covariance of logit absorption is none"),
        ("logit_covariance", (1, 0, 1), 0.01, "the covariance of logit absorption is none"),
    ],
)  # fmt: skip
def test_what_no_posterior_can_hold_is_refused_by_its_name(name, at, value, words):
    given = arrays()
    given[name][at] = value
    with pytest.raises(InputError, match=words):
        AbsorptionPosterior(("a", "b", "c"), BANDS, **given)


def test_the_covariance_of_a_bounded_absorption_is_that_of_finite_differences() -> None:
    """logit a by the logit of its share between bounds; without bounds nothing changes."""
    lower, upper = np.array([0.0, 0.1, 0.0]), np.array([1.0, 1.0, 0.7])
    rng = np.random.default_rng(1)
    root = rng.normal(size=(2, 3, 3))
    covariance = root @ root.transpose(0, 2, 1)
    found = plain_logit_covariance(covariance, A[:, ::-1], lower, upper)

    def plain(x: Any) -> Any:
        return logit(lower[:, None] + (upper - lower)[:, None] * expit(x))

    x = logit((A[:, ::-1] - lower[:, None]) / (upper - lower)[:, None])
    slope = ((plain(x + 1e-6) - plain(x - 1e-6)) / 2e-6).T
    np.testing.assert_allclose(found, covariance * slope[:, :, None] * slope[:, None, :], rtol=1e-7)


def test_intervals_give_the_mean_of_their_sides_and_open_ones_the_other_side() -> None:
    """In logit; both open: the broad prior's 1.5. No width is no variance."""
    middle, sides = 0.3, (0.4, 0.8)
    low, high = (float(expit(logit(middle) + z)) for z in (-1.959964 * 0.4, 1.959964 * 0.8))
    a = np.full((5, 1), middle)
    lower = np.array([[low], [0.0], [low], [0.0], [middle]])
    upper = np.array([[high], [high], [1.0], [1.0], [middle]])
    found = covariance_from_intervals(a, lower, upper)
    assert found.shape == (1, 5, 5)
    sd = [0.5 * sum(sides), sides[1], sides[0], 1.5, 0.0]
    np.testing.assert_allclose(found[0], np.diag(np.square(sd)), rtol=1e-6, atol=1e-15)


def test_draws_of_a_prior_have_its_law_and_keep_what_is_fixed_or_tied():
    """Mirrored pairs have the prior's mean exactly; 4,000 its covariance within 7 %."""
    a, mean = np.array([0.2, 0.3, 0.3, 0.6]), np.array([-1.0, 0.5, 0.5, 0.0])
    prior = np.array([[1.0, 0.3, 0.3, 0.0], [0.3, 0.5, 0.5, 0.0], [0.3, 0.5, 0.5, 0.0],
                      [0.0, 0.0, 0.0, 0.25]])  # fmt: skip
    answer = 0.1 * prior
    answer[3] = answer[:, 3] = 0.0
    found = prior_draws(a, answer, mean, prior, 4000, np.random.default_rng(5))
    np.testing.assert_array_equal(found[:, 3], 0.6)
    np.testing.assert_array_equal(found[:, 1], found[:, 2])
    x = logit(found[:, :2])
    np.testing.assert_allclose(x.mean(axis=0), mean[:2], atol=1e-12)
    np.testing.assert_allclose(np.cov(x.T), prior[:2, :2], rtol=0.07, atol=0.03)


def test_a_band_without_data_has_the_prior_and_0_to_1_where_none_was_stated():
    """Between its bounds; a known absorption stands, and a tied one is that of its leader."""
    priors = (
        roomfit.material_prior("open", BANDS),
        roomfit.material_prior("stated", BANDS, prior=(0.3, 0.05), bounds=(0.1, 0.8)),
        roomfit.material_prior("known", BANDS, absorption=[0.2, 0.7]),
        roomfit.material_prior("twin", BANDS, same_absorption_as="stated"),
    )
    found = prior_only_band(priors, 1)
    k = priors[1]
    free, sd = found.logit_mean[1], np.sqrt(found.logit_covariance[1, 1])
    share = [expit(free + z * sd) for z in (-1.959964, 0.0, 1.959964)]
    expected = k.lower + (k.upper - k.lower) * np.array(share)
    np.testing.assert_allclose(
        [found.lower95[1], found.absorption[1], found.upper95[1]], expected, rtol=1e-6
    )
    assert 0.1 < found.lower95[1] < found.absorption[1] < found.upper95[1] < 0.8
    assert (found.lower95[0], found.upper95[0]) == (0.0, 1.0)
    assert found.absorption[2] == found.lower95[2] == found.upper95[2] == 0.7
    assert not np.any(found.logit_covariance[2]) and not np.any(found.logit_covariance[:, 2])
    for values in (found.lower95, found.absorption, found.upper95):
        assert values[3] == values[1]
    drawn = prior_absorptions(priors, 1, 4000, np.random.default_rng(7))
    np.testing.assert_array_equal(drawn[:, 2], 0.7)
    np.testing.assert_array_equal(drawn[:, 3], drawn[:, 1])
    assert drawn[:, 1].min() > 0.1 and drawn[:, 1].max() < 0.8
    # 95 % of 4,000, give or take three times 0.35 %
    inside = (found.lower95[1] < drawn[:, 1]) & (drawn[:, 1] < found.upper95[1])
    assert 0.939 < inside.mean() < 0.961
    # free numbers of the open one: their mean and spread, to five of its standard deviations
    x = logit(drawn[:, 0])
    own = np.sqrt(found.logit_covariance[0, 0])
    assert x.mean() == pytest.approx(found.logit_mean[0], abs=5.0 * own / np.sqrt(4000.0))
    assert x.std() == pytest.approx(own, rel=0.06)
