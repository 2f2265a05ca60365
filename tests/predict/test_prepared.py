"""Many changes of one room: what `predict` says of each, in a fraction of its time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.air import attenuation_per_m
from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import question_of
from roomfit.model import reduced_rows
from roomfit.predict.changes import read_change
from roomfit.predict.decay import RELATIVE
from roomfit.predict.other_walls import numbers_at
from roomfit.predict.predict import predict, predict_change, prepare
from roomfit.room.mesh import volume_m3
from roomfit.room.scene import material_areas_m2
from roomfit.signals.decay import jnd_of
from roomfit.signals.iso3382 import VALUE_NAMES
from roomfit.uncertainty.posterior import AbsorptionPosterior
from small_campaign import ABSORPTION, write_campaign

CHANGES = ("walls=0.3+-0.03", "carpet=x0.6", "tiles=0.6+-0.05", "carpet=0.7,0.8")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return read_campaign(write_campaign(tmp_path_factory.mktemp("prepared") / "campaign"))


@pytest.fixture(scope="module")
def given(campaign):
    a = np.array([[x] * 2 for x in ABSORPTION.values()])
    low, high = (1.0 / (1.0 + (1.0 / a - 1.0) * np.exp(s * 0.196)) for s in (1.0, -1.0))
    covariance = np.stack([0.01 * np.eye(len(a))] * 2)
    bands = bands_between("octave", 500, 1000)
    known = AbsorptionPosterior(tuple(ABSORPTION), bands, a, low, high, covariance)
    found = question_of(campaign, known)
    return replace(found, settings=replace(found.settings, n_draws=64))


@pytest.fixture(scope="module")
def room(given):
    return prepare(given, [[read_change(c)] for c in CHANGES])


@pytest.mark.slow
@pytest.mark.parametrize("text", CHANGES)
def test_a_prepared_room_predicts_a_change_as_predict_does(given, room, text):
    """Means within a twentieth of a just noticeable difference, widths of intervals within 3 %.

    Both evaluate all paths, which are followed longer where harder changes may be asked for; draws
    are the same. Changes are up to ten just noticeable differences.
    """
    change = [read_change(text)]
    found, expected = predict_change(room, change), predict(replace(given, changes=change))
    assert [f.code for f in found.findings] == [f.code for f in expected.findings]
    np.testing.assert_array_equal(found.absorption, expected.absorption)
    np.testing.assert_array_equal(found.lower95, expected.lower95)
    for name, one in expected.mean.items():
        other, unit = found.mean[name], jnd_of(name, one.predicted)
        width = one.upper95 - one.lower95
        assert np.all(np.abs(other.predicted - one.predicted) < 0.05 * unit), name
        np.testing.assert_allclose(other.upper95 - other.lower95, width, rtol=0.03)
        relative = np.where(RELATIVE[VALUE_NAMES.index(name)], one.change.before, 1.0)
        moved = relative * (other.change.change - one.change.change)
        assert np.all(np.abs(moved) < 0.05 * jnd_of(name, one.change.before)), name
        np.testing.assert_array_equal(other.change.before, one.change.before)
    for own, theirs in zip(found.pairs, expected.pairs, strict=True):
        for name, one in theirs.parameters.items():
            unit = jnd_of(name, one.predicted)
            assert np.all(np.abs(own.parameters[name].predicted - one.predicted) < 0.1 * unit)


def test_of_a_material_that_is_changed_in_part_the_rest_must_be_known(campaign, given):
    """All of it may be replaced where nothing was found of it."""
    names = [n for n in given.known.materials if n != "carpet"]
    at = [given.known.materials.index(n) for n in names]
    rows = [getattr(given.known, k)[at] for k in ("absorption", "lower95", "upper95")]
    covariance = given.known.logit_covariance[:, at][:, :, at]
    known = AbsorptionPosterior(tuple(names), given.known.bands, *rows, covariance)
    whole = question_of(campaign, known, [read_change("carpet=0.4")])
    assert "carpet" in whole.known.materials
    with pytest.raises(InputError, match="is not known"):
        question_of(campaign, known, [read_change("carpet=40% 0.4")])


def test_sabines_formula_stands_beside_a_change_of_decay_times(given, room):
    """``T = k V / (S a + 4 m V)``: the walls of the campaign's box are counted by hand here."""
    found = predict_change(room, [read_change("carpet=50% 0.8")])
    before, air_per_m = (
        given.known.absorption,
        attenuation_per_m(given.scene.air, given.known.bands),
    )
    names, areas_m2 = given.known.materials, material_areas_m2(given.scene.room)
    after = before.copy()
    after[names.index("carpet")] = 0.5 * (before[names.index("carpet")] + 0.8)
    air_m2 = 4.0 * volume_m3(given.scene.room.mesh) * air_per_m
    ratio = (areas_m2 @ before + air_m2) / (areas_m2 @ after + air_m2)
    for name in ("T30_s", "T20_s", "EDT_s"):
        change = found.mean[name].change
        np.testing.assert_allclose(change.sabine, change.before * ratio, rtol=1e-12)
        assert np.all(np.abs(np.log(change.sabine / found.mean[name].predicted)) < 0.5)
    assert np.isnan(found.mean["C80_dB"].change.sabine).all()


def test_few_rows_bring_the_energies_of_all_of_them(room):
    """Each wall changed, all of them, and cases between: whole energies within 1 %."""
    a = room.absorption.absorption
    traced = room.traced
    few = traced.reduced(0, a, 1500)
    assert all(len(rows) <= 1500 < len(traced.binned.rows[0]) for rows in few.by_band)
    edges_s = traced.binned.edges_s
    every_s = edges_s[:-1][:: reduced_rows.BINS_TOGETHER]
    np.testing.assert_array_equal(few.edges_s, [*every_s, edges_s[-1]])
    far = np.where(a < 0.4, 0.6, 0.15)
    points = [a, far, 0.5 * (a + far)]
    points += [np.where(np.arange(len(a))[:, None] == m, far, a) for m in range(len(a))]
    for point, energy in zip(points, few.energies(np.array(points)), strict=True):
        every = traced.energies(point)[0]
        np.testing.assert_allclose(energy.sum(axis=1), every.sum(axis=1), rtol=0.01)


def test_what_is_not_known_before_a_change_is_said(given):
    """Without an absorption of the carpet there is nothing from which to carry over."""
    known = given.known
    i = known.materials.index("carpet")
    covariance = known.logit_covariance.copy()
    covariance[:, i] = covariance[:, :, i] = 0.0
    low, high = known.lower95.copy(), known.upper95.copy()
    low[i], high[i] = 0.0, 1.0
    unknown = replace(known, logit_covariance=covariance, lower95=low, upper95=high)
    change = read_change("carpet=0.4")
    room = prepare(replace(given, absorption=unknown), [[change]])
    with pytest.raises(InputError, match="not known before the change"):
        numbers_at(room, known.absorption, room.draws)
    assert predict_change(room, [change]).mean["T30_s"].change is None
