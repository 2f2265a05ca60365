"""Room-acoustical parameters of ISO 3382-1 from decay curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.findings import Finding
from roomfit.signals.decay import DecayCurve, decay_curve_db
from roomfit.typing import BoolArray, FloatArray

ParameterName = Literal["EDT_s", "T20_s", "T30_s", "C50_dB", "C80_dB", "D50_percent", "TS_ms"]
PARAMETER_NAMES: tuple[ParameterName, ...] = get_args(ParameterName)

# Levels between which each decay time is read, below the curve's beginning.
FIT_RANGES_DB: dict[str, tuple[float, float]] = {
    "EDT_s": (0.0, 10.0),
    "T20_s": (5.0, 25.0),
    "T30_s": (5.0, 35.0),
}
POINTS_OF_A_FIT = 512
# Energy after the usable end is extrapolated; where it is a hundredth of all, it can be 20 % wrong
# without moving D50, TS or C80 around 0 dB by more than a tenth of a just noticeable difference.
_LEAST_RANGE_DB = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class RoomParameters:
    """Parameters of one source and receiver in every band.

    Attributes
    ----------
    bands : Bands
    values : float array, shape (7, n_bands)
        In the order of `PARAMETER_NAMES`, in the units these names tell; nan where not valid.
    valid : bool array, shape (7, n_bands)
        Whether the decay range holds the parameter.
    nonlinearity_permille : float array, shape (2, n_bands)
        Of T20 and T30: 1000 (1 - r^2) of the straight line; above 10 the decay is not straight
        (ISO 3382-2, annex B). nan where not valid.
    curvature_percent : float array, shape (n_bands,)
        100 (T30 / T20 - 1); above 10 the decay is far from straight, below 0 noise is suspect.
    """

    bands: Bands
    values: FloatArray
    valid: BoolArray
    nonlinearity_permille: FloatArray
    curvature_percent: FloatArray

    def of(self, name: ParameterName) -> FloatArray:
        """Return one parameter in every band, nan where not valid, shape (n_bands,)."""
        if name not in PARAMETER_NAMES:
            raise InputError(
                "unknown room parameter", found=repr(name), needed=", ".join(PARAMETER_NAMES)
            )
        return np.asarray(self.values[PARAMETER_NAMES.index(name)])


def room_parameters(curve: DecayCurve) -> RoomParameters:
    """Return EDT, T20, T30, C50, C80, D50 and TS of every band.

    The same function serves measured and predicted curves, so that neither is favoured.

    Notes
    -----
    Decay times come from a straight line through the curve by least squares, every instant of the
    range with the same weight: 0 to -10 dB from the onset on (EDT), -5 to -25 dB (T20), -5 to
    -35 dB (T30) [1]_. A range that reaches deeper than `curve.usable_db` is not evaluated; nor
    are C, D and TS where that is less than 20 dB, or C where the late part lies below it.

    References
    ----------
    .. [1] ISO 3382-1:2009, "Measurement of room acoustic parameters - Performance spaces"; ISO
           3382-2:2008, annex B, for the non-linearity and the curvature.
    """
    levels_db = decay_curve_db(curve)
    n_bands = len(curve.bands)
    values = np.full((len(PARAMETER_NAMES), n_bands), np.nan)
    nonlinearity = np.full((2, n_bands), np.nan)
    for band in range(n_bands):
        for row, (_, fit_range_db) in enumerate(FIT_RANGES_DB.items()):
            found = _decay_time_s(curve, levels_db[band], band, fit_range_db)
            if found is not None:
                values[row, band] = found[0]
                if row > 0:
                    nonlinearity[row - 1, band] = found[1]
        values[3:, band] = _early_to_late(curve, band)
    t20_s, t30_s = values[1], values[2]
    return RoomParameters(
        curve.bands, values, np.isfinite(values), nonlinearity, 100.0 * (t30_s / t20_s - 1.0)
    )


def range_findings(parameters: RoomParameters, where: str) -> tuple[Finding, ...]:
    """Return a finding for the bands in which T20 could not be evaluated.

    Parameters
    ----------
    parameters : RoomParameters
    where : str
        Names the response in the sentence.
    """
    missing = parameters.bands.centres_hz[~parameters.valid[PARAMETER_NAMES.index("T20_s")]]
    if not missing.size:
        return ()
    names = ", ".join(f"{f:g}" for f in missing)
    return (
        Finding(
            "decay-range-too-small",
            "warning",
            f"{where}: noise or the end of the file leaves less than 25 dB of decay at {names} Hz; "
            "T20 is not evaluated there.",
            {"bands_hz": missing.tolist()},
        ),
    )


def _decay_time_s(
    curve: DecayCurve, level_db: FloatArray, band: int, fit_range_db: tuple[float, float]
) -> tuple[float, float] | None:
    """Return reverberation time and non-linearity over one range, or None beyond the usable."""
    upper_db, lower_db = fit_range_db
    if lower_db > curve.usable_db[band]:
        return None
    start = int(np.searchsorted(curve.time_s, curve.onset_s))
    begin_s = max(curve.onset_s, _first_below_s(curve.time_s, level_db, upper_db))
    end_s = _first_below_s(curve.time_s, level_db, lower_db)
    if not end_s > begin_s or start >= len(curve.time_s):
        return None
    # the curve is known at unequal times: the line is drawn through equally spaced ones
    times = np.linspace(begin_s, end_s, POINTS_OF_A_FIT)
    levels = np.interp(times, curve.time_s, level_db)
    t, y = times - times.mean(), levels - levels.mean()
    slope = float(t @ y / (t @ t))
    if not slope < 0.0:
        return None
    r_squared = slope**2 * float(t @ t) / float(y @ y)
    return -60.0 / slope, 1000.0 * (1.0 - r_squared)


def _first_below_s(time_s: FloatArray, level_db: FloatArray, depth_db: float) -> float:
    """Return when the curve first falls below a depth, between its points by a straight line."""
    below = np.flatnonzero(level_db < -depth_db)
    if not below.size or below[0] == 0:
        return float(time_s[0])
    i = int(below[0])
    high, low = level_db[i - 1], max(level_db[i], -300.0)
    share = (high + depth_db) / (high - low)
    return float(time_s[i - 1] + share * (time_s[i] - time_s[i - 1]))


def _early_to_late(curve: DecayCurve, band: int) -> list[float]:
    """Return C50 and C80 in dB, D50 in percent, TS in ms; nan beyond the usable range."""
    left, usable_db = curve.energy_left[band], float(curve.usable_db[band])
    values = [np.nan] * 4
    if usable_db < _LEAST_RANGE_DB:
        return values
    total, tail = float(left[0]), float(left[0]) * 10.0 ** (-0.1 * usable_db)
    late = np.interp(curve.onset_s + np.array([0.05, 0.08]), curve.time_s, left, right=0.0)
    for row in (0, 1):
        if tail < late[row] < total:
            values[row] = float(10.0 * np.log10(total / late[row] - 1.0))
    values[2] = float(100.0 * (1.0 - late[0] / total))
    # the first moment by parts: the integral of what is left, with the exponential tail's share
    area = float(np.trapezoid(left, curve.time_s)) + tail * curve.tail_time_constant_s[band]
    values[3] = float(1000.0 * (area / total - (curve.onset_s - curve.time_s[0])))
    return values
