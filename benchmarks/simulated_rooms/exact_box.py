"""Exact pressures in a box of locally reacting walls: modes, and no image sources at all."""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eig

from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray


def exact_box_pressure(
    lengths_m: tuple[float, float, float],
    admittance: ComplexArray,
    wavenumber_per_m: ComplexArray,
    sources_m: FloatArray,
    receivers_m: FloatArray,
    polynomials: int | None = None,
) -> ComplexArray:
    """Return the pressure of point sources in a box, one pair a row.

    Solves ``(laplace + k**2) p = -delta`` with ``dp/dn = -j k beta p`` at each wall, n out of the
    room and ``exp(+j w t)``: modes across the two shorter distances of a pair (Legendre
    polynomials, Galerkin), a closed form along the longest.

    Parameters
    ----------
    admittance : complex array, shape (6, n_frequencies)
        Of west (x = 0), east, south, north, floor and ceiling, over that of the air.
    wavenumber_per_m : complex array, shape (n_frequencies,)
        With a negative imaginary part behind an exponential window.
    sources_m, receivers_m : float arrays, shape (n_pairs, 3)
    polynomials : int, optional
        Along each axis of modes; left out: 20 and half the largest wavenumber times the longest
        side. The field converges as the modes decay between source and receiver along the third
        axis, on which they must stand apart.

    Raises
    ------
    InputError
        A source and a receiver nearer to each other than a twentieth of the longest side on every
        axis.

    References
    ----------
    .. [1] P. M. Morse, K. U. Ingard, "Theoretical Acoustics" (1968), section 9.4.
    """
    lengths = np.array(lengths_m, dtype=np.float64)
    apart = np.abs(sources_m - receivers_m)
    axis = np.argmax(apart, axis=1)
    if apart.max(axis=1).min() < 0.05 * lengths.max():
        raise InputError(
            "source and receiver are too close for a sum of modes",
            found=f"{apart.max(axis=1).min():.3g} m apart on the widest axis",
        )
    largest = float(np.abs(wavenumber_per_m).max()) * lengths.max()
    n = math.ceil(20.0 + 0.5 * largest) if polynomials is None else polynomials
    out = np.empty((len(sources_m), len(wavenumber_per_m)), dtype=np.complex128)
    for f, k in enumerate(wavenumber_per_m):
        ends = admittance[:, f].reshape(3, 2)
        modes = [_modes(lengths[a], k, ends[a], n) for a in range(3)]
        for i, (source, receiver, along) in enumerate(
            zip(sources_m, receivers_m, axis, strict=True)
        ):
            others = [a for a in range(3) if a != along]
            square = [modes[a][0] for a in others]
            value = [_products(modes[a][1], lengths[a], source[a], receiver[a]) for a in others]
            out[i, f] = _sum(
                k, lengths[along], ends[along], source[along], receiver[along], square, value
            )
    return out


def _modes(
    length: float, k: complex, ends: ComplexArray, n: int
) -> tuple[ComplexArray, ComplexArray]:
    """Return the squared wavenumbers of the modes along an axis, and the modes in its polynomials.

    The weak form ``int u' v' + j k (beta_0 u v|_0 + beta_L u v|_L) = kappa**2 int u v`` in
    normalised Legendre polynomials; modes are orthogonal without conjugation, and normed so.
    """
    order = np.arange(n)
    norm = np.sqrt((2 * order + 1) / length)
    # int P_i' P_j' over (-1, 1) is m (m + 1), m the lower order, where i + j is even
    lower = np.minimum(order[:, None], order)
    stiffness = np.where((order[:, None] + order) % 2 == 0, lower * (lower + 1.0), 0.0)
    stiffness = stiffness * (2.0 / length) * norm[:, None] * norm
    low, high = norm * (-1.0) ** order, norm
    matrix = stiffness + 1j * k * (ends[0] * np.outer(low, low) + ends[1] * np.outer(high, high))
    square, vectors = eig(matrix)
    return square, vectors / np.sqrt(np.sum(vectors**2, axis=0))


def _products(modes: ComplexArray, length: float, source: float, receiver: float) -> ComplexArray:
    """Return each mode's value at the source times that at the receiver."""
    n = len(modes)
    points = 2.0 * np.array([source, receiver]) / length - 1.0
    norm = np.sqrt((2 * np.arange(n) + 1) / length)
    at = (legendre.legvander(points, n - 1) * norm) @ modes
    return np.asarray(at[0] * at[1])


def _sum(
    k: complex,
    length: float,
    ends: ComplexArray,
    source: float,
    receiver: float,
    square: list[ComplexArray],
    value: list[ComplexArray],
) -> complex:
    """Return the sum over all modes of their products and of the field along the last axis."""
    gamma = np.sqrt(square[0][:, None] + square[1] - k * k)
    gamma = np.where(gamma.real < 0.0, -gamma, gamma)
    start, end = ((gamma - 1j * k * b) / (gamma + 1j * k * b) for b in ends)
    apart, together = abs(source - receiver), source + receiver
    field = (
        np.exp(-gamma * apart)
        + start * np.exp(-gamma * together)
        + end * np.exp(-gamma * (2.0 * length - together))
        + start * end * np.exp(-gamma * (2.0 * length - apart))
    ) / (2.0 * gamma * (1.0 - start * end * np.exp(-2.0 * gamma * length)))
    return complex(value[0] @ field @ value[1])


def damped_wavenumber_per_m(
    frequency_hz: FloatArray, tau_s: float, speed_m_s: float
) -> ComplexArray:
    """Return the wavenumber at which a spectrum behind the window ``exp(-t / tau)`` stands."""
    return np.asarray(2.0 * math.pi * (frequency_hz - 0.5j / (math.pi * tau_s)) / speed_m_s)
