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
    # of each bounce over frequency: all its hits, and their derivatives by R0 and by the cosine
    slopes = np.empty((3, most, n_f), dtype=np.complex128)
    before = np.empty((most + 1, n_f), dtype=np.complex128)
    # products of later bounces, derivative along the path, derivative by the three coordinates
    back = np.empty((5, n_f), dtype=np.complex128)
    cosines = np.empty(most)
    for pair in range(n_pairs):
        for path in range(pair_first[pair], pair_first[pair + 1]):
            x, y, z = vector_m[path, 0], vector_m[path, 1], vector_m[path, 2]
            r = math.sqrt(x * x + y * y + z * z)
            x, y, z = x / r, y / r, z / r
            own = slice(bounce_first[path], bounce_first[path + 1])
            m = bounce_first[path + 1] - bounce_first[path]
            for i in range(m):
                n = normal[own][i]
                cosines[i] = x * n[0] + y * n[1] + z * n[2]
            for f in range(n_f):
                before[0, f] = _spread(wavenumber[f], r)
            _forward(r0, material[own], hits[own], cosines, slopes, before)
            for f in range(n_f):
                out[pair, f] += before[m, f]
                back[0, f] = 1.0
                back[1, f] = (-1j * wavenumber[f] - 1.0 / r) * before[m, f]
            _backward(material[own], slopes, before, back, by_r0[pair])
            if with_geometry:
                _turned(normal[own], cosines, r, slopes, back)
                a = unfolding[path]
                for f in range(n_f):
                    gx, gy, gz = back[2, f], back[3, f], back[4, f]
                    gx, gy, gz = gx + back[1, f] * x, gy + back[1, f] * y, gz + back[1, f] * z
                    by_receiver[pair, 0, f] += gx
                    by_receiver[pair, 1, f] += gy
                    by_receiver[pair, 2, f] += gz
                    for i in range(3):
                        by_source[pair, i, f] -= a[0, i] * gx + a[1, i] * gy + a[2, i] * gz
                    by_wavenumber[pair, f] += -1j * r * before[m, f]
    return out, by_r0, by_source, by_receiver, by_wavenumber


@kernel(allocates=False)
def _forward(
    r0: ComplexArray,
    material: IntArray,
    hits: IntArray,
    cosines: FloatArray,
    slopes: ComplexArray,
    before: ComplexArray,
) -> None:
    """Write every bounce of a path with its slopes, and the product of all before each."""
    for i in range(len(material)):
        cosine = min(abs(cosines[i]), 1.0)
        _bounce(r0[material[i]], cosine, hits[i], slopes[0, i], slopes[1, i], slopes[2, i])
        for f in range(r0.shape[1]):
            before[i + 1, f] = before[i, f] * slopes[0, i, f]


@kernel(allocates=False)
def _backward(
    material: IntArray,
    slopes: ComplexArray,
    before: ComplexArray,
    back: ComplexArray,
    by_r0: ComplexArray,
) -> None:
    """Add the derivative by each R0, and weigh the slopes by the cosine with all other bounces."""
    for i in range(len(material) - 1, -1, -1):
        own = by_r0[material[i]]
        for f in range(before.shape[1]):
            others = before[i, f] * back[0, f]
            back[0, f] *= slopes[0, i, f]
            own[f] += others * slopes[1, i, f]
            slopes[2, i, f] *= others


@kernel(allocates=False)
def _turned(
    normal: FloatArray, cosines: FloatArray, r: float, slopes: ComplexArray, back: ComplexArray
) -> None:
    """Write what the path's turning does to its cosines: each moves by ``(n - cos u) / r``."""
    back[2:] = 0.0
    for i in range(len(normal)):
        sign = 1.0 if cosines[i] >= 0.0 else -1.0
        nx, ny, nz = sign * normal[i, 0] / r, sign * normal[i, 1] / r, sign * normal[i, 2] / r
        along = abs(cosines[i]) / r
        for f in range(slopes.shape[2]):
            turn = slopes[2, i, f]
            back[1, f] -= turn * along
            back[2, f] += turn * nx
            back[3, f] += turn * ny
            back[4, f] += turn * nz


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
