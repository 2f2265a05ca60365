"""Room parameters of made responses, as somebody would have written them into a table."""

from __future__ import annotations

import numpy as np

from roomfit.app.calibrating.plan import CalibrationPlan, TabulatedPair
from roomfit.app.calibrating.sound import Sound
from roomfit.app.calibrating.truth import Truth
from roomfit.bands import Bands
from roomfit.files.parameters import NAMES
from roomfit.scene.scene import Point
from roomfit.signals.decay import decay_curve
from roomfit.signals.filters import FilterBank, filter_pressure
from roomfit.signals.impulse_response import ImpulseResponse, padded
from roomfit.signals.parameter_gradients import ValueName
from roomfit.signals.room_parameters import room_parameters
from roomfit.typing import FloatArray

_WRITTEN: dict[ValueName, str] = {name: key for key, name in NAMES.items()}
_PAD_S = 0.05


def made_table(
    plan: CalibrationPlan, truth: Truth, sound: Sound, rate_hz: float, rng: np.random.Generator
) -> str:
    """Return a table of the same pairs, parameters and stated spreads as the user's.

    Values come from the made responses by roomfit's own analysis, in the fitted bands; to each the
    error is added that its stated spread owns. Where a response does not hold a parameter the cell
    stays empty.
    """
    bands = plan.campaign.bands
    lines = [",".join(("source", "receiver", "parameter", *(f"{f:g}" for f in bands.centres_hz)))]
    for measured in plan.tabulated:
        pressure = sound.pressure[measured.source, measured.receiver]
        response = padded(ImpulseResponse(pressure, rate_hz), _PAD_S)
        direct_s = _distance_m(truth, measured) / truth.speed_of_sound_m_s
        found = _values(response, bands, direct_s)
        for name, spread in measured.spread.items():
            error = np.where(np.isfinite(spread), spread, 0.0) * rng.standard_normal(len(bands))
            lines.append(_line(measured, _WRITTEN[name], _possible(name, found[name] + error)))
            if np.isfinite(spread).any():
                lines.append(_line(measured, f"{_WRITTEN[name]}_sd", spread))
    return "\n".join(lines) + "\n"


def _values(
    response: ImpulseResponse, bands: Bands, direct_s: float
) -> dict[ValueName, FloatArray]:
    """Return all parameters of a response in absolute pressures."""
    bank = FilterBank(bands)
    parameters = room_parameters(decay_curve(bank, response, direct_s))
    found: dict[ValueName, FloatArray] = {"G_dB": _strength_db(bank, response)}
    for name in _WRITTEN:
        if name != "G_dB":
            found[name] = parameters.of(name)
    return found


def _strength_db(bank: FilterBank, response: ImpulseResponse) -> FloatArray:
    """Return G: energy over that of the direct sound at 10 m, ISO 3382-1, equation A.2."""
    impulse: FloatArray = np.zeros(len(response.pressure))
    impulse[impulse.size // 2] = 1.0 / (4.0 * np.pi * 10.0)
    free = ImpulseResponse(impulse, response.sampling_rate_hz)
    heard, reference = (np.sum(filter_pressure(bank, r) ** 2, axis=1) for r in (response, free))
    return np.asarray(10.0 * np.log10(heard / reference))


def _distance_m(truth: Truth, measured: TabulatedPair) -> float:
    def place(points: tuple[Point, ...], name: str) -> FloatArray:
        return next(p.position_m for p in points if p.name == name)

    step = place(truth.receivers, measured.receiver) - place(truth.sources, measured.source)
    return float(np.linalg.norm(step))


def _possible(name: ValueName, values: FloatArray) -> FloatArray:
    """Leave out what an added error has driven where no room is."""
    if name == "D50_percent":
        return np.clip(values, 0.0, 100.0)
    if name.endswith("_dB"):
        return values
    return np.where(values > 0.0, values, np.nan)


def _line(measured: TabulatedPair, key: str, values: FloatArray) -> str:
    cells = [f"{v:.6g}" if np.isfinite(v) else "" for v in values]
    return ",".join((measured.source, measured.receiver, key, *cells))
