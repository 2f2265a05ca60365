"""Intervals that include the noise of the trace: against the scatter of answers over traces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import END_S, MATERIALS, energy_term, objective_of, small_scene
from rays_reference import tracing_variance
from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray
from roomfit.fit.systematics import batch_spread, effect_on_answer, shared_errors
from roomfit.materials.priors import uniform_scattering
from roomfit.model.binned import bin_paths, in_band
from roomfit.model.energy import EnergyTerm
from roomfit.model.parameters import start_vector
from roomfit.solver import score_band
from roomfit.tracing.paths import TraceSettings
from roomfit.tracing.trace import trace

CENTRE_HZ = 1000.0
N_RAYS, N_TRACES = 6400, 40


def energies(n_rays: int, seed: int) -> EnergyTerm:
    """Return the energies of a box whose walls scatter by 0.4, from so many rays."""
    settings = TraceSettings(END_S, n_rays=n_rays, image_order=1, seed=seed)
    scene, bands = small_scene(), Bands("octave", np.array([CENTRE_HZ]))
    paths = trace(scene, settings, uniform_scattering(MATERIALS, 0.4)).paths
    binned = in_band(bin_paths(scene, bands, paths, END_S), CENTRE_HZ)
    return replace(energy_term(bands, scene, binned), model_error=0.2)


@pytest.fixture(scope="module")
def data() -> FloatArray:
    """Return what a fine trace expects at the start of the fits."""
    fine = energies(100_000, 1000)
    whole = objective_of(fine)
    return whole.predict(start_vector(whole.parameters)).expected


def fitted(seed: int, data: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the answer by one coarse trace, and the variance that its batches predict."""
    coarse = energies(N_RAYS, seed)
    halves = np.split(data, 2)
    observed = zip(coarse.observations, halves, strict=True)
    term = replace(coarse, observations=tuple(replace(o, energy=e) for o, e in observed))
    problem = objective_of(term)
    fit = score_band(problem, start_vector(problem.parameters))
    shared = shared_errors(problem, fit, (0, 0), np.zeros((fit.measured.size, 2)))
    areas_m2 = np.ones(len(problem.parameters.blocks[0].labels))
    steps = effect_on_answer(problem, fit, shared, areas_m2).steps
    return fit.vector, (steps**2).sum(axis=1)


@pytest.mark.slow
def test_batches_predict_how_far_another_trace_moves_the_answer(data: FloatArray) -> None:
    """Forty traces, the same data: their scatter has a standard error of 11 %.

    The data have no noise, so that nothing but the rays moves the answer. A factor of 1.5 is
    3.6 standard errors, a chance of 1e-3 for the four unknowns together; what is neglected, the
    curvature and the weights that move with the rays, lies within that margin as well.
    """
    answers, predicted = zip(*(fitted(seed, data) for seed in range(N_TRACES)), strict=True)
    observed = np.std(answers, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(predicted, axis=0)) / observed
    assert np.all((ratio > 1.0 / 1.5) & (ratio < 1.5)), ratio


def test_columns_add_up_to_the_variance_of_every_window() -> None:
    """And receivers of one source share columns, of two sources none."""
    problem = energies(N_RAYS, 3)
    parameters = objective_of(problem).parameters
    vector = start_vector(parameters)
    gain, alone = 2.0, problem.observations[0].energy.size
    absorption = parameters.blocks[0].start
    expected = [
        gain**2 * tracing_variance(rows, observed, absorption)
        for rows, observed in zip(problem.rows, problem.observations, strict=True)
    ]
    shared = batch_spread(problem, parameters, vector, (0, 0))
    apart = batch_spread(problem, parameters, vector, (4, 2))
    for columns in (shared, apart):
        np.testing.assert_allclose((columns**2).sum(axis=1), np.concatenate(expected), rtol=1e-9)
    assert np.any(np.abs(shared[:alone] @ shared[alone:].T) > 0.0)
    assert not np.any(apart[:alone] @ apart[alone:].T)
