"""Image sources with phase as a model of a measured room: its paths, its cost, its uncertainties.

A path is kept with the product of its reflections, so that sources and receivers can be moved
without another search; the pressures of all paths are weighed by `roomfit.impedance.wave_kernels`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from roomfit.base.air import pressure_decay_per_m, speed_of_sound_m_s
from roomfit.base.arguments import check_known, check_range, read_only
from roomfit.base.errors import InputError
from roomfit.base.typing import ComplexArray, FloatArray, IntArray
from roomfit.impedance.wave_kernels import pressure_gradients, pressures
from roomfit.room.mesh import area_vectors_m2, mean_free_path_m, volume_m3
from roomfit.room.scene import Room, Scene, distances_m, triangle_material
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
# Of a fixed point that each step brings at least four times as near.
_STEPS = 6
# In rooms of so few triangles the search is never what costs.
_FEW_TRIANGLES = 60
# No order of reflections can be reached within any length worth the name.
_ANY_ORDER = 10_000

# Lengths of paths in units of c tau: beyond the first lies 1e-3 of the damped field, even between
# walls that absorb nothing; up to the second, paths are weighed anew at every step of a fit.
_WHOLE = 7.0
_SHORT = 4.0


def check_cost(scene: Scene, n_frequencies: int, tau_s: float, lengths: float) -> None:
    """Refuse a model whose paths are too many to be weighed, or to be found, within minutes.

    `lengths`: longest path in units of the speed of sound times `tau_s`.
    """
    reflections = _reflections_to_weigh(scene, n_frequencies, lengths * tau_s)
    if reflections > MOST_REFLECTIONS:
        affordable_s = tau_s
        for _ in range(_STEPS):
            count = _reflections_to_weigh(scene, n_frequencies, lengths * affordable_s)
            affordable_s *= (MOST_REFLECTIONS / count) ** 0.25
        found = f"{reflections:.2g} reflections times frequencies"
        raise _too_costly(tau_s, affordable_s, found, "fewer frequencies")
    mesh = scene.room.mesh
    if len(mesh.triangles) <= _FEW_TRIANGLES:
        return
    work = MOST_WORK / max(len(np.unique(scene.pairs[:, 0])), 1)
    affordable_s = affordable_duration_s(scene, lengths * tau_s, work=work, images=1e6) / lengths
    # what is asked for comes back as it is, up to rounding
    if affordable_s < 0.999 * tau_s:
        found = f"a room of {len(mesh.triangles)} triangles"
        raise _too_costly(tau_s, affordable_s, found, "a room of fewer walls")


def _reflections_to_weigh(scene: Scene, n_frequencies: int, longest_s: float) -> float:
    """Return about how many reflections all pairs have up to a duration, times frequencies."""
    mesh = scene.room.mesh
    length_m = longest_s * speed_of_sound_m_s(scene.air)
    images = expected_images(abs(volume_m3(mesh)), length_m)
    # paths that long, and three quarters of it on average
    hits = 1.0 + 0.75 * length_m / abs(mean_free_path_m(mesh))
    return images * hits * len(scene.pairs) * n_frequencies


def _too_costly(tau_s: float, affordable_s: float, found: str, else_try: str) -> InputError:
    longest_ms = math.floor(affordable_s * 1e4) / 10.0
    return InputError(
        "the exponential window lets more reflections through than can be weighed in minutes",
        found=f"tau = {1000.0 * tau_s:g} ms, {found}",
        needed=f"tau of at most {longest_ms:g} ms here",
        hint=f"choose a shorter window, or {else_try}",
    )


@dataclass(frozen=True, slots=True, eq=False)
class UnfoldedPaths:
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

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            read_only(getattr(self, name))


def unfolded_paths(scene: Scene, longest_m: float) -> UnfoldedPaths:
    """Return all specular paths of every pair up to a length.

    In a room that is no box, only images that are visible from the receiver.
    """
    distances = distances_m(scene)
    if distances.size and distances.min() < 1e-6:
        source, receiver = scene.pairs[int(np.argmin(distances))]
        raise InputError(
            "a source stands where a receiver is",
            where=f"{scene.sources[source].name} and {scene.receivers[receiver].name}",
            found="less than a micrometre apart",
            needed="two places",
            hint="correct one of the two positions",
        )
    if scene.room.shoebox_m is None:
        return _joined(_polyhedron_paths(scene, longest_m))
    ends = [(scene.sources[s].position_m, scene.receivers[r].position_m) for s, r in scene.pairs]
    return _joined([_box_paths(scene.room, *pair, longest_m) for pair in ends])


def _box_paths(
    room: Room, source_m: FloatArray, receiver_m: FloatArray, longest_m: float
) -> UnfoldedPaths:
    """Return the paths of one pair, in which hits on one wall, all at one angle, are one bounce."""
    lengths = np.array(room.shoebox_m, dtype=np.float64)
    index, vector = images_within(lengths, source_m, receiver_m, _ANY_ORDER, longest_m)
    near = np.argsort(np.linalg.norm(vector, axis=1), kind="stable")
    index, vector = index[near], vector[near]
    turned = np.where(index % 2 == 0, 1.0, -1.0)
    hits = np.column_stack([wall_hits(index, wall) for wall in range(6)])
    path, wall = np.nonzero(hits)
    bounces = np.bincount(path, minlength=len(vector))
    return UnfoldedPaths(
        np.array([0, len(vector)]),
        vector,
        np.asarray(turned[:, :, None] * np.eye(3)),
        np.concatenate(([0], np.cumsum(bounces))),
        np.asarray(room.surface_material[wall], dtype=np.int64),
        np.eye(3)[wall // 2],
        hits[path, wall].astype(np.int64),
    )


def _polyhedron_paths(scene: Scene, longest_m: float) -> list[UnfoldedPaths]:
    """Return the paths of every pair, searched for once a source."""
    reflectors = reflectors_of(scene.room)
    parts: dict[int, UnfoldedPaths] = {}
    for s in np.unique(scene.pairs[:, 0]):
        own = np.flatnonzero(scene.pairs[:, 0] == s)
        found = images_of_source(
            scene,
            reflectors,
            limits_of(_ANY_ORDER, longest_m),
            int(s),
            with_image_transforms=True,
            with_triangles=True,
        )
        parts.update(
            (int(i), _paths_of_images(scene.room, f)) for i, f in zip(own, found, strict=True)
        )
    return [parts[i] for i in range(len(scene.pairs))]


def _paths_of_images(room: Room, images: ImageSet) -> UnfoldedPaths:
    first, triangle, transform = images.first_hit, images.triangle, images.image_transform
    if first is None or triangle is None or transform is None:
        raise ValueError("images without their hits or image transforms")
    vectors = area_vectors_m2(room.mesh)[triangle]
    normals = unfolded_normals(vectors / np.linalg.norm(vectors, axis=1)[:, None], first)
    return UnfoldedPaths(
        np.array([0, len(transform)]),
        images.length_m[:, None] * images.arrival,
        transform,
        np.asarray(first, dtype=np.int64),
        np.asarray(triangle_material(room)[triangle], dtype=np.int64),
        normals,
        np.ones(len(normals), dtype=np.int64),
    )


def _joined(parts: list[UnfoldedPaths]) -> UnfoldedPaths:
    bounces = np.concatenate([np.diff(p.bounce_first) for p in parts])
    return UnfoldedPaths(
        np.concatenate(([0], np.cumsum([len(p.vector_m) for p in parts]))),
        np.concatenate([p.vector_m for p in parts]),
        np.concatenate([p.image_transform for p in parts]),
        np.concatenate(([0], np.cumsum(bounces))),
        np.concatenate([p.material for p in parts]),
        np.concatenate([p.normal for p in parts]),
        np.concatenate([p.hits for p in parts]),
    )


def _shortened(paths: UnfoldedPaths, longest_m: float) -> UnfoldedPaths:
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


GainMode = Literal["known", "common", "source", "pair", "spectrum", "pair-spectrum"]
DelayMode = Literal["source", "pair"]


@dataclass(frozen=True, slots=True)
class Nuisances:
    """What may be wrong about a measurement, and is estimated together with the walls.

    Parameters
    ----------
    position_sd_m : float
        Prior standard deviation of every coordinate for which the scene specifies none, 0 to 1 m;
        0 takes them as exact.
    speed_sd : float
        Prior standard deviation of the speed of sound, relative, 0 to 0.2; 0 takes it as exact.
    gain : {"known", "common", "source", "pair", "spectrum", "pair-spectrum"}
        known: pressures are absolute. common, source, pair: one unknown complex gain for all, for
        each source or for each pair. spectrum: one for each source and frequency; pair-spectrum:
        that, and one for each pair.
    delay_sd_s : float
        Prior standard deviation of the time of emission, 0 to 0.1 s; 0 takes it as exact.
    delay : {"source", "pair"}
        One time for each source, or one for each pair, as of files that were cut one by one.
    least_position_sd_m : float
        Coordinates that the scene specifies more exactly are given this standard deviation, 0 to
        1 m.

    Raises
    ------
    InputError
        A number out of its range, or an unknown kind of gain or delay.

    Examples
    --------
    Loudspeakers of unknown spectra at well-known positions.

    >>> Nuisances(position_sd_m=0.002, gain="spectrum").speed_sd
    0.01
    """

    position_sd_m: float = 0.01
    speed_sd: float = 0.01
    gain: GainMode = "known"
    delay_sd_s: float = 0.0
    delay: DelayMode = "source"
    least_position_sd_m: float = 0.0

    def __post_init__(self) -> None:
        for name, high in (
            ("position_sd_m", 1.0),
            ("speed_sd", 0.2),
            ("delay_sd_s", 0.1),
            ("least_position_sd_m", 1.0),
        ):
            check_range(name, getattr(self, name), 0.0, high)
        check_known("unknown kind of gain", self.gain, get_args(GainMode))
        check_known("unknown kind of delay", self.delay, get_args(DelayMode))


def has_free_spectra(nuisances: Nuisances) -> bool:
    """Whether each source has an unknown spectrum."""
    return nuisances.gain in ("spectrum", "pair-spectrum")


class State(NamedTuple):
    """How positions and speed of sound differ from the specified ones."""

    source_m: FloatArray  # (n_sources, 3), shift of each position
    receiver_m: FloatArray  # (n_receivers, 3)
    speed: float  # relative change of the speed of sound


@dataclass(frozen=True, slots=True, eq=False)
class WaveModel:
    """A scene's image sources at the frequencies of a measurement."""

    scene: Scene
    frequency_hz: FloatArray  # (n_frequencies,)
    tau_s: float  # of the exponential window
    speed_m_s: float  # as specified; the laws of materials keep to it
    air_per_m: FloatArray  # (n_frequencies,), decay of pressures in the air
    whole: UnfoldedPaths  # all that the window lets through
    short: UnfoldedPaths  # those that every step of a fit weighs


def wave_model(scene: Scene, frequency_hz: FloatArray, tau_s: float) -> WaveModel:
    """Return the model of a scene behind an exponential window."""
    check_cost(scene, len(frequency_hz), tau_s, _WHOLE)
    bare = model_without_paths(scene, frequency_hz, tau_s)
    whole = unfolded_paths(scene, _WHOLE * bare.speed_m_s * tau_s)
    return replace(bare, whole=whole, short=_shortened(whole, _SHORT * bare.speed_m_s * tau_s))


def model_without_paths(scene: Scene, frequency_hz: FloatArray, tau_s: float) -> WaveModel:
    """Return a model without paths: enough to ask whether the data can determine the unknowns."""
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
    """Return the state in which all is as specified."""
    scene = model.scene
    return State(np.zeros((len(scene.sources), 3)), np.zeros((len(scene.receivers), 3)), 0.0)


def wavenumber_per_m(model: WaveModel, state: State) -> ComplexArray:
    """Return ``2 pi (f - j / (2 pi tau)) / c - j a``, a the decay in the air."""
    f = model.frequency_hz - 0.5j / (np.pi * model.tau_s)
    return np.asarray(
        2.0 * np.pi * f / (model.speed_m_s * (1.0 + state.speed)) - 1j * model.air_per_m
    )


def moved_vectors_m(model: WaveModel, paths: UnfoldedPaths, state: State) -> FloatArray:
    """Return every path's vector with sources and receivers moved, (n_paths, 3)."""
    pair = np.repeat(np.arange(len(paths.pair_first) - 1), np.diff(paths.pair_first))
    source, receiver = model.scene.pairs[pair].T
    moved = np.einsum("pij,pj->pi", paths.image_transform, state.source_m[source])
    return np.asarray(paths.vector_m + state.receiver_m[receiver] - moved)


def predicted_pressure(
    model: WaveModel, r0: ComplexArray, state: State, *, spherical: bool = True
) -> ComplexArray:
    """Return the damped spectra of all pairs with all images, shape (n_pairs, n_frequencies).

    Shapes: `r0` (n_materials, n_frequencies).
    """
    return _pressure(model, model.whole, r0, state, spherical=spherical)


def frozen_correction(
    model: WaveModel, r0: ComplexArray, state: State, *, spherical: bool = True
) -> ComplexArray:
    """Return all images with spherical waves minus the short paths with plane waves."""
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
    """Pressures of short paths with plane waves at the walls, and their derivatives."""

    pressure: ComplexArray  # (n_pairs, n_frequencies)
    by_r0: ComplexArray  # (n_pairs, n_materials, n_frequencies)
    by_source: ComplexArray  # (n_pairs, 3, n_frequencies), 1/m times the pressure
    by_receiver: ComplexArray  # likewise
    by_speed: ComplexArray  # (n_pairs, n_frequencies), by the relative change of the speed


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
