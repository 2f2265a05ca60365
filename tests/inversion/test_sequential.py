"""Which error of the model a band is fitted with, and where its fit begins."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from coherent_cases import objective_of, small_term, with_data
from roomfit.inversion import sequential
from roomfit.inversion.sequential import (
    NOISES,
    UNDECIDED,
    CoherentBand,
    CoherentOptions,
    compared_with_energies,
    contradicts_geometry,
    evidence_of_energies,
    fit_in_rounds,
    forward_pass,
    inflated_log_likelihood,
    log_evidence,
    log_evidences,
)
from roomfit.objective.parameters import GEOMETRY, Block, Marginal, Parameters, start_vector
from roomfit.objective.problem import DataTerm, Objective, gamma_log_likelihood
from roomfit.solvers.least_squares import score_band


def tried(monkeypatch: pytest.MonkeyPatch, said: list[tuple[float, float]], **options):
    """Return the noises that are tried and the one that is chosen, and all starts.

    `said` has the log-likelihood and the reduced chi-square of a fit with each of `NOISES`.
    """
    noises, starts = [], []

    def fit(band, start, noise, joint, **_):
        likelihood, chi2 = said[NOISES.index(noise)]
        noises.append(noise)
        starts.append(start)
        answer = SimpleNamespace(chi2_reduced=chi2, vector=np.array([0.5]))
        return SimpleNamespace(fit=answer, log_likelihood=likelihood, found=None, noise=noise)

    monkeypatch.setattr(sequential, "fit_in_rounds", fit)
    nothing = SimpleNamespace(fitted=np.zeros(0, dtype=bool))
    monkeypatch.setattr(sequential, "geometry_block", lambda _: nothing)
    band = SimpleNamespace(
        coherent=SimpleNamespace(geometry=None), energy_fit=SimpleNamespace(vector=np.array([0.1]))
    )
    (best,) = forward_pass([band], CoherentOptions(model="coherent"), None, **options)
    return noises, best.noise, [float(s[0]) for s in starts]


@pytest.mark.parametrize(("n_geometry", "settled_sd"), [(0, None), (3, 0.1)])
def test_only_what_is_fitted_once_more_ends_early(monkeypatch, n_geometry, settled_sd):
    """Without an unknown position no pass follows, and the fit ends as near as any other."""
    asked = []

    def fit(*_, **how):
        asked.append(how["settled_sd"])
        answer = SimpleNamespace(chi2_reduced=0.5)
        return SimpleNamespace(fit=answer, log_likelihood=0.0, found=None)

    monkeypatch.setattr(sequential, "fit_in_rounds", fit)
    free = SimpleNamespace(fitted=np.ones(n_geometry, dtype=bool))
    monkeypatch.setattr(sequential, "geometry_block", lambda _: free)
    band = SimpleNamespace(
        coherent=SimpleNamespace(geometry=None), energy_fit=SimpleNamespace(vector=np.array([0.1]))
    )
    forward_pass([band], CoherentOptions(model="coherent"), None)
    assert asked == [settled_sd]


@pytest.mark.parametrize(
    ("said", "n_tried", "chosen"),
    [
        # as the model says: nothing else is tried
        ([(0.0, 0.9), (9.0, 0.5), (9.0, 0.5), (9.0, 0.5)], 1, 0),
        ([(0.0, 1.4), (5.0, 1.0), (9.0, 0.9), (9.0, 0.5)], 2, 1),
        # a larger error of the model that is less likely ends the search
        ([(0.0, 1.4), (-1.0, 1.1), (9.0, 0.9), (9.0, 0.5)], 2, 0),
        # a random phase that is less likely does not: 40 measured responses at 4 kHz
        ([(16164.0, 13.5), (18356.2, 4.30), (18355.8, 4.30), (19072.0, 1.77)], 4, 3),
        ([(0.0, 2.0), (5.0, 1.5), (4.0, 1.4), (4.5, 1.1)], 4, 1),
    ],
)
def test_errors_of_the_model_grow_while_that_is_likelier(monkeypatch, said, n_tried, chosen):
    noises, best, _ = tried(monkeypatch, said)
    assert noises == list(NOISES[:n_tried])
    assert best == NOISES[chosen]


def test_a_later_pass_begins_where_an_earlier_one_ended(monkeypatch):
    said = [(0.0, 0.9)] * 4
    assert tried(monkeypatch, said)[2] == [0.1]
    assert tried(monkeypatch, said, starts=[np.array([0.3, 7.0])])[2] == [0.3]
    assert tried(monkeypatch, said, starts=[None])[2] == [0.1]


def largest_array(record: object) -> int:
    """Return the number of entries of the largest array in a record and all that it holds."""
    if isinstance(record, np.ndarray):
        return record.size
    parts: list[object] = []
    if is_dataclass(record):
        parts = [getattr(record, f.name) for f in fields(record)]
    elif isinstance(record, dict):
        parts = list(record.values())
    elif isinstance(record, tuple | list):
        parts = list(record)
    return max((largest_array(p) for p in parts), default=0)


@pytest.mark.parametrize("rounds", [1, 2])
def test_a_fit_holds_no_paths_and_what_was_fitted_is_made_again_bit_by_bit(rounds):
    """Passes over the bands hold up to three fits of each: their paths would fill the memory."""
    term = small_term()
    energies = objective_of(term.energies)
    start = start_vector(energies.parameters)
    band = CoherentBand(energies, score_band(energies, start, max_rounds=2), term)
    whole = np.append(start, np.zeros(term.geometry.sd.size))
    found = fit_in_rounds(band, whole, NOISES[2], None, rounds=rounds, max_rounds=2)
    assert largest_array(band) >= term.images.weight.size > 4 * whole.size**2 > 0
    assert largest_array(found) <= max(whole.size**2, term.measured().size)
    again = found.objective(band)
    np.testing.assert_array_equal(again.predict(found.fit.vector).expected, found.fit.expected)
    np.testing.assert_array_equal(again.variance(found.fit.vector), found.fit.variance)


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


def test_a_model_that_misses_few_windows_by_far_is_not_the_likelier_one():
    """A hundred windows as expected, and ten between reflections, six times as loud as expected.

    With a standard deviation of 1 there, or of 10, as where a loudspeaker rings. The densities,
    whose tails are exponential, prefer the first, whose reduced chi-square is 3; with the variances
    times chi-square nothing is left that could decide.
    """
    usual = np.random.default_rng(4).gamma(25.0, 0.04, 100)
    measured, expected = np.append(usual, np.full(10, 6.0)), np.ones(110)
    said = SimpleNamespace(
        log_likelihood=lambda mean, spread: gamma_log_likelihood(measured, mean, spread)
    )

    def compared(sd_between):
        variance = np.append(np.full(100, 0.04), np.full(10, sd_between**2))
        chi2 = float(np.mean((measured - expected) ** 2 / variance))
        fit = SimpleNamespace(expected=expected, variance=variance, chi2_reduced=chi2)
        plain = gamma_log_likelihood(measured, expected, variance)
        return chi2, float(plain.sum()), float(inflated_log_likelihood(said, fit).sum())

    (close_chi2, close_plain, close), (wide_chi2, wide_plain, wide) = compared(1.0), compared(10.0)
    assert close_chi2 > 3.0
    assert wide_chi2 < 1.5
    assert close_plain > wide_plain + 2.0 * UNDECIDED
    assert close < wide + 0.5 * UNDECIDED


@pytest.mark.parametrize(
    ("chi2", "evidences", "said"),
    [
        ((0.9, 1.5), (10.0, 14.0), (10.0, 14.0)),
        ((0.9, 1.5), (10.0, 11.0), (10.0, 11.0)),
        ((0.9, 2.1), (10.0, 11.0), (10.0, -np.inf)),
        ((2.1, 0.9), (11.0, 10.0), (-np.inf, 10.0)),
        ((2.1, 3.0), (10.0, 11.0), (10.0, 11.0)),
        ((0.9, 2.1), (10.0, 14.0), (10.0, 14.0)),
        ((2.1, 0.9), (14.0, 10.0), (14.0, 10.0)),
    ],
)
def test_between_models_of_like_evidence_one_that_does_not_fit_is_not_taken(chi2, evidences, said):
    band = SimpleNamespace(energy_fit=SimpleNamespace(chi2_reduced=chi2[0]))
    fit = SimpleNamespace(
        fit=SimpleNamespace(chi2_reduced=chi2[1]),
        energy_log_evidence=evidences[0],
        log_evidence=evidences[1],
    )
    assert log_evidences(band, fit) == said


def passed(monkeypatch, centres_hz, gains, model="auto"):
    """Return what a pass says of bands whose pressures gain so much, and what each was told."""
    told = []

    def fit(band, _start, noise, joint, **_):
        told.append(joint)
        answer = SimpleNamespace(chi2_reduced=0.9, vector=np.zeros(1))
        found = Marginal(np.zeros(0), np.full((1, 1), band.coherent.energies.centre_hz))
        return SimpleNamespace(fit=answer, log_likelihood=0.0, found=found, noise=noise)

    def compared(band, found, _evidence):
        found.evidences = 0.0, gains[centres_hz.index(band.coherent.energies.centre_hz)]
        found.found = found.found if found.evidences[1] > 0.0 else None
        return found

    monkeypatch.setattr(sequential, "fit_in_rounds", fit)
    monkeypatch.setattr(sequential, "evidence_of_energies", lambda _: 0.0)
    monkeypatch.setattr(sequential, "compared_with_energies", compared)
    monkeypatch.setattr(sequential, "log_evidences", lambda _, found: found.evidences)
    nothing = SimpleNamespace(fitted=np.zeros(0, dtype=bool))
    monkeypatch.setattr(sequential, "geometry_block", lambda _: nothing)
    bands = [
        SimpleNamespace(
            coherent=SimpleNamespace(geometry=None, energies=SimpleNamespace(centre_hz=f)),
            energy_fit=SimpleNamespace(vector=np.zeros(1)),
        )
        for f in centres_hz
    ]
    fits = forward_pass(bands, CoherentOptions(model=model), None)
    informed = [None if j is None else float(j.information[0, 0]) for j in told]
    return fits, informed, contradicts_geometry(bands, fits)


def test_a_band_that_does_not_fit_hands_no_geometry_on(monkeypatch):
    """The third band is told what the first found; the fourth, above 1 kHz, may well not fit."""
    of_gains = [250.0, 500.0, 1000.0, 2000.0], [20.0, -1.0, 30.0, -40.0]
    fits, told, contradicted = passed(monkeypatch, *of_gains)
    assert not contradicted
    assert told == [None, 250.0, 250.0, 1000.0]
    assert [f.found is not None for f in fits] == [True, False, True, False]


def test_bands_may_contradict_the_geometry_of_lower_ones(monkeypatch):
    octaves = [125.0, 250.0, 500.0, 1000.0]
    _, told, contradicted = passed(monkeypatch, octaves, [20.0, 30.0, -2.5, 99.0])
    assert contradicted
    assert told == [None, 125.0, 250.0, 250.0]
    # where no lower band has determined anything, nothing is contradicted
    _, told, contradicted = passed(monkeypatch, octaves, [-20.0, 30.0, 40.0, 99.0])
    assert not contradicted
    assert told == [None, None, 250.0, 500.0]
    # less than 2 units decide nothing, and no band above 1 kHz does
    assert not passed(monkeypatch, octaves, [20.0, 30.0, -1.5, 99.0])[2]
    assert not passed(monkeypatch, [1000.0, 2000.0], [20.0, -99.0])[2]


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
