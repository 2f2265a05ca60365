"""Pictures of how sure an answer is: what is drawn is what the answer holds."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.image import imread

from report_cases import answer_of, scene_of, texts_of
from roomfit.report.answer import result_blocks
from roomfit.report.figures import (
    decay_figure,
    png,
    svg,
    write_pictures,
)
from roomfit.report.html import page
from roomfit.report.tables import prior_tables


@pytest.fixture(scope="module")
def answer():
    """Three materials in six bands with a prior."""
    return answer_of(scene_of())


def test_the_prior_stands_in_a_table_of_its_own(answer):
    (table,) = prior_tables(answer)
    assert [row[0] for row in texts_of(table)] == list(answer.materials)
    assert len(table.rows[0]) == 1 + 6


def test_each_picture_is_the_drawing_of_the_page_and_shows_its_own_curves(answer, tmp_path):
    """Curves, levels and names of other pairs are not in it; PNG stands beside it on request."""
    shown = result_blocks(answer, scene_of())
    text = page(shown)
    write_pictures(tmp_path, shown, png_too=True)
    svgs = {f.stem: f.read_text() for f in tmp_path.glob("*.svg")}
    assert set(svgs) == {f.stem for f in tmp_path.glob("*.png")}
    for name in ("absorption", "room", "decay_times"):
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
