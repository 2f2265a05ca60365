"""Pairs on a plane of symmetry: what it costs, and where to move them."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.air import Air
from roomfit.base.bands import bands_between
from roomfit.base.findings import Code
from roomfit.design.candidates import DesignOptions
from roomfit.design.positions import design, plane_findings
from roomfit.fit.symmetry import mirror_planes
from roomfit.room.scene import Scene, scene_of, shoebox_room
from roomfit.settings import Settings

SIDES = ("west", "east", "south", "north", "floor", "ceiling")
SIZE_M = (6.4, 5.2, 2.8)
OCTAVE, FEW = bands_between("octave", 500, 1000), Settings(n_rays=2000)


def scene(heights_m, materials=None, size_m=SIZE_M):
    """Return four sources about one receiver, all at such heights, off the upright planes."""
    sources = {
        f"S{i}": (3.9 + 1.5 * np.cos(a), 2.1 + 1.4 * np.sin(a), heights_m[0])
        for i, a in enumerate((0.3, 1.4, 2.6, 4.0))
    }
    room = shoebox_room(size_m, materials or {side: side for side in SIDES})
    return scene_of(room, sources, {"M": (3.9, 2.1, heights_m[1])})


def test_pairs_at_half_height_are_told_which_walls_they_hardly_tell_apart():
    (finding,) = plane_findings(scene((1.4, 1.4)))
    assert finding.code is Code.ON_SYMMETRY_PLANE
    assert set(finding.about.materials) == {"floor", "ceiling"}
    np.testing.assert_allclose(finding.evidence["normal"], (0.0, 0.0, 1.0), atol=1e-12)
    assert finding.evidence["offset_m"] == pytest.approx(1.4)
    assert finding.evidence["move"] == ["M"]
    assert "z = 1.40 m" in finding.sentence and "Move M off the plane" in finding.sentence
    assert not plane_findings(scene((1.4, 1.9)))


@pytest.mark.parametrize(
    "own",
    [
        scene((1.4, 1.1)),
        scene((1.2, 1.2)),
        # both are one material: nothing to tell apart
        scene((1.4, 1.4), {**{s: s for s in SIDES}, "floor": "tiles", "ceiling": "tiles"}),
    ],
)
def test_pairs_off_the_plane_or_of_equal_walls_are_not_warned(own):
    assert not mirror_planes(own) and not plane_findings(own)


def test_a_pair_mirrored_into_its_reverse_counts_and_turned_by_an_axis_does_not():
    """Source below and receiver above: by reciprocity the pair is its own image in z = 1.4 m.

    That of the source in the axis is no plane: of the four symmetries here one is a plane.
    """
    room = shoebox_room(SIZE_M, {side: side for side in SIDES})
    own = scene_of(room, {"S": (2.0, 1.7, 1.0)}, {"R": (2.0, 1.7, 1.8)})
    ((symmetry, normal),) = mirror_planes(own)
    np.testing.assert_allclose(np.abs(normal), (0.0, 0.0, 1.0), atol=1e-12)
    assert symmetry.centre_m[2] == pytest.approx(1.4)


def test_a_design_at_half_height_alone_says_so_and_one_at_all_heights_does_not():
    room = shoebox_room(SIZE_M, {side: side for side in SIDES})
    for heights_m, expected in (((1.4, 1.4), 1), ((1.0, 2.0), 0)):
        options = DesignOptions(
            number=3, n_candidates=12, new_sources=3, n_draws=1, n_random=0,
            source_heights_m=heights_m, receiver_heights_m=heights_m, receiver_distance_m=0.5,
            source_distance_m=1.0,
        )  # fmt: skip
        empty = Scene(room, (), (), np.zeros((0, 2), dtype=np.int64), Air())
        plan = design(empty, bands=OCTAVE, options=options, settings=FEW)
        codes = [f.code for f in plan.findings]
        assert codes.count(Code.ON_SYMMETRY_PLANE) == expected
