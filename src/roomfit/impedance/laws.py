"""Physical laws of walls as curves of R0 over frequency."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.special import expit

from roomfit.materials.impedance_laws import miki_layer, panel, r0_of_impedance, resonator
from roomfit.typing import ComplexArray, FloatArray, IntArray

# Of a step in the logarithm of a law's parameter; the error of the slope is its fourth power.
_STEP = 1e-3

Law = Callable[..., ComplexArray]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of a law: where it starts, and the range that is searched (both above 0)."""

    name: str
    unit: str
    start: float
    low: float
    high: float


LAWS: Mapping[str, tuple[Law, tuple[Parameter, ...]]] = MappingProxyType(
    {
        "miki": (
            miki_layer,
            (
                Parameter("flow_resistivity", "Pa s/m2", 1.5e4, 5e2, 5e5),
                Parameter("thickness_m", "m", 0.05, 0.003, 0.5),
                Parameter("air_gap_m", "m", 0.01, 1e-4, 0.6),
            ),
        ),
        "resonator": (
            resonator,
            (
                Parameter("resistance", "rho c", 0.3, 0.003, 30.0),
                Parameter("mass_m", "m", 0.3, 0.003, 10.0),
                Parameter("depth_m", "m", 0.1, 0.005, 1.0),
                Parameter("flow_resistivity", "Pa s/m2", 1e3, 1.0, 1e5),
            ),
        ),
        "panel": (
            panel,
            (
                Parameter("resistance", "rho c", 0.5, 0.003, 30.0),
                Parameter("mass_m", "m", 5.0, 0.3, 200.0),
                Parameter("depth_m", "m", 0.1, 0.003, 1.0),
            ),
        ),
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class LawCurve:
    """R0 by a physical law; x are its parameters through a logistic curve between their bounds.

    Attributes
    ----------
    kind : str
        A key of `LAWS`.
    frequency_hz : complex array, shape (n_frequencies,)
        At the window, see `roomfit.impedance.observed.complex_frequency_hz`.
    speed_m_s : float
    parameters : tuple of Parameter
    """

    kind: str
    frequency_hz: ComplexArray
    speed_m_s: float
    parameters: tuple[Parameter, ...]

    @property
    def start(self) -> FloatArray:
        return self.x_of(np.array([p.start for p in self.parameters]))

    @property
    def roughness(self) -> FloatArray:
        return np.zeros((0, len(self.parameters)))

    @property
    def prior_sd(self) -> float:
        # nearly even over the range on a scale of logarithms, and never stuck at its ends
        return 3.0

    def values(self, x: FloatArray) -> FloatArray:
        """Return the law's parameters in their units, shape (..., n)."""
        low = np.log([p.low for p in self.parameters])
        high = np.log([p.high for p in self.parameters])
        return np.asarray(np.exp(low + (high - low) * expit(x)))

    def x_of(self, values: FloatArray) -> FloatArray:
        """Return the x of parameters within their bounds, kept a little off the ends."""
        low = np.log([p.low for p in self.parameters])
        high = np.log([p.high for p in self.parameters])
        share = np.clip((np.log(values) - low) / (high - low), 0.01, 0.99)
        return np.asarray(np.log(share / (1.0 - share)))

    def r0(self, x: FloatArray) -> ComplexArray:
        law, _ = LAWS[self.kind]
        return r0_of_impedance(law(self.frequency_hz, *self.values(x), self.speed_m_s))

    def slope(self, x: FloatArray) -> ComplexArray:
        columns = []
        for i in range(len(x)):
            step = _STEP * np.eye(len(x))[i]
            near = self.r0(x + step) - self.r0(x - step)
            far = self.r0(x + 2.0 * step) - self.r0(x - 2.0 * step)
            columns.append((8.0 * near - far) / (12.0 * _STEP))
        return np.column_stack(columns)

    def at(self, chosen: IntArray) -> LawCurve:
        return replace(self, frequency_hz=self.frequency_hz[chosen])

    def between(self, x: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        # passive by its parameters
        return np.zeros(0, dtype=np.complex128), np.zeros((0, len(x)), dtype=np.complex128)


def law_curve(
    kind: str,
    frequency_hz: ComplexArray,
    speed_m_s: float,
    told: Mapping[str, Parameter] | None = None,
) -> LawCurve:
    """Return a law with its usual starts and bounds, or those that were told."""
    _, usual = LAWS[kind]
    return LawCurve(
        kind, frequency_hz, speed_m_s, tuple((told or {}).get(p.name, p) for p in usual)
    )
