"""A profile and what else is reported of the same unknown, against integrals and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from roomfit.base.bands import bands_between
from roomfit.materials.priors import unknown_material
from roomfit.uncertainty.gaussian import prior_only_band
from roomfit.uncertainty.profile import RISE95, Profile, profile_under
from roomfit.uncertainty.smoothing import smoothed

Z95 = 1.959963984540054


def rise(x: float) -> float:
    """Return a skew rise about 0: flat below, steep above, as of a hard wall in the logit."""
    return float((np.exp(0.8 * x) - 1.0) ** 2 / 0.4)


def skew() -> Profile:
    """Return that rise as a profile at eleven points."""
    points = np.linspace(-4.0, 1.5, 12)
    at = np.array([rise(float(x)) for x in points] + [0.0])
    points = np.append(points, 0.0)
    order = np.argsort(points)
    lower, upper = (brentq(lambda x: rise(x) - RISE95, 0.0, x) for x in (-4.0, 3.0))
    return Profile(0, points[order], at[order], lower, upper, False, 12)


def straight(sd: float) -> Profile:
    points = np.linspace(-2.0, 2.0, 9) * sd
    return Profile(0, points, 0.5 * (points / sd) ** 2, -Z95 * sd, Z95 * sd, False, 9)


@pytest.mark.parametrize("mean", [-2.0, 0.3, 4.0])
def test_two_gaussians_multiply(mean: float) -> None:
    """Precisions add, and the ends are those of the product, wherever the other's mean is."""
    one, other = 0.6, 0.9
    precision = one**-2 + other**-2
    centre = mean * other**-2 / precision
    ends = profile_under(straight(one), (Z95 * one, Z95 * one), mean, other**-2)
    expected = centre + np.array([-1.0, 1.0]) * Z95 / np.sqrt(precision)
    # the grid's step, and a curve interpolated between nine points
    np.testing.assert_allclose(ends, expected, atol=0.01)


def test_with_nothing_specified_a_profile_keeps_its_ends_and_takes_the_sides_it_is_given() -> None:
    plain = straight(0.5)
    np.testing.assert_allclose(profile_under(plain, (1.3, 2.0), 7.0, 0.0), (-1.3, 2.0), atol=0.01)


def test_a_skew_profile_and_a_gaussian_rise_together_by_1_92() -> None:
    """Against the ends of the sum of both formulas, found by bracketing."""
    found = skew()
    mean, information = -1.5, 1.0 / 0.7**2

    def whole(x: float) -> float:
        return rise(x) + 0.5 * information * (x - mean) ** 2

    grid = np.linspace(-5.0, 2.0, 70_001)
    bottom = float(grid[int(np.argmin([whole(float(x)) for x in grid[::10]])) * 10])
    lowest = whole(bottom)
    expected = (
        brentq(lambda x: whole(x) - lowest - RISE95, -9.0, bottom),
        brentq(lambda x: whole(x) - lowest - RISE95, bottom, 4.0),
    )
    ends = profile_under(found, (-found.lower, found.upper), mean, information)
    # twelve points of the curve
    np.testing.assert_allclose(ends, expected, atol=0.03)


def test_profiles_stay_profiles_under_smoothness() -> None:
    """One band of a hard wall between two others: its profile is kept, and its side."""
    bands = bands_between("octave", 500, 2000)
    priors = (unknown_material("wall", 3),)
    reported = [prior_only_band(priors, band) for band in range(3)]
    free, sd = -3.0, 0.8
    found = skew()
    profile = replace(
        found, points=found.points + free, lower=found.lower + free, upper=found.upper + free
    )

    def share(x: float) -> float:
        return float(1.0 / (1.0 + np.exp(-x)))

    reported[1] = replace(
        reported[1],
        absorption=np.array([share(free)]),
        lower95=np.array([share(profile.lower)]),
        upper95=np.array([share(profile.upper)]),
        logit_mean=np.array([free]),
        logit_covariance=np.array([[sd**2]]),
        kinds=("profile",),
        profiles=(profile,),
        model="coherent",
        chi2_reduced=1.0,
    )
    (_, loose, _) = smoothed(reported, priors, bands, 1e6)
    np.testing.assert_allclose(loose.lower95, reported[1].lower95, rtol=0.02)
    np.testing.assert_allclose(loose.upper95, reported[1].upper95, rtol=0.02)
    # bands that know only the same prior have nothing to add
    (_, alone, _) = smoothed(reported, priors, bands, 0.5)
    np.testing.assert_allclose(alone.lower95, loose.lower95, rtol=1e-9)
    np.testing.assert_allclose(alone.upper95, loose.upper95, rtol=1e-9)
    for band in (0, 2):
        own = {"logit_mean": np.array([-2.8]), "logit_covariance": np.array([[0.6**2]])}
        reported[band] = replace(reported[band], model="coherent", chi2_reduced=1.0, **own)
    (_, tight, _) = smoothed(reported, priors, bands, 0.5)
    assert loose.kinds == tight.kinds == ("profile",)
    assert tight.lower95[0] > loose.lower95[0]
    # below, the likelihood is flat and a Gaussian's end would lie far beyond where it rises
    assert tight.lower95[0] <= tight.absorption[0] <= tight.upper95[0]
