"""The wave model of a measured room: its paths, and what may be wrong about the measurement.

What a wave model will cost, asked before its paths are looked for.

Reflection of plane and spherical waves at locally reacting walls, in terms of R0.

R0 is the plane-wave reflection coefficient at normal incidence, ``(Z - 1) / (Z + 1)`` of the
impedance Z over that of the air. A wall is passive if and only if ``|R0| <= 1``.

Pressures of image sources that carry phase, and their derivatives; compiled.

Image paths of moving sources and receivers, with the angle at every wall: for pressures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from roomfit._checks import read_only
from roomfit._numba import kernel
from roomfit.air import pressure_decay_per_m, speed_of_sound_m_s
from roomfit.errors import InputError
from roomfit.geometry.mesh import mean_free_path_m, volume_m3
from roomfit.scene import Room, Scene, distances_m
from roomfit.tracing.image_sources import (
    affordable_duration_s,
    expected_images,
    image_positions_m,
    lattice_indices,
    limits_of,
    polyhedron_images,
    wall_hits,
)
from roomfit.tracing.paths import ImageSet
from roomfit.tracing.reflectors import mirrors_of
from roomfit.typing import ComplexArray, FloatArray, IntArray

# Reflections times frequencies, of all pairs: a fit of so many takes some ten minutes on one core.
MOST_REFLECTIONS = 1e9
# Walls held against beams, of all sources: some ten seconds.
MOST_WORK = 3e7
# Of a fixed point that each step brings at least four times as near.
_STEPS = 6
# In rooms of so few triangles the search is never what costs.
_FEW_TRIANGLES = 60


def check_cost(scene: Scene, n_frequencies: int, tau_s: float, lengths: float) -> None:
    """Refuse a model whose paths are too many to be weighed, or to be found, within minutes.

    Parameters
    ----------
    scene : Scene
    n_frequencies : int
    tau_s : float
    lengths : float
        Longest path in units of the speed of sound times `tau_s`.

    Raises
    ------
    InputError
        Names the longest time constant that can be afforded.

    Notes
    -----
    Images within a length fill space with one for each volume of the room, whatever its shape, and
    a path is reflected once a mean free path; so the reflections grow with the fourth power of
    `tau_s`. How many walls the search for them meets is counted, not estimated, in a room of many
    walls.
    """
    reflections = reflections_to_weigh(scene, n_frequencies, lengths * tau_s)
    if reflections > MOST_REFLECTIONS:
        affordable_s = tau_s
        for _ in range(_STEPS):
            count = reflections_to_weigh(scene, n_frequencies, lengths * affordable_s)
            affordable_s *= (MOST_REFLECTIONS / count) ** 0.25
        found = f"{reflections:.2g} reflections times frequencies"
        raise _too_much(tau_s, affordable_s, found, "fewer frequencies")
    mesh = scene.room.mesh
    if len(mesh.triangles) <= _FEW_TRIANGLES:
        return
    work = MOST_WORK / max(len(np.unique(scene.pairs[:, 0])), 1)
    affordable_s = affordable_duration_s(scene, lengths * tau_s, work=work, images=1e6) / lengths
    # what is asked for comes back as it is, up to rounding
    if affordable_s < 0.999 * tau_s:
        found = f"a room of {len(mesh.triangles)} triangles"
        raise _too_much(tau_s, affordable_s, found, "a room of fewer walls")


def reflections_to_weigh(scene: Scene, n_frequencies: int, longest_s: float) -> float:
    """Return about how many reflections all pairs have up to a duration, times frequencies."""
    mesh = scene.room.mesh
    length_m = longest_s * speed_of_sound_m_s(scene.air)
    images = expected_images(abs(volume_m3(mesh)), length_m)
    # paths that long, and three quarters of it on average
    hits = 1.0 + 0.75 * length_m / abs(mean_free_path_m(mesh))
    return images * hits * len(scene.pairs) * n_frequencies


def _too_much(tau_s: float, affordable_s: float, found: str, else_try: str) -> InputError:
    longest_ms = math.floor(affordable_s * 1e4) / 10.0
    return InputError(
        "the exponential window lets more reflections through than can be weighed in minutes",
        found=f"tau = {1000.0 * tau_s:g} ms, {found}",
        needed=f"tau of at most {longest_ms:g} ms here",
        hint=f"choose a shorter window, or {else_try}",
    )


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
        Of `roomfit.impedance.wave_model.UnfoldedPaths`.
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
    # of the numerical distance, see `roomfit.impedance.wave_model.spherical_reflection`
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

    `roomfit.impedance.wave_model.plane_reflection` in real numbers, which the compiler turns into
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


# No order of reflections can be reached within any length worth the name.
_ANY_ORDER = 10_000


@dataclass(frozen=True, slots=True, eq=False)
class UnfoldedPaths:
    """Specular paths of every pair, straightened, with all that a pressure needs.

    From its image a path runs straight along `vector_m` to the receiver. When the source moves by
    dS and the receiver by dR, without another wall coming into play, it runs along
    ``vector_m + dR - image_transform dS``, exactly. A bounce stands for one or several hits at the
    same angle: its cosine of incidence is that between the path and `normal`.

    Attributes
    ----------
    pair_first : int64 array, shape (n_pairs + 1,)
        Pair i owns the paths ``pair_first[i]:pair_first[i + 1]``, shortest first.
    vector_m : float array, shape (n_paths, 3)
    image_transform : float array, shape (n_paths, 3, 3)
    bounce_first : int64 array, shape (n_paths + 1,)
        Path i owns the bounces ``bounce_first[i]:bounce_first[i + 1]``.
    material : int64 array, shape (n_bounces,)
    normal : float array, shape (n_bounces, 3)
        Of the wall as the receiver sees it, mirrored by all later hits; a unit vector.
    hits : int64 array, shape (n_bounces,)
        How many hits a bounce stands for.
    """

    pair_first: IntArray
    vector_m: FloatArray
    image_transform: FloatArray
    bounce_first: IntArray
    material: IntArray
    normal: FloatArray
    hits: IntArray

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            read_only(getattr(self, name))


def unfolded_paths(scene: Scene, longest_m: float) -> UnfoldedPaths:
    """Return all specular paths of every pair up to a length.

    Parameters
    ----------
    scene : Scene
        Any room; in one that is no box, only images that are seen from the receiver.
    longest_m : float

    Raises
    ------
    InputError
        A source stands where a receiver is, or there are more images than the memory or the work
        allows.
    """
    distances = distances_m(scene)
    if distances.size and distances.min() < 1e-6:
        source, receiver = scene.pairs[int(np.argmin(distances))]
        raise InputError(
            "a source stands where a receiver is",
            where=f"{scene.sources[source].name} and {scene.receivers[receiver].name}",
        )
    find = _of_a_polyhedron if scene.room.shoebox_m is None else _of_a_box
    return _joined(find(scene, longest_m))


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The paths of one pair; `path` says to which each bounce belongs, in rising order."""

    vector_m: FloatArray
    image_transform: FloatArray
    path: IntArray
    material: IntArray
    normal: FloatArray
    hits: IntArray


def _of_a_box(scene: Scene, longest_m: float) -> list[_Part]:
    parts = []
    for s, r in scene.pairs:
        source, receiver = scene.sources[s].position_m, scene.receivers[r].position_m
        parts.append(_box_part(scene.room, source, receiver, longest_m))
    return parts


def _box_part(room: Room, source_m: FloatArray, receiver_m: FloatArray, longest_m: float) -> _Part:
    """Return paths whose hits on one wall, all at one angle, are one bounce."""
    lengths = np.array(room.shoebox_m, dtype=np.float64)
    index = lattice_indices(lengths, source_m, receiver_m, _ANY_ORDER, longest_m)
    vector = receiver_m - image_positions_m(index, lengths, source_m)
    near = np.argsort(np.linalg.norm(vector, axis=1), kind="stable")
    index, vector = index[near], vector[near]
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    hits = np.column_stack([wall_hits(index, wall) for wall in range(6)])
    path, wall = np.nonzero(hits)
    material = np.asarray(room.surface_material[wall], dtype=np.int64)
    image_transform = np.asarray(turned[:, :, None] * np.eye(3))
    return _Part(vector, image_transform, path, material, np.eye(3)[wall // 2], hits[path, wall])


def _of_a_polyhedron(scene: Scene, longest_m: float) -> list[_Part]:
    mirrors = mirrors_of(scene.room)
    parts: list[_Part | None] = [None] * len(scene.pairs)
    for s in np.unique(scene.pairs[:, 0]):
        own = np.flatnonzero(scene.pairs[:, 0] == s)
        receivers = np.array([scene.receivers[r].position_m for r in scene.pairs[own, 1]])
        found = polyhedron_images(
            scene.room,
            scene.sources[s].position_m,
            receivers,
            limits_of(_ANY_ORDER, longest_m),
            with_reflections=True,
            with_image_transforms=True,
            mirrors=mirrors,
        )
        for pair, images in zip(own, found, strict=True):
            parts[pair] = _polyhedron_part(images)
    return [p for p in parts if p is not None]


def _polyhedron_part(images: ImageSet) -> _Part:
    reflections, image_transform, normals = (
        images.reflections,
        images.image_transform,
        images.normals,
    )
    if reflections is None or image_transform is None or normals is None:
        raise ValueError("images without reflections, unfolding or normals")
    counts = np.diff(reflections.offsets)
    return _Part(
        images.length_m[:, None] * images.arrival,
        image_transform,
        np.repeat(np.arange(len(counts)), counts),
        np.asarray(reflections.material, dtype=np.int64),
        normals,
        np.ones(len(normals), dtype=np.int64),
    )


def _joined(parts: list[_Part]) -> UnfoldedPaths:
    n_paths = [len(p.vector_m) for p in parts]
    bounces = np.concatenate([np.bincount(p.path, minlength=len(p.vector_m)) for p in parts])
    return UnfoldedPaths(
        np.concatenate(([0], np.cumsum(n_paths))),
        np.concatenate([p.vector_m for p in parts]),
        np.concatenate([p.image_transform for p in parts]),
        np.concatenate(([0], np.cumsum(bounces))),
        np.concatenate([p.material for p in parts]),
        np.concatenate([p.normal for p in parts]),
        np.concatenate([p.hits for p in parts]).astype(np.int64),
    )


GainMode = Literal["known", "common", "source", "pair", "spectrum", "pair-spectrum"]
_GAINS = get_args(GainMode)
DelayMode = Literal["source", "pair"]

# Lengths of paths in units of c tau: what lies beyond the first is 1e-3 of the damped field even
# between walls that swallow nothing; to the second reaches the part that is weighed at every step.
_WHOLE = 7.0
_SHORT = 4.0


@dataclass(frozen=True, slots=True)
class Nuisances:
    """What may be wrong about a measurement, and is found together with the walls.

    Attributes
    ----------
    position_sd_m : float
        Of every coordinate for which the scene tells none; 0 takes them as exact.
    speed_sd : float
        Of the speed of sound, relative; 0 takes it as exact.
    gain : {"known", "common", "source", "pair", "spectrum", "pair-spectrum"}
        known: pressures are absolute. common, source, pair: one unknown complex gain for all, for
        each source or for each pair. spectrum: one for each source and frequency; pair-spectrum:
        that, and one for each pair.
    delay_sd_s : float
        Of the moment of emission; 0 takes it as exact.
    delay : {"source", "pair"}
        One moment for each source, or one for each pair, as of files that were cut one by one.
    least_position_sd_m : float
        Coordinates that the scene tells more exactly are given this standard deviation.
    """

    position_sd_m: float = 0.01
    speed_sd: float = 0.01
    gain: GainMode = "known"
    delay_sd_s: float = 0.0
    delay: DelayMode = "source"
    least_position_sd_m: float = 0.0

    def __post_init__(self) -> None:
        for name, value, high in (
            ("position_sd_m", self.position_sd_m, 1.0),
            ("speed_sd", self.speed_sd, 0.2),
            ("delay_sd_s", self.delay_sd_s, 0.1),
            ("least_position_sd_m", self.least_position_sd_m, 1.0),
        ):
            if not 0.0 <= value <= high:
                raise InputError(
                    f"{name} is out of range", found=f"{value:g}", needed=f"0 to {high:g}"
                )
        if self.gain not in _GAINS:
            raise InputError(
                "unknown kind of gain",
                found=repr(self.gain),
                needed=", ".join(_GAINS),
            )
        if self.delay not in ("source", "pair"):
            raise InputError(
                "unknown kind of delay", found=repr(self.delay), needed="source or pair"
            )


def has_free_spectra(nuisances: Nuisances) -> bool:
    """Whether each source has an unknown spectrum."""
    return nuisances.gain in ("spectrum", "pair-spectrum")


class State(NamedTuple):
    """Where source and receivers are off, and how fast sound is.

    Attributes
    ----------
    source_m, receiver_m : float arrays, shape (n_sources, 3) and (n_receivers, 3)
        Moves from the told positions.
    speed : float
        Relative change of the speed of sound.
    """

    source_m: FloatArray
    receiver_m: FloatArray
    speed: float


@dataclass(frozen=True, slots=True, eq=False)
class WaveModel:
    """A scene's image sources at the frequencies of a measurement.

    Attributes
    ----------
    scene : Scene
    frequency_hz : float array, shape (n_frequencies,)
    tau_s : float
    speed_m_s : float
        As told; the laws of materials keep to it.
    air_per_m : float array, shape (n_frequencies,)
        By which pressures fall in the air.
    whole, short : UnfoldedPaths
        All paths that the window lets through, and those that every step of a fit weighs.
    """

    scene: Scene
    frequency_hz: FloatArray
    tau_s: float
    speed_m_s: float
    air_per_m: FloatArray
    whole: UnfoldedPaths
    short: UnfoldedPaths


def wave_model(scene: Scene, frequency_hz: FloatArray, tau_s: float) -> WaveModel:
    """Return the model of a scene behind an exponential window.

    Raises
    ------
    InputError
        As of `roomfit.impedance.wave_model.unfolded_paths`, or more paths than minutes suffice for.
    """
    check_cost(scene, len(frequency_hz), tau_s, _WHOLE)
    bare = model_without_paths(scene, frequency_hz, tau_s)
    whole = unfolded_paths(scene, _WHOLE * bare.speed_m_s * tau_s)
    short = shortened(whole, _SHORT * bare.speed_m_s * tau_s)
    return replace(bare, whole=whole, short=short)


def model_without_paths(scene: Scene, frequency_hz: FloatArray, tau_s: float) -> WaveModel:
    """Return a model of no paths at all: enough to ask whether the data can hold the unknowns."""
    nothing = np.zeros(0, dtype=np.int64)
    vectors = np.zeros((0, 3))
    pairs = np.zeros(len(scene.pairs) + 1, dtype=np.int64)
    paths = UnfoldedPaths(
        pairs, vectors, np.zeros((0, 3, 3)), np.zeros(1, np.int64), nothing, vectors, nothing
    )
    f = np.asarray(frequency_hz, dtype=np.float64)
    speed, air = speed_of_sound_m_s(scene.air), pressure_decay_per_m(scene.air, f)
    return WaveModel(scene, f, float(tau_s), speed, air, paths, paths)


def at_frequencies(model: WaveModel, chosen: IntArray) -> WaveModel:
    """Return the model at some of its frequencies."""
    return replace(
        model, frequency_hz=model.frequency_hz[chosen], air_per_m=model.air_per_m[chosen]
    )


def at_rest(model: WaveModel) -> State:
    """Return the state in which all is as told."""
    scene = model.scene
    return State(np.zeros((len(scene.sources), 3)), np.zeros((len(scene.receivers), 3)), 0.0)


def shortened(paths: UnfoldedPaths, longest_m: float) -> UnfoldedPaths:
    """Return the paths up to a length."""
    kept = np.linalg.norm(paths.vector_m, axis=1) <= longest_m
    counts = np.diff(paths.bounce_first)
    bounces = np.repeat(kept, counts)
    per_pair = np.add.reduceat(np.append(kept, False).astype(np.int64), paths.pair_first[:-1])
    per_pair = np.where(np.diff(paths.pair_first) > 0, per_pair, 0)
    return UnfoldedPaths(
        np.concatenate(([0], np.cumsum(per_pair))),
        paths.vector_m[kept],
        paths.image_transform[kept],
        np.concatenate(([0], np.cumsum(counts[kept]))),
        paths.material[bounces],
        paths.normal[bounces],
        paths.hits[bounces],
    )


def wavenumber_per_m(model: WaveModel, state: State) -> ComplexArray:
    """Return ``2 pi (f - j / (2 pi tau)) / c - j a``, a the decay in the air."""
    f = model.frequency_hz - 0.5j / (np.pi * model.tau_s)
    return np.asarray(
        2.0 * np.pi * f / (model.speed_m_s * (1.0 + state.speed)) - 1j * model.air_per_m
    )


def moved_vectors_m(model: WaveModel, paths: UnfoldedPaths, state: State) -> FloatArray:
    """Return where every path runs with sources and receivers moved, (n_paths, 3)."""
    pair = np.repeat(np.arange(len(paths.pair_first) - 1), np.diff(paths.pair_first))
    source, receiver = model.scene.pairs[pair].T
    moved = np.einsum("pij,pj->pi", paths.image_transform, state.source_m[source])
    return np.asarray(paths.vector_m + state.receiver_m[receiver] - moved)


def predicted_pressure(
    model: WaveModel, r0: ComplexArray, state: State, *, spherical: bool = True
) -> ComplexArray:
    """Return the damped spectra of all pairs with all images, shape (n_pairs, n_frequencies).

    Parameters
    ----------
    model : WaveModel
    r0 : complex array, shape (n_materials, n_frequencies)
        ``|r0| <= 1``, at the complex frequency of the window.
    state : State
    spherical : bool
        Spherical waves at the walls, as they are; plane ones are 5 times as wrong.

    Notes
    -----
    Against exact wave fields the rms error is some 1.4, 1.2, 0.6 and 0.4 % in 100 to 200, to 400,
    to 700 and to 1000 Hz in rooms of 60 m3.
    """
    return _pressure(model, model.whole, r0, state, spherical=spherical)


def frozen_correction(
    model: WaveModel, r0: ComplexArray, state: State, *, spherical: bool = True
) -> ComplexArray:
    """Return what all images with spherical waves have over short paths with plane waves."""
    whole = _pressure(model, model.whole, r0, state, spherical=spherical)
    return np.asarray(whole - _pressure(model, model.short, r0, state, spherical=False))


def _pressure(
    model: WaveModel, paths: UnfoldedPaths, r0: ComplexArray, state: State, *, spherical: bool
) -> ComplexArray:
    return pressures(
        paths.pair_first,
        moved_vectors_m(model, paths, state),
        paths.bounce_first,
        paths.material,
        paths.normal,
        paths.hits,
        wavenumber_per_m(model, state),
        np.ascontiguousarray(r0, dtype=np.complex128),
        spherical,
    )


class Gradients(NamedTuple):
    """Pressures of short paths with plane waves at the walls, and their derivatives.

    Attributes
    ----------
    pressure : complex array, shape (n_pairs, n_frequencies)
    by_r0 : complex array, shape (n_pairs, n_materials, n_frequencies)
    by_source, by_receiver : complex arrays, shape (n_pairs, 3, n_frequencies)
    by_speed : complex array, shape (n_pairs, n_frequencies)
        By the relative change of the speed of sound.
    """

    pressure: ComplexArray
    by_r0: ComplexArray
    by_source: ComplexArray
    by_receiver: ComplexArray
    by_speed: ComplexArray


def gradients(
    model: WaveModel, r0: ComplexArray, state: State, *, with_geometry: bool = True
) -> Gradients:
    """Return pressures with their exact derivatives; without geometry only those by R0."""
    paths = model.short
    k = wavenumber_per_m(model, state)
    p, by_r0, by_source, by_receiver, by_k = pressure_gradients(
        paths.pair_first,
        moved_vectors_m(model, paths, state),
        paths.image_transform,
        paths.bounce_first,
        paths.material,
        paths.normal,
        paths.hits,
        k,
        np.ascontiguousarray(r0, dtype=np.complex128),
        with_geometry,
    )
    k_by_speed = -(k + 1j * model.air_per_m) / (1.0 + state.speed)
    return Gradients(p, by_r0, by_source, by_receiver, by_k * k_by_speed)
