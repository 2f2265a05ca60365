"""Against another program, pyroomacoustics 0.10: its image sources and its ray tracer.

It counts an image of amplitude ``d / (4 pi r)`` where ours has energy ``d**2 / (4 pi r**2)``, and
its ray tracer is scaled so that a histogram sums to ``d**2 / r**2``: each ray that meets a sphere
brings 2 / n_rays over ``r**2 (1 - sqrt(1 - a**2 / r**2))``, and half that bracket is the share of
rays that do (libroom_src/room.cpp, simul_ray). One constant factor, 4 pi, therefore holds for both.
It computes in single precision. Speed of sound and air are set here, because its own differ.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from boxes_in_space import box_with_doors, room_with_doors, rotation
from images_reference import BOX_M, BOX_MATERIALS, SPEED_M_S, box_room, l_shaped_room, scene_of
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import uniform_scattering
from roomfit.model.weighing import energy_rows, weigh
from roomfit.paper.room import paper_scene
from roomfit.room.mesh import corners_m
from roomfit.room.scene import Room, Scene, triangle_material
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.lattice import lattice_of
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.trace import trace

pra = pytest.importorskip("pyroomacoustics")

SOURCE, RECEIVER = [1.2, 1.5, 1.1], [4.1, 2.9, 1.2]
ABSORPTION = np.array([0.1, 0.3, 0.2, 0.4, 0.5, 0.15])
# Coordinates of 30 m in single precision, mirrored in oblique planes four times.
SINGLE_PRECISION_M = 2e-4
TENTHS_OF_DB = 10.0 ** (0.2 / 10.0) - 1.0


def total_energy(paths: Paths, a: FloatArray) -> float:
    """Return the energy of pair 0 at all times, no air."""
    rows = energy_rows(paths, 0, np.array([0.0, 100.0]), SPEED_M_S)
    return float(weigh(rows, a[:, None], np.zeros(1))[0, 0])


def their_box(a: FloatArray, **options: Any) -> Any:
    """Return the same box with source and receiver in it."""
    materials = {name: pra.Material(float(x)) for name, x in zip(BOX_MATERIALS, a, strict=True)}
    room = pra.ShoeBox(list(BOX_M), fs=16000, materials=materials, air_absorption=False, **options)
    return _with_points(room)


def their_images(room: Any, scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Return distance and energy left of every image that its receiver sees, nearest first."""
    room.image_source_model()
    source = room.sources[0]
    observed = np.asarray(room.visibility[0][0]).astype(bool)
    receiver = scene.receivers[0].position_m
    distance = np.linalg.norm(source.images[:, observed].T - receiver, axis=1)
    order = np.argsort(distance)
    return distance[order], np.asarray(source.damping[0, observed] ** 2)[order]


def test_the_box_has_their_images() -> None:
    """Every distance and every remaining energy up to order 10, and their sum."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    still = uniform_scattering(BOX_MATERIALS, 0.0)
    paths = trace_images(scene, 10, 1.0, still)
    distance, left = their_images(their_box(ABSORPTION, max_order=10), scene)
    np.testing.assert_allclose(paths.length_m, distance, atol=SINGLE_PRECISION_M)
    theirs = np.sum(left / distance**2) / (4.0 * np.pi)
    assert total_energy(paths, ABSORPTION) == pytest.approx(theirs, rel=1e-5)


def test_a_room_that_is_not_convex_has_their_images() -> None:
    """Hidden ones left out alike, orders 0 to 3 round a corner and in view."""
    for source in ([5.2, 1.1, 1.3], [1.0, 1.0, 1.2]):
        scene = scene_of(l_shaped_room(), [source], [[1.3, 4.1, 0.9]])
        paths = trace_images(scene, 3, 1.0, uniform_scattering(scene.room.materials, 0.0))
        outline = np.array([[0, 0], [6, 0], [6, 2], [3, 2], [3, 5], [0, 5]], dtype=float).T
        material = pra.Material(0.3)
        room = pra.Room.from_corners(
            outline, fs=16000, materials=material, max_order=3, air_absorption=False
        )
        room.extrude(2.5, materials=material)
        room.add_source(source)
        room.add_microphone([1.3, 4.1, 0.9])
        distance, left = their_images(room, scene)
        np.testing.assert_allclose(paths.length_m, distance, atol=SINGLE_PRECISION_M)
        np.testing.assert_allclose(0.7 ** paths.hits_specular.sum(axis=1), left, rtol=1e-5)


def their_room(room: Room, a: FloatArray, order: int) -> Any:
    """Return a room of a wall for each triangle, so that no polygon is given twice; normals out."""
    walls = [
        pra.wall_factory(triangle.T, [a[material]], [0.0], f"triangle {i}")
        for i, (triangle, material) in enumerate(
            zip(corners_m(room.mesh), triangle_material(room), strict=True)
        )
    ]
    return pra.Room(walls, fs=16000, max_order=order, air_absorption=False)


def assert_same_images(scene: Scene, a: FloatArray, order: int) -> None:
    """Compare distance and remaining energy of every image, and their sum."""
    room = their_room(scene.room, a, order)
    room.add_source(scene.sources[0].position_m)
    room.add_microphone(scene.receivers[0].position_m)
    distance, left = their_images(room, scene)
    paths = trace_images(scene, order, 1.0, uniform_scattering(scene.room.materials, 0.0))
    np.testing.assert_allclose(paths.length_m, distance, atol=SINGLE_PRECISION_M)
    ours = np.prod((1.0 - a) ** paths.hits_specular, axis=1)
    # where two lengths are one in single precision, either may come first
    moment = np.round(paths.length_m, 2)
    sums = [np.bincount(np.unique(moment, return_inverse=True)[1], e) for e in (ours, left)]
    np.testing.assert_allclose(*sums, rtol=1e-5)
    theirs = np.sum(left / distance**2) / (4.0 * np.pi)
    assert total_energy(paths, a) == pytest.approx(theirs, rel=1e-5)


def test_the_gabled_room_has_their_images() -> None:
    """Seven planes of seven materials, orders 0 to 4."""
    full = paper_scene()
    scene = scene_of(full.room, [[9.82, 6.05, 1.7]], [[4.3, 3.1, 1.2]])
    assert_same_images(scene, np.linspace(0.1, 0.7, 7), 4)


def test_a_turned_box_with_a_door_and_a_window_has_their_images() -> None:
    """Of eight materials, orders 0 to 4: ours come from the lattice, theirs from mirrored walls."""
    turn, by_m = rotation(30.0), np.array([2.3, -1.7, 0.4])
    doors = {0: (0.21, 0.4, 0.0, 0.75), 2: (0.32, 0.66, 0.32, 0.75)}
    room = room_with_doors(box_with_doors(BOX_M, doors, turn, by_m))
    ends = [turn @ np.array(p) + by_m for p in (SOURCE, RECEIVER)]
    scene = scene_of(room, ends[:1], ends[1:])
    assert lattice_of(room) is not None
    assert_same_images(scene, np.array([0.1, 0.7, 0.3, 0.2, 0.6, 0.4, 0.5, 0.15]), 4)


@pytest.mark.parametrize("mean", [0.15, 0.5])
def test_the_total_energy_is_that_of_their_ray_tracer(mean: float) -> None:
    """Images to order 3 and rays against 100,000 of their rays: within 0.2 dB.

    Standard errors: theirs some 0.6 %, ours less; 0.2 dB is 4.7 %.
    """
    a = mean * ABSORPTION / ABSORPTION.mean()
    room = their_box(a, max_order=-1, ray_tracing=True)
    room.set_ray_tracing(
        n_rays=100_000, receiver_radius=0.3, energy_thres=1e-9, time_thres=1.0, hist_bin_size=0.004
    )
    room.image_source_model()
    room.ray_tracing()
    theirs = float(np.sum(room.rt_histograms[0][0][0])) / (4.0 * np.pi)
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    settings = TraceSettings(1.0, n_rays=20_000, image_order=3, receiver_radius_m=0.3)
    paths = trace(scene, settings, uniform_scattering(BOX_MATERIALS, 0.0)).paths
    assert total_energy(paths, a) == pytest.approx(theirs, rel=TENTHS_OF_DB)


def _with_points(room: Any) -> Any:
    room.set_sound_speed(SPEED_M_S)
    room.add_source(SOURCE)
    room.add_microphone(RECEIVER)
    return room
