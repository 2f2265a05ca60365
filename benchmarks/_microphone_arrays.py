"""An omnidirectional beam and six cardioids from a microphone array or from ambisonics.

The channels of an array are combined, frequency by frequency, so that the beams come as near to
their patterns as the capsules permit. Which pattern each of them then has is known:
`cross_patterns`. Directions are those from which sound comes.

References
----------
.. [1] B. Rafaely, "Fundamentals of Spherical Array Processing", 2nd ed., Springer (2019).
.. [2] C. Nachbar, F. Zotter, E. Deleflie, A. Sontacchi, "AmbiX: a suggested ambisonics format",
       Ambisonics Symposium, Lexington (2011).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import fft
from scipy.special import spherical_jn

from roomfit.base.arguments import float_array
from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray
from roomfit.signals.filters import frequency_response

BEAM_AXES = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions that the cardioids face, (6, 3); before them stands the omnidirectional beam."""
N_BEAMS = 1 + len(BEAM_AXES)

# Order of the components x, y, z behind W, and by what W is smaller than the pressure.
_FORMATS = {"ambix": ((3, 1, 2), 1.0), "fuma": ((1, 2, 3), 2.0**-0.5)}
# Of a capsule beside the others where it is unspecified, relative: amplitude and phase together.
CAPSULE_ERROR = 0.03
# Filters of capsules some centimetres apart ring for a few milliseconds.
_FILTER_S = 0.1
_FREQUENCIES = 24  # of each band, over which patterns are averaged
_SILENCE = 1e-12  # of the largest energy: where a spectrum has none, a quotient has no meaning


def beam_patterns(directions: FloatArray) -> FloatArray:
    """Return the ideal amplitude of every beam, shape (n_directions, 7).

    1, and ``(1 + u . a) / 2`` for the direction u from which sound comes and the axis a.

    Examples
    --------
    >>> beam_patterns(np.array([[1.0, 0.0, 0.0]])).tolist()
    [[1.0, 1.0, 0.5, 0.5, 0.0, 0.5, 0.5]]
    """
    u = float_array("directions", directions, (None, 3), low=-1.0, high=1.0)
    return np.column_stack([np.ones(len(u)), 0.5 * (1.0 + u @ BEAM_AXES.T)])


def ambisonic_beams(
    samples: FloatArray, convention: Literal["ambix", "fuma"], axes: FloatArray
) -> FloatArray:
    """Return the seven beams of the first four channels of ambisonics, shape (7, n_samples).

    Parameters
    ----------
    samples : float array, shape (n_channels, n_samples)
        Four channels or more, the first four of order 0 and 1: W, Y, Z, X with all alike for sound
        from their own direction (AmbiX), or W, X, Y, Z with W 3 dB lower (FuMa).
    convention : {"ambix", "fuma"}
    axes : float array, shape (3, 3)
        Rows: directions in the room of the microphone's front (x), left (y) and top (z).

    Raises
    ------
    InputError
        Fewer than four channels, or an unknown convention.
    """
    if convention not in _FORMATS:
        known = ", ".join(map(repr, _FORMATS))
        raise InputError("unknown format of ambisonics", found=repr(convention), needed=known)
    if np.ndim(samples) != 2 or len(samples) < 4:
        raise InputError(
            "too few channels for ambisonics of first order",
            found=str(np.shape(samples)),
            needed="(4 or more, n_samples)",
        )
    order, level_of_w = _FORMATS[convention]
    turned = BEAM_AXES @ float_array("axes", axes, (3, 3), low=-1.0, high=1.0).T
    pressure = samples[0] / level_of_w
    return np.concatenate([pressure[None], 0.5 * (pressure + turned @ samples[list(order)])])


def array_weights(
    capsules_m: FloatArray,
    frequencies_hz: FloatArray,
    speed_of_sound_m_s: float,
    capsule_error: float = CAPSULE_ERROR,
) -> ComplexArray:
    """Return the factors on capsules' spectra that make beams, (n_frequencies, 7, n_capsules).

    They minimise the mean square error of the pattern over all directions of plane waves, and over
    independent errors of the capsules, ``mean |w p - b|**2 + e**2 |w|**2`` with p the pressures,
    b the pattern: both means are spherical Bessel functions [1]_. Low frequencies are limited by e
    alone, high ones by the distances of the capsules.

    Parameters
    ----------
    capsules_m : float array, shape (n_capsules, 3)
        From the centre of the array, in the axes of the room.
    frequencies_hz : float array, shape (n_frequencies,)
        0 or more.
    capsule_error : float
        Relative standard deviation of a capsule's response, 1e-4 to 1.
    """
    at = float_array("capsules", capsules_m, (None, 3), low=-1.0, high=1.0, unit="m")
    e = float(float_array("capsule error", capsule_error, (), low=1e-4, high=1.0))
    wave = 2.0 * np.pi * np.asarray(frequencies_hz)[:, None] / speed_of_sound_m_s
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)
    gram = spherical_jn(0, wave[..., None] * apart) + e**2 * np.eye(len(at))
    radius = np.linalg.norm(at, axis=1)
    toward = at / np.where(radius > 0.0, radius, 1.0)[:, None]
    even, odd = (spherical_jn(n, wave * radius) for n in (0, 1))
    right = np.empty((len(wave), N_BEAMS, len(at)), dtype=np.complex128)
    right[:, 0] = even
    right[:, 1:] = 0.5 * (even[:, None] - 1j * odd[:, None] * (BEAM_AXES @ toward.T))
    return np.asarray(np.linalg.solve(gram, right.swapaxes(1, 2)).swapaxes(1, 2))


def array_beams(
    samples: FloatArray,
    sampling_rate_hz: float,
    capsules_m: FloatArray,
    speed_of_sound_m_s: float,
    capsule_error: float = CAPSULE_ERROR,
    responses: ComplexArray | None = None,
) -> FloatArray:
    """Return the seven beams of an array on the samples of its channels, shape (7, n_samples).

    Parameters
    ----------
    samples : float array, shape (n_capsules, n_samples)
    capsules_m, speed_of_sound_m_s, capsule_error
        As for `array_weights`.
    responses : complex array, shape (n_capsules, n_frequencies), optional
        Of each capsule beside a common one, at equal steps from 0 Hz to half the sampling rate, as
        `capsule_responses` returns them; left out: all capsules are alike.
    """
    count = float_array("capsules", capsules_m, (None, 3)).shape[0]
    if np.ndim(samples) != 2 or len(samples) != count:
        raise InputError(
            "channels and capsules of an array differ in number",
            found=f"samples of shape {np.shape(samples)} and {count} positions",
            needed="one channel a capsule",
        )
    n = samples.shape[1]
    length = fft.next_fast_len(n + 2 * round(_FILTER_S * sampling_rate_hz), real=True)
    frequencies_hz = fft.rfftfreq(length, 1.0 / sampling_rate_hz)
    spectra = fft.rfft(samples, length, axis=1)
    if responses is not None:
        steps = np.linspace(0.0, 0.5 * sampling_rate_hz, responses.shape[1])
        spectra /= [np.interp(frequencies_hz, steps, r) for r in responses]
    weights = array_weights(capsules_m, frequencies_hz, speed_of_sound_m_s, capsule_error)
    return np.asarray(fft.irfft(np.einsum("fbm,mf->bf", weights, spectra), length, axis=1)[:, :n])


def cross_patterns(
    bands: Bands,
    directions: FloatArray,
    capsules_m: FloatArray | None = None,
    speed_of_sound_m_s: float = 343.0,
    capsule_error: float = CAPSULE_ERROR,
) -> ComplexArray:
    """Return the band means of the products of all beams' patterns, (n_bands, n_directions, 7, 7).

    ``integral |H|**2 B_k conj(B_l) df / integral |H|**2 df``. The diagonal is the factor on the
    energy of a plane wave; a sum over waves weighed by their energies, the cross-spectrum of the
    beams where phases are random.

    Parameters
    ----------
    directions : float array, shape (n_directions, 3)
        Unit vectors from which sound comes.
    capsules_m : float array, shape (n_capsules, 3), optional
        Of an array; left out: ideal beams, as ambisonics have them.
    """
    u = float_array("directions", directions, (None, 3), low=-1.0 - 1e-6, high=1.0 + 1e-6)
    if capsules_m is None:
        ideal = beam_patterns(np.clip(u, -1.0, 1.0))
        cross = (ideal[:, :, None] * ideal[:, None, :]).astype(np.complex128)
        return np.broadcast_to(cross, (len(bands), *cross.shape))
    out = np.zeros((len(bands), len(u), N_BEAMS, N_BEAMS), dtype=np.complex128)
    for band in range(len(bands)):
        one = Bands(bands.kind, bands.centres_hz[band : band + 1])
        reach = one.upper_hz[0] / one.exact_centres_hz[0]
        f = one.exact_centres_hz[0] * reach ** np.linspace(-2.0, 2.0, _FREQUENCIES)
        share = frequency_response(one, f)[0] ** 2 * f
        weights = array_weights(capsules_m, f, speed_of_sound_m_s, capsule_error)
        delay_s = u @ np.asarray(capsules_m).T / speed_of_sound_m_s
        for own_hz, own, part in zip(f, weights, share / share.sum(), strict=True):
            amplitude = np.exp(2j * np.pi * own_hz * delay_s) @ own.T
            out[band] += part * amplitude[:, :, None] * amplitude[:, None, :].conj()
    return out


def level_errors(
    bands: Bands,
    capsules_m: FloatArray,
    speed_of_sound_m_s: float,
    capsule_error: float = CAPSULE_ERROR,
) -> FloatArray:
    """Return the relative error of every beam's energy by those of its capsules, (n_bands, 7).

    Twice the rms error of the amplitude over all directions beside its rms, ``2 e |w| / |B|``: at
    most so large is a common error of the beam's level.
    """
    out = np.zeros((len(bands), N_BEAMS))
    at = np.asarray(capsules_m)
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)
    for band, f in enumerate(bands.exact_centres_hz):
        (own,) = array_weights(at, np.array([f]), speed_of_sound_m_s, capsule_error)
        gram = spherical_jn(0, 2.0 * np.pi * f / speed_of_sound_m_s * apart)
        power = np.einsum("bm,mn,bn->b", own, gram, own.conj()).real
        size = np.sum(np.abs(own) ** 2, axis=1)
        out[band] = 2.0 * capsule_error * np.sqrt(size / power)
    return out


def capsule_responses(
    direct: FloatArray,
    sampling_rate_hz: float,
    directions: FloatArray,
    capsules_m: FloatArray,
    speed_of_sound_m_s: float,
    distances_m: FloatArray | None = None,
) -> tuple[ComplexArray, FloatArray]:
    """Return each capsule's response beside the first one's, and what direct sounds leave of it.

    Least squares over direct sounds from known directions, frequency by frequency.

    Parameters
    ----------
    direct : float array, shape (n_sounds, n_capsules, n_samples)
        Nothing but the direct sound, of all capsules from the same moment on.
    directions : float array, shape (n_sounds, 3)
        Unit vectors from which each comes.
    distances_m : float array, shape (n_sounds,), optional
        From source to centre; left out: plane waves.

    Returns
    -------
    responses : complex array, shape (n_capsules, n_frequencies)
        At equal steps from 0 Hz to half the sampling rate.
    residual : float array, shape (n_capsules, n_frequencies)
        Relative rms difference of the sounds from it.
    """
    spectra = fft.rfft(direct, axis=2)
    f = fft.rfftfreq(direct.shape[2], 1.0 / sampling_rate_hz)
    far = np.full(len(directions), 1e6) if distances_m is None else distances_m
    path_m = np.linalg.norm(far[:, None, None] * directions[:, None] - capsules_m[None], axis=2)
    late_s = (path_m - path_m[:, :1]) / speed_of_sound_m_s
    expected = spectra[:, :1] * np.exp(-2j * np.pi * f * late_s[..., None])
    expected *= (path_m[:, :1] / path_m)[..., None]
    power = np.sum(np.abs(expected) ** 2, axis=0)
    power = np.maximum(power, _SILENCE * power.max())
    found = np.sum(spectra * expected.conj(), axis=0) / power
    off = np.sum(np.abs(spectra - found * expected) ** 2, axis=0)
    size = np.abs(found) ** 2 * power
    return found, np.sqrt(off / np.maximum(size, _SILENCE * size.max()))
