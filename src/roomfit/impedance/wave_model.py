"""Image sources with phase as a model of a measured room: its paths, its cost, its uncertainties.

A path is kept with the product of its reflections, so that sources and receivers can be moved
without another search.

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
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.special import wofz

from roomfit.base.air import pressure_decay_per_m, speed_of_sound_m_s
from roomfit.base.arguments import check_known, check_range
from roomfit.base.errors import InputError
from roomfit.base.kernels import kernel
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.room.mesh import area_vectors_m2, mean_free_path_m, volume_m3
from roomfit.room.scene import Room, Scene, check_apart, triangle_material
from roomfit.tracing.image_sources import (
    affordable_duration_s,
    expected_images,
    images_of_source,
    limits_of,
    reflectors_of,
)
from roomfit.tracing.lattice import images_within, wall_hits
from roomfit.tracing.paths import ImageSet, unfolded_normals

# Reflections times frequencies, of all pairs: a fit of so many takes some ten minutes on one core.
MOST_REFLECTIONS = 1e9
# Walls compared with beams, of all sources: some ten seconds.
MOST_WORK = 3e7
# In rooms of so few triangles the search is never what costs.
_FEW_TRIANGLES = 60
# No order of reflections can be reached within any length worth the name.
_ANY_ORDER = 10_000

# Lengths of paths in units of c tau: beyond the first lies 1e-3 of the damped field, even between
# walls that absorb nothing; up to the second, paths are weighed anew at every step of a fit.
_WHOLE = 7.0
_SHORT = 4.0


def check_cost(scene: Scene, n_frequencies: int, tau_s: float) -> None:
    """Refuse a model whose paths are too many to be weighed, or to be found, within minutes."""
    mesh, n_triangles = scene.room.mesh, len(scene.room.mesh.triangles)

    def reflections(window_s: float) -> float:
        length_m = _WHOLE * window_s * speed_of_sound_m_s(scene.air)
        # paths that long, and three quarters of it on average
        hits = 1.0 + 0.75 * length_m / abs(mean_free_path_m(mesh))
        images = expected_images(abs(volume_m3(mesh)), length_m)
        return images * hits * len(scene.pairs) * n_frequencies

    affordable_s, found = tau_s, f"{reflections(tau_s):.2g} reflections times frequencies"
    if reflections(tau_s) > MOST_REFLECTIONS:
        for _ in range(6):  # each step brings the fixed point at least four times as near
            affordable_s *= (MOST_REFLECTIONS / reflections(affordable_s)) ** 0.25
    elif n_triangles > _FEW_TRIANGLES:
        work = MOST_WORK / max(len(np.unique(scene.pairs[:, 0])), 1)
        affordable_s = affordable_duration_s(scene, _WHOLE * tau_s, work=work, images=1e6) / _WHOLE
        found = f"a room of {n_triangles} triangles"
    # what is asked for comes back as it is, up to rounding
    if affordable_s < 0.999 * tau_s:
        what = "the exponential window lets more reflections through than can be weighed in minutes"
        found = f"tau = {1000.0 * tau_s:g} ms, {found}"
        needed = f"tau of at most {math.floor(affordable_s * 1e4) / 10.0:g} ms here"
        hint = "choose a shorter window, fewer frequencies, or a room of fewer walls"
        raise InputError(what, found=found, needed=needed, hint=hint)


class UnfoldedPaths(NamedTuple):
    """Specular paths of every pair, unfolded, with all that a pressure needs.

    From its image a path runs straight along `vector_m` to the receiver. When the source moves by
    dS and the receiver by dR, without another wall coming into play, it runs along
    ``vector_m + dR - image_transform dS``, exactly. A bounce stands for one or several hits at the
    same angle: its cosine of incidence is that between the path and `normal`.
    """

    # (n_pairs + 1,): pair i owns the paths pair_first[i]:pair_first[i + 1], shortest first
    pair_first: IntArray
    vector_m: FloatArray  # (n_paths, 3)
    image_transform: FloatArray  # (n_paths, 3, 3)
    # (n_paths + 1,): path i owns the bounces bounce_first[i]:bounce_first[i + 1]
    bounce_first: IntArray
    material: IntArray  # (n_bounces,), int64
    # (n_bounces, 3), unit vectors: of the wall as the receiver sees it, mirrored by all later hits
    normal: FloatArray
    hits: IntArray  # (n_bounces,), int64: for how many hits a bounce stands


def unfolded_paths(scene: Scene, longest_m: float) -> UnfoldedPaths:
    """Return all specular paths of every pair up to a length.

    In a room that is no box, only images that are visible from the receiver.
    """
    check_apart(scene)
    parts: dict[int, tuple[FloatArray | IntArray, ...]] = {}
    if scene.room.shoebox_m is not None:
        for i, (s, r) in enumerate(scene.pairs):
            ends = scene.sources[s].position_m, scene.receivers[r].position_m
            parts[i] = _box_paths(scene.room, *ends, longest_m)
    else:
        reflectors, limits = reflectors_of(scene.room), limits_of(_ANY_ORDER, longest_m)
        also = {"with_image_transforms": True, "with_triangles": True}
        for source in np.unique(scene.pairs[:, 0]).tolist():  # once a source
            images = images_of_source(scene, reflectors, limits, source, **also)
            own = np.flatnonzero(scene.pairs[:, 0] == source)
            for i, one in zip(own.tolist(), images, strict=True):
                parts[i] = _paths_of_images(scene.room, one)
    whole = [parts[i] for i in range(len(scene.pairs))]
    columns = [np.concatenate(column) for column in zip(*whole, strict=True)]
    vector_m, image_transform, bounces, *of_bounces = columns
    pair_first = np.append(0, np.cumsum([len(part[0]) for part in whole]))
    bounce_first = np.append(0, np.cumsum(bounces))
    return UnfoldedPaths(pair_first, vector_m, image_transform, bounce_first, *of_bounces)


def _box_paths(
    room: Room, source_m: FloatArray, receiver_m: FloatArray, longest_m: float
) -> tuple[FloatArray | IntArray, ...]:
    """Return the paths of one pair: vectors, transforms, numbers of bounces, and what is of these.

    Hits on one wall, all at one angle, are one bounce.
    """
    lengths = np.array(room.shoebox_m, dtype=np.float64)
    index, vector = images_within(lengths, source_m, receiver_m, _ANY_ORDER, longest_m)
    near = np.argsort(np.linalg.norm(vector, axis=1), kind="stable")
    index, vector = index[near], vector[near]
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    hits = np.column_stack([wall_hits(index, wall) for wall in range(6)])
    path, wall = np.nonzero(hits)
    bounces = np.bincount(path, minlength=len(vector))
    material, struck = room.surface_material[wall].astype(np.int64), hits[path, wall]
    transform = turned[:, :, None] * np.eye(3)
    return vector, transform, bounces, material, np.eye(3)[wall // 2], struck.astype(np.int64)


def _paths_of_images(room: Room, images: ImageSet) -> tuple[FloatArray | IntArray, ...]:
    """Return the paths of one pair as `_box_paths` does, each hit a bounce."""
    first, triangle, transform = images.first_hit, images.triangle, images.image_transform
    if first is None or triangle is None or transform is None:
        raise ValueError("images without their hits or image transforms")
    vectors = area_vectors_m2(room.mesh)[triangle]
    normals = unfolded_normals(vectors / np.linalg.norm(vectors, axis=1)[:, None], first)
    material = triangle_material(room)[triangle].astype(np.int64)
    vector = images.length_m[:, None] * images.arrival
    return vector, transform, np.diff(first), material, normals, np.ones(len(normals), np.int64)


GainMode = Literal["known", "common", "source", "pair", "spectrum", "pair-spectrum"]
DelayMode = Literal["source", "pair"]


@dataclass(frozen=True, slots=True)
class Nuisances:
    """What may be wrong about a measurement, and is estimated together with the walls."""

    # prior sd of every coordinate for which the scene specifies none, 0 to 1 m; 0: exact
    position_sd_m: float = 0.01
    speed_sd: float = 0.01  # prior sd of the speed of sound, relative, 0 to 0.2; 0: exact
    # known: pressures are absolute. common, source, pair: one unknown complex gain for all, for
    # each source or for each pair. spectrum: one for each source and frequency; pair-spectrum:
    # that, and one for each pair
    gain: GainMode = "known"
    delay_sd_s: float = 0.0  # prior sd of the time of emission, 0 to 0.1 s; 0: exact
    delay: DelayMode = "source"  # one time for each source, or one for each pair

    def __post_init__(self) -> None:
        for name, high in (("position_sd_m", 1.0), ("speed_sd", 0.2), ("delay_sd_s", 0.1)):
            check_range(name, getattr(self, name), 0.0, high)
        check_known("unknown kind of gain", self.gain, get_args(GainMode))
        check_known("unknown kind of delay", self.delay, get_args(DelayMode))

    @property
    def free_spectra(self) -> bool:
        """Whether each source has an unknown spectrum."""
        return self.gain in ("spectrum", "pair-spectrum")


class State(NamedTuple):
    """How positions and speed of sound differ from the specified ones."""

    source_m: FloatArray  # (n_sources, 3), shift of each position
    receiver_m: FloatArray  # (n_receivers, 3)
    speed: float  # relative change of the speed of sound


class WaveModel(NamedTuple):
    """A scene's image sources at the frequencies of a measurement."""

    scene: Scene
    frequency_hz: FloatArray  # (n_frequencies,)
    tau_s: float  # of the exponential window
    speed_m_s: float  # as specified; the laws of materials keep to it
    air_per_m: FloatArray  # (n_frequencies,), decay of pressures in the air
    paths: UnfoldedPaths  # all that the window lets through
    # (n_pairs,), behind the last of each pair's short paths, which every step of a fit weighs
    short_last: IntArray


def wave_model(scene: Scene, frequency_hz: FloatArray, tau_s: float) -> WaveModel:
    """Return the model of a scene behind an exponential window."""
    check_cost(scene, len(frequency_hz), tau_s)
    f, speed = np.asarray(frequency_hz, dtype=np.float64), speed_of_sound_m_s(scene.air)
    paths = unfolded_paths(scene, _WHOLE * speed * tau_s)
    far = np.linalg.norm(paths.vector_m, axis=1) > _SHORT * speed * tau_s
    last = [a + int(np.searchsorted(far[a:b], True)) for a, b in pairwise(paths.pair_first)]
    air = pressure_decay_per_m(scene.air, f)
    return WaveModel(scene, f, float(tau_s), speed, air, paths, np.array(last, dtype=np.int64))


def at_frequencies(model: WaveModel, chosen: IntArray) -> WaveModel:
    """Return the model at some of its frequencies."""
    f, air = model.frequency_hz[chosen], model.air_per_m[chosen]
    return model._replace(frequency_hz=f, air_per_m=air)


def at_rest(model: WaveModel) -> State:
    """Return the state in which all is as specified."""
    scene = model.scene
    return State(np.zeros((len(scene.sources), 3)), np.zeros((len(scene.receivers), 3)), 0.0)


def wavenumber_per_m(model: WaveModel, state: State) -> ComplexArray:
    """Return ``2 pi (f - j / (2 pi tau)) / c - j a``, a the decay in the air."""
    f = model.frequency_hz - 0.5j / (np.pi * model.tau_s)
    return np.asarray(
        2.0 * np.pi * f / (model.speed_m_s * (1.0 + state.speed)) - 1j * model.air_per_m
    )


def moved_vectors_m(model: WaveModel, state: State) -> FloatArray:
    """Return every path's vector with sources and receivers moved, (n_paths, 3)."""
    paths = model.paths
    pair = np.repeat(np.arange(len(paths.pair_first) - 1), np.diff(paths.pair_first))
    source, receiver = model.scene.pairs[pair].T
    moved = np.einsum("pij,pj->pi", paths.image_transform, state.source_m[source])
    return np.asarray(paths.vector_m + state.receiver_m[receiver] - moved)


# Of paths times frequencies that are weighed together: 16 MB.
_TOGETHER = 1_000_000


def predicted_pressure(
    model: WaveModel, r0: ComplexArray, state: State, *, spherical: bool = True, short: bool = False
) -> ComplexArray:
    """Return the damped spectra of all pairs, of all images or of the short paths alone.

    ``sum exp(-j k r) / (4 pi r) prod R``. Shapes: `r0` (n_materials, n_frequencies); the result
    (n_pairs, n_frequencies).
    """
    paths, k = model.paths, wavenumber_per_m(model, state)
    vectors_m, counts = moved_vectors_m(model, state), np.diff(paths.bounce_first)
    step = max(_TOGETHER // len(k), 1)
    out = np.zeros((len(model.scene.pairs), len(k)), dtype=np.complex128)
    lasts = model.short_last if short else paths.pair_first[1:]
    for pair, (first, last) in enumerate(zip(paths.pair_first[:-1], lasts, strict=True)):
        for begin in range(first, last, step):
            own = slice(begin, min(begin + step, last))
            length_m = np.linalg.norm(vectors_m[own], axis=1)[:, None]
            value = np.exp(-1j * k * length_m) / (4.0 * np.pi * length_m)
            for n in range(counts[own].max(initial=0)):
                some = np.flatnonzero(counts[own] > n)
                bounce, far = paths.bounce_first[own][some] + n, length_m[some]
                cosine = np.sum(vectors_m[own][some] * paths.normal[bounce], axis=1)[:, None]
                cosine = np.minimum(np.abs(cosine) / far, 1.0)
                wall, times = r0[paths.material[bounce]], paths.hits[bounce]
                if spherical:
                    reflection = spherical_reflection(wall, cosine, k, far)
                else:
                    reflection = plane_reflection(wall, cosine)
                for hit in range(times.max()):
                    again = times > hit
                    value[some[again]] *= reflection[again]
            out[pair] += value.sum(axis=0)
    return out


def gradients(
    model: WaveModel, r0: ComplexArray, state: State
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Return pressures of short paths with plane waves at the walls, and their derivatives.

    By R0, source, receiver, see `pressure_gradients`, and the relative change of the speed of
    sound, (n_pairs, n_frequencies).
    """
    paths, k = model.paths, wavenumber_per_m(model, state)
    p, by_r0, by_source, by_receiver, by_k = pressure_gradients(
        paths.pair_first,
        model.short_last,
        moved_vectors_m(model, state),
        paths.image_transform,
        paths.bounce_first,
        paths.material,
        paths.normal,
        paths.hits,
        k,
        np.ascontiguousarray(r0, dtype=np.complex128),
    )
    k_by_speed = -(k + 1j * model.air_per_m) / (1.0 + state.speed)
    return p, by_r0, by_source, by_receiver, by_k * k_by_speed


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
