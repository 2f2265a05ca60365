"""Impedances of porous layers, resonators and panels, over that of air, for walls of test rooms.

Frequencies may be complex, ``f - j / (2 pi tau)``, for spectra behind an exponential window.
"""

from __future__ import annotations

import numpy as np

from roomfit.base.typing import ComplexArray


def r0_of_impedance(impedance: ComplexArray) -> ComplexArray:
    """Return the reflection coefficient at normal incidence, ``(Z - 1) / (Z + 1)``."""
    z = np.asarray(impedance, dtype=np.complex128)
    return np.asarray((z - 1.0) / (z + 1.0))


def miki_layer(
    frequency_hz: ComplexArray,
    flow_resistivity: complex,
    thickness_m: complex,
    air_gap_m: complex,
    speed_m_s: float,
) -> ComplexArray:
    """Return the impedance of a porous layer before a rigid wall, with or without a gap of air.

    Miki's model of the material [1]_ and the transfer of an impedance through a layer. Good for
    ``0.01 < f / flow_resistivity < 1`` (m3/kg), used a little beyond.

    Parameters
    ----------
    flow_resistivity : complex
        Pa s/m2.
    thickness_m, air_gap_m : complex
        Complex where derivatives are taken.

    References
    ----------
    .. [1] Y. Miki, "Acoustical properties of porous materials - modifications of Delany-Bazley
           models", J. Acoust. Soc. Jpn (E) 11, 19-24 (1990).
    """
    k = 2.0 * np.pi * np.asarray(frequency_hz) / speed_m_s
    x = np.asarray(frequency_hz) / flow_resistivity
    own, wave = miki_material(x)
    phase = wave * k * thickness_m
    # admittance of the gap, 0 where there is none: no cotangent of nothing
    behind = 1j * np.tan(k * air_gap_m)
    sine, cosine = np.sin(phase), np.cos(phase)
    return np.asarray(
        own * (cosine + 1j * own * behind * sine) / (own * behind * cosine + 1j * sine)
    )


def miki_material(x: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return characteristic impedance and wavenumber, over those of air, at ``x = f / sigma``."""
    return (
        1.0 + (0.070 - 0.107j) * x**-0.632,
        1.0 + (0.109 - 0.160j) * x**-0.618,
    )


def resonator(
    frequency_hz: ComplexArray,
    resistance: complex,
    mass_m: complex,
    depth_m: complex,
    flow_resistivity: complex,
    speed_m_s: float,
) -> ComplexArray:
    """Return the impedance of a perforated plate or Helmholtz resonators before a filled cavity.

    ``Z = r + j k m + Z_cavity``, the cavity holding a porous material (`miki_layer`).

    Parameters
    ----------
    resistance : complex
        Over rho c.
    mass_m : complex
        Effective length of the necks over the share of open area, m.
    flow_resistivity : complex
        Of what fills the cavity, Pa s/m2; 10 and less is as good as air.
    """
    k = 2.0 * np.pi * np.asarray(frequency_hz) / speed_m_s
    cavity = miki_layer(frequency_hz, flow_resistivity, depth_m, 0.0, speed_m_s)
    return np.asarray(resistance + 1j * k * mass_m + cavity)


def panel(
    frequency_hz: ComplexArray,
    resistance: complex,
    mass_m: complex,
    depth_m: complex,
    speed_m_s: float,
) -> ComplexArray:
    """Return the impedance of a panel that moves as a mass on the spring of the air behind it.

    ``Z = r + j k m - j cot(k d)``.

    Parameters
    ----------
    resistance : complex
        Losses over rho c.
    mass_m : complex
        Mass per area over the density of air, m: 1 m is 1.2 kg/m2.
    depth_m : complex
        Of the air behind.
    """
    k = 2.0 * np.pi * np.asarray(frequency_hz) / speed_m_s
    return np.asarray(resistance + 1j * k * mass_m - 1j / np.tan(k * depth_m))
