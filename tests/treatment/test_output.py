"""What a treatment's sentence says and its figure draws, of numbers that are written down here."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb

import roomfit
from roomfit.bands import bands_between
from roomfit.prediction.tables import PredictedValue, ValueChange
from roomfit.report.room_figure import COLOURS, projection
from roomfit.treatment.output import treatment_figure, treatment_sentence
from roomfit.treatment.question import Target
from roomfit.treatment.treat import Arrangement, Hung, Treatment

BANDS = bands_between("octave", 500, 1000)
NONE = np.full(2, np.nan)


@pytest.fixture
def treatment() -> Treatment:
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), {})
    scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    before = ValueChange(
        np.array([1.2, 1.3]), np.array([1.1, 1.15]), np.array([1.35, 1.4]),
        np.array([-0.5, -0.5]), np.array([-0.6, -0.6]), np.array([-0.4, -0.4]),
        NONE, NONE, NONE,
    )  # fmt: skip
    after = PredictedValue(
        np.array([0.7, 0.8]), np.array([0.65, 0.7]), np.array([0.78, 0.95]),
        NONE, NONE, NONE, NONE, NONE, before,
    )  # fmt: skip
    hung = Hung("ceiling", "panel", 12.5, 0.4)
    first = Arrangement(
        (hung,), 100.0, {"T30_s": after}, np.array([0.834]), np.array([0.02]), 0.834, (), ()
    )
    changing: Any = SimpleNamespace(scene=scene)
    target = Target("T30_s", high=0.9, bands_hz=(500.0, 1000.0))
    return Treatment(BANDS, (target,), (first,), True, changing, ())


def test_intervals_stand_at_their_bands_from_the_lower_to_the_upper_limit(treatment):
    """Before on the left of a band's mark, after on the right, the limit across it."""
    axes = treatment_figure(treatment).axes[1]
    drawn = [s for c in axes.collections if isinstance(c, LineCollection) for s in c.get_segments()]
    upright = sorted((x0, y0, y1) for (x0, y0), (x1, y1) in drawn if x0 == x1)
    wanted = [(-0.1, 1.1, 1.35), (0.1, 0.65, 0.78), (0.9, 1.15, 1.4), (1.1, 0.7, 0.95)]
    np.testing.assert_allclose(upright, wanted, atol=1e-12)
    level = sorted((x0, x1, y0) for (x0, y0), (x1, y1) in drawn if y0 == y1)
    np.testing.assert_allclose(level, [(-0.4, 0.4, 0.9), (0.6, 1.4, 0.9)], atol=1e-12)
    points = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_allclose(points["as it is"], [(-0.1, 1.2), (0.9, 1.3)], atol=1e-12)
    np.testing.assert_allclose(points["treated"], [(0.1, 0.7), (1.1, 0.8)], atol=1e-12)
    # half as much again as the highest number drawn, from zero
    assert axes.get_ylim() == pytest.approx((0.0, 1.5 * 1.4))
    assert [t.get_text() for t in axes.get_xticklabels()] == ["500", "1000"]


def test_covered_surfaces_have_colours_that_are_paler_the_less_is_covered(treatment):
    """Of 0.4 of the ceiling 0.58 of the colour; it is turned away, and so drawn twice: through."""
    axes = treatment_figure(treatment).axes[0]
    handles = axes.get_legend().legend_handles
    texts = [t.get_text() for t in axes.get_legend().get_texts()]
    assert texts == ["ceiling: 12.5 m² panel (40 %)", "as it is"]
    full = np.array(to_rgb(COLOURS[0]))
    pale = np.array(handles[0].get_facecolor()[:3])
    np.testing.assert_allclose(pale, 1.0 - 0.58 * (1.0 - full), atol=1 / 255)
    walls, front = (c for c in axes.collections if isinstance(c, PolyCollection))
    shown = {tuple(np.round(c[:3], 3)) for c in walls.get_facecolor()}
    assert shown == {tuple(np.round(to_rgb("#EEEEEE"), 3))}
    np.testing.assert_allclose(front.get_facecolor()[0], (*pale, 0.35), atol=1e-6)
    assert len(front.get_paths()) == 2  # both triangles of the ceiling
    flat = treatment.room.scene.room.mesh.vertices_m @ projection()[:2].T
    assert axes.get_xlim() == (flat[:, 0].min(), flat[:, 0].max())
    assert axes.get_ylim() == (flat[:, 1].min(), flat[:, 1].max())
    high = treatment.room.scene.room.mesh.vertices_m[:, 2] == 3.0
    corners = np.concatenate([path.vertices for path in front.get_paths()])
    np.testing.assert_allclose(
        np.unique(np.round(corners, 9), axis=0), np.unique(np.round(flat[high], 9), axis=0)
    )


def test_the_sentence_says_what_hangs_where_and_how_likely_it_is_enough(treatment):
    text = treatment_sentence(treatment)
    assert text.startswith("12.5 m² panel on ceiling: ")
    assert text.endswith("The target is met with a probability of 83 %.")
    two = replace(treatment, targets=2 * treatment.targets)
    assert treatment_sentence(two).endswith("All targets are met with a probability of 83 %.")
    missed = treatment_sentence(replace(treatment, is_met=False))
    assert missed.endswith(
        "By the likeliest prediction this does not meet the targets; nothing that was allowed does."
    )
    assert "probability" not in missed
    # a miss that rounding to whole percents would hide
    asked = treatment_sentence(replace(treatment, is_met=False, asked=0.8345))
    assert asked.endswith(
        "The target is met with a probability of 83.4 %; nothing that was allowed meets each "
        "target with the 83.45 % that were asked for."
    )
    bare = replace(treatment.arrangements[0], hung=(), mean={})
    alone = treatment_sentence(replace(treatment, arrangements=(bare,)))
    assert alone == "Nothing. The target is met with a probability of 83 %."


def test_edges_of_the_room_are_drawn_over_its_surfaces(treatment):
    """The twelve of a box, each in the projection of its ends."""
    axes = treatment_figure(treatment).axes[0]
    room = treatment.room.scene.room
    (edges,) = (c for c in axes.collections if isinstance(c, LineCollection))
    drawn = {frozenset(map(tuple, np.round(s, 9).tolist())) for s in edges.get_segments()}
    corners = room.mesh.vertices_m
    flat = np.round(corners @ projection()[:2].T, 9).tolist()
    expected = {
        frozenset((tuple(flat[i]), tuple(flat[j])))
        for i in range(len(corners))
        for j in range(i)
        if np.count_nonzero(corners[i] != corners[j]) == 1
    }
    assert len(expected) == 12 and drawn == expected
