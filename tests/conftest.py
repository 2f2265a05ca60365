"""What every test may use: where real measurements lie, and quiet, repeatable hypothesis runs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from roomfit.solvers import least_squares

settings.register_profile(
    "roomfit", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("roomfit")
# No test writes into the folder of whoever runs it, nor does any process that a test starts; those
# of the cache name a folder of their own.
os.environ["ROOMFIT_CACHE"] = "off"

DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real measurements; tests that need it are skipped where it is missing."""
    if not DATA.is_dir():
        pytest.skip("real measurements are not on this machine")
    return DATA


@pytest.fixture(scope="module")
def exact_fits() -> Iterator[None]:
    """Fits that end within a ten-millionth of a standard deviation, not a fiftieth."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(least_squares, "_SETTLED_SD", 1e-7)
        patch.setattr(least_squares, "_AGREEMENT_SD", 1e-7)
        yield
