"""A whole campaign: how each interval was made, the priors, and what was chosen."""

from __future__ import annotations

import json

import numpy as np
import pytest

import roomfit.io.campaign
from coherent_cases import estimate_of
from roomfit.bands import Bands
from roomfit.commands import identify_to_folder
from roomfit.diagnostics import convergence, prior
from roomfit.inversion.methods import interval_words, prior_intervals, reasons
from roomfit.materials.priors import MaterialPrior, unknown_material
from roomfit.settings import Settings
from seen import of_answers
from small_campaign import write_campaign

QUICK = ("to_hz = 1000", 'to_hz = 500\nmodel = "energy"\nmethod = "posterior"')
SPECIFIED = ("[materials.tiles]", "[materials.tiles]\nprior = {mean = [0.5], sd = [0.02]}")


@pytest.fixture(scope="module")
def reported(tmp_path_factory):
    """The result of one octave by samples, with a narrow and wrong prior of the ceiling."""
    folder = tmp_path_factory.mktemp("sure")
    campaign = write_campaign(folder / "c", QUICK, SPECIFIED)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roomfit.io.campaign, "DEFAULTS", Settings(n_rays=2000))
        answer = identify_to_folder(campaign, folder / "out", keep=False)
    return answer, json.loads((folder / "out" / "result.json").read_text()), folder / "out"


@pytest.mark.slow
def test_a_campaign_by_samples_says_how_they_came_about(reported):
    answer, result, folder = reported
    (sampling,) = result["fit"]["sampling"]
    assert sampling["converged"]
    assert sampling["independent"] > 200
    assert result["fit"]["method_chosen"] == "posterior"
    assert any("converged in 1 of 1 bands" in r for r in result["fit"]["reasons"])
    for name, material in result["materials"].items():
        assert material["interval"] == ["sampled"]
        assert material["lower95"][0] <= material["absorption"][0] <= material["upper95"][0]
        draws = answer.samples[0][:, answer.materials.index(name)]
        assert np.mean(draws <= material["upper95"][0]) == pytest.approx(0.975, abs=0.01)
    assert (folder / "corner_500_hz.png").exists()
    assert 'aria-labelledby="corner-title"' in (folder / "report.html").read_text()


@pytest.mark.slow
def test_a_prior_that_the_data_hardly_change_is_named_and_shown(reported):
    """0.5 +- 0.02 for a ceiling of 0.3: one octave's energies cannot correct it."""
    _, result, _ = reported
    (finding,) = [f for f in result["findings"] if f["code"] == "prior-dominated"]
    assert finding["evidence"]["material"] == "tiles"
    prior = result["materials"]["tiles"]["prior"]
    assert prior["absorption"] == [pytest.approx(0.5)]
    # sd of the logit: 0.02 / 0.25
    assert prior["upper95"][0] == pytest.approx(1.0 / (1.0 + np.exp(-1.96 * 0.08)), abs=1e-4)


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
