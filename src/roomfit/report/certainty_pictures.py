"""How sure an answer is, in pictures: what is identifiable, profiles, and a posterior's corner."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from roomfit.report.pictures import OKABE_ITO, new_figure
from roomfit.uncertainty.answer import Answer
from roomfit.uncertainty.choice import most_tied_band, shown_profiles
from roomfit.uncertainty.profile import RISE95, profile_curve

_MOST_MATERIALS = 6
_MOST_DRAWS = 800


def identifiability_figure(answer: Answer) -> Figure:
    """Return a matrix of materials by bands: the darker, the narrower the 95 % interval.

    A tick marks what is identifiable, G what was given.
    """
    width = answer.upper95 - answer.lower95
    n, m = width.shape
    figure = new_figure(1.8 + max(0.62 * m, 3.2), 1.4 + 0.36 * n)
    axes = figure.subplots()
    image = axes.imshow(width, cmap="Blues_r", vmin=0.0, vmax=1.0, aspect="auto")
    for i in range(n):
        for j in range(m):
            given = width[i, j] == 0.0
            mark = "G" if given else "\N{CHECK MARK}" if answer.identifiable[i, j] else ""
            ink = "white" if width[i, j] < 0.45 else "black"
            number = "" if given else f"{width[i, j]:.2f}".lstrip("0")
            axes.text(j, i, f"{mark} {number}".strip(), ha="center", va="center", color=ink, size=8)
    axes.set_xticks(range(m), [f"{f:g}" for f in answer.bands.centres_hz])
    if m > 10:
        axes.tick_params(axis="x", rotation=60)
    axes.set_yticks(range(n), answer.materials)
    axes.set_xlabel("band centre (Hz)")
    axes.set_title("\N{CHECK MARK} identifiable   G given", fontsize=9, loc="left")
    bar = figure.colorbar(image, ax=axes)
    bar.set_label("width of the 95 % interval")
    return figure


def profiles_figure(answer: Answer) -> Figure | None:
    """Return the profiles that took the place of Gaussian intervals, twelve at most.

    None where there are none.
    """
    shown = shown_profiles(answer)
    if not shown:
        return None
    columns = min(len(shown), 3)
    rows = -(-len(shown) // columns)
    figure = new_figure(3.0 * columns, 2.1 * rows + 0.6)
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, (band, line) in zip(panels.ravel(), shown, strict=False):
        a, low, high = (
            float(x[line.entry, band]) for x in (answer.absorption, answer.lower95, answer.upper95)
        )
        at = 1.0 / (1.0 + np.exp(-line.points))
        axes.axvspan(low, high, color=OKABE_ITO[4], alpha=0.25, lw=0, label="95 % interval")
        axes.axhline(RISE95, color="black", lw=0.8, ls=":", label="1.92")
        free, rise = profile_curve(line)
        axes.plot(at, line.rise, "o", ms=3.5, color=OKABE_ITO[0])
        between = 1.0 / (1.0 + np.exp(-free))
        axes.plot(between, rise, "-", lw=1.2, color=OKABE_ITO[0], label="profile")
        axes.axvline(a, color=OKABE_ITO[1], lw=1.0, label="answer")
        axes.set_ylim(0.0, 5.0)
        centre = answer.bands.centres_hz[band]
        axes.set_title(f"{answer.materials[line.entry]}, {centre:g} Hz", fontsize=9)
        axes.grid(alpha=0.25)
    for axes in panels.ravel()[len(shown) :]:
        axes.set_visible(False)
    figure.supxlabel("absorption coefficient")
    figure.supylabel("rise of the cost, all else fitted again")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    return figure


def corner_figure(answer: Answer) -> tuple[float, Figure] | None:
    """Return the centre of the sampled band whose materials hang together most, and its samples.

    Each material against each other, six at most, histograms on the diagonal; None where nothing
    was sampled.
    """
    band = most_tied_band(answer.samples)
    if band is None:
        return None
    draws = answer.samples[band]
    assert draws is not None  # noqa: S101 - the band was chosen among the sampled ones
    free = np.flatnonzero(np.ptp(draws, axis=0) > 0.0)[:_MOST_MATERIALS]
    n = free.size
    figure = new_figure(1.7 * n + 0.6, 1.6 * n + 0.6)
    panels = figure.subplots(n, n, squeeze=False, sharex="col")
    step = max(len(draws) // _MOST_DRAWS, 1)
    for row in range(n):
        for column in range(n):
            axes = panels[row, column]
            if column > row:
                axes.set_visible(False)
                continue
            x = draws[:, free[column]]
            if row == column:
                axes.hist(x, bins=30, color=OKABE_ITO[4])
                axes.axvline(answer.absorption[free[row], band], color=OKABE_ITO[1], lw=1.2)
                axes.set_yticks([])
            else:
                y = draws[:, free[row]]
                axes.plot(x[::step], y[::step], ".", ms=1.5, color=OKABE_ITO[0], alpha=0.5)
            if column == 0 and row > 0:
                axes.set_ylabel(answer.materials[free[row]], fontsize=8)
            elif column > 0:
                axes.set_yticklabels([])
            if row == n - 1:
                axes.set_xlabel(answer.materials[free[column]], fontsize=8)
            axes.tick_params(labelsize=7)
    centre = float(answer.bands.centres_hz[band])
    figure.suptitle(f"Samples of the absorption coefficients at {centre:g} Hz", fontsize=10)
    return centre, figure
