"""How the absorption that was measured is split among walls, where the data do not say it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import logit
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import Wanted, question_of
from roomfit.materials.priors import DEFAULT_LOGIT_SD
from roomfit.predict.changes import read_change
from roomfit.predict.split import doubted_walls, for_another_room, open_splits
from roomfit.uncertainty.posterior import AbsorptionPosterior, draw_absorption

BANDS = bands_between("octave", 500, 1000)
NAMES, AREAS = ("walls", "curtain", "floor"), np.array([80.0, 25.0, 40.0])
CURTAIN = (Finding(Code.CHANGE_PRIOR_DOMINATED, About(materials=["curtain"], bands_hz=[1000]), ""),)
DISPLACED = Finding(Code.DISPLACEMENT_DETECTED, About(), "")


def one_decay(**more) -> AbsorptionPosterior:
    """Return walls of which a decay fixes the sum of exponents within 3 %, the prior the rest."""
    a = np.full((3, 2), 0.2)
    slopes = AREAS * 0.2 / np.sum(AREAS * -np.log(0.8))
    covariance = np.linalg.inv(np.eye(3) / DEFAULT_LOGIT_SD**2 + np.outer(slopes, slopes) / 0.03**2)
    mean, sd = np.full((3, 2), logit(np.array(0.15))), np.full((3, 2), DEFAULT_LOGIT_SD)
    return AbsorptionPosterior(
        NAMES, BANDS, a, 0.5 * a, 2.0 * a, np.stack([covariance] * 2), mean, sd,
        areas_m2=AREAS, **more,
    )  # fmt: skip


def sums(draws: np.ndarray) -> np.ndarray:
    return -np.einsum("m,dmb->db", AREAS, np.log1p(-draws))


def test_other_splits_leave_the_sum_of_exponents_and_hold_every_share():
    """Every second draw; a share from none to all of what 95 % absorption allows, by hand."""
    known = one_decay()
    draws = draw_absorption(known, 400, np.random.default_rng(1))
    found = open_splits(known, draws, CURTAIN, AREAS[None], 1)
    np.testing.assert_array_equal(found[:, :, 0], draws[:, :, 0])  # another band
    np.testing.assert_array_equal(found[::2], draws[::2])
    np.testing.assert_allclose(sums(found), sums(draws), rtol=1e-9)
    share = -AREAS[1] * np.log1p(-found[1::2, 1, 1]) / sums(found)[1::2, 1]
    # of 200 even draws the extremes lie within 0.03 of the ends but once in 400
    assert share.min() < 0.03 and share.max() > 0.97
    assert abs(np.median(share) - 0.5) < 0.12  # 3.4 standard deviations of a median of 200
    kept = found[1::2, [0, 2], 1] / found[1::2, [0, 2], 1].sum(axis=1, keepdims=True)
    assert np.all(np.isfinite(kept)) and np.all((found >= 0.0) & (found < 0.96))
    np.testing.assert_array_equal(found, open_splits(known, draws, CURTAIN, AREAS[None], 1))


def test_a_doubted_result_leaves_the_splits_of_what_it_doubts_open():
    wrong = Finding(
        Code.REFLECTION_DISAGREES, About(materials=["floor"], bands_hz=[500]), "", graded="serious"
    )
    mild = Finding(Code.REFLECTION_DISAGREES, About(bands_hz=[1000]), "")
    of_floor = one_decay(result_findings=(wrong, mild))
    assert doubted_walls(of_floor).tolist() == [[False, False], [False, False], [True, False]]
    draws = draw_absorption(of_floor, 400, np.random.default_rng(1))
    found = open_splits(of_floor, draws, (), AREAS[None], 1)
    # the other walls keep their proportions, and the sum stays
    shares = np.log1p(-found[:, 1, 0]) / np.log1p(-found[:, 0, 0])
    own = np.log1p(-draws[:, 1, 0]) / np.log1p(-draws[:, 0, 0])
    np.testing.assert_allclose(shares, own, rtol=1e-9)
    np.testing.assert_allclose(sums(found), sums(draws), rtol=1e-9)
    assert np.ptp(found[1::2, 2, 0]) > 0.5 and np.array_equal(found[:, :, 1], draws[:, :, 1])
    known = one_decay(result_findings=(DISPLACED,))
    assert doubted_walls(known).all()
    draws = draw_absorption(known, 400, np.random.default_rng(1))
    found = open_splits(known, draws, (), AREAS[None], 1)
    np.testing.assert_allclose(sums(found), sums(draws), rtol=1e-9)
    low, high = np.quantile(found, (0.025, 0.975), axis=0)
    assert np.all(low < 0.06) and np.all(high[1] > 0.6) and np.all(high[2] > 0.45)


def test_states_keep_their_own_sums_and_what_they_have_in_common():
    """The curtain of one state stands where a panel does in the other, by hand."""
    two = AbsorptionPosterior(
        (*NAMES, "panel"), BANDS, *(np.full((4, 2), x) for x in (0.2, 0.1, 0.3)),
        np.stack([0.3 * np.eye(4)] * 2), result_findings=(DISPLACED,),
    )  # fmt: skip
    areas = np.array([[80.0, 25.0, 0.0, 0.0], [80.0, 0.0, 40.0, 25.0]])
    draws = draw_absorption(two, 200, np.random.default_rng(1))
    found = open_splits(two, draws, (), areas, 1)
    first, second = (
        [-np.einsum("m,dmb->db", a, np.log1p(-d)) for d in (draws, found)] for a in areas
    )
    np.testing.assert_allclose(first[1], first[0], rtol=1e-9)
    # where the common walls take nearly all of the second state, a twentieth is left to others
    common = -80.0 * np.log1p(-found[:, 0])
    fits = common < 0.9 * second[0]
    assert np.mean(fits[1::2]) > 0.5
    np.testing.assert_allclose(second[1][fits], second[0][fits], rtol=1e-9)
    assert np.ptp(found[1::2, 3, 0]) > np.ptp(draws[:, 3, 0])


@pytest.mark.parametrize("doubts", [(), (DISPLACED,)])
def test_a_room_with_other_areas_is_predicted_with_its_splits_open_and_the_same_room_is_not(doubts):
    """The curtain opened: less of it, more of the walls behind it."""
    known = one_decay(result_findings=doubts)
    same, findings = for_another_room(known, dict(zip(NAMES, AREAS, strict=True)), 64, 1)
    assert same is known and findings == ()
    opened, findings = for_another_room(known, {"walls": 100.0, "floor": 40.0}, 64, 1)
    assert {m for f in findings for m in f.about.materials} == {"walls", "curtain"}
    assert {f.code for f in findings} == {Code.CHANGE_PRIOR_DOMINATED}
    assert opened.draws.shape == (64, 3, 2)
    assert np.quantile(opened.draws[:, 1], 0.9) > np.quantile(
        draw_absorption(known, 64, np.random.default_rng(1))[:, 1], 0.9
    )
    old = replace(known, areas_m2=None)  # of a file that does not say
    assert for_another_room(old, {"walls": 100.0}, 64, 1) == (old, ())


TURNED = """
[room]
shoebox = [8, 5, 5]
[room.materials]
walls = "walls"
floor = "floor"
ceiling = "curtain"
[[states]]
name = "turned"
materials = {ceiling = "floor", floor = "curtain", west = "curtain"}
[sources.S]
position = [1.5, 1.2, 1.5]
[receivers.R]
position = [4.0, 3.5, 1.2]
[identify]
from_hz = 500
to_hz = 1000
"""


@pytest.mark.parametrize("fitted", [("",), ("elsewhere",)])
def test_a_state_that_was_not_fitted_is_predicted_with_the_splits_of_a_doubted_result_open(
    tmp_path, fitted
):
    """Sums of exponents stay those of the room as described, of 130, 40 and 40 m2, by hand."""
    file = tmp_path / "campaign.toml"
    file.write_text(TURNED)
    campaign, areas = read_campaign(file, to_fit=False), np.array([130.0, 40.0, 40.0])
    own = {"fitted_states": fitted, "result_findings": (DISPLACED,)}
    known = replace(one_decay(**own), areas_m2=areas)
    arguments = question_of(campaign, known, (), Wanted(state="turned", doubted=True))
    found, scene = arguments.known, arguments.scene
    assert scene.pair_state.tolist() == [1] and found.draws.shape[1:] == (3, 2)
    for other in ({"result_findings": ()}, {"fitted_states": ("turned",)}):
        sure = question_of(campaign, replace(known, **other), (), Wanted(state="turned")).known
        assert sure.draws is None and len(sure.bands) == 2
    draws = draw_absorption(sure, len(found.draws), np.random.default_rng(campaign.settings.seed))
    np.testing.assert_array_equal(found.draws[::2], draws[::2])
    in_order = areas[[NAMES.index(name) for name in found.materials]]

    def exponents(drawn):
        return -np.einsum("m,dmb->db", in_order, np.log1p(-drawn))

    np.testing.assert_allclose(exponents(found.draws), exponents(draws), rtol=1e-9)
    assert np.quantile(found.draws, 0.99) > np.quantile(draws, 0.99)


def test_other_walls_are_not_predicted_where_the_result_is_seriously_doubted(tmp_path):
    """And nothing else is left out: the room as it was fitted, and bands without the doubt."""
    file = tmp_path / "campaign.toml"
    file.write_text(TURNED)
    campaign, change = read_campaign(file, to_fit=False), read_change("curtain=0.3+-0.1,0.4+-0.2")
    wrong = Finding(Code.DECAY_NOT_REPRODUCED, About(bands_hz=[500]), "")
    mild = Finding(Code.MODEL_DOES_NOT_FIT, About(bands_hz=[1000]), "")
    about = About(materials=["floor"], bands_hz=[1000])
    of_one = Finding(Code.REFLECTION_DISAGREES, about, "", graded="serious")
    known = one_decay(fitted_states=("",), result_findings=(wrong, mild, of_one))
    known = replace(known, areas_m2=np.array([130.0, 40.0, 40.0]))
    as_fitted = question_of(campaign, known).known
    assert as_fitted.bands.centres_hz.tolist() == [500.0, 1000.0]
    for changes, state in (([change], ""), ([], "turned")):
        found = question_of(campaign, known, changes, Wanted(state=state))
        assert found.known.bands.centres_hz.tolist() == [1000.0]
        (said,) = [f for f in found.known.findings if f.code is Code.RESULT_DOUBTED]
        assert said.about.bands_hz == (500.0,) and "decay-not-reproduced" in said.sentence
        assert [(c.values, c.sds) for c in found.changes] == [((0.4,), (0.2,))] * len(changes)
        whole = question_of(campaign, known, changes, Wanted(state=state, doubted=True))
        assert len(whole.known.bands) == 2 and whole.changes == tuple(changes)
    with pytest.raises(InputError, match="one value per predicted band") as refused:
        question_of(campaign, known, [read_change("curtain=0.3,0.4,0.5")])
    assert "500, 1000 Hz" in str(refused.value)
    everywhere = replace(known, result_findings=(DISPLACED,))
    with pytest.raises(InsufficientDataError, match="seriously doubted") as refused:
        question_of(campaign, everywhere, [change])
    assert "displacement-detected" in str(refused.value) and "--doubted" in str(refused.value)
