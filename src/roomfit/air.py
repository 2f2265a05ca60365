"""The air in the room: speed of sound and attenuation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.bands import Bands
from roomfit.errors import InputError
from roomfit.typing import FloatArray

AttenuationLaw = Literal["iso9613", "none"]


@dataclass(frozen=True, slots=True)
class Air:
    """State of the air.

    Attributes
    ----------
    temperature_c : float
        -20 to 50 degrees Celsius (the range in which ISO 9613-1 claims 10 %).
    humidity_percent : float
        Relative humidity, 0 to 100 %.
    pressure_kpa : float
        Atmospheric pressure, 50 to 120 kPa.
    speed_of_sound_m_s : float or None
        Overrides the speed from temperature where given, 250 to 450 m/s.
    attenuation : {"iso9613", "none"}
    """

    temperature_c: float = 20.0
    humidity_percent: float = 50.0
    pressure_kpa: float = 101.325
    speed_of_sound_m_s: float | None = None
    attenuation: AttenuationLaw = "iso9613"

    def __post_init__(self) -> None:
        limits = (
            ("temperature", self.temperature_c, -20.0, 50.0, "degrees C"),
            ("relative humidity", self.humidity_percent, 0.0, 100.0, "%"),
            ("atmospheric pressure", self.pressure_kpa, 50.0, 120.0, "kPa"),
            ("speed of sound", self.speed_of_sound_m_s, 250.0, 450.0, "m/s"),
        )
        for name, value, low, high, unit in limits:
            if value is not None and not low <= value <= high:
                raise InputError(
                    f"{name} is out of range",
                    where="air",
                    found=f"{value:g} {unit}",
                    needed=f"{low:g} to {high:g} {unit}",
                )
        if self.attenuation not in ("iso9613", "none"):
            raise InputError(
                "unknown law of air attenuation",
                where="air",
                found=repr(self.attenuation),
                needed='"iso9613" or "none"',
            )


def speed_of_sound_m_s(air: Air) -> float:
    """Return the speed of sound: the given one, or Cramer's (1993) as in pyfar.

    343.99 m/s at 20 degrees C, 50 % and 101.325 kPa by Cramer's formula [1]_.

    References
    ----------
    .. [1] O. Cramer, "The variation of the specific heat ratio and the speed of sound in air with
           temperature, pressure, humidity, and CO2 concentration", J. Acoust. Soc. Am. 93,
           2510-2516 (1993).
    """
    if air.speed_of_sound_m_s is not None:
        return air.speed_of_sound_m_s
    from pyfar.constants import speed_of_sound_cramer

    # Cramer's fit holds from 0 to 30 degrees C and 75 to 102 kPa, and pyfar refuses what lies
    # outside; the ideal-gas law carries the value on in temperature (c grows as the root of T),
    # and pressure changes it by less than 2e-4 over the range that `Air` accepts.
    temperature_c = float(np.clip(air.temperature_c, 0.0, 30.0))
    speed = speed_of_sound_cramer(
        temperature_c,
        air.humidity_percent / 100.0,
        atmospheric_pressure=float(np.clip(air.pressure_kpa, 75.0, 102.0)) * 1000.0,
    )
    factor = np.sqrt((air.temperature_c + 273.15) / (temperature_c + 273.15))
    return float(np.asarray(speed).item() * factor)


def attenuation_per_m(air: Air, bands: Bands) -> FloatArray:
    """Return the energy attenuation m of each band by ISO 9613-1, at the exact centre frequency.

    Energy falls as ``exp(-m d)`` over d metres; 10 log10(e) m is the standard's figure in dB/m.

    Returns
    -------
    float array, shape (n_bands,)
        1/m; zeros where `air.attenuation` is "none".
    """
    if air.attenuation == "none":
        return np.zeros(len(bands))
    from pyfar.constants import air_attenuation

    # pyfar refuses frequencies below 50 Hz, where the attenuation over a room is below 1e-4 dB
    frequencies = np.maximum(bands.exact_centres_hz, 50.0)
    _, m, _ = air_attenuation(
        air.temperature_c, frequencies, air.humidity_percent / 100.0, air.pressure_kpa * 1000.0
    )
    return np.real(np.asarray(m.freq)).reshape(-1).astype(np.float64)


def pressure_decay_per_m(air: Air, frequency_hz: FloatArray) -> FloatArray:
    """Return by how much pressures fall in the air, ISO 9613-1 at any frequencies, 1/m.

    Half of what energies fall by, see `attenuation_per_m`; zeros where `air.attenuation` is "none".
    """
    if air.attenuation == "none":
        return np.zeros(len(frequency_hz))
    from pyfar.constants import air_attenuation

    _, m, _ = air_attenuation(
        air.temperature_c,
        np.maximum(frequency_hz, 50.0),
        air.humidity_percent / 100.0,
        air.pressure_kpa * 1000.0,
    )
    return 0.5 * np.real(np.asarray(m.freq)).reshape(-1).astype(np.float64)
