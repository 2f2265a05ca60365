"""Decay times of windows of energy, and signs of pressures that a pattern weighs."""

from __future__ import annotations

import numpy as np
import pytest

from coherent_cases import small_term
from roomfit.model.windows import windows_decay_s
from roomfit.pressures.directed import directed_images


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
