"""What the figure of a predicted decay draws, of curves that are written down here."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from roomfit.bands import bands_between
from roomfit.prediction.decay import PredictedDecay
from roomfit.prediction.output import predicted_decay_figure
from roomfit.prediction.tables import PredictedPair, PredictedValue

BANDS = bands_between("octave", 500, 1000)
TIME_S = np.linspace(0.0, 0.6, 61)


def line(decay_s: float) -> np.ndarray:
    return np.stack([-60.0 * TIME_S / decay_s, -60.0 * TIME_S / (1.1 * decay_s)])


@pytest.mark.parametrize(
    ("changes", "compares", "labels"),
    [
        ((), False, {"predicted": 0.6, "measured": 0.7}),
        (
            ("wall=0.3",),
            True,
            {
                "predicted after the change": 0.6,
                "predicted before the change": 0.8,
                "measured before the change": 0.7,
            },
        ),
    ],
)
def test_each_curve_stands_in_the_panel_of_its_band_under_its_name(changes, compares, labels):
    nothing = np.full(2, np.nan)
    time_s = PredictedValue(np.array([0.6, 0.66]), *[nothing] * 7)
    before_db = line(0.8) if changes else None
    decay = PredictedDecay(TIME_S, line(0.6), line(0.5), line(0.75), line(0.7), before_db)
    pair = PredictedPair("S", "R", None, {"T30_s": time_s}, decay)
    predicted = SimpleNamespace(bands=BANDS, changes=changes, compares_states=compares)
    figure = predicted_decay_figure(predicted, pair)
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert [axes.get_title() for axes in panels] == ["500 Hz: T30 0.60 s", "1000 Hz: T30 0.66 s"]
    for band, axes in enumerate(panels):
        drawn = {own.get_label(): own.get_xydata() for own in axes.lines}
        assert drawn.keys() == labels.keys()
        for label, decay_s in labels.items():
            np.testing.assert_allclose(drawn[label][:, 0], TIME_S)
            np.testing.assert_allclose(drawn[label][:, 1], line(decay_s)[band])
        (area,) = axes.collections
        corners = area.get_paths()[0].vertices
        at = corners[np.isclose(corners[:, 0], 0.3)][:, 1]
        assert (at.min(), at.max()) == pytest.approx((line(0.5)[band, 30], line(0.75)[band, 30]))
