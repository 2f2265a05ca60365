"""A room before and after one wall is changed: what cancels, what is undetermined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import Bands
from roomfit.base.findings import Code
from roomfit.base.logit import logit
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import question_of
from roomfit.materials.priors import DEFAULT_LOGIT_SD
from roomfit.predict.changes import read_change
from roomfit.predict.predict import predict
from roomfit.predict.split import prior_dominated
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption
from small_campaign import ABSORPTION, write_campaign

BANDS = Bands("octave", np.array([500.0, 1000.0]))
NAMES = tuple(ABSORPTION)


def posterior(sd: float, materials: tuple[str, ...] = NAMES) -> AbsorptionPosterior:
    """Return independent materials, all with one standard deviation of logit absorption."""
    a = np.array([[ABSORPTION[n]] * 2 for n in materials])
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.96 * sd))) for s in (-1, 1))
    covariance = np.stack([np.eye(len(materials)) * sd**2] * 2)
    return AbsorptionPosterior(materials, BANDS, a, low, high, covariance)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return read_campaign(write_campaign(tmp_path_factory.mktemp("change") / "campaign"))


def changed(campaign, known, *texts: str, n_draws: int = 32):
    asked = question_of(campaign, known, [read_change(t) for t in texts])
    return predict(replace(asked, settings=replace(asked.settings, n_draws=n_draws)))


def test_what_is_common_to_both_states_cancels_in_the_change(campaign):
    """Walls unknown by a factor of two leave T20 open by as much, its ratio by a third of that.

    Another carpet reflects anew even where it absorbs as the one before.
    """
    known = posterior(0.0)
    covariance = np.zeros((2, 3, 3))
    covariance[:, 0, 0] = 0.4**2
    v = changed(campaign, replace(known, logit_covariance=covariance), "carpet=x1.02").mean["T20_s"]
    spread = np.log(v.change.before_upper95 / v.change.before_lower95)
    assert np.all(np.log(v.change.change_upper95 / v.change.change_lower95) < 0.4 * spread)


def test_no_change_has_no_direction(campaign):
    found = changed(campaign, posterior(0.3), "carpet=x1")
    for v in found.mean.values():
        neutral = 1.0 if v.change.change[0] > 0.5 else 0.0
        np.testing.assert_allclose(v.change.change, neutral, atol=1e-9)
    (said,) = [f for f in found.findings if f.code is Code.MATERIALS_CHANGED]
    assert "has no determined direction at 500, 1000 Hz" in said.sentence
    assert "rises" not in said.sentence and "falls" not in said.sentence


@pytest.mark.slow
def test_a_direction_is_said_where_the_data_support_it_and_not_where_they_do_not(campaign):
    """Walls of 0.15 become 0.1: known within some per cent T rises; unknown, it may fall."""
    sure = changed(campaign, posterior(0.05), "walls=0.1")
    (said,) = [f for f in sure.findings if f.code is Code.MATERIALS_CHANGED]
    assert "the mean of T30 rises at 500, 1000 Hz" in said.sentence
    assert said.evidence["directions"]["C80_dB"] == {"falls": [500.0, 1000.0]}
    known = posterior(0.05)
    covariance = known.logit_covariance.copy()
    covariance[:, 0, 0] = DEFAULT_LOGIT_SD**2
    unsure = changed(campaign, replace(known, logit_covariance=covariance), "walls=0.1")
    (said,) = [f for f in unsure.findings if f.code is Code.MATERIALS_CHANGED]
    assert set(said.evidence["directions"]["T30_s"]) == {"has no determined direction"}
    assert "T30 has no determined direction" in str(unsure)


def test_a_share_that_only_the_prior_knows_is_named_with_what_would_cure_it():
    """Ten equal areas each: a decay fixes the sum of three absorptions and nothing of its parts."""
    materials = ("walls", "curtain", "floor")
    mean = np.full((3, 2), logit(np.array(0.15)))
    sd = np.full((3, 2), DEFAULT_LOGIT_SD)
    a = np.full((3, 2), 0.15)
    precision = np.eye(3) / DEFAULT_LOGIT_SD**2
    decay = precision + np.ones((3, 3)) / 0.05**2
    apart = precision + np.eye(3) / 0.1**2

    def found(information, prior_sd=sd):
        covariance = np.stack([np.linalg.inv(information)] * 2)
        known = AbsorptionPosterior(materials, BANDS, a, a * 0.5, a * 2, covariance, mean, prior_sd)
        draws = draw_absorption(known, 400, np.random.default_rng(1))
        areas, rng = np.full(3, 10.0), np.random.default_rng(2)
        return prior_dominated(known, draws, ["curtain"], areas, rng)

    (one,) = found(decay)
    assert one.code is Code.CHANGE_PRIOR_DOMINATED
    assert one.evidence["bands_hz"] == [500.0, 1000.0]
    assert one.evidence["share"] == pytest.approx([1 / 3, 1 / 3])
    low, high = one.evidence["share_lower95"][0], one.evidence["share_upper95"][0]
    assert low < 0.12 and high > 0.6
    assert f"{100 * low:.0f} to {100 * high:.0f} %" in one.sentence
    assert 'prior = "curtain", "curtain-light"' in one.sentence and "roomfit design" in one.sentence
    # known one by one within a tenth, or stated within a fifth: nothing to say
    assert found(apart) == ()
    narrow = np.full((3, 2), 0.2)
    stated = np.eye(3) / 0.2**2 + np.ones((3, 3)) / 0.05**2
    assert found(stated, narrow) == ()


def test_a_material_that_was_not_found_is_predicted_but_not_compared(campaign):
    found = changed(campaign, posterior(0.05, ("walls", "tiles")), "carpet=0.3+-0.05")
    assert not found.compares_states
    assert found.mean["T20_s"].change is None
    assert found.lower95[1, 0] > 0.15 and found.upper95[1, 0] < 0.5


# ---------------------------------------------------------------- names of materials
