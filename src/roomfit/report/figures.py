"""How sure an answer is, in pictures: what is identifiable, profiles, and a posterior's corner.

The pictures of an answer as files in its folder.

An answer in pictures: absorption with intervals, and decay curves.

Boxes that a certified search leaves over, in two dimensions.

Figures without a window or a hidden state, and colours that everybody can tell apart.

Which profiles and which band's samples are worth a picture.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, NullLocator

from roomfit.cache import write_bytes_atomically
from roomfit.results import Answer, ComparedPair
from roomfit.typing import FloatArray, Progress
from roomfit.uncertainty.profile import RISE95, Profile, profile_curve

# The report shows the decays of all pairs; as files of their own they would take minutes.
MOST_DECAY_PICTURES = 12


def write_pictures(folder: Path, answer: Answer, progress: Progress | None = None) -> None:
    """Write absorption, what is identifiable, profiles, samples and decays as PNG files.

    Profiles and samples only where there are some; decays of the first twelve pairs.

    Parameters
    ----------
    folder : Path
    answer : Answer
    progress : callable, optional

    Raises
    ------
    StoreError
        The disk refuses.
    """

    write_bytes_atomically(folder / "absorption.png", png(absorption_figure(answer)))
    write_bytes_atomically(folder / "identifiable.png", png(identifiability_figure(answer)))
    bent, corner = profiles_figure(answer), corner_figure(answer)
    if bent is not None:
        write_bytes_atomically(folder / "profiles.png", png(bent))
    if corner is not None:
        write_bytes_atomically(folder / f"corner_{corner[0]:g}_hz.png", png(corner[1]))
    heard = [(number, p) for number, p in enumerate(answer.pairs, start=1) if p.decay]
    for number, pair in heard[:MOST_DECAY_PICTURES]:
        name = f"decay_{number:02d}_{_in_file_name(pair.source)}_{_in_file_name(pair.receiver)}"
        write_bytes_atomically(folder / f"{name}.png", png(decay_figure(answer, pair)))
        if progress is not None:
            progress(number / len(answer.pairs))


def _in_file_name(name: str) -> str:
    """Return a name without what a path gives a meaning to."""
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60]


# M. Okabe, K. Ito, "Color Universal Design" (2008), without the yellow that vanishes on white
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure whose labels never overlap."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, dpi: int = 130) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def frequency_axis(axes: Axes, centres_hz: FloatArray) -> None:
    """Give an axis octaves of equal width, labelled with the bands' nominal centres."""
    axes.set_xscale("log", base=2)
    axes.set_xticks(list(centres_hz))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda f, _: _hertz(f)))


def _hertz(frequency: float) -> str:
    return f"{frequency / 1000:g}k" if frequency >= 1000 else f"{frequency:g}"


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


def boxes_figure(
    covers: Mapping[str, FloatArray],
    names: tuple[str, ...],
    truth: FloatArray,
    grids: tuple[FloatArray, FloatArray, FloatArray],
    levels: Sequence[float],
) -> Figure:
    """Return one panel with the covers on top of each other, the widest first.

    Parameters
    ----------
    covers : mapping of label to float array, shape (n_boxes, 2, 2)
        Lower and upper absorption of each box. Every point whose error is below what the label
        says lies in one of them.
    names : tuple of two str
    truth : float array, shape (2,)
    grids : three float arrays, shape (n, n)
        Both absorptions and the error over a grid, for its contours.
    levels : sequence of float
        Rising: the errors that bound the covers, the smallest cover's first.
    """
    figure = new_figure(5.2, 5.0)
    axes = figure.subplots()
    for (label, boxes), colour in zip(covers.items(), (4, 0, 1), strict=False):
        patches = [Rectangle((b[0, 0], b[0, 1]), *(b[1] - b[0])) for b in boxes]
        axes.add_collection(
            PatchCollection(patches, facecolor=OKABE_ITO[colour], edgecolor="white", linewidth=0.4)
        )
        noun = "box" if len(boxes) == 1 else "boxes"
        axes.plot([], [], "s", color=OKABE_ITO[colour], label=f"{label}: {len(boxes)} {noun}")
    axes.contour(*grids, levels=list(levels), colors="black", linewidths=1.0)
    axes.plot([], [], "-", color="black", lw=1.0, label="where the error has just these values")
    axes.plot(*truth, "+", color="black", ms=12, mew=1.5, label="truth")
    widest = next(iter(covers.values()))
    low, high = widest[:, 0].min(axis=0), widest[:, 1].max(axis=0)
    margin = 0.08 * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_xlabel(f"absorption of {names[0]}")
    axes.set_ylabel(f"absorption of {names[1]}")
    axes.set_title("What is left after the proof", fontsize=10)
    figure.legend(loc="outside lower center", frameon=False, fontsize=9)
    return figure


MOST_PROFILES = 12


def shown_profiles(answer: Answer) -> list[tuple[int, Profile]]:
    """Return bands and profiles that took the place of a Gaussian, the widest.

    At most twelve, in the order of bands and materials.
    """
    bent = [
        (band, line)
        for band, lines in enumerate(answer.profiles)
        for line in lines
        if not line.gaussian and answer.interval_kinds[band][line.entry] == "profile"
    ]
    if len(bent) <= MOST_PROFILES:
        return bent
    worth = [answer.upper95[p.entry, b] - answer.lower95[p.entry, b] for b, p in bent]
    chosen = sorted(np.argsort(worth)[-MOST_PROFILES:])
    return [bent[i] for i in chosen]


def most_tied_band(samples: Sequence[FloatArray | None]) -> int | None:
    """Return the sampled band in which two materials are correlated most, None if none is.

    Examples
    --------
    >>> x = np.linspace(0.0, 1.0, 50)
    >>> most_tied_band([None, np.stack([x, x**0.5], axis=1), np.stack([x, x % 0.1], axis=1)])
    1
    """
    best: tuple[float, int] | None = None
    for band, draws in enumerate(samples):
        if draws is None:
            continue
        free = draws[:, np.ptp(draws, axis=0) > 0.0]
        n = free.shape[1]
        if n < 1:
            continue
        tied = np.abs(np.corrcoef(free.T)).reshape(n, n) - np.eye(n)
        most = float(tied.max())
        if best is None or most > best[0]:
            best = (most, band)
    return None if best is None else best[1]


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
