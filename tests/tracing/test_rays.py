"""Rays from source to receiver against plain numpy, closed forms and exact counts."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy.stats import kstest, qmc

from images_reference import SPEED_M_S, box_room, box_with_sheet, l_shaped_room, scene_of
from rays_reference import crossings, direct_energy_per_m2
from roomfit.base.errors import InputError
from roomfit.base.typing import FloatArray
from roomfit.materials.priors import Scattering, uniform_scattering
from roomfit.room.scene import Room, Scene
from roomfit.tracing.paths import Paths, TraceSettings, hits, select
from roomfit.tracing.rays import (
    Trace,
    expected_paths,
    fibonacci_directions,
    path_bytes,
    sobol_directions,
    trace_rays,
)
from roomfit.tracing.walls import ray_key, uniform

SOURCE, RECEIVER = [1.1, 0.9, 1.3], [4.2, 3.1, 1.6]


def _box_scene() -> Scene:
    return scene_of(box_room(), [SOURCE], [RECEIVER])


def _trace(scene: Scene, s: float = 0.0, **settings: object) -> Trace:
    chosen = {"duration_s": 0.1, "n_rays": 4096, "image_order": -1} | settings
    still = uniform_scattering(scene.room.materials, s)
    return trace_rays(scene, TraceSettings(**chosen), still)  # type: ignore[arg-type]


def _same_bits(a: Paths, b: Paths) -> bool:
    names = ("pair", "length_m", "weight_per_m2", "hits_specular", "hits_diffuse")
    names += ("departure", "arrival", "batch")
    return all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in names)


@pytest.mark.parametrize(
    ("room", "receiver"),
    [
        (box_room(), RECEIVER),
        (l_shaped_room(), [1.6, 4.0, 1.4]),
        (box_with_sheet(), [3.2, 1.2, 1.4]),
    ],
)
def test_every_crossing_is_that_of_a_ray_followed_by_hand(room: Room, receiver: list[float]):
    """200 Fibonacci rays, a sphere of 0.6 m, 50 ms: length, chord, hits, in the same order."""
    scene = scene_of(room, [SOURCE], [receiver])
    paths = _trace(
        scene, n_rays=200, directions="fibonacci", duration_s=0.05, receiver_radius_m=0.6
    ).paths

    expected = [
        crossing
        for direction in fibonacci_directions(200)
        for crossing in crossings(scene, np.array(SOURCE), direction, 0.6, 0.05 * SPEED_M_S)
    ]
    chords = paths.weight_per_m2 * 200 * 4.0 / 3.0 * np.pi * 0.6**3

    assert len(expected) > 30
    np.testing.assert_allclose(paths.length_m, [e[0] for e in expected], rtol=1e-10)
    # the chord of a near miss is the root of a small difference: 1e-15 m2 make 3e-8 m
    np.testing.assert_allclose(chords, [e[1] for e in expected], rtol=1e-9, atol=1e-7)
    np.testing.assert_array_equal(hits(paths), [e[2] for e in expected])


@pytest.mark.parametrize("receiver", [RECEIVER, [1.4, 1.1, 1.5]])
def test_direct_sound_averages_the_spherical_law_over_the_ball(receiver):
    """Also where the source stands inside the sphere.

    16 batches of 2048 rays; 5 standard errors, which chance exceeds once in 5,000 runs. The
    Fibonacci spiral has no such error to tell: 1 % is what 200 caught rays leave.
    """
    scene = scene_of(box_room(), [SOURCE], [receiver])
    expected = direct_energy_per_m2(float(np.linalg.norm(np.subtract(receiver, SOURCE))), 0.5)
    batches = _direct_batches(scene, "sobol")
    error = batches.std(ddof=1) / 4.0

    assert abs(batches.mean() - expected) < 5.0 * error
    assert error < 0.03 * expected
    assert _direct_batches(scene, "fibonacci").mean() == pytest.approx(expected, rel=0.01)


def _direct_batches(scene: Scene, directions: str) -> FloatArray:
    paths = _trace(scene, n_rays=2**15, directions=directions, duration_s=0.02).paths
    direct = select(paths, ~hits(paths).any(axis=1))
    return np.bincount(direct.batch, direct.weight_per_m2, 16) * 16


@pytest.mark.parametrize("s", [0.0, 0.3, 1.0])
def test_after_every_hit_all_energy_is_still_in_the_room(s: float):
    """A sphere around the whole room catches each ray once between any two hits.

    So every count of hits occurs once for each ray, the chords are the flights, and at no
    absorption the energy in the room is that sent out at all times, exactly, for every s. With
    absorption a the share left after n hits is (1 - a)^n because every ray counts n.
    """
    scene = scene_of(l_shaped_room(), [SOURCE], [[3.0, 2.5, 1.25]])
    trace = _trace(scene, s, n_rays=3000, receiver_radius_m=10.0, max_hits=12, duration_s=10.0)
    n_hits = hits(trace.paths).sum(axis=1)

    assert trace.findings == ()
    np.testing.assert_array_equal(np.bincount(n_hits), np.full(12, 3000))


def test_a_material_scatters_with_its_own_probability():
    """Diffuse hits of each material are binomial: 5 standard deviations, once in 2 million."""
    s = np.array([0.0, 0.1, 0.3, 0.5, 0.9, 1.0])
    scene = scene_of(box_room(), [SOURCE], [[3.0, 2.3, 1.4]])
    settings = TraceSettings(1.0, n_rays=2000, image_order=-1, receiver_radius_m=8.0, max_hits=30)
    paths = trace_rays(scene, settings, Scattering(scene.room.materials, s)).paths
    last = select(paths, hits(paths).sum(axis=1) == 29)

    n = hits(last).sum(axis=0, dtype=np.int64)
    diffuse = last.hits_diffuse.sum(axis=0, dtype=np.int64)
    assert len(last) == 2000
    assert np.all(np.abs(diffuse - n * s) <= 5.0 * np.sqrt(n * s * (1.0 - s)))


def test_random_numbers_are_uniform_and_neighbours_know_nothing_of_each_other():
    """Over rays, draws, sources and seeds; p-values and correlations of a fixed draw."""
    n = 20_000
    base = _draws(1, 0, 0, n)
    others = [_draws(1, 0, 1, n), _draws(1, 1, 0, n), _draws(2, 0, 0, n), np.roll(base, 1)]
    assert kstest(base, "uniform").pvalue > 0.01
    for other in others:
        # 4 standard deviations of the correlation of independent numbers
        assert abs(np.corrcoef(base, other)[0, 1]) < 4.0 / np.sqrt(n)


@numba.njit
def _draws(seed, source, draw, n):
    return np.array([uniform(ray_key(seed, source, ray), draw) for ray in range(n)])


def test_the_same_seed_gives_the_same_bits_on_one_thread_and_on_two():
    """In a convex room and in one with a tree; another seed gives other paths."""
    if numba.config.NUMBA_NUM_THREADS < 2:  # type: ignore[attr-defined]
        pytest.skip("one thread only")
    for room in (box_room(), l_shaped_room()):
        scene = scene_of(room, [SOURCE, [2.0, 1.0, 1.2]], [[1.6, 1.8, 1.4]])
        results = []
        for threads in (1, 2):
            before = numba.get_num_threads()
            numba.set_num_threads(threads)
            results.append(_trace(scene, 0.4).paths)
            numba.set_num_threads(before)
        assert _same_bits(*results)
        assert not _same_bits(results[0], _trace(scene, 0.4, seed=2).paths)


def test_many_receivers_in_one_trace_are_as_many_traces_of_one():
    """60 spheres of two sizes in a grid, overlapping; each gets the very paths it gets alone."""
    rng = np.random.default_rng(12)
    places = rng.uniform([0.7, 0.7, 0.7], [5.4, 4.0, 2.1], (60, 3)).tolist()
    together = scene_of(box_room(), [SOURCE], places)
    radii = np.where(np.arange(60) % 2, 0.2, 0.5)
    settings = TraceSettings(0.1, n_rays=600, image_order=-1)
    still = uniform_scattering(together.room.materials, 0.2)
    every = trace_rays(together, settings, still, receiver_radii_m=radii).paths

    for i in (0, 1, 17, 59):
        alone = scene_of(box_room(), [SOURCE], [places[i]])
        expected = trace_rays(alone, settings, still, receiver_radii_m=radii[i : i + 1]).paths
        own = select(every, every.pair == i)
        assert len(expected) > 20
        np.testing.assert_array_equal(own.length_m, expected.length_m)
        np.testing.assert_array_equal(own.weight_per_m2, expected.weight_per_m2)
        np.testing.assert_array_equal(own.hits_diffuse, expected.hits_diffuse)


def test_only_receivers_paired_with_a_source_are_recorded():
    """Two sources, three receivers, three pairs; each pair under its own number."""
    places = [[4.2, 3.1, 1.6], [2.0, 2.0, 1.0], [5.0, 1.0, 2.0]]
    pairs = [(1, 2), (0, 0), (1, 0)]
    scene = scene_of(box_room(), [SOURCE, [3.0, 2.0, 1.5]], places, pairs)
    paths = _trace(scene).paths
    direct = select(paths, ~hits(paths).any(axis=1))

    assert set(paths.pair.tolist()) == {0, 1, 2}
    for i, (s, r) in enumerate(pairs):
        lengths = direct.length_m[direct.pair == i]
        gap = np.subtract(places[r], scene.sources[s].position_m)
        assert abs(lengths.mean() - np.linalg.norm(gap)) < 0.5


def test_rays_end_by_time_or_by_number_of_hits():
    """Nothing arrives after the duration; a ray that ends at its third hit has made two."""
    late = _trace(_box_scene(), duration_s=0.03).paths
    few = _trace(_box_scene(), max_hits=3).paths
    assert late.length_m.max() <= 0.03 * SPEED_M_S
    assert hits(few).sum(axis=1).max() == 2


@pytest.mark.parametrize("n", [1, 2, 60, 1000])
def test_directions_are_the_scrambled_sobol_points_of_scipy(n):
    """To the last bit, for sizes that are a power of two and others."""
    directions = sobol_directions(n, 1, (3, 1))
    points = qmc.Sobol(2, rng=np.random.default_rng((3, 1, 0))).random_base2(10)[:n]
    across = np.sqrt(1.0 - (1.0 - 2.0 * points[:, 0]) ** 2)
    azimuth = 2.0 * np.pi * points[:, 1]
    np.testing.assert_array_equal(directions[:, 2], 1.0 - 2.0 * points[:, 0])
    np.testing.assert_allclose(directions[:, 0], across * np.cos(azimuth), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(directions[:, 1], across * np.sin(azimuth), rtol=1e-12, atol=1e-12)


def test_the_fibonacci_sphere_is_the_standard_one():
    """Equal steps in height, the golden angle between neighbours."""
    d = fibonacci_directions(18_000)
    turn = np.diff(np.unwrap(np.arctan2(d[:, 1], d[:, 0])))
    np.testing.assert_allclose(np.diff(d[:, 2]), -2.0 / 18_000, rtol=1e-9)
    golden = 2.0 * np.pi * (1.0 - 2.0 / (1.0 + np.sqrt(5.0)))
    np.testing.assert_allclose(np.mod(turn, 2.0 * np.pi), golden, rtol=1e-9)


def test_memory_is_reported_before_and_refused_where_it_is_too_much():
    """The estimate is right within 10 %, and bytes per path are those of the arrays."""
    scene = _box_scene()
    settings = TraceSettings(0.5, n_rays=4000, image_order=-1)
    paths = trace_rays(scene, settings, uniform_scattering(scene.room.materials, 0.5)).paths
    names = ("pair", "length_m", "weight_per_m2", "hits_specular", "hits_diffuse")
    names += ("departure", "arrival", "batch")

    assert len(paths) == pytest.approx(expected_paths(scene, settings), rel=0.1)
    assert sum(getattr(paths, n).nbytes for n in names) == len(paths) * path_bytes(scene)
    with pytest.raises(InputError, match=r"fit into memory[\s\S]*fewer rays"):
        _trace(scene, duration_s=0.5, n_rays=10**8)


def test_a_block_with_more_crossings_than_expected_loses_none():
    """Spheres around the source catch every ray at once, far above the diffuse estimate."""
    scene = scene_of(box_room(), [SOURCE], [SOURCE] * 40)
    paths = _trace(scene, n_rays=512, duration_s=1e-3, receiver_radius_m=0.1).paths
    assert len(paths) == 40 * 512
