"""How finely a campaign is traced: image sources where rays would miss what counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from images_reference import BOX_MATERIALS, SPEED_M_S, box_room, scene_of
from roomfit.base.findings import Code
from roomfit.fit.trace_plan import TracePlan, images_until_s, plan_trace, traced_s
from roomfit.materials.priors import MaterialPrior
from roomfit.room.scene import Scene, shoebox_room
from roomfit.room.scene import scene_of as named_scene
from roomfit.settings import Settings

LENGTHS_M = (5.7, 6.5, 2.7)
SOURCE, RECEIVER = [1.2, 1.5, 1.1], [4.1, 4.9, 1.6]


def far_plan(
    scene: Scene, priors: tuple[MaterialPrior, ...], longest_s: float, settings: Settings
) -> TracePlan:
    """Return the plan of a fit of pressures."""
    far_s = images_until_s(scene, traced_s(longest_s, longest_s), settings)
    return plan_trace(scene, priors, longest_s, longest_s, settings, images_until_s=far_s)


def plan(scattering: float, longest_s: float) -> TracePlan:
    """Return the plan of a partly coherent fit whose walls all scatter alike."""
    scene = scene_of(box_room(LENGTHS_M), [SOURCE], [RECEIVER])
    priors = tuple(
        MaterialPrior(name, np.zeros(1), np.ones(1), scattering=np.array([scattering]))
        for name in BOX_MATERIALS
    )
    return far_plan(scene, priors, longest_s, Settings())


def test_image_sources_of_a_box_reach_as_far_as_so_many_fill_a_ball() -> None:
    """They are as many as can be had: 60,000 a pair."""
    for scattering in (0.0, 0.15):
        long = plan(scattering, 2.0)
        until_s = long.settings.image_until_s
        assert until_s is not None
        count = 4.0 / 3.0 * np.pi * (SPEED_M_S * until_s) ** 3 / np.prod(LENGTHS_M)
        np.testing.assert_allclose(count, 60_000, rtol=1e-6)


def test_many_pairs_share_the_image_sources_that_fit_into_memory() -> None:
    """Two hundred have 20,000 each for pressures, four million together; eight have their 60,000.

    Where images are all there is, eight pairs have their 400,000, and 200 have rays beside fewer.
    """
    room = box_room(LENGTHS_M)
    prior = MaterialPrior("x", np.zeros(1), np.ones(1), scattering=np.zeros(1))
    priors = tuple(replace(prior, name=name) for name in BOX_MATERIALS)
    for n_receivers, expected in ((8, 60_000), (200, 20_000)):
        places = [[1.2 + 0.01 * i, 4.9, 1.6] for i in range(n_receivers)]
        scene = scene_of(room, [SOURCE], places)
        until_s = far_plan(scene, priors, 2.0, Settings())
        reach_m = SPEED_M_S * (until_s.settings.image_until_s or 0.0)
        count = 4.0 / 3.0 * np.pi * reach_m**3 / np.prod(LENGTHS_M)
        np.testing.assert_allclose(count, expected, rtol=1e-6)
        # up to 0.37 s: 200,000 images a pair
        alone = far_plan(scene, priors, 0.35, Settings())
        assert (alone.settings.n_rays == 0) == (n_receivers == 8)


def test_walls_that_scatter_ask_for_more_rays() -> None:
    """Then rays bring most of the energy, not only what comes late."""
    assert plan(0.15, 0.35).settings.n_rays == 60_000
    assert plan(0.0, 2.0).settings.n_rays == 20_000


def values_plan(
    lengths_m: tuple[float, float, float],
    decay_s: float,
    scattering: tuple[float, ...] = (0.2, 0.2),
    n_receivers: int = 1,
    settings: Settings | None = None,
) -> TracePlan:
    """Return the plan for room parameters of one source, in a box of one material."""
    room = shoebox_room(lengths_m, "plaster")
    place = np.array([[0.2, 0.3, 0.5]])
    rows = place + np.linspace(0.0, 1.0, n_receivers)[:, None] * [[0.5, 0.3, 0.0]]
    rows = (rows + np.array([0.1, 0.1, 0.0])) * lengths_m
    receivers = {f"R{i}": tuple(p) for i, p in enumerate(rows)}
    scene = named_scene(room, {"S": tuple(place[0] * lengths_m)}, receivers)
    n = len(scattering)
    prior = MaterialPrior("plaster", np.zeros(n), np.ones(n), scattering=np.array(scattering))
    return plan_trace(scene, (prior,), decay_s, 0.0, settings or Settings())


def crossings_per_s(planned: TracePlan, lengths_m: tuple[float, ...]) -> float:
    """Return how often a second some ray crosses a sphere in a diffuse field."""
    used = planned.settings
    area = np.pi * used.receiver_radius_m**2
    return float(used.n_rays * area * SPEED_M_S / np.prod(lengths_m))


def test_small_rooms_keep_their_rays_and_large_ones_their_crossings() -> None:
    """To 300 m3 60,000 rays and 0.5 m; beyond, as many crossings a second in any volume."""
    for lengths, decay_s in (
        ((5.0, 4.0, 3.0), 0.4),
        ((8.0, 6.0, 3.5), 0.6),
        ((9.0, 8.0, 4.0), 1.0),
    ):
        used = values_plan(lengths, decay_s).settings
        assert (used.n_rays, used.receiver_radius_m) == (60_000, 0.5)
    halls = (13.0, 10.0, 7.0), (26.0, 16.0, 8.0), (40.0, 25.0, 12.0), (40.0, 30.0, 3.0)
    plans = [values_plan(lengths, 1.5) for lengths in halls]
    found = [crossings_per_s(p, lengths) for p, lengths in zip(plans, halls, strict=True)]
    np.testing.assert_allclose(found, found[0], rtol=0.02)
    # windows of 0.025 s, 10 dB down, of which the data know 22 %: five crossings count as one
    own = 0.2**2 + 1.0 / (2828.0 * 0.025)
    np.testing.assert_allclose(found[0], 9.0 * 5.0 / own / 0.025, rtol=0.03)
    radii = [p.settings.receiver_radius_m for p in plans]
    assert radii[0] < radii[1] < radii[2] and radii[3] == 0.5
    for lengths, radius_m in zip(halls, radii, strict=True):
        x, y, z = lengths
        free_path_m = 2.0 * x * y * z / (x * y + y * z + z * x)
        assert abs(radius_m - max(0.5, 0.09 * free_path_m)) < 1e-9


def test_bands_that_scatter_apart_are_traced_in_groups_with_more_rays() -> None:
    """A ray that is worth half to some band is sent twice; equal bands are one group."""
    lengths, octaves = (26.0, 16.0, 8.0), (0.1, 0.1, 0.15, 0.2, 0.4, 0.6)
    alike, apart = values_plan(lengths, 1.5), values_plan(lengths, 1.5, octaves)
    assert alike.scattering.coefficients.tolist() == [0.2]
    assert 1 < len(apart.scattering.coefficients) < 6
    assert 1.2 < apart.settings.n_rays / alike.settings.n_rays < 4.0


def test_more_than_a_gigabyte_is_refused_with_the_error_that_remains() -> None:
    """Six hundred pairs: rays are fewer, and half a gigabyte of paths makes a trace of one."""
    lengths = (26.0, 16.0, 8.0)
    one, many = (values_plan(lengths, 1.5, n_receivers=n) for n in (1, 600))
    assert not one.findings
    (finding,) = many.findings
    assert finding.code is Code.FEW_RAYS
    share = many.settings.n_rays / one.settings.n_rays
    assert 0.1 < share < 0.9
    assert abs(finding.evidence["times_wanted_error"] ** 2 * share - 1.0) < 0.01
    # pairs times crossings times seconds times bytes a path
    n_paths = 600 * crossings_per_s(many, lengths) * many.settings.duration_s
    assert n_paths * 52 < 1.02 * 2**29
    # what is stated is done
    asked = values_plan(lengths, 1.5, n_receivers=600, settings=Settings(n_rays=60_000))
    assert asked.settings.n_rays == 60_000 and not asked.findings
