"""Bins of time as coarse as a band permits."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.model.binned import BinnedPaths, in_band
from roomfit.model.weighing import EnergyRows


@pytest.mark.parametrize("centre_hz", [63.0, 500.0, 8000.0])
def test_bins_are_a_sixteenth_of_a_period_or_a_400th_of_their_time(centre_hz):
    """Whole numbers of the finest bins of 0.1 ms, one at least, and none beyond the end."""
    edges_s = np.arange(20_001) * 1e-4
    rows = EnergyRows(
        ("w",), 20_000, np.zeros(20_001), np.zeros(0), np.zeros((0, 1)), np.zeros(0), np.zeros(0)
    )
    found = in_band(BinnedPaths(edges_s, (rows,)), centre_hz)
    assert found.edges_s[0] == 0.0 and found.edges_s[-1] == edges_s[-1]
    assert found.rows[0].n_windows == found.edges_s.size - 1
    steps = np.round(np.diff(found.edges_s) / 1e-4).astype(int)
    period = int(1.0 / (16.0 * centre_hz * 1e-4))
    wanted = np.maximum(max(period, 1), (found.edges_s[:-1] / 0.04 + 1e-9).astype(int))
    np.testing.assert_array_equal(steps[:-1], wanted[:-1])
    assert 0 < steps[-1] <= wanted[-1] and steps.max() == 49
