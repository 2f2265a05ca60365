"""Predictions in text, page and picture: before and after, side by side."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

import roomfit
from roomfit.base.bands import bands_between
from roomfit.base.findings import About, Code, Finding
from roomfit.base.logit import logit
from roomfit.predict.changes import Change
from roomfit.predict.predict import predict
from roomfit.predict.question import Question
from roomfit.report.html import page as html_page
from roomfit.report.predicted import describe
from roomfit.report.text import text
from roomfit.signals.iso3382 import MeasuredValues
from roomfit.uncertainty.posterior import AbsorptionPosterior

BANDS = bands_between("octave", 125, 8000)
FEW = roomfit.Settings(n_rays=2000, n_draws=8)
SIDES = ("west", "east", "south", "north", "ceiling")
MEASURED = MeasuredValues("S", "R", BANDS.centres_hz, {"T20_s": [0.8] * 7, "C80_dB": [4.0] * 7})
ORDER = ["measured before", "expected before", "expected after"]


def foreseen(changes, known_walls: bool = True):
    room = roomfit.shoebox_room((6.0, 5.0, 3.0), dict.fromkeys(SIDES, "walls") | {"floor": "floor"})
    scene = roomfit.scene_of(room, {"S": (1.5, 1.2, 1.5)}, {"R": (4.0, 3.5, 1.2)})
    a, sd = np.full((2, 7), 0.15), np.array([0.1, 0.1 if known_walls else 0.0])[:, None]
    low, high = (1.0 / (1.0 + np.exp(-(logit(a) + s * 1.96 * sd))) for s in (-1, 1))
    if not known_walls:
        # as of a material that the result does not name
        low[1], high[1] = 0.0, 1.0
    covariance = np.tile(np.diag(sd[:, 0] ** 2), (7, 1, 1))
    known = AbsorptionPosterior(
        room.materials, BANDS, a, low, high, covariance, scattering=np.full(a.shape, 0.4)
    )
    return predict(Question(scene, known, changes, [MEASURED], settings=FEW))


def page_of(predicted):
    return html_page(describe(predicted))


CHANGE = Change("floor", "value", (0.5,) * 7, (0.05,) * 7)


@pytest.fixture(scope="module")
def compared():
    return foreseen([CHANGE])


def test_the_page_has_all_parameters_in_the_order_of_time_per_pair_and_mean(compared):
    page = page_of(compared)
    tables = re.findall(r"<caption>(.*?)</caption>(.*?)</table>", page, flags=re.DOTALL)
    captions = [unescape(c) for c, _ in tables]
    assert captions.pop(0) == "T30 in s, mean over the positions"
    tables = tables[1:]
    assert captions[0].startswith("Mean over the pairs")
    assert captions[1].startswith("Speech transmission index")
    assert captions[2] == "S to R, measured"
    rows = re.findall(r'<th scope="row">(.*?)</th>', tables[2][1])
    heads = [re.sub(r"<small>.*", "", r).strip() for r in rows]
    kinds = [re.search(r"<small>(.*?)</small>", r).group(1) for r in rows]
    assert [h for h in heads if h] == [
        "T20 s", "T30 s", "EDT s", "C50 dB", "C80 dB", "D50 %", "TS ms", "G dB",
    ]  # fmt: skip
    first = kinds[: kinds.index("change %") + 1]
    assert first == [*ORDER, "change %"]
    strength = kinds[heads.index("G dB") :]
    assert strength == ["expected before", "expected after", "change dB"]
    v = compared.pairs[0].parameters["T20_s"]
    for number in (v.change.before_lower95[0], v.predicted[0], v.upper95[0]):
        assert f"{number:.2f}" in tables[2][1]


def test_the_first_screen_has_one_picture_and_one_table_of_the_same_decay_times(compared):
    """Before and after in every band, with their intervals; the terminal has the same."""
    (picture,), answer = describe(compared).drawings(), compared.mean["T30_s"]
    before, after = picture.figure.axes[0].get_lines()[:2]
    np.testing.assert_array_equal(after.get_ydata(), answer.predicted)
    np.testing.assert_array_equal(before.get_ydata(), answer.change.before)
    said = text(describe(compared), details=False)
    assert len(said.splitlines()) <= 30 and "Mean over the pairs" not in said
    for row, values in (
        ("after the change", answer.predicted),
        ("predicted before", before.get_ydata()),
    ):
        line = next(x for x in said.splitlines() if x.startswith(row))
        assert line.removeprefix(row).split() == [f"{x:.2f}" for x in values]


def test_without_a_change_the_page_says_predicted_and_measured():
    page = page_of(foreseen([]))
    assert "before" not in re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL)
    assert "<small>measured</small>" in page


def with_change(compared, name: str, low: float, high: float, code: Code | None):
    """Return a prediction of which a finding doubts 500 Hz, where a change has another interval."""
    value = compared.mean[name]
    low95, high95 = value.change.change_lower95.copy(), value.change.change_upper95.copy()
    low95[2], high95[2] = low, high
    change = replace(value.change, change_lower95=low95, change_upper95=high95)
    mean = {**compared.mean, name: replace(value, change=change)}
    doubts = () if code is None else (Finding(code, About(bands_hz=[500]), "Doubt."),)
    return replace(compared, mean=mean, findings=doubts, pairs=())


@pytest.mark.parametrize(
    ("name", "low", "high", "code", "said"),
    [
        ("T30_s", 0.7, 4.2, Code.CHANGE_PRIOR_DOMINATED, "prior alone"),
        ("T30_s", 0.7, 1.5, Code.RESULT_DOUBTED, "result doubted"),
        ("T30_s", 0.7, 1.3, Code.CHANGE_PRIOR_DOMINATED, ""),  # within a factor of 2
        ("T30_s", 1.1, 4.2, Code.CHANGE_PRIOR_DOMINATED, ""),  # the sign is known
        ("T30_s", 0.7, 4.2, None, ""),  # nothing is open: interference of a pair
        ("C80_dB", -1.6, 1.6, Code.CHANGE_PRIOR_DOMINATED, "prior alone"),  # a factor of 10**.32
        ("C80_dB", -1.4, 1.4, Code.CHANGE_PRIOR_DOMINATED, ""),
        ("D50_percent", -40.0, 40.0, Code.CHANGE_PRIOR_DOMINATED, ""),
    ],
)
def test_a_change_without_sign_or_size_that_nothing_but_a_prior_knows_is_not_determined(
    compared, name, low, high, code, said
):
    found = with_change(compared, name, low, high, code)
    said_, page = " ".join(str(found).split()), page_of(found)
    cells = re.sub(r"\s+", " ", said_.split("Mean over", 1)[1])
    # of the sign alone the sentence tells, whatever is open
    shown = re.sub(r"whether it (falls|rises) is not determined", "", page)
    assert ("not determined" in cells) == ("not determined" in shown) == bool(said)
    is_decay = name == "T30_s" and bool(said)
    lead = f"what the change does to it is not determined ({said})."
    assert (lead in said_) == is_decay
    if said:
        assert said in cells
