"""Errors that all windows of a band share: against fits of data that contain them, and others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import objective_of, small_term
from roomfit.base.air import Air, attenuation_per_m, pressure_decay_per_m, speed_of_sound_m_s
from roomfit.base.bands import Bands, bands_between
from roomfit.base.logit import Z95, expit, logit
from roomfit.base.typing import FloatArray
from roomfit.fit.systematics import (
    air_error,
    decay_error,
    decay_rate,
)
from roomfit.materials.priors import unknown_material
from roomfit.model.energy import EnergyTerm
from roomfit.model.parameters import start_vector
from roomfit.signals.filters import frequency_response
from roomfit.solver import BandFit, score_band
from roomfit.uncertainty.gaussian import (
    BandEstimate,
    DecayRate,
    answer_steps,
    prior_only_band,
)
from roomfit.uncertainty.intervals import (
    DECAY_PROBABILITIES,
    DECAY_SDS,
    decay_error_sds,
    identifiable_by_rule,
    with_errors_of_all_bands,
)

CENTRE_HZ = 1000.0
_PRIORS = (unknown_material("wall", 1), unknown_material("floor", 1))


def energies() -> EnergyTerm:
    """Return the energies of a small box with the data that its start expects."""
    problem = replace(small_term(CENTRE_HZ).energies, model_error=0.1)
    whole = objective_of(problem)
    expected = whole.predict(start_vector(whole.parameters)).expected
    observed, first = [], 0
    for o in problem.observations:
        observed.append(replace(o, energy=expected[first : first + o.energy.size]))
        first += o.energy.size
    return replace(problem, observations=tuple(observed))


def _with_data(problem: EnergyTerm, factor: FloatArray) -> EnergyTerm:
    sizes = np.cumsum([o.energy.size for o in problem.observations])[:-1]
    parts = zip(problem.observations, np.split(factor, sizes), strict=True)
    return replace(problem, observations=tuple(replace(o, energy=o.energy * f) for o, f in parts))


def _converged(term: EnergyTerm) -> BandFit:
    problem = objective_of(term)
    return score_band(problem, start_vector(problem.parameters), max_rounds=36)


def test_the_answer_moves_as_predicted_by_an_error_of_all_windows() -> None:
    """Against fits of data that contain the error: a decay that is faster by 1 % at 20 ms.

    The first order of what moves the answer by a few hundredths of a logit; both directions of the
    change together take out the second.
    """
    plain = energies()
    fit = _converged(plain)
    time_s = np.concatenate([0.5 * (o.edges_s[1:] + o.edges_s[:-1]) for o in plain.observations])
    error = -0.01 * time_s / 0.02
    objective = objective_of(plain)
    jacobian = objective.predict(fit.vector).jacobian
    (predicted,) = answer_steps(objective, fit, jacobian, (plain.measured() * error)[:, None]).T
    up, down = (_converged(_with_data(plain, 1.0 + s * error)).vector for s in (1.0, -1.0))
    observed = 0.5 * (up - down)
    # weights that follow the answer are neglected: a few percent of the step, or a few thousandths
    # of the standard deviation of what the data hardly determine
    sd = np.sqrt(np.diag(np.linalg.inv(fit.information)))
    assert np.all(np.abs(predicted - observed) <= 0.1 * np.abs(observed) + 0.003 * sd)


@pytest.mark.parametrize("kind", ["octave", "third-octave"])
def test_the_error_of_the_air_covers_its_mean_over_a_band(kind: str) -> None:
    """Against ISO 9613-1 averaged over the filter: as much, or up to three times as much."""
    air, problem = Air(), energies()
    bands = bands_between("octave" if kind == "octave" else "third-octave", 500, 4000)
    middle = np.concatenate([0.5 * (o.edges_s[1:] + o.edges_s[:-1]) for o in problem.observations])
    for band, centre in enumerate(bands.exact_centres_hz):
        own = Bands(bands.kind, bands.centres_hz[band : band + 1])
        frequencies = np.linspace(0.4 * centre, 2.2 * centre, 4001)
        weight = frequency_response(own, frequencies)[0] ** 2
        mean = np.average(2.0 * pressure_decay_per_m(air, frequencies), weights=weight)
        off = (mean - attenuation_per_m(air, own)[0]) * speed_of_sound_m_s(air) * middle
        error = air_error(air, bands, band, problem)
        assert np.all(error <= 0.0)
        late = middle > 0.01
        assert np.all(-error[late] >= off[late]) and np.all(-error[late] <= 3.0 * off[late])


def _middles_s(term: EnergyTerm) -> FloatArray:
    return np.concatenate([0.5 * (o.edges_s[1:] + o.edges_s[:-1]) for o in term.observations])


def test_the_error_of_a_decay_is_its_rate_times_the_time() -> None:
    """Of windows that hold an exponential decay, to the curvature within a window."""
    term, rate_per_s = energies(), 23.0
    edges = [o.edges_s for o in term.observations]
    signal = np.concatenate([-np.diff(np.exp(-rate_per_s * e)) for e in edges])
    found = decay_error(term, signal)
    np.testing.assert_allclose(found, -rate_per_s * _middles_s(term), rtol=0.02)


def test_the_information_on_the_rate_is_that_of_a_further_unknown() -> None:
    """Against the Schur complement of the rate in the information of all unknowns."""
    term = energies()
    problem, fit = objective_of(term), _converged(term)
    jacobian = problem.jacobian(fit.vector)
    error = fit.expected * decay_error(term, fit.expected)
    weight = 1.0 / (problem.correlation_length() * fit.variance)
    across = jacobian.T @ (weight * error)
    whole = np.block([[fit.information, across[:, None]], [across, np.sum(weight * error**2)]])
    variance = np.linalg.inv(whole)[-1, -1]
    found = decay_rate(problem, fit, jacobian, error[:, None])
    np.testing.assert_allclose(found.information, 1.0 / variance / max(fit.chi2_reduced, 1.0))
    # as unknowns move when the rate is held that much higher
    np.testing.assert_allclose(found.step, np.linalg.solve(fit.information, across))


def test_all_bands_say_whether_a_room_decays_as_its_model_does() -> None:
    """One band in six off by 2.5 standard deviations is chance; six off by 2.5 are none."""
    usual, off = (DecayRate(400.0, z * 20.0, np.zeros(1)) for z in (0.3, 2.5))
    alone = decay_error_sds([off])[0]
    beside_others = decay_error_sds([off, *[usual] * 5])
    everywhere = decay_error_sds([off] * 6)
    assert beside_others[0] < 0.25 * alone < 0.3 * everywhere[0]
    # which is what its data say, nearly without a prior: 2.5 +- 1 standard deviations of 0.05
    np.testing.assert_allclose(everywhere, 0.05 * np.hypot(2.5, 1.0), rtol=0.06)


def _answer(a: FloatArray, rate: DecayRate) -> BandEstimate:
    wide = prior_only_band(_PRIORS, 0)
    return replace(
        wide,
        absorption=a,
        lower95=a - 0.01,
        upper95=a + 0.01,
        logit_mean=logit(a),
        logit_covariance=np.diag([1e-3, 1e-3]),
        costs={"": np.full(2, 0.1), "noise": np.full(2, 0.05)},
        mean_costs={"": 0.005, "noise": 0.003},
        decay=rate,
    )


def test_the_decay_term_widens_answers_along_their_shift_alone() -> None:
    """In absorption: the mean by what the rate moves it, walls by their own share, named as such.

    A wall of 0.02 that a change moves by 0.035 is not 0 to 0.4, as its logit's first order says.
    """
    a, areas = np.array([0.02, 0.2]), np.array([1.0, 3.0])
    rate = DecayRate(1e-9, 0.0, np.array([0.07, 0.06]) / 0.2)  # nothing known: mixture of priors
    size = float(np.sqrt(DECAY_PROBABILITIES @ DECAY_SDS**2))
    before = _answer(a, rate)
    (after,) = with_errors_of_all_bands([before], areas, {})
    more = Z95 * size * (areas @ rate.step) / areas.sum()
    one_sd = expit(logit(a) + np.sqrt(np.diag(after.logit_covariance - before.logit_covariance)))
    np.testing.assert_allclose(one_sd, a + size * rate.step, rtol=1e-6)
    assert 0.1 < after.upper95[0] < 0.16 and after.lower95[0] > 0.0
    # the logit of the first is known no better than half its prior's
    assert identifiable_by_rule([after], _PRIORS)[:, 0].tolist() == [False, True]
    np.testing.assert_array_equal(after.costs["decay"], before.costs[""])
    assert after.mean_costs["decay"] == 0.005
    np.testing.assert_allclose(after.mean_costs[""], np.hypot(0.005, more / Z95))
    assert np.all(after.costs["noise"] < after.costs[""])
    np.testing.assert_array_equal(after.absorption, a)
