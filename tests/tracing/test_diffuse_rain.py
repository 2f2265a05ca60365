"""Diffuse rain against quadrature, against spheres, and under the laws of the diffuse field.

Comparisons of Monte-Carlo sums allow five standard errors of 32 independent batches: Student's t of
31 degrees of freedom passes that once in 48,000 draws; about 40 are made here, with fixed seeds.
"""

from __future__ import annotations

import numpy as np
import pytest

from images_reference import BOX_M, SPEED_M_S, box_room, box_with_sheet, l_shaped_room, scene_of
from roomfit.base.errors import InputError
from roomfit.base.typing import BoolArray, FloatArray
from roomfit.materials.priors import uniform_scattering
from roomfit.room.scene import Scene
from roomfit.tracing.paths import Paths, TraceSettings
from roomfit.tracing.ray_kernels import spheres, towards
from roomfit.tracing.rays import expected_paths, trace_rays
from roomfit.tracing.trace import trace

BATCHES = 32
SOURCE, RECEIVER = [1.2, 1.5, 1.1], [4.1, 2.9, 1.2]


def test_a_reflection_reaches_a_receiver_by_lamberts_law_on_the_side_it_came_from() -> None:
    """Walls and directions of any slope; the normal may have either sense."""
    rng = np.random.default_rng(8)
    centre = np.array([RECEIVER, [0.5, 0.7, 2.0]])
    two = spheres(centre, np.full(2, 0.3), np.arange(2, dtype=np.int32))
    for _ in range(20):
        o, d, normal = rng.uniform(0.5, 3.0, 3), *rng.normal(size=(2, 3))
        normal /= np.linalg.norm(normal)
        inward = -np.sign(d @ normal) * normal
        way = centre[1] - o
        far = np.linalg.norm(way)
        cosine = max(way @ inward / far, 0.0)
        distance, direction, weight = towards(two, 1, tuple(o), tuple(d), tuple(normal))
        assert distance == pytest.approx(far)
        np.testing.assert_allclose(direction, way / far)
        assert weight == pytest.approx(cosine / np.pi / far**2)
    assert towards(two, 0, tuple(RECEIVER), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0))[2] == 0.0


def rays(scene: Scene, estimator: str, s: float, n_rays: int = 2**14, **more: object) -> Paths:
    """Trace 0.05 s by rays alone."""
    chosen: dict[str, object] = {"image_order": -1, "n_batches": BATCHES, "receiver_radius_m": 0.3}
    settings = TraceSettings(
        more.pop("duration_s", 0.05),  # type: ignore[arg-type]
        n_rays=n_rays,
        estimator=estimator,  # type: ignore[arg-type]
        **(chosen | more),  # type: ignore[arg-type]
    )
    return trace_rays(scene, settings, uniform_scattering(scene.room.materials, s)).paths


def energy(paths: Paths, chosen: BoolArray) -> tuple[float, float]:
    """Return the energy of some paths and its standard error over batches."""
    batches = np.bincount(paths.batch[chosen], paths.weight_per_m2[chosen], BATCHES)
    return float(batches.sum()), float(np.sqrt(BATCHES * batches.var(ddof=1)))


def agree(a: tuple[float, float], b: tuple[float, float]) -> None:
    """Two estimates lie within five standard errors of each other, and those are small."""
    assert abs(a[0] - b[0]) < 5.0 * np.hypot(a[1], b[1])
    assert np.hypot(a[1], b[1]) < 0.15 * a[0]


def first_reflection(source: FloatArray, receiver: FloatArray, n: int = 400) -> FloatArray:
    """Return the energy of one diffuse reflection at each wall of the box, by the midpoint rule.

    Integral over the wall of ``cos_s / (4 pi r_s**2)  cos_r / (pi r_r**2)``.
    """
    found = []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        u, v = (BOX_M[k] * (np.arange(n) + 0.5) / n for k in others)
        area = BOX_M[others[0]] * BOX_M[others[1]] / n**2
        for height in (0.0, BOX_M[axis]):
            points = np.empty((n, n, 3))
            points[..., axis] = height
            points[..., others[0]], points[..., others[1]] = u[:, None], v[None, :]
            share = np.ones((n, n))
            for end, solid in ((source, 4.0), (receiver, 1.0)):
                way = points - end
                r2 = (way**2).sum(axis=2)
                share *= np.abs(way[..., axis]) / np.sqrt(r2) / (solid * np.pi * r2)
            found.append(area * share.sum())
    return np.array(found)


def test_one_diffuse_reflection_brings_what_the_integral_over_the_wall_says():
    """Each of the six walls of a box by itself."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    # the larger the sphere, the less is drawn by lot
    paths = rays(scene, "rain", 1.0, 2**16, receiver_radius_m=1.0)
    expected = first_reflection(np.array(SOURCE), np.array(RECEIVER))
    once = paths.hits_diffuse.sum(axis=1) == 1
    for wall in range(6):
        found, error = energy(paths, once & (paths.hits_diffuse[:, wall] == 1))
        # the midpoint rule on 400 x 400 squares is right to 1e-5 for points 1 m off the walls
        assert abs(found - expected[wall]) < 5.0 * error + 1e-4 * expected[wall]
        assert error < 0.08 * expected[wall]


def test_rain_is_exact_in_length_and_in_direction():
    """A path of one reflection meets the point that the departing ray strikes."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    paths = rays(scene, "rain", 1.0, 512)
    once = np.flatnonzero(paths.hits_diffuse.sum(axis=1) == 1)
    departure = paths.departure[once].astype(np.float64)
    with np.errstate(divide="ignore"):
        ends = np.where(departure > 0.0, (np.array(BOX_M) - SOURCE) / departure, -np.inf)
        starts = np.where(departure < 0.0, -np.array(SOURCE) / departure, np.inf)
    flight = np.minimum(np.where(departure > 0.0, ends, np.inf), starts).min(axis=1)
    points = SOURCE + flight[:, None] * departure
    way = np.array(RECEIVER) - points
    last = np.linalg.norm(way, axis=1)
    # directions are kept in single precision: 6e-8 of some metres
    np.testing.assert_allclose(paths.length_m[once], flight + last, atol=1e-5)
    np.testing.assert_allclose(paths.arrival[once], way / last[:, None], atol=1e-5)


@pytest.mark.parametrize("s", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("room", [box_room, l_shaped_room, box_with_sheet])
def test_rain_and_spheres_bring_the_same_energy_at_every_time(room, s):
    """In rooms with and without screens, with small spheres that see almost what a point sees.

    A point and a sphere of 0.15 m differ in the mean by (0.15 m over the distance to the walls)
    squared, below 1 %, far below the errors here.
    """
    scene = scene_of(room(), [SOURCE], [[2.7, 0.9, 1.2]])
    rain = rays(scene, "rain", s, 2**15)
    caught = rays(scene, "spheres", s, 2**17, receiver_radius_m=0.15)
    for low in np.arange(0.010, 0.05, 0.02):
        parts = []
        for paths in (rain, caught):
            late = (paths.length_m >= low * SPEED_M_S) & paths.hits_diffuse.any(axis=1)
            parts.append(energy(paths, late & (paths.length_m < (low + 0.02) * SPEED_M_S)))
        agree(*parts)


def test_what_is_last_reflected_specularly_stays_with_the_spheres():
    """Its crossings are the same, bit by bit; without scattering both traces are."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    rain, caught = rays(scene, "rain", 0.0, 2000), rays(scene, "spheres", 0.0, 2000)
    np.testing.assert_array_equal(rain.weight_per_m2, caught.weight_per_m2)
    rain, caught = rays(scene, "rain", 0.3, 2000), rays(scene, "spheres", 0.3, 2000)
    kept = np.isin(rain.length_m, caught.length_m)
    pure = ~caught.hits_diffuse.any(axis=1)
    assert kept.sum() > pure.sum() > 0
    assert np.isin(caught.length_m[pure], rain.length_m).all()


def test_a_screen_lets_no_rain_through():
    """Behind a curtain: the ways from either end of a path meet the wall at the same point."""
    receiver = [2.7, 0.9, 1.2]
    scene = scene_of(box_with_sheet(), [SOURCE], [receiver])
    paths = rays(scene, "rain", 1.0, 2**13)
    once = np.flatnonzero(paths.hits_diffuse.sum(axis=1) == 1)
    assert once.size > 0
    from rays_reference import flights_m
    from roomfit.room.mesh import corners_m

    corners = corners_m(scene.room.mesh)
    for i in once[:200]:
        back = -paths.arrival[i].astype(np.float64)
        there = paths.departure[i].astype(np.float64)
        flight = flights_m(corners, np.array(SOURCE), there).min()
        assert flight + flights_m(corners, np.array(receiver), back).min() == pytest.approx(
            paths.length_m[i], abs=1e-4
        )


@pytest.mark.parametrize("s", [0.2, 1.0])
def test_without_absorption_energy_arrives_at_a_steady_rate(s):
    """c / V a second, with rain as with anything; mean over receivers spread through the box.

    Energy density is uniform late and 1 / V in all; a receiver sees c times that. 24 receivers
    drawn at random leave a spread of some 2 %, and five of them are allowed.
    """
    rng = np.random.default_rng(5)
    places = rng.uniform(0.4, np.array(BOX_M) - 0.4, (24, 3)).tolist()
    scene = scene_of(box_room(), [SOURCE], places)
    paths = rays(scene, "rain", s, 2**12, duration_s=0.15)
    low, high = 0.05 * SPEED_M_S, 0.15 * SPEED_M_S
    late = (paths.length_m >= low) & (paths.length_m < high)
    per_receiver = np.bincount(paths.pair[late], paths.weight_per_m2[late], len(places))
    expected = (high - low) / np.prod(BOX_M)
    spread = per_receiver.std(ddof=1) / np.sqrt(len(places))
    assert spread < 0.03 * expected
    assert per_receiver.mean() == pytest.approx(expected, abs=5.0 * spread)


def test_images_and_rain_join_without_counting_twice():
    """The joined trace holds as much as rays alone."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    still = uniform_scattering(scene.room.materials, 0.3)
    more = {"n_batches": BATCHES, "receiver_radius_m": 0.3, "estimator": "rain"}
    joined = trace(scene, TraceSettings(0.05, 2**15, 3, **more), still).paths  # type: ignore[arg-type]
    alone = rays(scene, "spheres", 0.3, 2**16)
    image = joined.batch < 0
    exact = float(joined.weight_per_m2[image].sum())
    found, error = energy(joined, ~image)
    agree((exact + found, error), energy(alone, np.ones(len(alone), dtype=np.bool_)))


def test_rain_is_the_same_for_any_number_of_threads():
    """Bit by bit."""
    import numba

    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    one = rays(scene, "rain", 0.5, 2000)
    numba.set_num_threads(before)
    other = rays(scene, "rain", 0.5, 2000)
    np.testing.assert_array_equal(one.weight_per_m2, other.weight_per_m2)
    np.testing.assert_array_equal(one.length_m, other.length_m)


def test_the_memory_that_rain_will_need_is_predicted():
    """Never too little, and no more than twice too much."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    for radius in (0.3, 1.0):
        settings = TraceSettings(0.1, 4000, -1, radius, estimator="rain")
        paths = trace_rays(scene, settings, uniform_scattering(scene.room.materials, 0.5)).paths
        expected = expected_paths(scene, settings, scattering=0.5)
        assert 0.5 * expected < len(paths) < expected


def test_faint_rain_is_drawn_by_lot_and_none_is_fainter_than_a_quarter_of_a_crossing():
    """A mean crossing weighs 1 / (n pi a**2); the weights of the lot-drawn ones are all alike."""
    scene = scene_of(box_room(), [SOURCE], [RECEIVER])
    weight = rays(scene, "rain", 1.0, 2000).weight_per_m2
    least = 0.25 / (2000 * np.pi * 0.3**2)
    assert weight.min() >= 0.0
    drops = weight[rays(scene, "rain", 1.0, 2000).hits_diffuse.any(axis=1)]
    assert drops.min() == pytest.approx(least, rel=1e-12)
    assert np.mean(drops < 1.0001 * least) > 0.5


def test_another_estimator_is_refused():
    """By name."""
    with pytest.raises(InputError, match="unknown estimator"):
        TraceSettings(0.1, estimator="cones")  # type: ignore[arg-type]
