"""The air in the room: the speed of sound, how well it is known, and attenuation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from roomfit.base.arguments import check_known, check_range
from roomfit.base.bands import Bands
from roomfit.base.typing import FloatArray

AttenuationLaw = Literal["iso9613", "none"]

_ZERO_CELSIUS_K = 273.15
_REFERENCE_PRESSURE_PA = 101_325.0  # ISO 9613-1, 4.2.1
_REFERENCE_TEMPERATURE_K = 293.15  # ISO 9613-1, 4.2.1
_TRIPLE_POINT_K = 273.16  # ISO 9613-1, annex B
_CO2_PPM = 425.19  # mean of the globe in 2024 (NOAA); 100 ppm more change the speed by 9 mm/s
_LOWEST_HZ = 50.0  # where the tables of ISO 9613-1 begin


@dataclass(frozen=True, slots=True)
class Air:
    """State of the air."""

    temperature_c: float = 20.0  #: -20 to 50 degrees Celsius, where ISO 9613-1 claims 10 %
    humidity_percent: float = 50.0  #: Relative humidity, 0 to 100 %
    pressure_kpa: float = 101.325  #: Atmospheric pressure, 50 to 120 kPa
    speed_of_sound_m_s: float | None = None  #: 250 to 450 m/s; None for that of the temperature
    attenuation: AttenuationLaw = "iso9613"

    def __post_init__(self) -> None:
        check_range("temperature", self.temperature_c, -20.0, 50.0, "degrees C", "air")
        check_range("relative humidity", self.humidity_percent, 0.0, 100.0, "%", "air")
        check_range("atmospheric pressure", self.pressure_kpa, 50.0, 120.0, "kPa", "air")
        if self.speed_of_sound_m_s is not None:
            check_range("speed of sound", self.speed_of_sound_m_s, 250.0, 450.0, "m/s", "air")
        laws = ("iso9613", "none")
        check_known("unknown law of air attenuation", self.attenuation, laws, where="air")


def speed_of_sound_m_s(air: Air) -> float:
    """Return the speed of sound: the specified one, or the one by Cramer (1993).

    Outside the range of Cramer's fit (0 to 30 degrees C, 75 to 102 kPa) the value at its edge is
    extrapolated: over temperature as the root of the thermodynamic temperature, as in an ideal
    gas; over pressure as a constant, which is wrong by less than 2e-4 in the range of `Air`.

    Examples
    --------
    >>> round(speed_of_sound_m_s(Air(temperature_c=20.0, humidity_percent=50.0)), 2)
    343.98
    """
    if air.speed_of_sound_m_s is not None:
        return air.speed_of_sound_m_s
    temperature_c = min(max(air.temperature_c, 0.0), 30.0)
    pressure_pa = min(max(air.pressure_kpa, 75.0), 102.0) * 1000.0
    speed = cramer_speed_m_s(temperature_c, air.humidity_percent / 100.0, pressure_pa)
    factor = np.sqrt((air.temperature_c + _ZERO_CELSIUS_K) / (temperature_c + _ZERO_CELSIUS_K))
    return float(speed * factor)


def relative_speed_sd(air: Air, temperature_sd_c: float) -> float:
    """Return the relative standard deviation of the speed of sound, from that of temperature in K.

    The speed grows as the root of the thermodynamic temperature T, so ``dc / c = dT / (2 T)``.
    """
    return 0.5 * temperature_sd_c / (_ZERO_CELSIUS_K + air.temperature_c)


def cramer_speed_m_s(temperature_c: float, relative_humidity: float, pressure_pa: float) -> float:
    """Return the speed of sound in humid air with 425 ppm of carbon dioxide, m/s.

    The polynomial that Cramer fitted to real-gas speeds at zero frequency [1]_, uncertain by
    300 ppm where ``x_w`` is below 0.06. `speed_of_sound_m_s` keeps to the ranges within which it
    was fitted, so nothing is checked here.

    `temperature_c`: 0 to 30 degrees Celsius. `relative_humidity`: 0 to 1. `pressure_pa`: 75 to 102
    kPa, in Pa.

    References
    ----------
    .. [1] O. Cramer, "The variation of the specific heat ratio and the speed of sound in air with
           temperature, pressure, humidity, and CO2 concentration", J. Acoust. Soc. Am. 93,
           2510-2516 (1993). Equation (15) with table III; water vapour by (A1) to (A3).
    """
    t, p, x_c = temperature_c, pressure_pa, _CO2_PPM * 1e-6
    T = t + _ZERO_CELSIUS_K
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2  # (A2)
    saturation_pa = np.exp(  # (A3)
        1.2811805e-5 * T**2 - 1.9509874e-2 * T + 34.04926034 - 6.3536311e3 / T
    )
    x_w = relative_humidity * enhancement * saturation_pa / p  # (A1), mole fraction of water
    dry = 331.5024 + 0.603055 * t - 0.000528 * t**2
    of_water = (51.471935 + 0.1495874 * t - 0.000782 * t**2) * x_w
    of_pressure = (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p
    of_co2 = (-85.20931 - 0.228525 * t + 5.91e-5 * t**2) * x_c
    mixed = -2.835149 * x_w**2 - 2.15e-13 * p**2 + 29.179762 * x_c**2 + 0.000486 * x_w * p * x_c
    return float(dry + of_water + of_pressure + of_co2 + mixed)


def attenuation_per_m(air: Air, bands: Bands) -> FloatArray:
    """Return the energy attenuation m of each band by ISO 9613-1, 1/m, shape (n_bands,).

    At the exact centre frequency. Energy falls as ``exp(-m d)`` over d metres; 10 log10(e) m is the
    standard's figure in dB/m. Zeros where `air.attenuation` is "none"; below 50 Hz the value at
    50 Hz, less than 1e-4 dB over a room.
    """
    return 2.0 * pressure_decay_per_m(air, bands.exact_centres_hz)


def pressure_decay_per_m(air: Air, frequency_hz: FloatArray) -> FloatArray:
    """Return the pressure attenuation at any frequencies, 1/m: half of `attenuation_per_m`."""
    if air.attenuation == "none":
        return np.zeros(len(frequency_hz))
    f, pressure_pa = np.maximum(frequency_hz, _LOWEST_HZ), air.pressure_kpa * 1000.0
    of_air = iso9613_attenuation_db_per_m(f, air.temperature_c, air.humidity_percent, pressure_pa)
    return np.asarray(of_air / (20.0 * np.log10(math.e)))


def iso9613_attenuation_db_per_m(
    frequency_hz: FloatArray, temperature_c: float, humidity_percent: float, pressure_pa: float
) -> FloatArray:
    """Return the attenuation of pure tones in air by ISO 9613-1 [1]_, dB/m, shape (n,).

    Accurate within 10 % from -20 to 50 degrees C, with 0.05 to 5 % of water molecules, below
    200 kPa and from 0.0004 to 10 Hz/Pa; within 20 % in drier or moister air. `Air` keeps to that in
    temperature and pressure, so nothing is checked here.

    `frequency_hz`, shape (n,). `temperature_c`: degrees Celsius. `humidity_percent`: relative
    humidity, 0 to 100 %. `pressure_pa`: atmospheric pressure, Pa.

    References
    ----------
    .. [1] ISO 9613-1:1993, "Acoustics - Attenuation of sound during propagation outdoors -
           Part 1: Calculation of the absorption of sound by the atmosphere". Equations (3) to (5)
           and (B.1) to (B.3).
    """
    f, T = np.asarray(frequency_hz, dtype=np.float64), temperature_c + _ZERO_CELSIUS_K
    p, warmth = pressure_pa / _REFERENCE_PRESSURE_PA, T / _REFERENCE_TEMPERATURE_K
    exponent = -6.8346 * (_TRIPLE_POINT_K / T) ** 1.261 + 4.6151  # (B.3)
    h = humidity_percent * 10.0**exponent / p  # (B.1) and (B.2), molar concentration in %
    f_oxygen = p * (24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h))  # (3)
    f_nitrogen = (  # (4)
        p * warmth**-0.5 * (9.0 + 280.0 * h * np.exp(-4.170 * (warmth ** (-1.0 / 3.0) - 1.0)))
    )
    classical = 1.84e-11 / p * warmth**0.5
    oxygen = 0.01275 * np.exp(-2239.1 / T) / (f_oxygen + f**2 / f_oxygen)
    nitrogen = 0.1068 * np.exp(-3352.0 / T) / (f_nitrogen + f**2 / f_nitrogen)
    return np.asarray(8.686 * f**2 * (classical + warmth**-2.5 * (oxygen + nitrogen)))  # (5)
