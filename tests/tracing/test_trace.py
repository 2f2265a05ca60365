"""Images and rays against each other: the same energies, nothing twice, nothing lost.

Every comparison with rays allows five standard errors, given by 32 independent batches. Student's t
of 31 degrees of freedom passes that once in 48,000 draws; with the 100 or so compared here a new
seed fails about once in 500.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from images_reference import (
    BOX_MATERIALS,
    SPEED_M_S,
    box_room,
    box_with_sheet,
    l_shaped_room,
    scene_of,
)
from rays_reference import monte_carlo_sd, with_scattering
from roomfit.base.errors import InputError
from roomfit.base.findings import Code
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import uniform_scattering
from roomfit.model.weighing import energy_rows, weigh
from roomfit.paper.room import paper_scene
from roomfit.room.inside import nearest_triangles
from roomfit.room.mesh import Mesh
from roomfit.room.scene import Room, Scene
from roomfit.tracing.image_sources import trace_images
from roomfit.tracing.paths import Paths, TraceSettings, select
from roomfit.tracing.rays import Trace, trace_rays
from roomfit.tracing.trace import fitting_radii_m, trace

ERRORS_ALLOWED = 5.0
BATCHES = 32
NO_AIR = np.zeros(1)
PLACES = ([[1.2, 1.5, 1.1]], [[4.1, 2.9, 1.2]])
EDGES_S = np.arange(6.0, 70.0, 8.0) / 1e3


def settings(n_rays: int, image_order: int, radius_m: float = 0.3, seed: int = 1) -> TraceSettings:
    """Return settings of a trace of 0.1 s."""
    return TraceSettings(
        0.1,
        n_rays=n_rays,
        image_order=image_order,
        receiver_radius_m=radius_m,
        n_batches=BATCHES,
        seed=seed,
    )


def traced(scene: Scene, n_rays: int, image_order: int, s: float = 0.0, seed: int = 1) -> Trace:
    """Trace with the same scattering everywhere."""
    scattering = uniform_scattering(scene.room.materials, s)
    return trace(scene, settings(n_rays, image_order, seed=seed), scattering)


def energies(
    paths: Paths, a: FloatArray, edges_s: FloatArray = EDGES_S, pair: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return window energies of one pair in one band and their standard errors."""
    rows = energy_rows(paths, pair, edges_s, SPEED_M_S)
    energy = weigh(rows, a[:, None], NO_AIR)[0]
    return energy, monte_carlo_sd(rows, a[:, None], NO_AIR)[0]


def smeared(distance_m: FloatArray, radius_m: float, low_m: float, high_m: float) -> FloatArray:
    """Return what an image at each distance brings to a sphere in a window of path length.

    A share du / 2 of the rays leaves at u = cos(angle to the centre). Such a ray is inside the
    sphere for 2 sqrt(a**2 - r**2 + (r u)**2) and is heard at length L = r u; the sphere counts
    chord over volume V:

        E = 1 / (r V) * integral of sqrt(L**2 - k**2) dL, k**2 = r**2 - a**2,

    over the part of [k, r] in the window. Over all of it this is the mean of 1 / (4 pi rho**2).
    """
    r = distance_m
    k = np.sqrt(r**2 - radius_m**2)
    start, stop = np.clip(low_m, k, r), np.clip(high_m, k, r)

    def primitive(length: FloatArray) -> FloatArray:
        root = np.sqrt(np.maximum(length**2 - k**2, 0.0))
        return np.asarray(0.5 * (length * root - k**2 * np.log(length + root)))

    volume = 4.0 / 3.0 * np.pi * radius_m**3
    return np.asarray((primitive(stop) - primitive(start)) / (r * volume))


def test_the_smeared_energy_is_the_mean_over_the_sphere() -> None:
    """Against random points of the sphere; and far away it is 1 / (4 pi r**2)."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.8, 0.8, (400_000, 3))
    points = points[np.linalg.norm(points, axis=1) <= 0.8]
    spread = 1.0 / (4.0 * np.pi * np.sum((points - [2.0, 0.0, 0.0]) ** 2, axis=1))
    whole = smeared(np.array([2.0]), 0.8, 0.0, 10.0)[0]
    # mean of 200,000 points with a spread of half their mean: error 0.1 %
    assert whole == pytest.approx(np.mean(spread), rel=0.005)
    far = smeared(np.array([100.0]), 0.5, 0.0, 200.0)[0]
    assert far == pytest.approx(1.0 / (4.0 * np.pi * 100.0**2), rel=1e-5)


@pytest.mark.parametrize("radius_m", [0.3, 0.8])
def test_rays_in_a_box_bring_the_smeared_energies_of_the_images(radius_m: float) -> None:
    """Six different walls, windows of 5 ms, all of 0.1 s: 18 of them within five errors.

    Of 200 other seeds the worst window was off by 3.7 errors and the mean of all by 0.003.
    """
    room = box_room()
    scene = scene_of(room, *PLACES)
    a = np.array([0.1, 0.3, 0.2, 0.4, 0.5, 0.05])
    still = uniform_scattering(room.materials, 0.0)
    rays = trace_rays(scene, settings(120_000, -1, radius_m), still).paths
    # from the direct sound on, up to the last millisecond
    edges = np.arange(9.0, 100.0, 5.0) / 1e3
    energy, error = energies(rays, a, edges)
    images = trace_images(scene, 200, 0.11, still)
    left = np.prod((1.0 - a) ** images.hits_specular, axis=1)
    expected = [
        np.sum(left * smeared(images.length_m, radius_m, *(SPEED_M_S * edges[w : w + 2])))
        for w in range(len(edges) - 1)
    ]
    z = (energy - np.array(expected)) / error
    assert np.max(np.abs(z)) < ERRORS_ALLOWED
    # were the errors reported too large, z would be too small to notice a fault
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.7
    # 1 % of standard error for the smaller sphere
    assert np.sum(energy) == pytest.approx(np.sum(expected), rel=0.04)


@pytest.mark.parametrize(("name", "radius_m"), [("gabled", 0.15), ("L", 0.1), ("sheet", 0.06)])
def test_rays_bring_what_polyhedral_images_bring_order_by_order(name: str, radius_m: float) -> None:
    """Four receivers in the paper's room and two harder ones, orders 0 to 4 apart.

    Small spheres, clear of walls and sheets, so that few images are seen from part of one only.
    """
    rooms = {"gabled": paper_scene().room, "L": l_shaped_room(), "sheet": box_with_sheet()}
    room = rooms[name]
    size = {"gabled": (15.64, 10.7, 2.8), "L": (6.0, 2.0, 2.5), "sheet": (4.0, 3.0, 2.5)}[name]
    points = np.array(size) * np.random.default_rng(3).uniform(0.1, 0.9, (40, 3))
    source, *receivers = points[nearest_triangles(room.mesh, points)[0] > 0.3][:5]
    scene = scene_of(room, [source], receivers)
    a = np.linspace(0.1, 0.6, len(room.materials))
    still = uniform_scattering(room.materials, 0.0)
    rays = trace_rays(scene, settings(200_000, -1, radius_m), still).paths
    images = trace_images(scene, 4, 0.1, still)
    left = np.prod((1.0 - a) ** images.hits_specular, axis=1)
    brought = left * smeared(images.length_m, radius_m, 0.0, 100.0)
    for order in range(5):
        of_pairs = [
            energies(_of_order(rays, order), a, np.array([0.0, 1.0]), pair) for pair in range(4)
        ]
        total = sum(energy[0] for energy, _ in of_pairs)
        error = np.sqrt(sum(e[0] ** 2 for _, e in of_pairs))
        expected = np.sum(brought[images.hits_specular.sum(axis=1) == order])
        assert abs(total - expected) < ERRORS_ALLOWED * error
        assert error < 0.1 * expected


@pytest.mark.parametrize("s", [0.0, 0.3])
def test_the_join_brings_the_energies_of_rays_alone(s: float) -> None:
    """Window by window, with images to order 3 or all from rays, with and without scattering."""
    scene = scene_of(box_room(), *PLACES)
    a = np.array([0.1, 0.3, 0.2, 0.4, 0.5, 0.05])
    alone = traced(scene, 60_000, -1, s)
    joined = traced(scene, 60_000, 3, s, seed=2)
    one, one_error = energies(alone.paths, a)
    other, other_error = energies(joined.paths, a)
    assert np.all(np.abs(one - other) < ERRORS_ALLOWED * np.hypot(one_error, other_error))
    # the first window holds direct sound and first reflections: there the join has less noise
    assert other_error[0] <= (0.0 if s == 0.0 else 0.8) * one_error[0]


def test_without_scattering_the_join_brings_the_energies_of_images_alone() -> None:
    """Images of all orders against images to order 3 and rays: exact early, in the mean late."""
    scene = scene_of(box_room(), *PLACES)
    a = np.array([0.1, 0.3, 0.2, 0.4, 0.5, 0.05])
    exact, no_error = energies(traced(scene, 0, 100).paths, a)
    joined, error = energies(traced(scene, 60_000, 3).paths, a)
    assert not no_error.any()
    late = error > 0.0
    np.testing.assert_allclose(joined[~late], exact[~late], rtol=1e-12)
    assert late.any() and not late.all()
    # smearing moves energy across the edges of windows: 0.3 m / (8 ms c) of a window at most, and
    # only what differs between neighbours
    assert np.all(np.abs(joined - exact)[late] < ERRORS_ALLOWED * error[late] + 0.02 * exact[late])


def test_each_path_is_either_an_image_or_a_ray_that_no_image_stands_for() -> None:
    """Image paths: specular, to the order. Rays: more hits, or a diffuse one."""
    paths = traced(scene_of(box_room(), *PLACES), 5000, 2, s=0.3).paths
    n_specular, n_diffuse = paths.hits_specular.sum(axis=1), paths.hits_diffuse.sum(axis=1)
    image = paths.batch < 0
    assert np.all(n_diffuse[image] == 0)
    assert sorted(n_specular[image].tolist()) == [0] + [1] * 6 + [2] * 18
    assert np.all((n_diffuse > 0) | (n_specular > 2) | image)
    assert paths.n_batches == BATCHES


def test_images_only_and_rays_only_are_what_they_say() -> None:
    """And neither of them is refused."""
    scene = scene_of(box_room(), *PLACES)
    assert np.all(traced(scene, 0, 2).paths.batch == -1)
    assert np.all(traced(scene, 1000, -1).paths.batch >= 0)
    with pytest.raises(InputError, match="nothing to trace"):
        traced(scene, 0, -1)


def test_paths_weighed_for_another_scattering_bring_the_energies_of_a_trace_with_it() -> None:
    """Traced at 0.4 and weighed for 0.2 against traced at 0.2, images and rays together."""
    scene = scene_of(box_room(), *PLACES)
    a = np.array([0.1, 0.3, 0.2, 0.4, 0.5, 0.05])
    wanted = uniform_scattering(BOX_MATERIALS, 0.2)
    other = with_scattering(traced(scene, 60_000, 3, s=0.4, seed=3).paths, wanted)
    one, one_error = energies(traced(scene, 60_000, 3, s=0.2).paths, a)
    two, two_error = energies(other, a)
    assert np.all(np.abs(one - two) < ERRORS_ALLOWED * np.hypot(one_error, two_error))
    # the image paths are exact either way
    direct, _ = energies(select(other, other.batch < 0), a)
    expected, _ = energies(trace_images(scene, 3, 0.1, wanted), a)
    np.testing.assert_allclose(direct, expected, rtol=1e-12)


@pytest.mark.parametrize("s", [0.0, 0.4])
def test_source_and_receiver_may_change_places(s: float) -> None:
    """Reciprocity of the whole join, within the errors of both."""
    room = l_shaped_room()
    a = np.linspace(0.05, 0.4, 8)
    there = scene_of(room, [[5.2, 1.1, 1.3]], [[1.3, 4.1, 0.9]])
    back = scene_of(room, [[1.3, 4.1, 0.9]], [[5.2, 1.1, 1.3]])
    one, one_error = energies(traced(there, 40_000, 2, s).paths, a)
    other, other_error = energies(traced(back, 40_000, 2, s, seed=2).paths, a)
    assert np.all(np.abs(one - other) <= ERRORS_ALLOWED * np.hypot(one_error, other_error) + 1e-12)


def test_splitting_a_material_changes_nothing() -> None:
    """Six materials or one for the whole box, the same seed: the same paths, hits summed."""
    six = scene_of(box_room(), *PLACES)
    room = six.room
    one = scene_of(Room(room.mesh, ("all",), np.zeros(6, np.int32), room.shoebox_m), *PLACES)
    split, whole = traced(six, 3000, 2, s=0.3).paths, traced(one, 3000, 2, s=0.3).paths
    np.testing.assert_array_equal(split.length_m, whole.length_m)
    np.testing.assert_array_equal(split.hits_specular.sum(axis=1), whole.hits_specular[:, 0])
    np.testing.assert_array_equal(split.hits_diffuse.sum(axis=1), whole.hits_diffuse[:, 0])
    np.testing.assert_allclose(split.weight_per_m2, whole.weight_per_m2, rtol=1e-14)


def test_a_sphere_that_a_wall_or_a_source_would_cut_is_shrunk_with_a_finding() -> None:
    """One receiver 0.2 m from the floor, one 0.25 m from its source, one with room enough."""
    receivers = [[4.1, 2.9, 0.2], [1.2, 1.5, 1.35], [3.0, 2.0, 1.4]]
    scene = scene_of(box_room(), PLACES[0], receivers)
    radii, findings = fitting_radii_m(scene, 0.5)
    np.testing.assert_allclose(radii, [0.2, 0.25, 0.5], rtol=2e-3)
    assert np.all(radii[:2] < [0.2, 0.25])
    assert [f.code for f in findings] == [Code.RECEIVER_SPHERE_SHRUNK] * 2
    assert "R0" in findings[0].sentence and "wall" in findings[0].sentence
    assert "R1" in findings[1].sentence and "source" in findings[1].sentence
    # a receiver that no pair uses is left alone
    unpaired = scene_of(box_room(), PLACES[0], receivers, [(0, 2)])
    assert fitting_radii_m(unpaired, 0.5)[1] == ()


def test_rays_near_a_wall_still_bring_the_direct_sound() -> None:
    """Its shrunken sphere lies in the air as a whole: 1 / (4 pi r**2) within five errors."""
    scene = scene_of(box_room(), [[3.0, 2.0, 1.5]], [[3.6, 2.1, 0.15]])
    black = np.ones(6)
    result = traced(scene, 60_000, -1)
    assert [f.code for f in result.findings] == [Code.RECEIVER_SPHERE_SHRUNK]
    energy, error = energies(result.paths, black, np.array([0.0, 0.1]))
    distance = np.linalg.norm([0.6, 0.1, 1.35])
    expected = smeared(np.array([distance]), 0.15 * 0.999, 0.0, 10.0)[0]
    assert abs(energy[0] - expected) < ERRORS_ALLOWED * error[0]


def test_a_receiver_in_a_wall_is_refused() -> None:
    """A sphere of a millimetre would catch nothing."""
    scene = scene_of(box_room(), PLACES[0], [[4.1, 2.9, 0.001]])
    with pytest.raises(InputError, match="a receiver stands in a wall"):
        traced(scene, 100, 0)


def test_a_leak_is_reported() -> None:
    """A box without its ceiling loses rays, and says how many and where."""
    full = box_room()
    mesh = full.mesh
    kept = mesh.triangle_surface != 5
    open_mesh = Mesh(
        mesh.vertices_m, mesh.triangles[kept], mesh.triangle_surface[kept], mesh.surfaces
    )
    scene = scene_of(Room(open_mesh, BOX_MATERIALS, np.arange(6)), *PLACES)
    findings = traced(scene, 1000, 1).findings
    assert [(f.code, f.severity) for f in findings] == [(Code.RAYS_ESCAPED, "serious")]
    assert findings[0].evidence["n_escaped"] > 500


def _of_order(paths: Paths, order: int) -> Paths:
    return select(paths, paths.hits_specular.sum(axis=1, dtype=np.int64) == order)


def test_images_may_end_at_a_time_and_rays_go_on_from_there():
    """Every window within 4.5 standard errors: one false alarm in 20,000 rooms."""
    scene = scene_of(box_room(), *PLACES)
    exact = trace(scene, settings(0, 1000), uniform_scattering(scene.room.materials, 0.0))
    chosen = replace(settings(40_000, 1000), image_until_s=0.03)
    mixed = trace(scene, chosen, uniform_scattering(scene.room.materials, 0.0))
    images = mixed.paths.batch < 0
    assert 0 < np.count_nonzero(images) < len(exact.paths)
    assert mixed.paths.length_m[images].max() < 0.03 * SPEED_M_S
    assert mixed.paths.length_m[~images].min() >= 0.03 * SPEED_M_S
    a = np.full(len(scene.room.materials), 0.3)
    edges = np.array([0.006, 0.027, 0.033, 0.05, 0.07])
    expected, _ = energies(exact.paths, a, edges)
    found, sd = energies(mixed.paths, a, edges)
    assert np.all(np.abs(found - expected) <= 4.5 * sd + 1e-3 * expected)
