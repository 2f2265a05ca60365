"""Errors that all windows of a band share: against fits of data that contain them, and others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import SPEED_M_S, objective_of, small_scene, small_term, with_data
from roomfit.air import Air, attenuation_per_m, pressure_decay_per_m, speed_of_sound_m_s
from roomfit.bands import Bands, bands_between
from roomfit.inversion.sequential import CoherentBand
from roomfit.inversion.systematics import (
    DECAY_PROBABILITIES,
    DECAY_SDS,
    air_error,
    decay_error,
    decay_error_sd,
    lost_coherence,
    shared_errors,
    with_shared_errors,
)
from roomfit.objective.coherent import CoherentTerm, fully_coherent
from roomfit.objective.energy import EnergyTerm
from roomfit.objective.parameters import start_vector
from roomfit.signals.filters import frequency_response, window_energies
from roomfit.signals.response import ImpulseResponse
from roomfit.solvers.least_squares import BandFit, score_band
from roomfit.synthetic.boxes import SyntheticBox, pressure_response
from roomfit.typing import FloatArray
from roomfit.uncertainty.gaussian import add_covariance, answer_steps

CENTRE_HZ = 1000.0


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


def test_a_shared_error_adds_its_own_step_to_the_covariance() -> None:
    """And only that, whatever the misfit."""
    fit = replace(_converged(energies()), chi2_reduced=1.7)
    steps = np.array([[0.3, 0.0], [-0.1, 0.2], [0.0, 0.1], [0.05, 0.0]])
    wider = add_covariance(fit, steps)
    more = np.linalg.inv(wider.information) - np.linalg.inv(fit.information)
    np.testing.assert_allclose(more * 1.7, steps @ steps.T, atol=1e-9)
    assert add_covariance(fit, np.zeros((4, 1))) is fit


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


def _band(term: CoherentTerm) -> tuple[CoherentBand, BandFit]:
    """Return a band and a fit that ended at its start."""
    problem = objective_of(term)
    vector = start_vector(problem.parameters)
    own = with_data(term, problem.predict(vector).expected)
    fit = score_band(objective_of(own), vector, max_rounds=0)
    return CoherentBand(objective_of(own.energies), fit, own), fit


def test_nothing_is_lost_where_all_is_coherent() -> None:
    """A band whose arrival times are known has no error of that kind."""
    band, fit = _band(fully_coherent(small_term(CENTRE_HZ)))
    np.testing.assert_allclose(lost_coherence(band, fit), 0.0, atol=1e-9)


def test_lost_coherence_is_what_pressures_of_images_lack_or_have_beyond_their_energies() -> None:
    """Against the pressures of an own list of images, filtered, in slots of 40 ms."""
    scene = small_scene()
    band, fit = _band(small_term(CENTRE_HZ))
    octaves = bands_between("octave", 500, 2000)
    walls = np.array([0.2, 0.2, 0.2, 0.2, 0.4, 0.1])
    truth = SyntheticBox(
        *((4.0, 3.1, 2.5), octaves.centres_hz, np.tile(walls[:, None], 3), np.zeros(3)), SPEED_M_S
    )
    own = Bands("octave", np.array([CENTRE_HZ]))
    pressures, rate_hz = [], 24_000.0
    for (_, r), observed in zip(scene.pairs, band.coherent.energies.observations, strict=True):
        ends = scene.sources[0].position_m, scene.receivers[r].position_m
        samples = pressure_response(truth, *ends, 0.1, rate_hz, np.zeros(3))
        response = ImpulseResponse(samples, rate_hz)
        pressures.append(window_energies(own, response, observed.edges_s)[0])
    energy = fit.expected
    # the gain at the start; a path's energy at 1 m is 1 / (4 pi), its pressure as well
    whole = 2.0 * 4.0 * np.pi * np.concatenate(pressures)
    middle = np.concatenate(
        [0.5 * (o.edges_s[1:] + o.edges_s[:-1]) for o in band.coherent.energies.observations]
    )
    for low, high in ((0.0, 0.04), (0.04, 0.08)):
        slot = (middle >= low) & (middle < high)
        weight = (energy / fit.variance)[slot]
        share = weight @ (whole - energy)[slot] / (weight @ energy[slot])
        reported = lost_coherence(band, fit)[slot]
        assert np.ptp(reported) == 0.0
        assert abs(reported[0] - share) < 0.01
    # 24 % of the energy is missing there: it is not nothing that was compared
    assert reported[0] < -0.2


def _middles_s(term: EnergyTerm) -> FloatArray:
    return np.concatenate([0.5 * (o.edges_s[1:] + o.edges_s[:-1]) for o in term.observations])


def test_the_error_of_a_decay_is_its_rate_times_the_time() -> None:
    """Of windows that hold an exponential decay, to the curvature within a window."""
    term, rate_per_s = energies(), 23.0
    edges = [o.edges_s for o in term.observations]
    signal = np.concatenate([-np.diff(np.exp(-rate_per_s * e)) for e in edges])
    found = decay_error(term, signal)
    np.testing.assert_allclose(found, -rate_per_s * _middles_s(term), rtol=0.02)


def _decay_sd(change: float) -> tuple[float, float]:
    """Return the size of the term for data whose rate is so much larger, and what data know."""
    term = energies()
    signal = np.concatenate([o.energy for o in term.observations])
    slope = decay_error(term, signal)
    fit = _converged(_with_data(term, np.exp(change * slope)))
    problem = objective_of(_with_data(term, np.exp(change * slope)))
    jacobian = problem.jacobian(fit.vector)
    error = (fit.expected * decay_error(term, fit.expected))[:, None]
    (step,) = answer_steps(problem, fit, jacobian, error).T
    weighed = error[:, 0] / (problem.correlation_length() * fit.variance)
    known = weighed @ error[:, 0] - (weighed @ jacobian) @ step
    return decay_error_sd(problem, fit, jacobian, error), float(known)


def test_data_that_agree_with_the_rate_leave_the_mean_of_both_priors() -> None:
    """Without a residual the posterior is the mixture of two normal laws of known variances.

    The priors of the walls leave a residual of 1 % of it.
    """
    found, known = _decay_sd(0.0)
    variance = 1.0 / (known + DECAY_SDS**-2)
    weight = DECAY_PROBABILITIES * np.sqrt(variance) / DECAY_SDS
    np.testing.assert_allclose(found**2, weight @ variance / weight.sum(), rtol=0.02)
    assert found < np.sqrt(DECAY_PROBABILITIES @ DECAY_SDS**2)


def test_data_that_contradict_the_rate_of_the_walls_enlarge_the_term() -> None:
    """The farther off, the larger, and never beyond what they say and the wide prior together."""
    sizes = [_decay_sd(change)[0] for change in (0.0, 1.5, 3.0)]
    assert sizes[0] < sizes[1] < sizes[2] < 3.0


def test_the_decay_term_widens_the_answer_along_its_shift_alone() -> None:
    """The covariance grows by the outer product of the shift, and its cost is named."""
    term = energies()
    problem, fit = objective_of(term), _converged(term)
    shared = shared_errors(problem, fit, (0, 0), np.zeros((fit.measured.size, 2)))
    wider = with_shared_errors(problem, fit, shared)
    more = np.linalg.inv(wider.information) - np.linalg.inv(fit.information)
    jacobian = problem.jacobian(fit.vector)
    step = answer_steps(problem, fit, jacobian, shared["decay"])[:, 0]
    size = decay_error_sd(problem, fit, jacobian, shared["decay"])
    expected = np.outer(step, step) * size**2 / max(fit.chi2_reduced, 1.0)
    np.testing.assert_allclose(more, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    assert np.all(wider.costs["decay"] <= wider.costs[""])
    np.testing.assert_array_equal(wider.vector, fit.vector)
