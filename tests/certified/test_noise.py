"""What is certified is what is fitted: energies, their noise and their gains."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coherent_cases import objective_of, small_term
from roomfit.certified import certificate
from roomfit.certified.question import energy_global_problem
from roomfit.objective.parameters import physical_values, start_vector
from roomfit.objective.windows import windows_decay_s
from roomfit.response.directivity import directed_images


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


def test_what_rays_may_change_of_a_cost_is_its_mean_and_twice_its_deviation(monkeypatch):
    """Loop by loop; gains are squared, and where none is fitted it is one. 0.02 at least."""
    precision, off = np.array([3.0, 5.0, 7.0]), np.array([0.1, -0.2, 0.3])
    measured, tracing = np.array([1.0, 2.0, 3.0]), np.array([0.01, 0.02, 0.03])
    observations = [SimpleNamespace(gain=0), SimpleNamespace(gain=-1)]
    weighed = [SimpleNamespace(tracing=tracing[:2]), SimpleNamespace(tracing=tracing[2:])]
    energies = SimpleNamespace(
        observations=observations, predict=lambda _: (measured + off,), measured=lambda: measured
    )
    values = {"gain": np.array([2.0]), "absorption": None}
    monkeypatch.setattr(certificate, "physical_values", lambda *_: (values, None))
    monkeypatch.setattr(certificate, "weighed", lambda *_: weighed)
    variance = [0.01 * 4.0, 0.02 * 4.0, 0.03]
    mean = sum(c * v for c, v in zip(precision, variance, strict=True))
    spread = sum((2 * c * r) ** 2 * v for c, r, v in zip(precision, off, variance, strict=True))
    found = certificate.tracing_delta(energies, None, np.zeros(0), precision)
    assert found == pytest.approx(mean + 2.0 * spread**0.5)
    assert certificate.tracing_delta(energies, None, np.zeros(0), 1e-6 * precision) == 0.02
