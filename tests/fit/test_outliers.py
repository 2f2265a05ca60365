"""Measurements that the model explains far worse than all others."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.fit.outliers import outlier_files
from roomfit.signals.measurement import Measurement

A, B, C, D = (Measurement("S", name, np.ones(2), 8000) for name in "ABCD")


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
