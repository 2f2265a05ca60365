"""Pictures of how sure an answer is: what is drawn is what the answer holds."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from report_cases import answer_of, scene_of, texts_of
from roomfit.report.answer import result_blocks
from roomfit.report.figures import (
    absorption_figure,
    decay_figure,
    identifiability_figure,
    png,
    profiles_figure,
    shown_profiles,
    svg,
    write_pictures,
)
from roomfit.report.html import page
from roomfit.report.tables import prior_tables
from roomfit.uncertainty.profile import Profile


@pytest.fixture(scope="module")
def answer():
    """Three materials in six bands: fifteen profiles, a prior."""
    plain = answer_of(scene_of())
    points = np.array([-5.0, -4.0, -3.0, -2.0, -1.0])
    rise = np.array([2.2, 0.7, 0.0, 0.9, 2.6])
    lines = tuple(Profile(i, points, rise, -4.8, -1.3, False, 4) for i in range(3))
    return replace(
        plain,
        profiles=(lines,) * 5 + ((),),
        interval_kinds=(("profile",) * 3,) * 6,
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
    assert sum(axes.get_visible() for axes in figure.axes) == 12
    for axes, (band, line) in zip(figure.axes, shown, strict=True):
        (at,) = [x.get_xdata()[0] for x in axes.lines if x.get_label() == "answer"]
        assert at == answer.absorption[line.entry, band]


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


def test_without_profiles_or_priors_nothing_is_drawn():
    plain = answer_of(scene_of())
    assert "profiles" not in {d.name for d in result_blocks(plain).drawings()}
    assert prior_tables(plain) == ()


def test_each_picture_is_the_drawing_of_the_page_and_shows_its_own_curves(answer, tmp_path):
    """Curves, levels and names of other pairs are not in it; PNG stands beside it on request."""
    shown = result_blocks(answer, scene_of())
    text = page(shown)
    write_pictures(tmp_path, shown, png_too=True)
    svgs = {f.stem: f.read_text() for f in tmp_path.glob("*.svg")}
    assert set(svgs) == {f.stem for f in tmp_path.glob("*.png")}
    for name in ("absorption", "identifiable", "profiles", "room", "decay_times"):
        assert svgs[name].replace(' xmlns="http://www.w3.org/2000/svg"', "").strip() in text
    pairs = sorted(name for name in svgs if name.startswith("decay_0"))
    assert len(pairs) == len(answer.pairs) > 1
    for i, name in enumerate(pairs):
        assert set(re.findall(r'class="curve-(\d+)"', svgs[name])) == {str(i)}
        ET.fromstring(svgs[name])


@pytest.mark.slow
def test_each_decay_picture_is_what_its_pair_would_be_by_itself(answer, tmp_path):
    """What all share is drawn once."""
    write_pictures(tmp_path, result_blocks(answer), png_too=True)
    pictures = [imread(file) for file in sorted(tmp_path.glob("decay_0*.png"))]
    figure = decay_figure(answer, *answer.pairs)
    svg(figure, "decay", "as the page, which settles the layout")
    parts = [a for x in (figure, *figure.axes) for a in x.get_children() if a.get_gid()]
    for i, picture in enumerate(pictures):
        for part in parts:
            part.set_visible(part.get_gid() == f"class:curve-{i}")
        alone = imread(io.BytesIO(png(figure)))
        # the same but for frames and grid, of which curves lie above here and below there
        assert np.mean(np.abs(alone - picture).max(axis=2) > 0.3) < 1e-3
        others = [np.mean(np.abs(alone - p).max(axis=2) > 0.3) for p in pictures]
        assert int(np.argmin(others)) == i and sorted(others)[1] > 1e-3
