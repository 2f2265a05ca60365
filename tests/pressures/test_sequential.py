"""Which error of the model a band is fitted with, and where its fit begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from coherent_cases import objective_of, small_term, with_data
from roomfit.model.parameters import GEOMETRY, Block, Marginal, Parameters, start_vector
from roomfit.model.problem import DataTerm, Objective
from roomfit.pressures.sequential import (
    NOISES,
    CoherentBand,
    compared_with_energies,
    evidence_of_energies,
    fit_in_rounds,
    log_evidence,
)
from roomfit.solver import score_band


class Straight(DataTerm):
    """Normal data that are linear in the free numbers of the geometry, each by itself."""

    is_gamma = False

    def __init__(self, data: np.ndarray, rows: np.ndarray, variance: np.ndarray) -> None:
        self.data, self.rows, self.variance = data, rows, variance

    def measured(self):
        return self.data

    def predict(self, values):
        return self.expected(values), self.expected(values), {GEOMETRY: self.rows}

    def expected(self, values):
        return self.rows @ values[GEOMETRY]

    def variance_parts(self, _values):
        return {"noise": self.variance}

    def correlation_length(self, _start):
        return np.ones(self.data.size)


@pytest.mark.parametrize("is_joint", [False, True])
def test_the_evidence_of_linear_data_is_the_density_of_the_data(is_joint):
    """Laplace's approximation is exact there: N(y; A m, A C A' + V), by scipy.

    With unit normal priors, and with a joint one as a lower band leaves it. The noise is small
    enough for a reduced chi-square below 1.
    """
    rng = np.random.default_rng(5)
    n, n_data = 3, 12
    rows, variance = rng.normal(size=(n_data, n)), rng.uniform(0.5, 2.0, n_data)
    root = rng.normal(size=(n, n)) if is_joint else np.eye(n)
    mean = rng.normal(size=n) if is_joint else np.zeros(n)
    covariance = root @ root.T
    data = rows @ (mean + root @ rng.normal(size=n)) + 0.5 * np.sqrt(variance) * rng.normal(
        size=n_data
    )
    block = Block(
        *(GEOMETRY, ("x", "y", "z"), "identity", np.zeros(n), np.ones(n, dtype=np.bool_)),
        *(np.zeros(n), np.ones(n), np.full(n, -1e6), np.full(n, 1e6)),
    )
    joint = Marginal(mean, np.linalg.inv(covariance)) if is_joint else None
    objective = Objective(Parameters((block,), joint), (Straight(data, rows, variance),))
    prior, weighted = np.linalg.inv(covariance), rows.T / variance
    best = np.linalg.solve(weighted @ rows + prior, weighted @ data + prior @ mean)
    fit = score_band(objective, best)
    assert fit.chi2_reduced < 1.0
    exact = multivariate_normal(rows @ mean, rows @ covariance @ rows.T + np.diag(variance)).logpdf(
        data
    )
    assert log_evidence(objective, fit) == pytest.approx(exact, abs=1e-9)


def test_energies_and_pressures_without_coherence_have_the_same_evidence():
    """With positions known to ten metres no path is coherent: both models are one.

    Pressures with another entry of `NOISES` than energies would gain by that alone, 420 in the
    octave of 4 kHz of a measured room with 24 responses. The fits end within a tenth of a standard
    deviation of each unknown, of which there are four.
    """
    term, rng = small_term(), np.random.default_rng(2)
    energies = objective_of(term.energies)
    start = start_vector(energies.parameters)
    expected = energies.expected(start)
    term = with_data(term, expected * rng.gamma(4.0, 0.25, expected.size))
    sd = np.append(np.full(9, 10.0), term.geometry.sd[9:])
    early = term.energies.observations
    term = replace(term, early=early, geometry=replace(term.geometry, sd=sd))
    energies = objective_of(term.energies)
    band = CoherentBand(energies, score_band(energies, start), term)
    whole = np.append(start, np.zeros(sd.size))
    fits = [fit_in_rounds(band, whole, noise, None, rounds=1) for noise in NOISES]
    best = max(fits, key=lambda f: f.log_evidence)
    best = compared_with_energies(band, best, evidence_of_energies(band))
    assert np.ptp([f.log_evidence for f in fits]) > 0.5
    assert best.log_evidence == pytest.approx(best.energy_log_evidence, abs=0.1)
