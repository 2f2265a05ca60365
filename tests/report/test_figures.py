"""Pictures of how sure an answer is: what is drawn is what the answer holds."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from report_cases import answer_of, scene_of, texts_of
from roomfit.report.figures import (
    absorption_figure,
    answer_figures,
    corner_figure,
    decay_figure,
    identifiability_figure,
    png,
    profiles_figure,
    shown_profiles,
    svg,
    write_pictures,
)
from roomfit.report.html import mean_decay_figure
from roomfit.report.tables import prior_tables
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
    assert [row[0] for row in texts_of(table)] == list(answer.materials)
    assert len(table.rows[0]) == 1 + 6


def numbers_of(figure):
    """The numbers that label scales, and where they stand, in points from the lower left corner."""
    turned = r'<text [^>]*transform="translate\(([-.\d]+)[ ,]([-.\d]+)\)[^>]*>([.\dk]+)</text>'
    plain = r'<text [^>]*?x="([-.\d]+)" y="([-.\d]+)"[^>]*>([.\dk]+)</text>'
    text, height = svg(figure, "a", "b"), 72.0 * figure.get_figheight()
    found = re.findall(plain, text) + re.findall(turned, text)
    return [(word, np.array([float(x), height - float(y)])) for x, y, word in found]


def test_numbers_of_panels_stand_at_their_values_whatever_the_limits(answer):
    """Three materials and the mean in one row: four scales of bands, one of absorption."""
    figure = absorption_figure(answer)
    for low, high in ((0.0, 1.0), (0.1, 0.35)):
        figure.axes[0].set_ylim(low, high)
        numbers = numbers_of(figure)
        levels = {float(w): at for w, at in numbers if "." in w}
        assert len(levels) >= 3
        for level, at in levels.items():
            assert low <= level <= high
            expected = figure.axes[0].transData.transform((1000.0, level)) * 72.0 / figure.dpi
            # the base line of ten-point numbers that have their middle there
            assert at[1] == pytest.approx(expected[1] - 3.6, abs=1.0)
            assert at[0] < 72.0 * figure.axes[0].get_position().x0 * figure.get_figwidth()
        places = [at[0] for w, at in numbers if w == "1k"]
        for axes, x in zip(figure.axes, sorted(places), strict=True):
            expected = axes.transData.transform((1000.0, low)) * 72.0 / figure.dpi
            assert x == pytest.approx(expected[0], abs=8.0)  # left of its middle, or there


def test_each_decay_picture_is_what_its_pair_would_be_by_itself(answer, tmp_path):
    """Curves, levels and names of the others are not in it; what all share is drawn once."""
    figure = decay_figure(answer, *answer.pairs)
    write_pictures(tmp_path, answer, figures={"decays": figure})
    pictures = [imread(file) for file in sorted(tmp_path.glob("decay_*.png"))]
    assert len(pictures) == len(answer.pairs) > 1
    parts = [a for x in (figure, *figure.axes) for a in x.get_children() if a.get_gid()]
    for i, picture in enumerate(pictures):
        for part in parts:
            part.set_visible(part.get_gid() == f"class:curve-{i}")
        alone = imread(io.BytesIO(png(figure)))
        # the same but for frames and grid, of which curves lie above here and below there
        assert np.mean(np.abs(alone - picture).max(axis=2) > 0.3) < 1e-3
        others = [np.mean(np.abs(alone - p).max(axis=2) > 0.3) for p in pictures]
        assert int(np.argmin(others)) == i and sorted(others)[1] > 1e-3


@pytest.mark.slow
def test_pairs_without_curves_have_no_decay_picture(answer, tmp_path):
    values = replace(answer, pairs=tuple(replace(p, decay=None) for p in answer.pairs))
    assert "decays" not in answer_figures(values)
    write_pictures(tmp_path, values)
    assert not list(tmp_path.glob("decay_*.png"))


def test_a_figure_is_the_same_whether_the_page_or_its_file_is_drawn_first(answer):
    """Two processes draw them at the same time, each its own."""
    pages, files = (
        answer_figures(answer, decay_times=mean_decay_figure(answer), none=None) for _ in range(2)
    )
    assert "decay_times" in pages and "none" not in pages
    for name, page in pages.items():
        text, picture = svg(page, "x", name), png(files[name])
        assert picture == png(page)
        assert text == svg(files[name], "x", name)
