"""How finely a campaign is traced: image sources where rays would miss what counts."""

from __future__ import annotations

import numpy as np

from images_reference import BOX_MATERIALS, SPEED_M_S, box_room, scene_of
from roomfit.inversion.trace_plan import TracePlan, plan_trace
from roomfit.materials.priors import MaterialPrior
from roomfit.settings import Settings
from roomfit.synthetic.boxes import SyntheticBox, box_images
from roomfit.tracing.trace import trace

LENGTHS_M = (5.7, 6.5, 2.7)
SOURCE, RECEIVER = [1.2, 1.5, 1.1], [4.1, 4.9, 1.6]
ALPHA = np.array([0.1, 0.9, 0.02, 0.02, 0.9, 0.15])


def plan(scattering: float, longest_s: float) -> TracePlan:
    """Return the plan of a partly coherent fit whose walls all scatter alike."""
    scene = scene_of(box_room(LENGTHS_M), [SOURCE], [RECEIVER])
    priors = tuple(
        MaterialPrior(name, np.zeros(1), np.ones(1), scattering=np.array([scattering]))
        for name in BOX_MATERIALS
    )
    return plan_trace(scene, priors, longest_s, longest_s, Settings(), coherent=True)


def test_what_flutters_between_hard_walls_is_late_and_still_exact() -> None:
    """Energy without any diffuse hit from 0.22 to 0.3 s, against the lattice of another module.

    Rays find it by luck: of sixty thousand few stay between two walls for so long.
    """
    planned = plan(0.15, 0.35)
    scene = scene_of(box_room(LENGTHS_M), [SOURCE], [RECEIVER])
    paths = trace(scene, planned.settings, planned.scattering).paths
    t = paths.length_m / SPEED_M_S
    late = (t > 0.22) & (t < 0.3) & ~paths.hits_diffuse.any(axis=1)
    found = paths.weight_per_m2 * np.prod((1.0 - ALPHA) ** paths.hits_specular, axis=1)
    truth = SyntheticBox(LENGTHS_M, np.ones(1), ALPHA[:, None], np.zeros(1), SPEED_M_S)
    lengths, hits = box_images(truth, np.array(SOURCE), np.array(RECEIVER), 0.3)
    kept = np.prod(((1.0 - ALPHA) * 0.85) ** hits, axis=1) / (4.0 * np.pi * lengths**2)
    expected = kept[lengths > 0.22 * SPEED_M_S].sum()
    np.testing.assert_allclose(found[late].sum(), expected, rtol=1e-6)


def test_no_window_ends_later_than_the_image_sources_of_a_smooth_box() -> None:
    """They are as many as can be had: 60,000 a pair, by the volume of a ball.

    Where walls scatter, rays bring what is later.
    """
    for scattering in (0.0, 0.15):
        long = plan(scattering, 2.0)
        until_s = long.settings.image_until_s
        assert until_s is not None
        count = 4.0 / 3.0 * np.pi * (SPEED_M_S * until_s) ** 3 / np.prod(LENGTHS_M)
        np.testing.assert_allclose(count, 60_000, rtol=1e-6)
        assert long.fit_until_s == (np.inf if scattering else until_s)


def test_walls_that_scatter_ask_for_more_rays() -> None:
    """Then rays bring most of the energy, not only what comes late."""
    assert plan(0.15, 0.35).settings.n_rays == 60_000
    assert plan(0.0, 2.0).settings.n_rays == 20_000
