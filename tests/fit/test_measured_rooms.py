"""Measured rooms: what was not fitted is predicted about as well as the mean of what was.

Bounds stand a little above what was measured (docs/measured-rooms.md) and are no statistics.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roomfit.result import Result

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    """Return the benchmark as a module."""
    path = Path(__file__).parents[2] / "benchmarks" / "measured_rooms.py"
    spec = importlib.util.spec_from_file_location("measured_rooms", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["measured_rooms"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def laboratory(benchmark: ModuleType, real_data: Path) -> Result:
    """Return the answer for dEchorate, three microphones fitted."""
    text = benchmark.dechorate_campaign(real_data / "dechorate", ("M4", "M5", "M6"))
    return benchmark.answer_to(text)


def _upper(benchmark: ModuleType, answer: Result, name: str) -> tuple[float, float]:
    ours, null = benchmark.errors(answer, name)
    judged = answer.bands.centres_hz > 400.0
    return float(np.nanmean(ours[:, judged])), float(np.nanmean(null[:, judged]))


def test_decay_times_of_microphones_kept_apart(benchmark: ModuleType, laboratory: Result) -> None:
    """T20 and EDT, 500 to 4000 Hz: not worse than the mean of the others by 1.5 points."""
    for name in ("T20_s", "EDT_s"):
        ours, null = _upper(benchmark, laboratory, name)
        assert ours <= null + 1.5


def test_clarity_of_microphones_kept_apart(benchmark: ModuleType, laboratory: Result) -> None:
    """C80, 500 to 4000 Hz: better than the mean of the others."""
    ours, null = _upper(benchmark, laboratory, "C80_dB")
    assert ours < null


def test_a_band_that_does_not_fit_tells_no_material(laboratory: Result) -> None:
    """phi above 2 forbids "identifiable", and an interval beside it would be no news."""
    poor = laboratory.chi2_reduced > 2.0
    assert not laboratory.identifiable[:, poor].any()
    width = (laboratory.upper95 - laboratory.lower95)[laboratory.identifiable]
    assert (width <= 0.2).all()
