"""Reflection of plane and spherical waves at locally reacting walls, in terms of R0.

R0 is the plane-wave reflection coefficient at normal incidence, ``(Z - 1) / (Z + 1)`` of the
impedance Z over that of the air. A wall is passive if and only if ``|R0| <= 1``.
"""

from __future__ import annotations

import math

import numpy as np

from roomfit.compiled import kernel

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
def plane_reflection(r0: complex, cosine: float) -> tuple[complex, complex, complex]:
    """Return ``R(theta)`` of a locally reacting wall and its derivatives by R0 and by the cosine.

    With ``q = tan(theta / 2)**2``: ``R = (R0 - q) / (1 - q R0)``, the same as
    ``(Z cos theta - 1) / (Z cos theta + 1)``.

    Parameters
    ----------
    r0 : complex
        ``|r0| <= 1``; then ``|R| <= 1`` at every angle.
    cosine : float
        Of the angle of incidence, 0 (grazing) to 1 (normal).
    """
    q = (1.0 - cosine) / (1.0 + cosine)
    inverse = 1.0 / (1.0 - q * r0)
    r = (r0 - q) * inverse
    by_r0 = (1.0 - q * q) * inverse * inverse
    by_cosine = (1.0 - r0 * r0) * inverse * inverse * 2.0 / ((1.0 + cosine) * (1.0 + cosine))
    return r, by_r0, by_cosine


@kernel(allocates=False)
def spherical_reflection(r0: complex, cosine: float, kr: complex) -> complex:
    """Return the reflection of a spherical wave at a locally reacting wall.

    ``Q = R + (1 - R) F(w)`` with the boundary loss factor F of the numerical distance
    ``w = sqrt(j kr / 2) (beta + cos theta)`` [1]_, [2]_.

    Parameters
    ----------
    r0 : complex
    cosine : float
    kr : complex
        Wavenumber times the whole length of the path; ``exp(+j w t)``, so that its imaginary part
        is negative where the wave decays.

    References
    ----------
    .. [1] C. F. Chien, W. W. Soroka, "Sound propagation along an impedance plane", J. Sound Vib.
           43, 9-20 (1975).
    .. [2] C. I. Chessell, "Propagation of noise along a finite impedance boundary", J. Acoust.
           Soc. Am. 62, 825-834 (1977).
    """
    r, _, _ = plane_reflection(r0, cosine)
    w = np.sqrt(0.5j * kr.conjugate()) * (conjugate_admittance(r0) + cosine)
    return complex(r + (1.0 - r) * boundary_loss(w).conjugate())


@kernel(allocates=False)
def conjugate_admittance(r0: complex) -> complex:
    """Return ``(1 - R0) / (1 + R0)`` as ``exp(-j w t)`` has it, which `boundary_loss` takes.

    A wall without any pressure, R0 = -1, gets a number so large that its F is 0.
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
