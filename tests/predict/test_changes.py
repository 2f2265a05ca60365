"""What a change makes of the absorption and of its draws, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.materials.catalogue import band_correlation, catalogue_prior, find_material
from roomfit.predict.changes import Change, change_text, changed_draws, read_change
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 500, 1000)
NAMES = ("wall", "floor", "people")
N_DRAWS = 20_000


def drawn_with(*changes: Change):
    a = np.array([[0.2, 0.3], [0.1, 0.15], [0.05, 0.06]])
    known = AbsorptionPosterior(
        NAMES, BANDS, a, a, a, np.zeros((2, 3, 3)), objects={"people": 100.0}
    )
    draws = np.tile(a, (N_DRAWS, 1, 1)) * np.linspace(0.5, 1.5, N_DRAWS)[:, None, None]
    absorption, drawn, _ = changed_draws(known, draws, changes, 5)
    return a, absorption, draws, drawn


def test_an_entry_of_the_catalogue_stands_with_its_mean_and_spread():
    """Half of the draws are below the median, which lies near the mean; others stay."""
    mean, sd = catalogue_prior("plaster-on-masonry", BANDS)
    a, absorption, draws, drawn = drawn_with(
        Change("wall", "catalogue", entry="plaster-on-masonry")
    )
    np.testing.assert_array_equal(absorption[0], mean)
    np.testing.assert_array_equal(absorption[1:], a[1:])
    np.testing.assert_array_equal(drawn[:, 1:], draws[:, 1:])
    # four standard errors of a share of a half
    assert np.abs((drawn[:, 0] < mean).mean(axis=0) - 0.5).max() < 4 * 0.5 / np.sqrt(N_DRAWS)
    # the spread of the logit is that of the mean to first order
    logits = np.log(drawn[:, 0] / (1.0 - drawn[:, 0]))
    np.testing.assert_allclose(logits.std(axis=0), sd / (mean * (1.0 - mean)), rtol=0.05)
    # bands are off alike as far as tables are; within four standard errors
    apart = find_material("plaster-on-masonry").octave_correlation
    found = np.corrcoef(logits.T)[0, 1]
    assert abs(found - apart) < 4 * (1.0 - apart**2) / np.sqrt(N_DRAWS)
    assert band_correlation("Carpet", bands_between("octave", 500, 2000))[0, 2] == pytest.approx(
        find_material("carpet").octave_correlation ** 2
    )


def test_another_material_of_the_room_is_taken_with_its_own_draws():
    a, absorption, draws, drawn = drawn_with(Change("wall", "catalogue", entry="floor"))
    np.testing.assert_array_equal(absorption[0], a[1])
    np.testing.assert_array_equal(drawn[:, 0], draws[:, 1])


def test_an_object_is_set_in_square_metres_as_the_absorption_they_stand_for():
    """In 100 m3 ten times the area is ten times the attenuation; the spread is that of the area."""
    _, absorption, _, drawn = drawn_with(Change("people", "value", (0.8,), (0.08,)))
    _, larger, _, _ = drawn_with(Change("people", "value", (8.0,)))
    np.testing.assert_allclose(np.log1p(-larger[2]) / np.log1p(-absorption[2]), 10.0, rtol=1e-9)
    assert np.all(absorption[2] > 0.0) and absorption[2][0] == absorption[2][1]
    relative = drawn[:, 2].std(axis=0) / absorption[2]
    np.testing.assert_allclose(relative, 0.1, rtol=0.05)


def test_parts_of_a_material_make_the_mean_by_area_and_no_more_than_all_of_it():
    """40 % of one product and 20 % of another: what is left keeps its own, draw by draw."""
    one, other = Change("wall", "value", (0.8,), (0.05,)), Change("wall", "factor", (2.0,))
    (a, _, draws, whole), (*_, second) = drawn_with(one), drawn_with(other)
    parts = replace(one, share=0.4), replace(other, share=0.2)
    _, absorption, _, drawn = drawn_with(*parts)
    np.testing.assert_allclose(absorption[0], 0.4 * a[0] + 0.4 * 0.8 + 0.2 * 2.0 * a[0])
    by_hand = 0.4 * draws[:, 0] + 0.4 * whole[:, 0] + 0.2 * second[:, 0]
    np.testing.assert_allclose(drawn[:, 0], by_hand, atol=1e-12)
    with pytest.raises(InputError, match="changed twice"):
        drawn_with(one, replace(other, share=0.1))


@pytest.mark.parametrize(
    "text",
    [
        "wall=40% 0.3+-0.05",
        "wall=12.5% x1.5",
        "wall=7% curtain-heavy",
        "wall=0.1,0.2",
        "wall=0, 1",
        "a b=x2",
    ],
)
def test_a_change_is_read_as_it_is_written(text):
    assert change_text(read_change(text)) == text


@pytest.mark.parametrize("text", ["wall=0,1", "wall=40% 0,25", "people=12,5"])
def test_a_decimal_comma_is_no_list_of_two_bands(text):
    """Of two bands 0,1 had become 0 and 1."""
    with pytest.raises(InputError, match=r"(?s)may stand for a point.*\d\.\d+ for one number"):
        read_change(text)


@pytest.mark.parametrize("text", ["wall=0% 0.3", "wall=120% 0.3", "wall=40% 0.3,"])
def test_a_part_that_is_none_is_refused(text):
    with pytest.raises(InputError, match="not written as it must be"):
        read_change(text)
