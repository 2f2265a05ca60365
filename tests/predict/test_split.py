"""How the absorption that was measured is split among walls, where the data do not say it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.base.errors import InputError, InsufficientDataError
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import logit
from roomfit.base.typing import VALUE_NAMES
from roomfit.files.campaign import read_campaign
from roomfit.files.questions import Wanted, question_of
from roomfit.materials.priors import DEFAULT_LOGIT_SD
from roomfit.predict.changes import read_change
from roomfit.predict.split import for_another_room
from roomfit.uncertainty.posterior import AbsorptionPosterior, FittedPair

BANDS = bands_between("octave", 500, 1000)
NAMES, AREAS = ("walls", "curtain", "floor"), np.array([80.0, 25.0, 40.0])
NOTHING = np.full((len(VALUE_NAMES), 2), np.nan)
AS_DESCRIBED = FittedPair("S", "R", "", 2.0, NOTHING, NOTHING)
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


def test_a_room_with_other_areas_says_what_the_prior_decides_and_the_same_room_does_not():
    """The curtain opened: less of it, more of the walls behind it."""
    known = one_decay()
    same, findings = for_another_room(known, dict(zip(NAMES, AREAS, strict=True)), 64, 1)
    assert same is known and findings == ()
    opened, findings = for_another_room(known, {"walls": 100.0, "floor": 40.0}, 64, 1)
    assert {m for f in findings for m in f.about.materials} == {"walls", "curtain"}
    assert {f.code for f in findings} == {Code.CHANGE_PRIOR_DOMINATED}
    assert opened.is_other_room
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


def test_other_walls_are_not_predicted_where_the_result_is_seriously_doubted(tmp_path):
    """And nothing else is left out: the room as it was fitted, and bands without the doubt."""
    file = tmp_path / "campaign.toml"
    file.write_text(TURNED)
    campaign, change = read_campaign(file, to_fit=False), read_change("curtain=0.3+-0.1,0.4+-0.2")
    wrong = Finding(Code.DECAY_NOT_REPRODUCED, About(bands_hz=[500]), "")
    mild = Finding(Code.MODEL_DOES_NOT_FIT, About(bands_hz=[1000]), "")
    about = About(materials=["floor"], bands_hz=[1000])
    of_one = Finding(Code.REFLECTION_DISAGREES, about, "", graded="serious")
    known = one_decay(fitted=(AS_DESCRIBED,), result_findings=(wrong, mild, of_one))
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
    with pytest.raises(InputError, match="one value per band") as refused:
        question_of(campaign, known, [read_change("curtain=0.3,0.4,0.5")])
    assert "500 Hz, 1000 Hz" in str(refused.value)
    everywhere = replace(known, result_findings=(DISPLACED,))
    with pytest.raises(InsufficientDataError, match="seriously doubted") as refused:
        question_of(campaign, everywhere, [change])
    assert "displacement-detected" in str(refused.value) and "--doubted" in str(refused.value)
