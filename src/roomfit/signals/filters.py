"""One filter bank with two front ends: measured pressure, and predicted path energies.

Why not pyfar's: energies are compared, so the squared magnitudes of neighbouring bands must add up
to one; and the delay must be the same in every band, or early reflections of low bands fall into
the wrong window. The Butterworth bank of pyfar 0.8 delays each band differently (125 Hz by 35 ms at
order 14). Its ``reconstructing_fractional_octave_bands`` has a constant delay, but adds up in
amplitude (-6 dB at the edges, so an impulse loses energy between bands), turns the outer bands into
a low-pass and a high-pass, and is cut by a window whose length, not the band, sets the ringing.
The magnitudes here are Antoni's, whose squares do add up, applied without any delay.

References
----------
.. [1] J. Antoni, "Orthogonal-like fractional-octave-band filters", J. Acoust. Soc. Am. 127,
       884-895 (2010).
.. [2] IEC 61260-1:2014, "Electroacoustics - Octave-band and fractional-octave-band filters".
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft
from scipy.sparse import csr_array

from roomfit.base.arguments import read_only
from roomfit.base.bands import BandKind, Bands
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.signals.response import ImpulseResponse, padded

# Ringing beyond this many periods of the centre frequency, times the number of bands per octave,
# contains less than 1e-11 of a band's energy (measured; it falls with the fifth power).
_SPAN_PERIODS = 64.0
_STEPS_PER_PERIOD = 256
# Shares below this are below every other error and would fill memory.
_LEAST_SHARE = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class SpreadingKernel:
    """How a filter bank spreads the energy of an impulse over time.

    All bands of a bank have the same shape, stretched by their centre frequency.
    """

    centres_hz: FloatArray  # (n_bands,), exact
    periods: FloatArray  # (n_steps,), time in periods of the centre, uniform, symmetric about 0
    density: FloatArray  # (n_steps,), squared impulse response: share of energy per period
    cumulative: FloatArray  # (n_steps,), share of energy up to that time, from 0 to 1
    least_share: float = _LEAST_SHARE  # on either side; less is left out of sparse matrices


def frequency_response(bands: Bands, frequencies_hz: ArrayLike) -> FloatArray:
    """Return the magnitude of every band's filter, 0 to 1, shape (n_bands, n_frequencies).

    Filters have zero phase, and squared magnitudes that add up to one.

    Notes
    -----
    With u the distance of a frequency from the nearer band edge in band widths on a logarithmic
    axis (-1/2 at the centre, 0 at the edge, 1/2 at the neighbour's centre), the magnitude is
    ``cos(pi / 4 (1 + sin(pi u)))`` between these centres [1]_: 1 at the own centre, -3 dB at the
    edge, and nothing from the neighbour's centre on. It meets class 1 of [2]_. The inner sine
    makes the edges smooth at both ends, so the ringing dies with the third power of time, not
    with the second.
    """
    f = np.abs(np.asarray(frequencies_hz, dtype=np.float64))
    width = np.log(bands.upper_hz / bands.lower_hz)
    with np.errstate(divide="ignore"):  # 0 Hz lies infinitely many octaves below every band
        distance = np.abs(np.log(f[None, :] / bands.exact_centres_hz[:, None])) / width[:, None]
    u = np.clip(distance - 0.5, -0.5, 0.5)
    return np.asarray(np.cos(0.25 * np.pi * (1.0 + np.sin(np.pi * u))) * (u < 0.5))


def ringing_s(bands: Bands) -> FloatArray:
    """Return how long each band rings before and after an impulse, shape (n_bands,).

    Less than 1e-11 of the energy lies farther away.
    """
    return np.asarray(_span_periods(bands) / bands.exact_centres_hz)


def energy_bandwidth_hz(bands: Bands) -> FloatArray:
    """Return the integral of the squared magnitude of each band, shape (n_bands,)."""
    return _integrals_of_powers(bands.kind, tuple(bands.centres_hz.tolist()))[0]


def statistical_bandwidth_hz(bands: Bands) -> FloatArray:
    """Return the bandwidth B that sets how random a band's energy is, shape (n_bands,).

    The energy of white noise through a band during T has the relative variance ``1 / (B T)``, with
    ``B = (integral of |H|^2)^2 / (integral of |H|^4)`` over positive frequencies; 109 Hz for the
    octave at 125 Hz.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, "Random Data", 4th ed., Wiley (2010), section 8.3.
    """
    once, twice = _integrals_of_powers(bands.kind, tuple(bands.centres_hz.tolist()))
    return np.asarray(once**2 / twice)


def check_sampling_rate(bands: Bands, sampling_rate_hz: float, where: str | None = None) -> None:
    """Refuse a sampling rate at which some band does not fit below half of it."""
    # a filter ends where the next band of its kind has its centre
    top_hz = float(bands.upper_hz[-1] ** 2 / bands.exact_centres_hz[-1])
    if top_hz > 0.5 * sampling_rate_hz:
        raise InputError(
            "a frequency band reaches above half the sampling rate",
            where=where,
            found=f"the {bands.kind} band at {bands.centres_hz[-1]:g} Hz, whose filter ends at "
            f"{top_hz:.0f} Hz, and a sampling rate of {sampling_rate_hz:g} Hz",
            needed=f"a sampling rate of at least {2.0 * top_hz:.0f} Hz",
            hint="lower to_hz, or take the file at its original sampling rate",
        )


def filter_pressure(bands: Bands, response: ImpulseResponse) -> FloatArray:
    """Return the pressure in every band, without delay.

    The filters ring before an impulse as much as after it: use `padded` first where sound begins
    at the very start of the file and its energy matters.

    The result has the shape (n_bands, n_samples): on the same samples as `response`. Nothing wraps
    from the end to the beginning.
    """
    rate_hz = response.sampling_rate_hz
    check_sampling_rate(bands, rate_hz)
    n = len(response.pressure)
    # rings run into the padding from both ends, and meet there only where they have died
    length = fft.next_fast_len(n + int(np.ceil(ringing_s(bands).max() * rate_hz)), real=True)
    spectrum = fft.rfft(response.pressure, length)
    centres_hz = tuple(bands.centres_hz.tolist())
    magnitudes = _magnitudes(bands.kind, centres_hz, length, rate_hz)
    filtered = np.empty((len(bands), n))
    for band, magnitude in enumerate(magnitudes):
        filtered[band] = fft.irfft(spectrum * magnitude, length)[:n]
    return filtered


@lru_cache(maxsize=8)
def _magnitudes(
    kind: BandKind, centres_hz: tuple[float, ...], length: int, rate_hz: float
) -> FloatArray:
    """Return the bands on the frequencies of a transform: all responses of a room have the same."""
    frequencies_hz = fft.rfftfreq(length, 1.0 / rate_hz)
    return frequency_response(Bands(kind, np.array(centres_hz)), frequencies_hz)


def window_energies(bands: Bands, response: ImpulseResponse, edges_s: FloatArray) -> FloatArray:
    """Return the measured energy of every band in every time window (the first front end).

    `edges_s`, shape (n_windows + 1,): rising times after emission. Before and after the file there
    is silence.

    The result has the shape (n_bands, n_windows): in the unit of pressure squared, scaled so that a
    lone sample of height a has the energy a^2 in every band: the sum over paths of energy times
    `energy_share` is its expectation.
    """
    rate_hz = response.sampling_rate_hz
    long = padded(response, float(ringing_s(bands).max()))
    # sample k stands for the time from half a sample before to half a sample after it
    boundaries = (np.arange(len(long.pressure) + 1) - 0.5) / rate_hz - long.time_zero_s
    lone_sample = 2.0 * energy_bandwidth_hz(bands) / rate_hz
    energies = np.empty((len(bands), len(edges_s) - 1))
    for band, pressure in enumerate(filter_pressure(bands, long)):
        cumulative = np.concatenate(([0.0], np.cumsum(pressure**2)))
        energies[band] = np.diff(np.interp(edges_s, boundaries, cumulative)) / lone_sample[band]
    return energies


def spreading_kernel(bands: Bands) -> SpreadingKernel:
    """Return how the bands spread an impulse over time: the second front end's table."""
    return SpreadingKernel(bands.exact_centres_hz, *_spreading_table(bands.kind))


@cache
def _spreading_table(kind: BandKind) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return periods, density and cumulative share of the bands of a kind, made once."""
    # The table is made for a bank with one band at the reference frequency of 1 kHz, whose exact
    # centre is its nominal one, and long enough that what wraps is far below the cut-off share.
    reference = Bands(kind, np.array([1000.0]))
    span = round(_span_periods(reference) * _STEPS_PER_PERIOD)
    length = 16 * span
    frequencies = fft.rfftfreq(length, 1.0 / (1000.0 * _STEPS_PER_PERIOD))
    response = fft.irfft(frequency_response(reference, frequencies)[0], length)
    half = response[: span + 1] ** 2
    density = np.concatenate((half[:0:-1], half))
    cumulative = np.concatenate(([0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))))
    density *= _STEPS_PER_PERIOD / cumulative[-1]
    cumulative /= cumulative[-1]
    periods = np.arange(-span, span + 1) / _STEPS_PER_PERIOD
    return read_only(periods), read_only(density), read_only(cumulative)


def energy_share(
    kernel: SpreadingKernel, band: int, delays_s: ArrayLike, edges_s: ArrayLike
) -> FloatArray:
    """Return which share of an impulse's energy falls into each window (the second front end).

    `delays_s`, shape (n_impulses,): when each impulse arrives. `edges_s`, shape (n_windows + 1,):
    rising, on the same clock.

    The result has the shape (n_impulses, n_windows): each row sums to at most 1; less where energy
    falls outside all windows.
    """
    edges, delays = (np.asarray(x, dtype=np.float64) for x in (edges_s, delays_s))
    periods = (edges[None, :] - delays[:, None]) * kernel.centres_hz[band]
    return np.diff(np.interp(periods, kernel.periods, kernel.cumulative), axis=1)


def spreading_reach_s(kernel: SpreadingKernel, band: int) -> float:
    """Return how far from a window's edges `spreading_matrix` looks for impulses that reach it."""
    reached = kernel.periods[np.searchsorted(kernel.cumulative, kernel.least_share)]
    return -float(reached) / float(kernel.centres_hz[band])


def spreading_matrix(
    kernel: SpreadingKernel, band: int, delays_s: FloatArray, edges_s: ArrayLike
) -> csr_array:
    """Return `energy_share` of many impulses as a sparse matrix.

    `delays_s`, shape (n_impulses,): rising.

    The result has the shape (n_windows, n_impulses): without what an impulse leaves in windows that
    less than the kernel's least share reaches.
    """
    return _banded(kernel, band, delays_s, edges_s, kernel.cumulative)


def spreading_slopes_per_s(
    kernel: SpreadingKernel, band: int, delays_s: FloatArray, edges_s: ArrayLike
) -> csr_array:
    """Return the derivative of `spreading_matrix` by the delays, 1/s."""
    rate = -kernel.centres_hz[band] * kernel.density
    return _banded(kernel, band, delays_s, edges_s, rate)


def _banded(
    kernel: SpreadingKernel, band: int, delays_s: FloatArray, edges_s: ArrayLike, table: FloatArray
) -> csr_array:
    """Return the difference of a tabulated function between both edges of every window."""
    edges = np.asarray(edges_s, dtype=np.float64)
    span_s = spreading_reach_s(kernel, band)
    first = np.searchsorted(delays_s, edges[:-1] - span_s)
    counts = np.searchsorted(delays_s, edges[1:] + span_s) - first
    # of 32 bits, or the columns would become 64
    pointers = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)
    window = np.repeat(np.arange(counts.size), counts)
    columns = np.arange(pointers[-1], dtype=np.int32) + (first - pointers[:-1])[window]
    late_s, middle = np.asarray(delays_s)[columns], 0.5 * (table.size - 1)
    at_edges = []
    for edge in (window, window + 1):
        # the table is uniform; beyond its ends, its ends
        steps = (edges[edge] - late_s) * kernel.centres_hz[band] * _STEPS_PER_PERIOD + middle
        steps = np.clip(steps, 0.0, table.size - 1.0)
        i = np.minimum(steps.astype(np.int64), table.size - 2)
        at_edges.append(table[i] + (steps - i) * (table[i + 1] - table[i]))
    values = at_edges[1] - at_edges[0]
    shape = (edges.size - 1, len(delays_s))
    return csr_array((values, columns.astype(np.int32), pointers), shape=shape)


def _span_periods(bands: Bands) -> float:
    width = np.log2(bands.upper_hz[0] / bands.lower_hz[0])
    return float(_SPAN_PERIODS * np.round(1.0 / width))


@cache
def _integrals_of_powers(
    kind: BandKind, centres_hz: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals of |H|^2 and of |H|^4 of every band, (n_bands,) each, made once."""
    bands = Bands(kind, np.array(centres_hz))
    # fine enough for the trapezoidal rule
    f = np.geomspace(bands.lower_hz[0] / 2.0, bands.upper_hz[-1] * 2.0, 4096 * (1 + len(bands)))
    squared = frequency_response(bands, f) ** 2
    once, twice = (np.asarray(np.trapezoid(squared**n, f, axis=1)) for n in (1, 2))
    return read_only(once), read_only(twice)
