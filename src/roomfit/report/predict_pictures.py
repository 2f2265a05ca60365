"""A prediction in pictures: decay curves with the band that the absorption leaves open."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.uncertainty.prediction import Predicted, PredictedPair


def predicted_decay_figure(predicted: Predicted, pair: PredictedPair) -> Figure:
    """Return predicted energy decay curves of one pair, one panel a band, measured ones beside."""
    n = len(predicted.bands)
    columns = min(n, 3)
    rows = -(-n // columns)
    figure = new_figure(3.4 * columns, 2.4 * rows + 0.6)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    decay, t20 = pair.decay, pair.parameters["T20_s"]
    shown_s = 1e-3
    for j, axes in enumerate(panels.ravel()):
        if j >= n:
            axes.set_visible(False)
            continue
        axes.fill_between(
            decay.time_s, decay.lower_db[j], decay.upper_db[j], color=OKABE_ITO[1], alpha=0.25,
            lw=0.0, label="95 % of the absorptions that are possible",
        )  # fmt: skip
        axes.plot(
            decay.time_s, decay.predicted_db[j], color=OKABE_ITO[1], lw=1.6, label="predicted"
        )
        if decay.measured_db is not None:
            axes.plot(decay.time_s, decay.measured_db[j], color="black", lw=1.4, label="measured")
        shown_s = max(shown_s, float(decay.time_s[decay.predicted_db[j] > -45.0].max(initial=0.0)))
        label = f"{predicted.bands.centres_hz[j]:g} Hz"
        if np.isfinite(t20.predicted[j]):
            label += f": T20 {t20.predicted[j]:.2f} s"
        axes.set_title(label, fontsize=9)
        axes.grid(alpha=0.25)
    panels[0, 0].set_ylim(-45.0, 2.0)
    panels[0, 0].set_xlim(0.0, shown_s)
    figure.supxlabel("time after emission (s)")
    figure.supylabel("energy decay curve (dB)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    title = f"{pair.source} to {pair.receiver}"
    if predicted.changes:
        title += " with " + "; ".join(predicted.changes)
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, title=title)
    return figure
