"""A whole campaign: how each interval was made, the priors, and what was chosen."""

from __future__ import annotations

import numpy as np

from coherent_cases import estimate_of
from roomfit.base.bands import Bands
from roomfit.checks import convergence, prior
from roomfit.fit.methods import interval_words, prior_intervals, reasons
from roomfit.materials.priors import MaterialPrior, unknown_material
from seen import of_answers


def test_prior_intervals_follow_bounds_ties_and_fixed_values():
    bounded = MaterialPrior("b", np.zeros(1), np.ones(1), lower=0.2, upper=0.6)
    fixed = MaterialPrior("h", np.zeros(1), np.ones(1), known=np.array([0.3]))
    tied = MaterialPrior("t", np.zeros(1), np.ones(1), tied_to="b")
    found = prior_intervals((bounded, fixed, tied))[:, :, 0]
    high = 0.2 + 0.4 / (1.0 + np.exp(-1.959964))
    np.testing.assert_allclose(found[:, 0], [0.4, 0.8 - high, high], atol=1e-6)
    np.testing.assert_allclose(found[:, 1], 0.3)
    np.testing.assert_allclose(found[:, 2], found[:, 0])


def test_only_a_specified_prior_is_reported():
    """The answer's variance of 0.01 is small beside the broad prior's, and all of the other's."""
    bands, answer = Bands("octave", [500.0]), estimate_of([0.3, 0.3], 0.05)
    broad = unknown_material("x", 1)
    narrow = MaterialPrior("y", np.full(1, -0.85), np.full(1, 0.1))
    (finding,) = prior.check(of_answers([answer], bands, priors=(broad, narrow)))
    assert finding.evidence["material"] == "y"
    assert finding.evidence["spread_left"] == [1.0]
    assert not list(prior.check(of_answers([answer], bands, priors=(broad, broad))))


def test_reasons_of_plain_answers():
    bands, answer = Bands("octave", [500.0]), estimate_of([0.3, 0.3], 0.05)
    assert interval_words([answer]) == "Gaussian, local"
    assert reasons("least-squares", bands, [answer]) == ()
    assert len(reasons("auto", bands, [answer])) == 2
    assert not list(convergence.check_samples(of_answers([answer], bands)))
