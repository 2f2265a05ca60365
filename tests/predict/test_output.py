"""What the figure of a predicted decay draws, of curves that are written down here."""

from __future__ import annotations

import numpy as np
import pytest

from roomfit.base.bands import bands_between
from roomfit.predict.prediction import PredictedValue, ValueChange
from roomfit.report.predicted import decay_answer, parameter_lines


@pytest.mark.parametrize(
    ("bounds", "after", "says"),
    [
        (
            (0.8, 0.95),
            0.86,
            "falls from 0.89 s (predicted, 0.80 to 0.99) to 0.86 s (0.72 to 1.02).",
        ),
        ((0.8, 1.1), 0.86, "whether it falls is not determined."),
        ((0.95, 1.3), 0.99, "whether it rises is not determined."),
        (
            (1.02, 1.3),
            0.99,
            "rises from 0.89 s (predicted, 0.80 to 0.99) to 0.99 s (0.72 to 1.02).",
        ),
        ((0.9, 1.1), 0.892, "stays at 0.89 s (predicted, 0.80 to 0.99): 0.89 s (0.72 to 1.02)"),
        ((np.nan, np.nan), 0.86, "falls from 0.89 s"),  # no draws, no interval
    ],
)
def test_a_sentence_says_falls_only_where_the_interval_of_the_change_does(bounds, after, says):
    """Of the means at 500 and 1000 Hz; one band alone may be beyond "none"."""
    two, apart, none = np.ones(2), np.array([-0.03, 0.03]), np.full(2, np.nan)
    change = ValueChange(
        0.89 * two, 0.8 * two, 0.99 * two, after / 0.89 * two, bounds[0] + apart, bounds[1] + apart,
        none, none, none,
    )  # fmt: skip
    value = PredictedValue(
        after * two, 0.72 * two, 1.02 * two, none, none, none, none, none, change
    )
    answer = decay_answer(bands_between("octave", 500, 1000), {"T30_s": value}, is_changed=True)
    assert f"T30 at mid frequencies {says}" in answer.sentence or answer.sentence.endswith(says)
    if "determined" in says:
        assert "0.89 s (predicted, 0.80 to 0.99), and 0." in answer.sentence
        assert "s (0.72 to 1.02) is expected after the change" in answer.sentence


def test_changes_have_a_sign_and_the_unit_of_what_changes():
    """A decay time in %, a share in points, and a level in dB; what it was before has none."""
    one = np.ones(1)
    expected = {
        "T20_s": (1.1, "change %", "+10 +5 to +20", "1.10 1.05 to 1.20"),
        "C80_dB": (2.0, "change dB", "+2.0 +1.9 to +2.2", "2.0 1.9 to 2.2"),
        "D50_percent": (-3.0, "change points", "-3 -4 to +1", "-3 -4 to 1"),
    }
    bounds = {"T20_s": (1.05, 1.2), "C80_dB": (1.9, 2.2), "D50_percent": (-4.0, 1.0)}
    for name, (change, label, changed, before) in expected.items():
        rows = [change * one, bounds[name][0] * one, bounds[name][1] * one]
        value = PredictedValue(*rows, *[np.full(1, np.nan)] * 5, ValueChange(*rows, *rows, *rows))
        lines = parameter_lines({name: value}, is_changed=True)
        found = {what: f"{cell.text} {cell.small[0]}" for _, what, (cell,) in lines}
        assert (found[label], found["model before"]) == (changed, before)
        assert "carried over" not in found  # nothing was measured
