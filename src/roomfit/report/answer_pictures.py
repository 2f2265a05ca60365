"""An answer in pictures: absorption with intervals, and decay curves."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from roomfit.report.pictures import OKABE_ITO, frequency_axis, new_figure
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer, ComparedPair


def absorption_figure(answer: Answer, true_absorption: FloatArray | None = None) -> Figure:
    """Return absorption over frequency, one panel a material.

    Filled points are identifiable, hollow ones are not; bars are 95 % intervals.

    Parameters
    ----------
    answer : Answer
    true_absorption : float array, shape (n_materials, n_bands), optional
        Drawn as crosses where the truth is known.
    """
    n = len(answer.materials)
    columns = min(n, 3)
    rows = -(-n // columns)
    figure = new_figure(3.4 * columns, 2.6 * rows + 0.5)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    centres = answer.bands.centres_hz
    for i, axes in enumerate(panels.ravel()):
        if i >= n:
            axes.set_visible(False)
            continue
        value, sure = answer.absorption[i], answer.identifiable[i]
        bars = np.array([value - answer.lower95[i], answer.upper95[i] - value])
        axes.errorbar(
            centres, value, yerr=np.maximum(bars, 0.0), fmt="none", ecolor=OKABE_ITO[0], capsize=2.5
        )
        axes.plot(centres[sure], value[sure], "o", color=OKABE_ITO[0], label="identified")
        axes.plot(
            centres[~sure], value[~sure], "o", color=OKABE_ITO[0], mfc="white",
            label="not identifiable",
        )  # fmt: skip
        if true_absorption is not None:
            axes.plot(
                centres, true_absorption[i], "x", color=OKABE_ITO[1], ms=7, mew=2, label="true"
            )
        frequency_axis(axes, centres)
        axes.set_ylim(-0.02, 1.02)
        axes.set_title(f"{answer.materials[i]}, {answer.areas_m2[i]:.1f} m²", fontsize=10)
        axes.grid(alpha=0.25)
    figure.supxlabel("octave band centre (Hz)" if answer.bands.kind == "octave" else "band (Hz)")
    figure.supylabel("absorption coefficient")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    return figure


def decay_figure(answer: Answer, pair: ComparedPair) -> Figure:
    """Return measured and predicted energy decay curves of one pair, one panel a band."""
    n = len(answer.bands)
    columns = min(n, 3)
    rows = -(-n // columns)
    figure = new_figure(3.4 * columns, 2.4 * rows + 0.5)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    decay = pair.decay
    if decay is None:
        raise ValueError("room parameters without a response have no decay curve")
    shown_s = 0.0
    for j, axes in enumerate(panels.ravel()):
        if j >= n:
            axes.set_visible(False)
            continue
        axes.plot(decay.time_s, decay.measured_db[j], color="black", lw=1.6, label="measured")
        axes.plot(
            decay.time_s, decay.predicted_db[j], color=OKABE_ITO[1], lw=1.6, ls="--",
            label="predicted",
        )  # fmt: skip
        known = np.isfinite(decay.measured_db[j]) & (decay.measured_db[j] > -45.0)
        shown_s = max(shown_s, float(decay.time_s[known].max(initial=0.0)))
        t20 = pair.parameters["T20_s"]
        label = f"{answer.bands.centres_hz[j]:g} Hz"
        if np.isfinite(t20.measured[j]) and np.isfinite(t20.predicted[j]):
            label += f": T20 {t20.measured[j]:.2f} s, predicted {t20.predicted[j]:.2f} s"
        axes.set_title(label, fontsize=9)
        axes.grid(alpha=0.25)
    panels[0, 0].set_ylim(-45.0, 2.0)
    panels[0, 0].set_xlim(0.0, max(shown_s, 1e-3))
    figure.supxlabel("time after emission (s)")
    figure.supylabel("energy decay curve (dB)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    title = f"{pair.source} to {pair.receiver}"
    title += "" if pair.use == "fit" else ", not fitted"
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False, title=title)
    return figure
