"""From which number on a check says something, and what: on both sides of each limit."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.checks import (
    decay,
)


def test_a_mean_miss_has_the_larger_of_the_scatter_by_theory_and_of_three_pairs_the_observed():
    jnd = np.array([1.0, 2.0, 6.0])
    mean, sd = decay.mean_miss(jnd, np.full(3, 0.05))
    assert (mean, sd) == pytest.approx((3.0, np.std(jnd, ddof=1) / np.sqrt(3.0)))
    assert decay.mean_miss(jnd, np.array([0.1, 0.4, 9.0]))[1] == pytest.approx(8.0 / np.sqrt(3.0))
    assert decay.mean_miss(jnd[:2], np.full(2, 0.05))[1] == pytest.approx(1.0 / np.sqrt(2.0))
    assert decay.mean_miss(np.zeros(0), np.zeros(0)) == (0.0, np.inf)
