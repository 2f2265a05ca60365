"""Pressures behind an exponential window, and the standard deviation of their residuals.

The damped spectrum of an impulse response is that of the response times ``exp(-t / tau)``: a
pressure at the complex frequency ``f - j / (2 pi tau)``, to which early sound contributes most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.base.air import speed_of_sound_m_s
from roomfit.base.arguments import check_range, float_array, read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.room.mesh import mean_free_path_m
from roomfit.room.scene import Scene
from roomfit.signals.response import ImpulseResponse, times_s

# Error of the image model itself against exact wave fields, spherical or plane waves at the walls:
# this over the wavenumber times the mean free path; see docs/impedance.md.
MODEL_ERROR = 0.16
PLANE_MODEL_ERROR = 1.3
_LOUDEST = 1e12  # so that squares stay finite


@dataclass(frozen=True, slots=True, eq=False)
class Observed:
    """Damped spectra of the measured pairs.

    The spectrum of an impulse response times ``exp(-t / tau)``, with time from emission and
    ``exp(+j w t)``; the direct sound alone is ``exp(-j k r) / (4 pi r)`` up to a gain.

    Examples
    --------
    >>> observed = Observed([250.0, 500.0], 0.01, [[0.1 - 0.2j, 0.05j]])
    >>> observed.pressure.shape, observed.noise is None
    ((1, 2), True)
    """

    frequency_hz: FloatArray  # (n_frequencies,), rising, 1 Hz to 100 kHz
    tau_s: float  # time constant of the window, 1e-4 to 10 s
    # (n_pairs, n_frequencies), finite and not 0 everywhere; magnitudes where `has_phase` is false
    pressure: ComplexArray
    # likewise, rms of the complex noise in the unit of the pressure, 0 or more; None: unknown
    noise: FloatArray | None = None
    has_phase: bool = True

    def __post_init__(self) -> None:
        f = float_array("frequencies (Hz)", self.frequency_hz, (None,), low=1.0, high=1e5)
        check_range("the time constant of the exponential window", self.tau_s, 1e-4, 10.0, "s")
        p = np.array(self.pressure, dtype=np.complex128)
        size = float_array("the size of a pressure", np.abs(p), (None, f.size), high=_LOUDEST)
        if not f.size or np.any(np.diff(f) <= 0.0):
            what, needed = "frequencies are out of order", "each above the one before"
            hint = "sort them, and the pressures with them"
            raise InputError(what, found=str(f), needed=needed, hint=hint)
        if not size.any():
            what, needed = "pressures are 0 everywhere", "what was measured"
            hint = "look whether the channel that was recorded is the microphone"
            raise InputError(what, found="0 of all pairs", needed=needed, hint=hint)
        object.__setattr__(self, "frequency_hz", f)
        object.__setattr__(self, "pressure", read_only(p))
        if self.noise is not None:
            noise = float_array("noise (rms)", self.noise, p.shape, low=0.0, high=_LOUDEST)
            object.__setattr__(self, "noise", noise)


def complex_frequency_hz(observed: Observed) -> ComplexArray:
    """Return ``f - j / (2 pi tau)``, the frequency at which the window evaluates every law."""
    return np.asarray(observed.frequency_hz - 0.5j / (np.pi * observed.tau_s))


def level_at(observed: Observed) -> FloatArray:
    """Return the rms pressure of all pairs about each frequency, shape (n_frequencies,)."""
    power = np.mean(np.abs(observed.pressure) ** 2, axis=0)
    return np.asarray(np.sqrt(smoothed(power, observed.frequency_hz, 0.15)))


def smoothed(values: FloatArray, frequency_hz: FloatArray, reach: float) -> FloatArray:
    """Return means over neighbours in frequency; `reach`: of the logarithm, one or for each."""
    near = np.abs(np.log(frequency_hz[:, None] / frequency_hz)) <= reach
    return np.asarray((near @ values) / near.sum(axis=1))


def model_error(scene: Scene, frequency_hz: FloatArray, factor: float = MODEL_ERROR) -> FloatArray:
    """Return the rms error of image sources against exact waves, over the rms pressure.

    `factor` over the wavenumber times the mean free path: it falls with frequency as what a
    reflected spherical wave leaves out does.
    """
    free_path_m, speed = mean_free_path_m(scene.room.mesh), speed_of_sound_m_s(scene.air)
    return np.asarray(factor * speed / (2.0 * np.pi * frequency_hz * free_path_m))


def deviation(scene: Scene, observed: Observed, factor: float = MODEL_ERROR) -> FloatArray:
    """Return the rms residual of a perfect fit: noise, and the error of image sources."""
    share = model_error(scene, observed.frequency_hz, factor)
    model = np.broadcast_to(share * level_at(observed), observed.pressure.shape)
    noise = 0.0 if observed.noise is None else observed.noise
    return np.asarray(np.sqrt(model**2 + np.square(noise)))


# Times tau after which nothing of a window is left, exp(-12) = 6e-6.
_WINDOW = 12.0


def damped_spectrum(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> ComplexArray:
    """Return the spectrum of a response times ``exp(-t / tau)``, t from emission.

    ``sum h exp(-t / tau) exp(-j w t)``: a response whose direct sound is a single sample of
    ``1 / (4 pi r)`` gives ``exp(-j k r) / (4 pi r)`` with the complex wavenumber of the window.
    What lies more than 2 ms before the direct sound is left out: filters ring both ways.
    """
    t = times_s(response)
    if t[-1] < direct_s + 3.0 * tau_s:
        what = "the response ends before the exponential window"
        found = f"{1000.0 * t[-1]:.0f} ms after emission"
        needed = f"at least {1000.0 * (direct_s + 3.0 * tau_s):.0f} ms"
        raise InputError(what, found=found, needed=needed, hint="choose a shorter tau_s")
    if frequency_hz[-1] > 0.4 * response.sampling_rate_hz:
        raise InputError(
            "the highest frequency is too near to half of the sampling rate",
            found=f"{frequency_hz[-1]:g} Hz at {response.sampling_rate_hz:g} Hz",
            needed=f"at most {0.4 * response.sampling_rate_hz:g} Hz",
            hint="lower to_hz",
        )
    own = (t >= direct_s - 0.002) & (t <= direct_s + _WINDOW * tau_s)
    return _transformed(response.pressure[own], t[own], frequency_hz, tau_s)


def damped_noise(
    response: ImpulseResponse, frequency_hz: FloatArray, tau_s: float, direct_s: float
) -> FloatArray | None:
    """Return the rms noise of a damped spectrum, from the silent end of the response.

    Windows of the same length and weight are laid side by side over its last half; the lowest
    third of them counts, so that what is left of the decay does not.
    """
    t = times_s(response)
    window_s = min(_WINDOW * tau_s, 0.25 * (t[-1] - direct_s))
    start = max(direct_s + _WINDOW * tau_s, 0.5 * t[-1])
    n = round(window_s * response.sampling_rate_hz)
    count = (len(t) - int(np.searchsorted(t, start))) // max(n, 1)
    if count < 2 or n < 8:
        return None
    # weighed as the response itself, from its direct sound on
    clock = direct_s + np.arange(n) / response.sampling_rate_hz
    parts = np.reshape(response.pressure[len(t) - count * n :], (count, n))
    power = np.array([np.abs(_transformed(p, clock, frequency_hz, tau_s)) ** 2 for p in parts])
    quiet = np.argsort(power.sum(axis=1))[: max(count // 3, 2)]
    # few windows: neighbouring frequencies are averaged
    return np.asarray(np.sqrt(smoothed(power[quiet].mean(axis=0), frequency_hz, 0.2)))


def _transformed(
    pressure: FloatArray, t: FloatArray, frequency_hz: FloatArray, tau_s: float
) -> ComplexArray:
    damped = pressure * np.exp(-t / tau_s)
    return np.array([np.sum(damped * np.exp(-2j * np.pi * f * t)) for f in frequency_hz])
