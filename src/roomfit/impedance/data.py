"""Damped spectra of one pair from a NumPy archive.

Measured pressures of all pairs behind an exponential window, and how far they can be trusted.

Spectra behind an exponential window, from impulse responses.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from roomfit._checks import float_array, read_only
from roomfit.errors import InputError, StoreError
from roomfit.signals.response import ImpulseResponse, times_s
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


@dataclass(frozen=True, slots=True, eq=False)
class DampedSpectrum:
    """What a file ``spectrum = "pair.npz"`` holds.

    Attributes
    ----------
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
        Time constant of the exponential window.
    pressure : complex array, shape (n_frequencies,)
    noise : float array, shape (n_frequencies,), or None
        rms, in the unit of the pressure.
    has_phase : bool
        False where the file holds levels.
    """

    frequency_hz: FloatArray
    tau_s: float
    pressure: ComplexArray
    noise: FloatArray | None
    has_phase: bool


def read_spectrum(path: Path) -> DampedSpectrum:
    """Return the damped spectrum of a pair.

    The archive holds ``f`` (Hz, rising), ``tau`` (s), ``p`` (complex, ``exp(+j w t)``) and perhaps
    ``noise`` (rms, one number or one a frequency). Where only levels were measured, ``magnitude``
    (``|p|``, not in decibels) stands in place of ``p``.

    Raises
    ------
    InputError
        No such file, no NumPy archive, arrays missing, of unlike shape, out of order or not finite.
    StoreError
        The disk refuses.
    """
    path = Path(path)
    arrays = _arrays(path)
    where = str(path)
    if ("p" in arrays) == ("magnitude" in arrays):
        raise InputError(
            "a spectrum needs pressures or magnitudes",
            where=where,
            found=", ".join(sorted(arrays)) or "nothing",
            needed="p (complex), or magnitude",
        )
    for name in ("f", "tau"):
        if name not in arrays:
            raise InputError(
                "a spectrum lacks an array",
                where=where,
                found=", ".join(sorted(arrays)),
                needed={"f": "f (Hz)", "tau": "tau (s), the window's time constant"}[name],
            )
    f = float_array(f"f of {path.name}", arrays["f"], (None,), low=1.0, high=1e5, unit="Hz")
    if len(f) == 0 or (np.diff(f) <= 0.0).any():
        raise InputError(
            "frequencies are out of order",
            where=where,
            found=first_fall(f) if len(f) else "none of them",
            needed="each above the one before, at least one",
        )
    if np.size(arrays["tau"]) != 1:
        raise InputError("tau is not one number", where=where, found=f"{np.shape(arrays['tau'])}")
    tau = float_array("tau", np.reshape(arrays["tau"], ()), (), low=1e-4, high=10.0, unit="s")
    return DampedSpectrum(
        f,
        float(tau),
        _pressure(arrays, len(f), where),
        _noise(arrays, len(f), where),
        "p" in arrays,
    )


def _arrays(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise InputError(
            "the spectrum does not exist",
            where=str(path),
            hint="paths in a campaign are relative to the campaign file",
        ) from None
    except (ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise InputError(
            "the spectrum is not a NumPy archive of arrays",
            where=str(path),
            found=str(error),
            needed="a file of numpy.savez with f, tau and p",
        ) from error
    except OSError as error:
        raise StoreError(
            "the spectrum cannot be read", where=str(path), found=str(error)
        ) from error


def _pressure(arrays: dict[str, Any], n: int, where: str) -> ComplexArray:
    name = "p" if "p" in arrays else "magnitude"
    values = np.asarray(arrays[name])
    if not np.issubdtype(values.dtype, np.number):
        raise InputError(f"{name} holds no numbers", where=where, found=str(values.dtype))
    if name == "p" and not np.issubdtype(values.dtype, np.complexfloating):
        raise InputError(
            "pressures without phase",
            where=where,
            found=f"p of type {values.dtype}",
            needed="complex numbers, or magnitude in place of p",
        )
    if values.shape != (n,):
        raise InputError(
            f"{name} and f disagree",
            where=where,
            found=f"{name} of shape {values.shape}, f of shape ({n},)",
            needed="one number a frequency",
        )
    if not np.isfinite(values).all():
        at = int(np.flatnonzero(~np.isfinite(values))[0])
        raise InputError(
            f"{name} is not finite everywhere", where=where, found=f"{values[at]} at index {at}"
        )
    if not values.any():
        raise InputError(
            f"{name} is 0 everywhere", where=where, needed="what was measured, not silence"
        )
    return read_only(np.array(values, dtype=np.complex128))


def _noise(arrays: dict[str, Any], n: int, where: str) -> FloatArray | None:
    if "noise" not in arrays:
        return None
    noise = np.asarray(arrays["noise"], dtype=np.float64)
    if noise.shape not in ((), (n,)):
        raise InputError(
            "noise and f disagree",
            where=where,
            found=f"noise of shape {noise.shape}, f of shape ({n},)",
            needed="one number, or one a frequency",
        )
    return float_array("noise (rms)", np.broadcast_to(noise, (n,)), (n,), low=0.0)


# Times tau after which nothing of a window is left, exp(-12) = 6e-6.
_WINDOW = 12.0
# So long before the direct sound a response may begin: filters ring both ways.
_EARLY_S = 0.002
_LEAST_PARTS = 2


def damped_spectrum(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> ComplexArray:
    """Return the spectrum of a response times ``exp(-t / tau)``, t from emission.

    ``sum h exp(-t / tau) exp(-j w t)``: a response whose direct sound is a single sample of
    ``1 / (4 pi r)`` gives ``exp(-j k r) / (4 pi r)`` with the complex wavenumber of the window.
    What comes more than 2 ms before the direct sound is no sound and left out.

    Parameters
    ----------
    response : ImpulseResponse
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
    direct_s : float
        When the direct sound arrives, after emission.

    Raises
    ------
    InputError
        The response ends before the window does, or does not reach the highest frequency.
    """
    t = times_s(response)
    if t[-1] < direct_s + 3.0 * tau_s:
        raise InputError(
            "the response ends before the exponential window",
            found=f"{1000.0 * t[-1]:.0f} ms after emission",
            needed=f"at least {1000.0 * (direct_s + 3.0 * tau_s):.0f} ms",
            hint="choose a shorter tau_s",
        )
    if frequency_hz[-1] > 0.4 * response.sampling_rate_hz:
        raise InputError(
            "the highest frequency is too near to half of the sampling rate",
            found=f"{frequency_hz[-1]:g} Hz at {response.sampling_rate_hz:g} Hz",
            needed=f"at most {0.4 * response.sampling_rate_hz:g} Hz",
        )
    own = (t >= direct_s - _EARLY_S) & (t <= direct_s + _WINDOW * tau_s)
    return _transformed(response.pressure[own], t[own], frequency_hz, tau_s)


def damped_noise(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> FloatArray | None:
    """Return the rms noise of a damped spectrum by what the end of the file holds.

    Windows of the same length and weight are laid side by side over its last half; the lowest
    third of them counts, so that what is left of the decay does not.

    Returns
    -------
    float array, shape (n_frequencies,), or None
        None where the file is too short.
    """
    t = times_s(response)
    window_s = min(_WINDOW * tau_s, 0.25 * (t[-1] - direct_s))
    start = max(direct_s + _WINDOW * tau_s, 0.5 * t[-1])
    n = round(window_s * response.sampling_rate_hz)
    first = int(np.searchsorted(t, start))
    count = (len(t) - first) // max(n, 1)
    if count < _LEAST_PARTS or n < 8:
        return None
    # at the window's start, as the sound that is measured
    clock = direct_s + np.arange(n) / response.sampling_rate_hz
    parts = np.reshape(response.pressure[len(t) - count * n :], (count, n))
    power = np.array(
        [np.abs(_transformed(part, clock, frequency_hz, tau_s)) ** 2 for part in parts]
    )
    quiet = np.argsort(power.sum(axis=1))[: max(count // 3, _LEAST_PARTS)]
    # few windows: neighbouring frequencies tell the same
    mean = power[quiet].mean(axis=0)
    near = np.abs(np.log(frequency_hz[:, None] / frequency_hz)) <= 0.2
    return np.asarray(np.sqrt((near @ mean) / near.sum(axis=1)))


def _transformed(
    pressure: FloatArray, t: FloatArray, frequency_hz: FloatArray, tau_s: float
) -> ComplexArray:
    damped = pressure * np.exp(-t / tau_s)
    return np.array([np.sum(damped * np.exp(-2j * np.pi * f * t)) for f in frequency_hz])
