"""Measured pressures of all pairs behind an exponential window, and how far they can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.checks import float_array, read_only
from roomfit.errors import InputError
from roomfit.typing import ComplexArray, FloatArray

# Error of the image model itself against exact wave fields, spherical or plane waves at the walls:
# this over the wavenumber times the mean free path; see docs/impedance.md.
MODEL_ERROR = 0.16
PLANE_MODEL_ERROR = 1.3
_SMOOTHED_OVER = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Damped spectra of the measured pairs.

    The spectrum of an impulse response times ``exp(-t / tau)``, with time from emission and
    ``exp(+j w t)``; the direct sound alone is ``exp(-j k r) / (4 pi r)`` up to a gain.

    Attributes
    ----------
    frequency_hz : float array, shape (n_frequencies,)
        Rising, above 0.
    tau_s : float
        Time constant of the window, above 0.
    pressure : complex array, shape (n_pairs, n_frequencies)
        Where `has_phase` is false, magnitudes.
    noise : float array, shape (n_pairs, n_frequencies), or None
        rms of the complex noise, in the unit of the pressure; None where it is not known.
    has_phase : bool
    """

    frequency_hz: FloatArray
    tau_s: float
    pressure: ComplexArray
    noise: FloatArray | None = None
    has_phase: bool = True

    def __post_init__(self) -> None:
        f = float_array("frequencies (Hz)", self.frequency_hz, (None,), low=1.0, high=1e5)
        if len(f) == 0 or (np.diff(f) <= 0.0).any():
            raise InputError(
                "frequencies are out of order",
                found=f"{len(f)} of them" if len(f) == 0 else first_fall(f),
                needed="each above the one before, at least one",
            )
        if not 1e-4 <= self.tau_s <= 10.0:
            raise InputError(
                "the time constant of the exponential window is out of range",
                found=f"{self.tau_s:g} s",
                needed="1e-4 to 10 s",
            )
        p = np.array(self.pressure, dtype=np.complex128)
        if p.ndim != 2 or p.shape[1] != len(f) or not np.isfinite(p).all() or not p.any():
            raise InputError(
                "pressures and frequencies disagree",
                found=f"pressures of shape {p.shape}, {len(f)} frequencies",
                needed=f"finite numbers, not all 0, of shape (pairs, {len(f)})",
            )
        object.__setattr__(self, "frequency_hz", f)
        object.__setattr__(self, "pressure", read_only(p))
        if self.noise is not None:
            noise = float_array("noise (rms)", self.noise, p.shape, low=0.0)
            object.__setattr__(self, "noise", noise)


def complex_frequency_hz(observed: Observed) -> ComplexArray:
    """Return ``f - j / (2 pi tau)``, the frequency at which the window evaluates every law."""
    return np.asarray(observed.frequency_hz - 0.5j / (np.pi * observed.tau_s))


def level_at(observed: Observed) -> FloatArray:
    """Return the rms pressure of all pairs about each frequency, shape (n_frequencies,)."""
    f = observed.frequency_hz
    near = np.abs(np.log(f[:, None] / f)) <= _SMOOTHED_OVER
    power = np.mean(np.abs(observed.pressure) ** 2, axis=0)
    return np.asarray(np.sqrt((near @ power) / near.sum(axis=1)))


def model_error(
    frequency_hz: FloatArray, free_path_m: float, speed_m_s: float, factor: float = MODEL_ERROR
) -> FloatArray:
    """Return the rms error of image sources against exact waves, over the rms pressure.

    `factor` over the wavenumber times the mean free path: it falls with frequency as what a
    reflected spherical wave leaves out does.
    """
    return np.asarray(factor * speed_m_s / (2.0 * np.pi * frequency_hz * free_path_m))


def standard_deviation(
    observed: Observed, free_path_m: float, speed_m_s: float, factor: float = MODEL_ERROR
) -> FloatArray:
    """Return the rms by which a perfect fit still misses: noise, and the error of image sources.

    Parameters
    ----------
    factor : float
        Of the model's own error, see `model_error`.

    Returns
    -------
    float array, shape (n_pairs, n_frequencies)
        Of the complex pressure; real and imaginary part have half of its square each.
    """
    share = model_error(observed.frequency_hz, free_path_m, speed_m_s, factor)
    model = np.broadcast_to(share * level_at(observed), observed.pressure.shape)
    noise = 0.0 if observed.noise is None else observed.noise
    return np.asarray(np.sqrt(model**2 + np.square(noise)))


def first_fall(f: FloatArray) -> str:
    """Return in words where frequencies first do not rise."""
    at = int(np.flatnonzero(np.diff(f) <= 0.0)[0])
    return f"{f[at + 1]:g} Hz after {f[at]:g} Hz at index {at + 1}"
