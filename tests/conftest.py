"""What every test may use: where real measurements lie, and quiet, repeatable hypothesis runs."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from roomfit import solver

settings.register_profile(
    "roomfit", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("roomfit")
# A shell without job control, and nohup, start what they start with signals ignored, which the
# processes that tests start would inherit: tests that interrupt a command would wait in vain.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The files that take longest, so that none begins when another worker has nothing left to do. The
# second needs hardly a kernel: while the first compiles them, it compiles none of them as well.
# The first must find no thread that other tests have left, beside which no copy is made.
LONGEST = (
    "test_forks.py",
    "fit/test_identify.py",
    "test_output_folders.py",
    "paper/test_command.py",
    "app/test_browser.py",
    "test_docs.py",
    "test_tutorials.py",
    "fit/test_identify_rooms.py",
    "predict/test_predict.py",
    "test_workers.py",
    "test_batch.py",
    "test_shape.py",
)
DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Hand the longest files to the workers of xdist first, in its order and by --dist loadfile."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        tests = Path(__file__).parent
        rank = {(tests / name).resolve(strict=True): i for i, name in enumerate(LONGEST)}
        items.sort(key=lambda item: rank.get(item.path.resolve(), len(rank)))


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
        patch.setattr(solver, "_SETTLED_SD", 1e-7)
        patch.setattr(solver, "_AGREEMENT_SD", 1e-7)
        yield
