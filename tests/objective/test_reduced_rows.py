"""Few rows that stand for many: how many are kept, and what they bring together."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.objective.reduced_rows import _calibrated


@pytest.mark.parametrize("n_each", [50, 150])
def test_rows_that_are_kept_bring_the_energy_of_all_in_every_case(n_each):
    """About so many of them, the largest of any case for certain, none with less than a fifth."""
    rng = np.random.default_rng(0)
    energy = rng.exponential(size=(200, 3)) ** 2
    weight = _calibrated(energy, n_each)
    kept = weight > 0.0
    assert abs(int(kept.sum()) - n_each) <= 1
    np.testing.assert_allclose(weight @ energy, energy.sum(axis=0), rtol=1e-9)
    assert weight[kept].min() >= 0.2
    largest = (energy / energy.sum(axis=0)).max(axis=1)
    assert kept[np.argsort(-largest)[: n_each // 5]].all()
    # those that are certain have nearly a weight of 1, others that of their chance
    assert np.median(weight[kept][largest[kept] >= np.sort(largest)[-n_each // 5]]) < 1.5
    # an order of magnitude more of a case changes nothing, nor does a case without energy
    np.testing.assert_allclose(_calibrated(energy * [1.0, 10.0, 0.1], n_each), weight, rtol=1e-9)
    silent = np.column_stack([energy, np.zeros(200)])
    np.testing.assert_allclose(_calibrated(silent, n_each), weight, rtol=1e-9)


def test_where_more_rows_may_be_kept_than_there_are_all_are_as_they_were():
    energy = np.random.default_rng(1).exponential(size=(60, 2))
    np.testing.assert_allclose(_calibrated(energy, 300.0), 1.0, rtol=1e-9)
    assert not _calibrated(np.zeros((4, 2)), 2.0).any()
    assert _calibrated(np.zeros((0, 2)), 2.0).shape == (0,)


def test_of_rows_of_one_size_every_nth_is_kept_with_n_times_its_weight():
    for n_each in (4, 16):
        weight = _calibrated(np.ones((128, 1)), n_each)
        np.testing.assert_allclose(weight[weight > 0.0], 128.0 / n_each)
        assert np.ptp(np.diff(np.flatnonzero(weight))) == 0
        assert np.flatnonzero(weight)[0] == 64 // n_each - 1
