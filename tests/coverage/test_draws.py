"""What coverage draws anew: positions, directivities and levels, each by its own law."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.coverage.synthetic_room import (
    CoverageSettings,
    synthetic_bands,
)


@pytest.mark.parametrize(
    ("kind", "low", "high", "expected"),
    [
        ("octave", 500, 1000, (250, 500, 1000, 2000)),
        ("octave", 1000, 1000, (500, 1000, 2000)),
        ("third-octave", 500, 800, (400, 500, 630, 800, 1000)),
    ],
)
def test_bands_of_a_simulation_reach_one_band_beyond_the_fitted_ones(kind, low, high, expected):
    found = synthetic_bands(bands_between(kind, low, high))
    assert found.kind == kind
    np.testing.assert_allclose(found.centres_hz, expected, rtol=0.01)


def test_settings_of_coverage_are_refused_beyond_their_limits_and_name_their_slice():
    """Each limit itself is taken."""
    most: dict[str, Any] = {"replicates": 100_000, "seed": 2**63 - 1, "workers": 1024}
    for own in (most, {"replicates": 1}, {"snr_db": 20.0}, {"snr_db": 90.0}, {"first": 199},
                {"seed": 0}, {"only": 200}, {"only": 1}):  # fmt: skip
        CoverageSettings(**own)
    for bad in ({"replicates": 100_001}, {"replicates": 0}, {"snr_db": 19.9}, {"snr_db": 90.1},
                {"first": 200}, {"first": -1}, {"seed": -1}, {"only": 201}, {"only": 0},
                {"workers": 0}, {"workers": 1025}, {"seed": 2**63}):  # fmt: skip
        with pytest.raises(InputError, match="out of range") as caught:
            CoverageSettings(**bad)
        assert next(iter(bad)).replace("_", "-") in str(caught.value)
    assert CoverageSettings(replicates=9, first=2, only=3).numbers == range(2, 5)
    assert CoverageSettings(replicates=4, first=2, only=3).numbers == range(2, 4)
    assert CoverageSettings(replicates=4, first=2).numbers == range(2, 4)
