"""Measurements that the model explains far worse than all others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from roomfit.inversion.outliers import file_misfits, outlier_files, variance_inflation
from roomfit.measurement import Measurement

A, B, C, D = (Measurement("S", name, np.ones(2), 8000) for name in "ABCD")


def windows(*sizes: int) -> Any:
    energies = [SimpleNamespace(energy=np.zeros(n)) for n in sizes]
    return SimpleNamespace(observations=energies)


def test_a_misfit_is_the_mean_squared_residual_of_a_file_as_it_was_measured():
    """Data behind the windows are of no file; what was added to the variance is taken out."""
    fit: Any = SimpleNamespace(
        measured=np.array([3.0, 1.0, 5.0, 0.0, 9.0]),
        expected=np.array([1.0, 2.0, 1.0, 1.0, 0.0]),
        variance=np.array([2.0, 1.0, 4.0, 0.5, 1.0]),
    )
    found = file_misfits([A, B], windows(3, 1), fit, None)
    assert found == {A: pytest.approx((2.0 + 1.0 + 4.0) / 3.0), B: pytest.approx(2.0)}
    inflation = np.array([2.0, 1.0, 1.0, 3.0, 7.0])
    found = file_misfits([A, B], windows(3, 1), fit, inflation)
    assert found == {A: pytest.approx(3.0), B: pytest.approx(6.0)}


@pytest.mark.parametrize(
    ("bands", "least", "found"),
    [
        ([{A: 1.0, B: 1.0, C: 4.1}], 3.0, {C: 4.1}),
        ([{A: 1.0, B: 1.0, C: 4.0}], 3.0, {}),  # no more than four times the median
        ([{A: 0.5, B: 0.5, C: 3.0}], 3.0, {}),  # small enough
        ([{A: 0.5, B: 0.5, C: 3.01}], 3.0, {C: 6.02}),
        ([{A: 1.0, C: 9.0}], 3.0, {}),  # of two nobody knows which
        ([{A: 1.0, B: 2.0, D: 3.0, C: 20.0}], 1.0, {C: 8.0}),
        # the median band decides, and a band of two files is none
        ([{A: 1.0, B: 1.0, C: 9.0}, {A: 1.0, B: 1.0, C: 7.0}, {A: 1.0, B: 1.0, C: 1.0}], 3.0,
         {C: 7.0}),
        ([{A: 1.0, B: 1.0, C: 9.0}, {A: 1.0, C: 1.0}], 3.0, {C: 9.0}),
        ([], 1.0, {}),
    ],
)  # fmt: skip
def test_an_outlier_has_four_times_the_median_misfit_in_the_median_band(bands, least, found):
    assert outlier_files(bands, least) == {k: pytest.approx(v) for k, v in found.items()}


def test_windows_of_an_outlier_have_its_factor_and_all_other_data_one():
    found = variance_inflation(windows(2, 1, 2), [A, B, C], {B: 5.0, C: 7.0}, 7)
    np.testing.assert_array_equal(found, [1.0, 1.0, 5.0, 7.0, 7.0, 1.0, 1.0])
    assert variance_inflation(windows(2, 1), [A, B], {C: 7.0}, 3) is None
    assert variance_inflation(windows(), [], {C: 7.0}, 3) is None
