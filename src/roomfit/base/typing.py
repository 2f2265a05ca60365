"""Types that every layer uses: arrays, and the report of progress."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
ComplexArray: TypeAlias = NDArray[np.complex128]
IntArray: TypeAlias = NDArray[np.integer[Any]]
BoolArray: TypeAlias = NDArray[np.bool_]

ParameterName = Literal["EDT_s", "T20_s", "T30_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms"]
ValueName = Literal[ParameterName, "G_dB"]
VALUE_NAMES: tuple[ValueName, ...] = (*get_args(ParameterName), "G_dB")

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction of a long job that is done, rising from 0 to 1."""


def part(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a progress function for the part of a job from one fraction to another."""
    if progress is None:
        return None
    whole = progress

    def report(fraction: float) -> None:
        whole(begin + (end - begin) * fraction)

    return report
