"""Measurements on arrays in memory: what they take, and what they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from roomfit.base.errors import InputError
from roomfit.signals.measurement import Measurement

SAMPLES = np.array([0.0, 1.0, 0.5, 0.25])


def test_samples_of_a_signal_are_those_of_an_array() -> None:
    """A ``pyfar.Signal`` brings its own sampling rate."""
    pyfar: Any = pytest.importorskip("pyfar")
    signal = Measurement("S", "R", pyfar.Signal(SAMPLES, 44_100))
    array = Measurement("S", "R", SAMPLES, 44_100)
    np.testing.assert_array_equal(signal.response.pressure, array.response.pressure)
    assert signal.response.sampling_rate_hz == array.response.sampling_rate_hz == 44_100.0
    with pytest.raises(InputError, match="another sampling rate"):
        Measurement("S", "R", pyfar.Signal(SAMPLES, 44_100), 48_000)


def test_emission_lies_a_latency_after_the_first_sample() -> None:
    """As in a campaign file."""
    assert Measurement("S", "R", SAMPLES, 48_000, latency_s=0.01).response.time_zero_s == 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": SAMPLES}, "without a sampling rate"),
        ({"samples": SAMPLES, "sampling_rate_hz": 10.0}, "sampling rate is out of range"),
        ({"samples": [np.nan, 1.0], "sampling_rate_hz": 48e3}, "S to R"),
        ({"samples": SAMPLES, "sampling_rate_hz": 48e3, "level": "loud"}, "unknown level"),
        ({"samples": SAMPLES, "sampling_rate_hz": 48e3, "use": "both"}, "unknown use"),
    ],
)
def test_what_is_no_measurement_is_refused(arguments: dict[str, Any], message: str) -> None:
    """With the pair in the message."""
    with pytest.raises(InputError, match=message):
        Measurement("S", "R", **arguments)
