"""Pressures of image sources in a room of locally reacting walls, and their derivatives; compiled.

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

from roomfit.base.kernels import kernel
from roomfit.base.typing import ComplexArray, FloatArray, IntArray

# From here on six terms of the asymptotic series leave less than 1e-7 of the answer.
_FAR = 36.0
_TERMS = 8
_N = 32
_L = math.sqrt(_N / math.sqrt(2.0))


def _weideman() -> tuple[float, ...]:
    """Return the coefficients of Weideman's rational approximation, highest power first [1]_.

    References
    ----------
    .. [1] J. A. C. Weideman, "Computation of the complex error function", SIAM J. Numer. Anal. 31,
           1497-1518 (1994).
    """
    m2 = 4 * _N
    t = _L * np.tan(np.arange(-m2 // 2 + 1, m2 // 2) * np.pi / m2)
    f = np.concatenate(([0.0], np.exp(-(t**2)) * (_L**2 + t**2)))
    a = np.real(np.fft.fft(np.fft.fftshift(f))) / m2
    return tuple(float(x) for x in a[1 : _N + 1][::-1])


_COEFFICIENTS = np.array(_weideman())


@kernel(allocates=False)
def conjugate_admittance(r0: complex) -> complex:
    """Return ``(1 - R0) / (1 + R0)`` as ``exp(-j w t)`` has it, which `boundary_loss` takes.

    A pressure-release wall, R0 = -1, gets a number so large that its F is 0.
    """
    above = 1.0 + r0
    if abs(above) < 1e-12:
        above = 1e-12 + 0.0j
    return complex(((1.0 - r0) / above).conjugate())


@kernel(allocates=False)
def boundary_loss(w: complex) -> complex:
    """Return ``F(w) = 1 + j sqrt(pi) w wofz(w)`` for any complex w."""
    if w.imag < 0.0:
        # wofz(w) = 2 exp(-w**2) - wofz(-w): the surface wave of springy walls
        return complex(_loss_above(-w) + 2.0j * math.sqrt(math.pi) * w * np.exp(-w * w))
    return _loss_above(w)


@kernel(allocates=False)
def _loss_above(w: complex) -> complex:
    size = w.real * w.real + w.imag * w.imag
    if size > _FAR:
        # 1 + j sqrt(pi) w wofz(w) = - sum (2 n - 1)!! u**n with u = 1 / (2 w**2), by Horner
        square = w * w
        scale = 0.5 / (size * size)
        u = complex(square.real * scale, -square.imag * scale)
        total = 1.0 + (2 * _TERMS - 1) * u
        for n in range(_TERMS - 1, 1, -1):
            total = 1.0 + (2 * n - 1) * u * total
        return -u * total
    below = _L - 1j * w
    z = (_L + 1j * w) / below
    p = 0.0j
    for a in _COEFFICIENTS:
        p = p * z + a
    wofz = 2.0 * p / (below * below) + (1.0 / math.sqrt(math.pi)) / below
    return 1.0 + 1j * math.sqrt(math.pi) * w * wofz


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

    Shapes: `vector_m` (n_paths, 3) from each image to the receiver, `wavenumber` (n_frequencies,),
    `r0` (n_materials, n_frequencies); the rest of `roomfit.impedance.wave_model.UnfoldedPaths`.
    """
    n_pairs, n_f = len(pair_first) - 1, len(wavenumber)
    out = np.zeros((n_pairs, n_f), dtype=np.complex128)
    value = np.empty(n_f, dtype=np.complex128)
    whole = np.empty(n_f, dtype=np.complex128)
    # of the numerical distance, for exp(-j w t)
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
                reflect(r0[material[b]], admittance[material[b]], cosine, root, r, spherical, whole)
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
def reflect(
    r0: ComplexArray,
    admittance: ComplexArray,
    cosine: float,
    root: ComplexArray,
    r: float,
    spherical: bool,
    out: ComplexArray,
) -> None:
    """Write one reflection, of a plane or a spherical wave, over frequency into `out`.

    `r0`, `admittance` (by `conjugate_admittance`), `root` (``sqrt(j k / 2)``, conjugate) and `out`
    have the shape (n_frequencies,); the cosine of the angle of incidence is 0 (grazing) to 1
    (normal), `r` the length of the path in m.
    """
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
    image_transform: FloatArray,
    bounce_first: IntArray,
    material: IntArray,
    normal: FloatArray,
    hits: IntArray,
    wavenumber: ComplexArray,
    r0: ComplexArray,
    with_geometry: bool,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Return the pressures with plane waves at the walls, and their exact derivatives.

    Arguments as of `pressures`; `image_transform` of the paths; `with_geometry` false leaves the
    last three derivatives zero.
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
                a = image_transform[path]
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
    """Add how each cosine changes as the path turns, ``(n - cos u) / r``, to the derivatives."""
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

    In real numbers, which the compiler turns into vector instructions.
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
