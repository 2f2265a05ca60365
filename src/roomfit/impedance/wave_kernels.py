"""Reflection at locally reacting walls, and pressures of image sources with their derivatives.

A wall is given by R0, its plane-wave reflection coefficient at normal incidence, ``(Z - 1) / (Z +
1)`` of the impedance Z over that of air; it is passive if and only if ``|R0| <= 1``. At an angle of
incidence theta, with ``q = tan(theta / 2)**2``, a plane wave is reflected by ``R = (R0 - q) / (1 -
q R0)``, the same as ``(Z cos theta - 1) / (Z cos theta + 1)``, so that ``|R| <= 1`` at every angle;
a spherical wave by ``Q = R + (1 - R) F(w)`` with the boundary loss factor F of the numerical
distance ``w = sqrt(j k r / 2) (1 / Z + cos theta)``, r the whole length of the path [1]_, [2]_.

References
----------
.. [1] C. F. Chien, W. W. Soroka, "Sound propagation along an impedance plane", J. Sound Vib. 43,
       9-20 (1975).
.. [2] C. I. Chessell, "Propagation of noise along a finite impedance boundary", J. Acoust. Soc. Am.
       62, 825-834 (1977).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import wofz

from roomfit.base.kernels import kernel
from roomfit.base.typing import ComplexArray, FloatArray, IntArray


def plane_reflection(r0: ComplexArray, cosine: FloatArray) -> ComplexArray:
    """Return the reflection of plane waves; the cosine of incidence is 0 (grazing) to 1."""
    q = (1.0 - cosine) / (1.0 + cosine)
    return np.asarray((r0 - q) / (1.0 - q * r0))


def spherical_reflection(
    r0: ComplexArray, cosine: FloatArray, wavenumber: ComplexArray, length_m: FloatArray
) -> ComplexArray:
    """Return the reflection of spherical waves over paths of some length."""
    plane = plane_reflection(r0, cosine)
    below = 1.0 + r0
    # a pressure-release wall, R0 = -1, gets a number so large that its F is 0
    admittance: ComplexArray = np.conj((1.0 - r0) / np.where(np.abs(below) < 1e-12, 1e-12, below))
    # the numerical distance for exp(-j w t), which the error function asks for
    root: ComplexArray = np.sqrt(0.5j * np.conj(wavenumber) * length_m)
    w: ComplexArray = root * (admittance + cosine)
    return np.asarray(plane + (1.0 - plane) * np.conj(boundary_loss(w)))


def boundary_loss(w: ComplexArray) -> ComplexArray:
    """Return ``F(w) = 1 + j sqrt(pi) w wofz(w)``."""
    with np.errstate(invalid="ignore", over="ignore"):
        loss = 1.0 + 1j * math.sqrt(math.pi) * w * wofz(w)
    # far out the two terms all but cancel: three terms of the asymptotic series are exact to 1e-9
    far = (np.abs(w) > 30.0) & (w.imag >= 0.0)
    u = 0.5 / np.where(far, w, 1.0) ** 2
    return np.where(far, -u * (1.0 + 3.0 * u * (1.0 + 5.0 * u)), loss)


@kernel()
def pressure_gradients(
    pair_first: IntArray,
    pair_last: IntArray,
    vector_m: FloatArray,
    image_transform: FloatArray,
    bounce_first: IntArray,
    material: IntArray,
    normal: FloatArray,
    hits: IntArray,
    wavenumber: ComplexArray,
    r0: ComplexArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Return the pressures with plane waves at the walls, and their exact derivatives.

    By R0, (n_pairs, n_materials, n_frequencies), by the positions of source and receiver, (n_pairs,
    3, n_frequencies), and by the wavenumber. Shapes: `pair_last` (n_pairs,) behind the last path of
    each pair, `vector_m` (n_paths, 3) from each image to the receiver, `wavenumber`
    (n_frequencies,), `r0` (n_materials, n_frequencies); the rest of
    `roomfit.impedance.wave_model.UnfoldedPaths`.
    """
    n_pairs, n_f = len(pair_last), len(wavenumber)
    out = np.zeros((n_pairs, n_f), dtype=np.complex128)
    by_r0 = np.zeros((n_pairs, len(r0), n_f), dtype=np.complex128)
    by_source = np.zeros((n_pairs, 3, n_f), dtype=np.complex128)
    by_receiver = np.zeros((n_pairs, 3, n_f), dtype=np.complex128)
    by_wavenumber = np.zeros((n_pairs, n_f), dtype=np.complex128)
    value = np.empty(n_f, dtype=np.complex128)
    away = np.empty((3, n_f), dtype=np.complex128)
    for pair in range(n_pairs):
        for path in range(pair_first[pair], pair_last[pair]):
            v, a = vector_m[path], image_transform[path]
            r = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
            for f in range(n_f):
                k = wavenumber[f]
                size = math.exp(k.imag * r) / (4.0 * math.pi * r)
                value[f] = complex(size * math.cos(k.real * r), -size * math.sin(k.real * r))
                for i in range(3):
                    away[i, f] = (-1j * k - 1.0 / r) * v[i] / r
            bounces = range(bounce_first[path], bounce_first[path + 1])
            for b in bounces:
                n, own = normal[b], r0[material[b]]
                along = (v[0] * n[0] + v[1] * n[1] + v[2] * n[2]) / r
                cosine, sign = min(abs(along), 1.0), math.copysign(1.0, along)
                q = (1.0 - cosine) / (1.0 + cosine)
                by_cosine = 2.0 * hits[b] / ((1.0 + cosine) * (1.0 + cosine))
                # how the cosine changes as the path turns
                turns = (sign * n - cosine * v / r) / r
                for f in range(n_f):
                    # next to nothing besides: not 0 / 0 where a wall gives nothing back
                    above, below = own[f] - q + 1e-30, 1.0 - q * own[f]
                    reflection = above / below
                    for _ in range(hits[b]):
                        value[f] *= reflection
                    bend = by_cosine * (1.0 - own[f] * own[f]) / (above * below)
                    for i in range(3):
                        away[i, f] += bend * turns[i]
            for f in range(n_f):
                out[pair, f] += value[f]
                by_wavenumber[pair, f] += -1j * r * value[f]
                for i in range(3):
                    by_receiver[pair, i, f] += value[f] * away[i, f]
                    moved = a[0, i] * away[0, f] + a[1, i] * away[1, f] + a[2, i] * away[2, f]
                    by_source[pair, i, f] -= value[f] * moved
            for b in bounces:
                n, own, found = normal[b], r0[material[b]], by_r0[pair, material[b]]
                cosine = min(abs(v[0] * n[0] + v[1] * n[1] + v[2] * n[2]) / r, 1.0)
                q = (1.0 - cosine) / (1.0 + cosine)
                share = hits[b] * (1.0 - q * q)
                for f in range(n_f):
                    found[f] += value[f] * share / ((own[f] - q + 1e-30) * (1.0 - q * own[f]))
    return out, by_r0, by_source, by_receiver, by_wavenumber
