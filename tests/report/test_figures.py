"""Pictures of how sure an answer is: what is drawn is what the answer holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from report_cases import answer_of, scene_of
from roomfit.report.figures import (
    corner_figure,
    identifiability_figure,
    profiles_figure,
    shown_profiles,
)
from roomfit.report.html_tables import prior_tables
from roomfit.uncertainty.profile import Profile


@pytest.fixture(scope="module")
def answer():
    """Three materials in six bands: fifteen profiles, samples of two bands, a prior."""
    plain = answer_of(scene_of())
    points = np.array([-5.0, -4.0, -3.0, -2.0, -1.0])
    rise = np.array([2.2, 0.7, 0.0, 0.9, 2.6])
    lines = tuple(Profile(i, points, rise, -4.8, -1.3, False, 4) for i in range(3))
    rng = np.random.default_rng(1)
    loose, tied = rng.uniform(0.2, 0.4, (2, 900, 3))
    tied[:, 1] = tied[:, 0] ** 2
    return replace(
        plain,
        profiles=(lines,) * 5 + ((),),
        interval_kinds=(("profile",) * 3,) * 6,
        samples=(None, loose, tied, None, None, None),
        prior=np.stack([plain.absorption, plain.lower95, plain.upper95]),
    )


def test_the_matrix_shows_widths_and_marks_what_is_identifiable(answer):
    axes = identifiability_figure(answer).axes[0]
    width = answer.upper95 - answer.lower95
    np.testing.assert_array_equal(np.ravel(axes.collections[0].get_array()), width.ravel())
    texts = [t.get_text() for t in axes.texts]
    reported = [float(t.split()[-1]) for t in texts]
    np.testing.assert_allclose(reported, width.ravel(), atol=0.00501)
    ticks = ["\N{CHECK MARK}" in t for t in texts]
    np.testing.assert_array_equal(np.reshape(ticks, width.shape), answer.identifiable)


def test_of_many_profiles_the_twelve_widest_are_drawn(answer):
    shown = shown_profiles(answer)
    width = (answer.upper95 - answer.lower95)[:, :5]
    chosen = sorted(width[line.entry, band] for band, line in shown)
    np.testing.assert_allclose(chosen, np.sort(width.ravel())[-12:])
    figure = profiles_figure(answer)
    assert figure is not None
    assert sum(axes.get_visible() for axes in figure.axes) == 12
    for axes, (band, line) in zip(figure.axes, shown, strict=True):
        (at,) = [x.get_xdata()[0] for x in axes.lines if x.get_label() == "answer"]
        assert at == answer.absorption[line.entry, band]


def test_the_corner_is_that_of_the_band_whose_materials_hang_together(answer):
    found = corner_figure(answer)
    assert found is not None
    assert found[0] == answer.bands.centres_hz[2]
    clouds = [axes for axes in found[1].axes if axes.get_visible() and axes.lines]
    # three histograms with the answer, and each material against each other
    assert len(clouds) == 6
    tied = found[1].axes[3].lines[0].get_xydata()
    np.testing.assert_allclose(tied[:, 1], tied[:, 0] ** 2)


def test_without_profiles_samples_or_priors_nothing_is_drawn():
    plain = answer_of(scene_of())
    assert profiles_figure(plain) is None
    assert corner_figure(plain) is None
    assert prior_tables(plain) == ()


def test_the_prior_stands_in_a_table_of_its_own(answer):
    (table,) = prior_tables(answer)
    assert [row.head for row in table.rows] == list(answer.materials)
    assert len(table.rows[0].cells) == 6
