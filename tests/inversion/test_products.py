"""Walls of one product from the campaign to the result file."""

from __future__ import annotations

import numpy as np
import pytest

import roomfit.io.campaign
from roomfit.cache import json_text
from roomfit.findings import Code
from roomfit.identification import identify
from roomfit.io.inputs import load_campaign
from roomfit.io.results import read_result, result_content
from roomfit.logit import logit
from roomfit.results import absorption_posterior
from roomfit.settings import Settings
from roomfit.uncertainty.posterior import draw_absorption, prior_law
from small_campaign import MATERIALS, write_campaign

SPLIT = """[room.materials]
west = "left"
east = "right"
south = "walls"
north = "walls"
floor = "carpet"
ceiling = "tiles"
[materials.left]
scattering = 0.0
product = "panel"
[materials.right]
scattering = 0.0
product = "panel"
[products.panel]
sd = 0.1
"""


@pytest.mark.slow
def test_a_campaign_with_a_product_is_answered_and_its_file_draws_the_same(tmp_path, monkeypatch):
    """One source, two receivers: what tells left from right is hardly more than the product."""
    monkeypatch.setattr(roomfit.io.campaign, "DEFAULTS", Settings(n_rays=4000))
    answer = identify(**load_campaign(write_campaign(tmp_path / "in", (MATERIALS, SPLIT))))
    left, right = (answer.materials.index(n) for n in ("left", "right"))
    (found,) = [f for f in answer.findings if f.code is Code.PRODUCT_ASSUMED]
    assert found.evidence == {"product": "panel", "materials": ["left", "right"], "sd": 0.1}
    assert answer.logit_prior is not None
    assert answer.logit_prior_covariance is not None
    np.testing.assert_allclose(answer.logit_prior[1, left], np.hypot(1.5, 0.1))
    assert answer.logit_prior_covariance[0, left, right] == 2.25
    apart = np.abs(logit(answer.absorption[left]) - logit(answer.absorption[right]))
    assert np.all(apart < 0.3)
    assert np.all(answer.interval_kinds[0][i] != "none" for i in (left, right))

    path = tmp_path / "result.json"
    content = result_content(answer, ())
    path.write_text(json_text(content))
    assert len(content["sd_without"]) == len(answer.bands)
    for band, covariance in zip(content["sd_without"], answer.logit_covariance, strict=True):
        assert set(band) >= {"nothing", "interference", "model", "prior", "gain", "air"}
        # what is reported also allows for absorption that changes within the band
        assert np.all(band["nothing"] <= np.sqrt(np.diag(covariance)) + 1e-3)
    read, made = read_result(path), absorption_posterior(answer)
    law, own = prior_law(read), prior_law(made)
    assert law is not None
    assert own is not None
    np.testing.assert_array_equal(law[1], own[1])
    draws = draw_absorption(read, 400, np.random.default_rng(1))
    np.testing.assert_allclose(
        draws, draw_absorption(made, 400, np.random.default_rng(1)), rtol=1e-9
    )
    # a difference of 0.1 sqrt(2) a priori, which data can only sharpen, and ends of bands widen
    spread = np.std(logit(draws[:, left]) - logit(draws[:, right]), axis=0)
    assert np.all(spread < 0.16)


@pytest.mark.slow
def test_a_result_of_independent_walls_holds_no_covariance_of_the_prior(tmp_path, monkeypatch):
    """The file is as it was; readers of it find none, and take walls for independent."""
    monkeypatch.setattr(roomfit.io.campaign, "DEFAULTS", Settings(n_rays=2000))
    answer = identify(**load_campaign(write_campaign(tmp_path / "in")))
    content = result_content(answer, ())
    assert "prior_logit_covariance" not in content["posterior"]
    path = tmp_path / "result.json"
    path.write_text(json_text(content))
    law = prior_law(read_result(path))
    assert law is not None
    np.testing.assert_allclose(law[1][0], 2.25 * np.eye(3))
