"""Whatever room parameters a table holds, text, pictures and report show those and no others."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from report_cases import answer_of, read_page, scene_of, texts_of
from roomfit.files.results import result_content
from roomfit.predict.prediction import Predicted, PredictedDecay, PredictedPair, PredictedValue
from roomfit.report.answer import report_html
from roomfit.report.prediction_figures import predicted_decay_figure
from roomfit.report.tables import error_tables, pair_table, sti_tables
from roomfit.report.wording import DASH
from roomfit.result import Compared

# How each is written, and which stands for the decay time: the first of these that is there.
SYMBOLS = {
    "T20_s": "T20", "T30_s": "T30", "EDT_s": "EDT", "C50_dB": "C50", "C80_dB": "C80",
    "D50_percent": "D50", "TS_ms": "TS", "G_dB": "G",
}  # fmt: skip
TIMES = ("T30_s", "T20_s", "EDT_s")
SUBSETS = [s for n in range(1, 9) for s in combinations(SYMBOLS, n)]
SCENE = scene_of()
ONE_BAND = answer_of(SCENE, low=1000, high=1000, kept=(1,))


def with_parameters(names, *, curves=False):
    """Return an answer in one band, a pair fitted and one not, that holds these parameters."""

    def changed(pair):
        whole = dict(pair.parameters)
        whole["G_dB"] = Compared(*np.array([[12.0], [12.5], [11.0], [0.5]]))
        kept = {name: whole[name] for name in SYMBOLS if name in names}
        return replace(pair, parameters=kept, decay=pair.decay if curves else None)

    return replace(ONE_BAND, pairs=tuple(map(changed, ONE_BAND.pairs)))


def time_of(names):
    return next((name for name in TIMES if name in names), None)


def test_the_tables_of_the_report_show_the_parameters_and_no_others():
    for names in SUBSETS:
        answer = with_parameters(names)
        expected = [SYMBOLS[n] for n in SYMBOLS if n in names]
        assert list(pair_table(answer).names[1:]) == expected
        for table in error_tables(answer):
            assert [row[0] for row in texts_of(table)] == expected


# with the curves of a recording: once where a decay time stands below them and once where none does
ALONE = [*((name, False) for name in SYMBOLS), ("T20_s", True), ("C50_dB", True)]


@pytest.mark.parametrize(("name", "curves"), ALONE)
def test_a_whole_page_and_the_whole_text_of_one_parameter_alone(name, curves):
    answer = with_parameters((name,), curves=curves)
    page = read_page(report_html(answer, SCENE, title=name))
    (pairs,) = [rows for caption, rows in page.tables.items() if "in JND: mean" in caption]
    assert pairs.pop("pair") == [[SYMBOLS[name]]]
    assert {len(cells) for cells in pairs.values()} == {1} and "S1 to R1" in pairs
    assert "Findings" not in str(answer)


def predicted_with(names):
    one = np.array([1.0])
    value = PredictedValue(one, one - 0.1, one + 0.1, one, one, one, one, one)
    time_s = np.linspace(0.0, 1.0, 30)
    level = -50.0 * time_s[None]
    decay = PredictedDecay(time_s, level, level - 1.0, level + 1.0, None)
    table = {name: value for name in SYMBOLS if name in names}
    pair = PredictedPair("S1", "R1", "fit", table, decay)
    answer = ONE_BAND
    return Predicted(
        answer.bands, answer.materials, answer.absorption, answer.lower95, answer.upper95,
        (), (pair,), table, (), 8, 1, 0.1,
    )  # fmt: skip


def test_the_speech_transmission_index_stands_in_text_report_and_result():
    """Straight decays of all seven octaves; a pair without a curve, or another band, has none."""
    answer = answer_of(SCENE, low=125, high=8000, kept=(1,))
    assert "Speech transmission index of the room alone" in str(answer)
    (table,) = sti_tables(answer)
    titles, measured, predicted, _ = zip(*texts_of(table), strict=True)
    assert titles == ("S1 to R1", "S1 to R2 (not fitted)")
    content = [pair["sti"] for pair in result_content(answer, [])["pairs"]]
    assert list(measured) == [f"{c['measured']:.2f}" for c in content]
    assert list(predicted) == [f"{c['predicted']:.2f}" for c in content]
    caption = next(
        c for c in read_page(report_html(answer, SCENE, title="A")).tables if "Speech" in c
    )
    assert "without noise" in caption
    # the only other pair was not fitted, so that the fitted one has no baseline
    assert table.rows[0][3].small[0] == f"others {DASH}"
    bare = replace(answer, pairs=tuple(replace(p, decay=None) for p in answer.pairs))
    for other in (bare, answer_of(SCENE, low=125, high=4000)):
        assert sti_tables(other) == () and "Speech" not in str(other)
        assert all("sti" not in pair for pair in result_content(other, [])["pairs"])


@pytest.mark.slow
def test_predictions_show_the_parameters_that_are_there():
    for names in SUBSETS:
        predicted = predicted_with(names)
        shown = str(predicted)
        time = time_of(names)
        assert time is None or shown.startswith(f"{SYMBOLS[time]} at ")
        assert "STI is not predicted: it needs the octave bands" in shown
        rows = [line.split()[0] for line in shown.splitlines() if "(predicted)" in line]
        assert set(rows) == {SYMBOLS[n] for n in names}, names
        panel, named = predicted_decay_figure(predicted, predicted.pairs[0]).axes[0], time_of(names)
        assert panel.get_title("left") == "1000 Hz"
        words = [text.get_text() for text in panel.texts]
        assert words == ([f"{SYMBOLS[named]} 1.00 s"] if named else [])
