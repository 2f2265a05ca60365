"""What is certified is what is fitted: energies, their noise and their gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coherent_cases import objective_of, small_term
from roomfit.model.parameters import physical_values, start_vector
from roomfit.model.patterns import directed_images
from roomfit.model.windows import windows_decay_s
from roomfit.paper.question import energy_global_problem


@pytest.mark.parametrize("fitted", [True, False])
def test_the_energies_of_the_certified_cost_are_those_of_the_fit_noise_included(fitted):
    """At five absorptions and gains, with noise in every window of its own size."""
    rng = np.random.default_rng(8)
    term = small_term().energies
    noisy = tuple(
        replace(o, noise=rng.uniform(1e-6, 1e-3, o.energy.size), gain=0) for o in term.observations
    )
    term = replace(term, observations=noisy)
    objective = objective_of(term)
    gain = objective.parameters.blocks[1]
    blocks = (objective.parameters.blocks[0], replace(gain, fitted=np.array([fitted])))
    parameters = replace(objective.parameters, blocks=blocks)
    vector = start_vector(parameters)
    problem = energy_global_problem(term, parameters, vector)
    for _ in range(5):
        at = vector + rng.normal(0.0, 0.5, vector.size)
        values, _ = physical_values(parameters, at)
        g = np.log1p(-values["absorption"])
        if fitted:
            g = np.concatenate((g, np.log(values["gain"])))
        rows = problem.weight * np.exp(problem.exponents @ g)
        energies = np.add.reduceat(rows, problem.offsets[:-1])
        # the filter's shares below zero, which rounding of their table leaves, are dropped
        np.testing.assert_allclose(energies, term.expected(values), rtol=1e-6, atol=1e-12)


def test_a_directed_pressure_has_the_sign_of_its_amplitude():
    """A pattern 1 + b u with a b above 1 has a rear lobe of the opposite phase."""
    images = small_term().images
    rng = np.random.default_rng(3)
    amplitude = rng.normal(0.0, 1.0, images.weight.size)
    found = directed_images(images, amplitude)
    pressure = np.sqrt(found.weight) * found.sign
    np.testing.assert_allclose(pressure, amplitude * np.sqrt(images.weight), rtol=1e-12)


@pytest.mark.parametrize(("name", "high_db", "low_db"), [("EDT_s", 0, -10), ("T20_s", -5, -25)])
def test_a_decay_time_of_windows_is_that_of_its_range_and_of_no_other(name, high_db, low_db):
    """0.7 s within the range, half of it before and after: 2 % for the windows at its ends."""
    level_db = np.linspace(0.0, -60.0, 1201)
    slope = np.where((level_db <= high_db) & (level_db > low_db), 60.0 / 0.7, 60.0 / 0.35)
    times_s = np.concatenate(([0.0], np.cumsum(-np.diff(level_db) / slope[:-1])))
    energy = -np.diff(10.0 ** (level_db / 10.0))
    assert windows_decay_s(times_s, energy, name) == pytest.approx(0.7, rel=0.02)
