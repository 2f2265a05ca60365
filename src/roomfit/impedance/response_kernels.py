"""Pressures of image sources that carry phase, and their derivatives; compiled."""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel
from roomfit.impedance.reflection import boundary_loss, conjugate_admittance
from roomfit.typing import ComplexArray, FloatArray, IntArray


@kernel()
def pressures(
    pair_first: IntArray,
    vector_m: FloatArray,
    bounce_first: IntArray,
    material: IntArray,
    normal: FloatArray,
    hits: IntArray,
    wavenumber: ComplexArray,
    r0: ComplexArray,
    spherical: bool,
) -> ComplexArray:
    """Return ``sum exp(-j k r) / (4 pi r) prod R``, shape (n_pairs, n_frequencies).

    Parameters
    ----------
    pair_first, bounce_first, material, normal, hits
        Of `roomfit.tracing.unfolded.UnfoldedPaths`.
    vector_m : float array, shape (n_paths, 3)
        From each image to the receiver, wherever both now are.
    wavenumber : complex array, shape (n_frequencies,)
        1/m, with the decay of window and air as a negative imaginary part.
    r0 : complex array, shape (n_materials, n_frequencies)
    spherical : bool
        Spherical instead of plane waves at the walls.
    """
    n_pairs, n_f = len(pair_first) - 1, len(wavenumber)
    out = np.zeros((n_pairs, n_f), dtype=np.complex128)
    value = np.empty(n_f, dtype=np.complex128)
    whole = np.empty(n_f, dtype=np.complex128)
    # of the numerical distance, see `roomfit.impedance.reflection.spherical_reflection`
    root = np.sqrt(0.5j * np.conj(wavenumber))
    admittance = np.empty_like(r0)
    for i in range(len(r0)):
        for f in range(n_f):
            admittance[i, f] = conjugate_admittance(r0[i, f])
    for pair in range(n_pairs):
        for path in range(pair_first[pair], pair_first[pair + 1]):
            x, y, z = vector_m[path, 0], vector_m[path, 1], vector_m[path, 2]
            r = math.sqrt(x * x + y * y + z * z)
            for f in range(n_f):
                value[f] = _spread(wavenumber[f], r)
            for b in range(bounce_first[path], bounce_first[path + 1]):
                n = normal[b]
                cosine = min(abs(x * n[0] + y * n[1] + z * n[2]) / r, 1.0)
                _reflect(
                    r0[material[b]], admittance[material[b]], cosine, root, r, spherical, whole
                )
                for _ in range(hits[b]):
                    for f in range(n_f):
                        value[f] *= whole[f]
            for f in range(n_f):
                out[pair, f] += value[f]
    return out


@kernel(allocates=False, inlined=True)
def _spread(k: complex, r: float) -> complex:
    """Return ``exp(-j k r) / (4 pi r)``."""
    size = math.exp(k.imag * r) / (4.0 * math.pi * r)
    return complex(size * math.cos(k.real * r), -size * math.sin(k.real * r))


@kernel(allocates=False)
def _reflect(
    r0: ComplexArray,
    admittance: ComplexArray,
    cosine: float,
    root: ComplexArray,
    r: float,
    spherical: bool,
    out: ComplexArray,
) -> None:
    """Write one reflection, of a plane or a spherical wave, over frequency."""
    q = (1.0 - cosine) / (1.0 + cosine)
    for f in range(len(r0)):
        a, b = r0[f].real, r0[f].imag
        u, v = 1.0 - q * a, q * b
        size = 1.0 / (u * u + v * v)
        out[f] = complex(a - q, b) * complex(u * size, v * size)
    if spherical:
        far = math.sqrt(r)
        for f in range(len(r0)):
            loss = boundary_loss(far * root[f] * (admittance[f] + cosine))
            out[f] += (1.0 - out[f]) * complex(loss.real, -loss.imag)


@kernel()
def pressure_gradients(
    pair_first: IntArray,
    vector_m: FloatArray,
    unfolding: FloatArray,
    bounce_first: IntArray,
    material: IntArray,
    normal: FloatArray,
    hits: IntArray,
    wavenumber: ComplexArray,
    r0: ComplexArray,
    with_geometry: bool,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Return the pressures with plane waves at the walls, and their exact derivatives.

    Arguments as of `pressures`; `unfolding` of the paths; `with_geometry` false leaves the last
    three derivatives zero.

    Returns
    -------
    pressure : complex array, shape (n_pairs, n_frequencies)
    by_r0 : complex array, shape (n_pairs, n_materials, n_frequencies)
        Holomorphic: a change dR0 of R0 changes the pressure by ``by_r0 dR0``.
    by_source, by_receiver : complex arrays, shape (n_pairs, 3, n_frequencies)
        1/m times the pressure; visibility held.
    by_wavenumber : complex array, shape (n_pairs, n_frequencies)
    """
    n_pairs, n_f, n_materials = len(pair_first) - 1, len(wavenumber), len(r0)
    out = np.zeros((n_pairs, n_f), dtype=np.complex128)
    by_r0 = np.zeros((n_pairs, n_materials, n_f), dtype=np.complex128)
    by_source = np.zeros((n_pairs, 3, n_f), dtype=np.complex128)
    by_receiver = np.zeros((n_pairs, 3, n_f), dtype=np.complex128)
    by_wavenumber = np.zeros((n_pairs, n_f), dtype=np.complex128)
    most = 0
    for path in range(len(bounce_first) - 1):
        most = max(most, bounce_first[path + 1] - bounce_first[path])
    cosines, signs = np.empty(most), np.empty(most)
    # of each bounce over frequency: all its hits, their derivatives by R0 and by the cosine
    whole = np.empty((most, n_f), dtype=np.complex128)
    slope_r0 = np.empty((most, n_f), dtype=np.complex128)
    slope_cosine = np.empty((most, n_f), dtype=np.complex128)
    before = np.empty((most + 1, n_f), dtype=np.complex128)
    after = np.empty(n_f, dtype=np.complex128)
    along = np.empty(n_f, dtype=np.complex128)
    g = np.empty((3, n_f), dtype=np.complex128)
    for pair in range(n_pairs):
        for path in range(pair_first[pair], pair_first[pair + 1]):
            x, y, z = vector_m[path, 0], vector_m[path, 1], vector_m[path, 2]
            r = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / r, y / r, z / r
            first = bounce_first[path]
            m = bounce_first[path + 1] - first
            for f in range(n_f):
                before[0, f] = _spread(wavenumber[f], r)
            for i in range(m):
                n = normal[first + i]
                c = x * n[0] + y * n[1] + z * n[2]
                signs[i] = 1.0 if c >= 0.0 else -1.0
                cosines[i] = min(abs(c), 1.0)
                _bounce(
                    r0[material[first + i]],
                    cosines[i],
                    hits[first + i],
                    whole[i],
                    slope_r0[i],
                    slope_cosine[i],
                )
                for f in range(n_f):
                    before[i + 1, f] = before[i, f] * whole[i, f]
            for f in range(n_f):
                out[pair, f] += before[m, f]
                after[f] = 1.0
                along[f] = (-1j * wavenumber[f] - 1.0 / r) * before[m, f]
            g[:] = 0.0
            for i in range(m - 1, -1, -1):
                own = by_r0[pair, material[first + i]]
                for f in range(n_f):
                    others = before[i, f] * after[f]
                    after[f] *= whole[i, f]
                    own[f] += others * slope_r0[i, f]
                    # the cosine turns with the direction: (n - cos u) / r
                    slope_cosine[i, f] *= others
                if with_geometry:
                    n = normal[first + i]
                    nx, ny, nz = signs[i] * n[0] / r, signs[i] * n[1] / r, signs[i] * n[2] / r
                    back = cosines[i] / r
                    for f in range(n_f):
                        turn = slope_cosine[i, f]
                        g[0, f] += turn * nx
                        g[1, f] += turn * ny
                        g[2, f] += turn * nz
                        along[f] -= turn * back
            if with_geometry:
                a = unfolding[path]
                for f in range(n_f):
                    gx, gy, gz = (
                        g[0, f] + along[f] * x,
                        g[1, f] + along[f] * y,
                        g[2, f] + along[f] * z,
                    )
                    by_receiver[pair, 0, f] += gx
                    by_receiver[pair, 1, f] += gy
                    by_receiver[pair, 2, f] += gz
                    for i in range(3):
                        by_source[pair, i, f] -= a[0, i] * gx + a[1, i] * gy + a[2, i] * gz
                    by_wavenumber[pair, f] += -1j * r * before[m, f]
    return out, by_r0, by_source, by_receiver, by_wavenumber


@kernel(allocates=False)
def _bounce(
    r0: ComplexArray,
    cosine: float,
    times: int,
    whole: ComplexArray,
    by_r0: ComplexArray,
    by_cosine: ComplexArray,
) -> None:
    """Write the reflection of so many hits at one angle, with derivatives, over frequency.

    `roomfit.impedance.reflection.plane_reflection` in real numbers, which the compiler turns into
    vector instructions.
    """
    q = (1.0 - cosine) / (1.0 + cosine)
    one_q, turned = 1.0 - q * q, 2.0 / ((1.0 + cosine) * (1.0 + cosine))
    for f in range(len(r0)):
        a, b = r0[f].real, r0[f].imag
        u, v = 1.0 - q * a, q * b
        size = 1.0 / (u * u + v * v)
        inverse = complex(u * size, v * size)
        reflection = complex(a - q, b) * inverse
        square = inverse * inverse
        power = complex(1.0, 0.0)
        for _ in range(times - 1):
            power *= reflection
        less = power * times
        whole[f] = power * reflection
        by_r0[f] = less * square * one_q
        by_cosine[f] = less * square * complex(1.0 - a * a + b * b, -2.0 * a * b) * turned
