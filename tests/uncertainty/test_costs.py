"""What each term of the uncertainty costs: against plain Gauss-Newton information."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import objective_of, small_term
from roomfit.fit.systematics import effect_on_answer
from roomfit.model.parameters import prior_residuals, start_vector
from roomfit.solver import score_band
from roomfit.uncertainty.gaussian import (
    answer_steps,
    costs_of_terms,
    fit_covariance,
    sd_without_term,
    weighted_mean_gradient,
)

RNG = np.random.default_rng(4)
JACOBIAN = RNG.standard_normal((40, 3))
PRIOR = np.diag([0.5, 2.0, 0.0])
PARTS = {"noise": RNG.uniform(0.5, 1.0, 40), "model": RNG.uniform(0.1, 3.0, 40)}
SHARED = {"air": RNG.standard_normal((40, 1)), "model": RNG.standard_normal((40, 2))}
NEIGHBOURS = np.full(40, 1.5)


def costs(**changed):
    given = {"parts": PARTS, "shared": SHARED, "neighbours": NEIGHBOURS, "misfit": 1.3}
    given |= changed
    misfit = given.pop("misfit")
    known = {"gain": np.array([2])}
    found = sd_without_term(JACOBIAN, PRIOR, **given, known=known, misfit=misfit, along=np.zeros(3))
    return {name: sd[:-1] for name, sd in found.items()}


def plain(variance, prior, shared, misfit):
    """Return the standard deviations by the formula, with whole matrices."""
    weight = np.diag(1.0 / variance)
    inverse = np.linalg.inv(JACOBIAN.T @ weight @ JACOBIAN + prior)
    steps = inverse @ JACOBIAN.T @ weight @ shared
    return np.sqrt(np.diag(misfit * inverse + steps @ steps.T))


def test_each_term_left_out_is_the_information_of_the_others():
    found = costs()
    both, air = PARTS["noise"] + PARTS["model"], SHARED["air"]
    every = np.hstack((air, SHARED["model"]))
    for name, expected in {
        "": plain(1.5 * both, PRIOR, every, 1.3),
        "model": plain(1.5 * PARTS["noise"], PRIOR, air, 1.3),
        "air": plain(1.5 * both, PRIOR, SHARED["model"], 1.3),
        "neighbours": plain(both, PRIOR, every, 1.3),
        "misfit": plain(1.5 * both, PRIOR, every, 1.0),
        "prior": plain(1.5 * both, np.zeros((3, 3)), every, 1.3),
    }.items():
        np.testing.assert_allclose(found[name], expected, rtol=1e-9, err_msg=name)
    assert list(found) == ["", "noise", "model", "air", "gain", "neighbours", "misfit", "prior"]


@pytest.mark.parametrize("centre_hz", [500.0, 1000.0])
def test_all_terms_together_are_the_covariance_that_is_reported(centre_hz):
    """Of a fitted band: parts add up to its variance, and the costs begin with its intervals."""
    objective = objective_of(small_term(centre_hz).energies)
    fit = score_band(objective, start_vector(objective.parameters))
    parts = objective.variance_parts(fit.vector)
    np.testing.assert_allclose(sum(parts.values()), fit.variance, rtol=1e-12)
    assert set(parts) == {"interference", "positions", "rays", "noise", "model", "ringing"}
    errors = {"air": 0.1 * fit.expected[:, None]}
    there = objective.predict(fit.vector).jacobian
    reported = fit_covariance(fit, answer_steps(objective, fit, there, errors["air"]))
    areas_m2 = np.ones(len(objective.parameters.blocks[0].labels))
    found, _ = costs_of_terms(objective, fit, there, errors, areas_m2)
    expected = np.sqrt(np.diag(reported))
    np.testing.assert_allclose(found[""], expected, rtol=1e-6)
    _, rows = prior_residuals(objective.parameters, fit.vector)
    narrow = replace(objective.terms[0], model_error=0.0)
    sharper = objective_of(narrow)
    jacobian, neighbours = sharper.predict(fit.vector).jacobian, objective.correlation_length()
    information = jacobian.T / (neighbours * sharper.variance(fit.vector)) @ jacobian
    information += rows.T @ rows
    steps = np.linalg.solve(
        information, jacobian.T / (neighbours * sharper.variance(fit.vector)) @ errors["air"]
    )
    covariance = np.linalg.inv(information) * max(fit.chi2_reduced, 1.0) + steps @ steps.T
    np.testing.assert_allclose(found["model"], np.sqrt(np.diag(covariance)), rtol=1e-6)


def test_a_mean_has_the_standard_deviation_of_its_direction():
    """Of one more quantity, with every term and without each: by whole covariances."""
    along = np.array([0.5, -0.2, 0.0])
    given = (PARTS, SHARED, NEIGHBOURS, {"gain": np.array([2])}, 1.3)
    found = sd_without_term(JACOBIAN, PRIOR, *given, along)
    both = PARTS["noise"] + PARTS["model"]
    for name, variance, shared in (
        ("", both, np.hstack((SHARED["air"], SHARED["model"]))),
        ("model", PARTS["noise"], SHARED["air"]),
    ):
        weight = np.diag(1.0 / (1.5 * variance))
        inverse = np.linalg.inv(JACOBIAN.T @ weight @ JACOBIAN + PRIOR)
        steps = inverse @ JACOBIAN.T @ weight @ shared
        covariance = 1.3 * inverse + steps @ steps.T
        np.testing.assert_allclose(found[name][-1] ** 2, along @ covariance @ along, rtol=1e-9)
        np.testing.assert_allclose(found[name][:-1] ** 2, np.diag(covariance), rtol=1e-9)


def test_the_mean_of_the_room_has_the_costs_of_its_own_interval():
    """Before absorption that changes within the band, and the rate of decay, are allowed for."""
    objective = objective_of(small_term(500.0).energies)
    fit = score_band(objective, start_vector(objective.parameters))
    areas_m2 = np.arange(1.0, 1.0 + len(objective.parameters.blocks[0].labels))
    errors = {"air": 0.1 * fit.expected[:, None], "decay": 0.2 * fit.expected[:, None]}
    found = effect_on_answer(objective, fit, errors, areas_m2)
    gradient = weighted_mean_gradient(objective.parameters, fit.vector, areas_m2 / areas_m2.sum())
    variance = gradient @ fit_covariance(fit, found.steps) @ gradient
    np.testing.assert_allclose(found.mean_costs[""] ** 2, variance, rtol=1e-6)
    assert found.mean_costs["interference"] < found.mean_costs[""]
    assert found.costs[""].shape == fit.vector.shape
