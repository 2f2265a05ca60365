"""What is known of a material beforehand: what it may hold, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.errors import InputError
from roomfit.findings import Code
from roomfit.materials.catalogue import product_findings
from roomfit.materials.priors import (
    MaterialPrior,
    logit_prior,
    prior_logits,
    sampling_scattering,
    unknown_material,
)

MEAN, SD = np.zeros(3), np.ones(3)


def test_an_unknown_material_has_the_broad_prior_and_nothing_else():
    plain = unknown_material("wall", 3)
    assert plain.prior_logit_mean.shape == plain.prior_logit_sd.shape == (3,)
    assert plain.scattering is None
    assert plain.known is None
    assert plain.tied_to is None
    assert plain.wall_delay_sd_s is None
    assert not plain.fit_scattering
    assert sampling_scattering(plain) is None


def test_the_trace_samples_with_the_mean_scattering_of_the_bands():
    specified = MaterialPrior("wall", MEAN, SD, scattering=np.array([0.1, 0.2, 0.6]))
    assert sampling_scattering(specified) == pytest.approx(0.3)


@pytest.mark.parametrize("s", [0.05, 0.1, 0.2, 0.7])
def test_the_same_scattering_in_all_bands_is_traced_to_the_last_bit(s):
    # the mean of six times 0.1 is less than 0.1, and paths would be weighed anew for nothing
    six = MaterialPrior("wall", np.zeros(6), np.ones(6), scattering=np.full(6, s))
    assert np.mean(np.full(6, s)) != s
    assert sampling_scattering(six) == s


def test_arrays_are_copies_that_cannot_be_changed():
    scattering = np.array([0.1, 0.2, 0.3])
    specified = MaterialPrior("wall", MEAN, SD, scattering=scattering)
    scattering[0] = 0.9
    assert specified.scattering[0] == pytest.approx(0.1)
    with pytest.raises(ValueError, match="read-only"):
        specified.scattering[0] = 0.5


@pytest.mark.parametrize(
    ("specified", "words"),
    [
        ({"scattering": np.array([0.1, 0.2])}, "materials.wall.scattering has the wrong shape"),
        ({"scattering": np.array([0.1, 0.2, 1.2])}, "materials.wall.scattering is out of range"),
        ({"known": np.array([0.1, np.nan, 0.2])}, "materials.wall.absorption is out of range"),
        ({"lower": 0.5, "upper": 0.5}, "lower bound is not below"),
        ({"tied_to": "wall"}, "tied to itself"),
        ({"tied_to": "floor", "known": np.full(3, 0.1)}, "has a value of its own"),
        ({"wall_delay_sd_s": -1e-4}, "delay out of range"),
        ({"wall_delay_sd_s": 0.3}, "delay out of range"),
        ({"wall_delay_sd_s": float("nan")}, "delay out of range"),
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


def test_the_priors_of_all_materials_stand_side_by_side_and_a_tied_one_has_its_leaders():
    floor = MaterialPrior("floor", np.array([-1.0, -2.0]), np.array([0.5, 0.6]))
    wall = MaterialPrior("wall", np.zeros(2), np.ones(2), tied_to="floor")
    door = MaterialPrior("door", np.array([0.3, 0.4]), np.array([1.5, 1.6]))
    mean, sd = prior_logits((wall, floor, door))
    assert mean.tolist() == [[-1.0, -2.0], [-1.0, -2.0], [0.3, 0.4]]
    assert sd.tolist() == [[0.5, 0.6], [0.5, 0.6], [1.5, 1.6]]


def test_of_each_product_one_finding_says_which_materials_are_of_it():
    """In the order in which products occur; a material that is of none is in none."""
    of = {"a": "panel", "b": None, "c": "foil", "d": "panel"}
    priors = [
        SimpleNamespace(name=name, product=product, product_sd=0.2 if product == "panel" else 0.3)
        for name, product in of.items()
    ]
    panel, foil = product_findings(priors)
    assert panel.code == foil.code == Code.PRODUCT_ASSUMED
    assert (panel.about.materials, foil.about.materials) == (("a", "d"), ("c",))
    assert dict(panel.evidence) == {"product": "panel", "materials": ["a", "d"], "sd": 0.2}
    assert panel.sentence.startswith("a, d are of one product, panel") and "0.2" in panel.sentence
    assert foil.evidence["sd"] == 0.3
    assert product_findings(priors[1:2]) == ()
