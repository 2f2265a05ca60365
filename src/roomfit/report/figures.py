"""Figures by matplotlib: what all share, SVG and PNG, and those of an identification."""

from __future__ import annotations

import html
import io
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_bytes_atomically, write_text_atomically
from roomfit.checks.usable import CheckedRecordings
from roomfit.report import wording
from roomfit.report.blocks import Blocks
from roomfit.result import ComparedPair, Result
from roomfit.signals.decay import FIT_RANGES_DB, decay_curve_db, evaluated_line, jnd_of
from roomfit.signals.filters import filter_pressure
from roomfit.signals.measurement import MeasuredPair

LOWEST_DB = -45.0
_WIDTH_IN = 10.2
# Curves of many pairs in one figure: about ten characters a point keep them below a megabyte.
_POINTS_IN_ALL, _FEWEST_POINTS, _MOST_POINTS = 60_000, 16, 120
CURVES = "class:curve-"
# a letter that the type lacks is a box
_UNKNOWN_LETTER = "Glyph .* missing from"


# ---------------------------------------------------------------- files


def write_pictures(folder: Path, answer: Blocks, *, png_too: bool = False) -> None:
    """Write the figures of an answer as SVG files, the same that its page shows; PNG beside them.

    Of a figure that shows one of several choices, each of the first choices is a file.
    """
    for shown in answer.drawings():
        for i, name in enumerate(shown.files or (shown.name,)):
            element = shown.svg if len(shown.choices) < 2 else _with_curves(shown.svg, i)
            written = element.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
            write_text_atomically(folder / f"{name}.svg", f"{written}\n")
            if not png_too:
                continue
            for artist in shown.figure.findobj(lambda a: str(a.get_gid()).startswith(CURVES)):
                artist.set_visible(artist.get_gid() == f"{CURVES}{i}")
            write_bytes_atomically(folder / f"{name}.png", png(shown.figure))


def _with_curves(element: str, chosen: int) -> str:
    """Return an SVG element without the groups of curves of other choices."""
    parts, at = [], 0
    for start in re.finditer(r'<g class="curve-(\d+)">', element):
        if start.start() < at or int(start[1]) == chosen:
            continue
        parts.append(element[at : start.start()])
        depth = 0
        for tag in re.finditer(r"<g[ >]|</g>", element[start.start() :]):
            depth += 1 if tag[0] != "</g>" else -1
            if depth == 0:
                at = start.start() + tag.end()
                break
    return "".join((*parts, element[at:]))


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.set_dpi(130)
    canvas: Any = FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", _UNKNOWN_LETTER)
        # two thirds of the time of the usual level, for files a fifteenth larger
        canvas.print_png(stream, pil_kwargs={"compress_level": 3})
    return stream.getvalue()


def svg(figure: Figure, name: str, title: str) -> str:
    """Return a figure as an SVG element to stand in an HTML page beside others.

    Equal figures give equal text. Words stay words, so that they can be searched and read aloud;
    the reader's sans-serif type replaces the one that was measured. Every id and style
    begins with `name`, so that figures of different names do not take each other's. What an
    artist's gid names as ``class:x`` is a group of the class ``x``.

    `title` is what the figure shows, for those who do not see it.
    """
    stream = io.StringIO()
    figure.set_dpi(72)  # that of SVG
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", _UNKNOWN_LETTER)
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(stream, metadata={"Date": None})
    figure.set_layout_engine("none")  # where it is drawn again, all stays in its place
    # the declaration, the document type and the licence of the metadata have no place in a page
    text = stream.getvalue()
    body = text[text.index(">", text.index("<svg ")) + 1 : text.rindex("</svg>")]
    body = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", body, flags=re.DOTALL)
    # matplotlib's rule for all elements would hold for the whole page
    body = re.sub(r"<defs>\s*<style[^>]*>.*?</style>\s*</defs>", "", body, flags=re.DOTALL)
    styles: dict[str, str] = {}
    body = re.sub(r"<[^>]+>", lambda tag: _short_tag(tag.group(), name, styles), body)
    body = re.sub(r">\s+<", "><", body.strip())
    rules = "".join(f".{rule}{{{style}}}" for style, rule in styles.items())
    width, height = figure.get_size_inches() * 72.0
    return (
        f'<svg role="img" aria-labelledby="{name}-title" viewBox="0 0 {width:g} {height:g}" '
        f'width="{width / 0.75:.0f}" height="{height / 0.75:.0f}" '
        f'class="{name}-all">'
        f'<title id="{name}-title">{html.escape(title)}</title>'
        f"<style>.{name}-all{{stroke-linejoin:round;stroke-linecap:butt}}{rules}</style>{body}</svg>"
    )


def _short_tag(tag: str, name: str, styles: dict[str, str]) -> str:
    """Return a tag with its names made unique, its style as a class, and its numbers short."""
    if tag.startswith("<g "):
        tag = re.sub(r'<g id="class:([\w-]+)"', r'<g class="\1"', tag)
        tag = re.sub(r' id="[^"]*"', "", tag)
    tag = re.sub(r' id="', f' id="{name}-', tag)
    tag = re.sub(r' (?:xlink:)?href="#', f' href="#{name}-', tag)
    tag = tag.replace("url(#", f"url(#{name}-")

    def ruled(found: re.Match[str]) -> str:
        style = re.sub(r"(font:[^;]*?[\d.]+px)[^;]*", r"\1 sans-serif", html.unescape(found[1]))
        style = re.sub(r"font-family:[^;]*", "font-family:sans-serif", style)
        style = re.sub(r"\s*([:;])\s*", r"\1", style.strip())
        style = re.sub(r"#([\da-f]{2})\1\1\b", _of_the_page, style)
        for colour, variable in (("#0072b2", "data"), ("#8a3c00", "warm")):
            style = style.replace(colour, f"var(--{variable},{colour})")
        return f' class="{styles.setdefault(style, f"{name}-s{len(styles)}")}"'

    def shorter(found: re.Match[str]) -> str:
        numbers = re.sub(r"-?\d+\.\d{3,}", lambda n: f"{float(n[0]):.2f}", found[2])
        numbers = re.sub(r"\s*([A-Za-z(),])\s*", r"\1", " ".join(numbers.split()))
        return f' {found[1]}="{numbers}"'

    tag = re.sub(r' style="([^"]*)"', ruled, tag)
    return re.sub(r' (d|x|y|width|height|transform)="([^"]*)"', shorter, tag)


def _of_the_page(grey: re.Match[str]) -> str:
    """Return a grey as the variable of the page that stands for it, so that it turns with it."""
    light = int(grey[1], 16)
    names = ((0x22, "ink"), (0x90, "soft"), (0xF0, "line"), (0xFF, "paper"))
    return f"var(--{next(name for most, name in names if light <= most)},{grey[0]})"


def say_in(figure: Figure, say: Callable[[str], str]) -> None:
    """Let the words and the ticks of a figure go through a translator."""
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        formatter: Any = axis.get_major_formatter()
        plain: Any = formatter.format_ticks
        formatter.format_ticks = partial(_each, say, plain)
    texts: Any = figure.findobj(Text)
    for text in texts:
        text.set_text(say(text.get_text()))


def _each(say: Any, plain: Any, at: Any) -> list[str]:
    return [say(text) for text in plain(at)]


# ---------------------------------------------------------------- what all figures share


def literal(name: str, longest: int = 34) -> str:
    """Return a name to be drawn: cut where it is long, no formula, never hidden from a legend."""
    shown = wording.shortened(" ".join(name.split()), longest).replace("$", r"\$")
    return f"\N{ZERO WIDTH SPACE}{shown}" if shown.startswith("_") else shown


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure whose labels never overlap: they are measured, which takes long."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def grid_of(
    rows: int, columns: int, width_in: float, height_in: float, **look: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with rows of panels, which `figure_legend` puts into their places."""
    figure = Figure(figsize=(width_in, height_in))
    FigureCanvasAgg(figure)
    panels: list[Axes] = list(figure.subplots(rows, columns, squeeze=False, **look).ravel())
    return figure, panels


def panels_of(n: int, across: str, up: str, height_in: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with n panels in rows that share both scales, their labels and a grid."""
    columns = min(n, 4 if n == 4 or n > 12 else 3)  # smaller where there are many
    rows = -(-n // columns)
    tall_in = height_in * (0.75 if columns > 3 else 1.0) * rows + 0.9
    # a single panel must leave room for the legend above it
    size_in = max(_WIDTH_IN / max(columns, 3) * columns, 4.6), tall_in
    figure, grid = grid_of(rows, columns, *size_in, sharex=True, sharey=True)
    for unused in grid[n:]:
        unused.set_visible(False)
    for i, axes in enumerate(grid[:n]):
        axes.grid(alpha=0.25)
        axes.xaxis.set_tick_params(labelbottom=i + columns >= n)
        for axis in (axes.xaxis, axes.yaxis):  # without a label, whose place would be sought
            axis.set_label_coords(0.5, 0.5)
    figure.supxlabel(across, fontsize=10)
    figure.supylabel(up, fontsize=10, x=0.08 / size_in[0])
    return figure, grid[:n]


def figure_legend(figure: Figure, columns: int = 4, title: str = "") -> None:
    """Name once, above all panels, what any of them shows, and put the panels below it.

    A layout that measures every label takes as long as all else that is drawn.
    """
    found = (axes.get_legend_handles_labels() for axes in figure.axes)
    once = {x: h for handles, labels in found for h, x in zip(handles, labels, strict=True)}
    figure.legend(
        once.values(), once, loc="upper center", ncols=columns, frameon=False, fontsize=9,
        title=title or None, bbox_to_anchor=(0.5, 1.0), borderaxespad=0.2,
    )  # fmt: skip
    across, tall = figure.get_size_inches()
    above_in = 0.19 * -(-len(once) // columns) + 0.42 + (0.2 if title else 0.0)
    grid: Any = figure.axes[0].get_gridspec()
    counts, left_in, below_in, right_in = (grid.ncols, grid.nrows), 0.72, 0.62, 0.1
    spans = across - left_in - right_in, tall - above_in - below_in
    shares = (  # of the size of a panel
        gap * n / (span - gap * (n - 1))
        for gap, n, span in zip((0.16, 0.32), counts, spans, strict=True)  # inches between them
    )
    figure.subplots_adjust(
        left_in / across, below_in / tall, 1.0 - right_in / across, 1.0 - above_in / tall, *shares
    )


def frequency_axis(axes: Axes, centres_hz: FloatArray) -> None:
    """Give an axis octaves of equal width, labelled with the bands' nominal centres.

    Of more than ten bands every second octave is named.
    """
    named = centres_hz
    if len(centres_hz) > 10:
        named = centres_hz[np.abs(np.log2(centres_hz / 500.0) / 2.0 % 1.0 - 0.5) > 0.475]
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_locator(FixedLocator(list(named)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda f, _: wording.short_hertz(f)))
    axes.set_xlim(centres_hz[0] / 1.32, centres_hz[-1] * 1.32)


def bands_side_by_side(axes: Axes, centres_hz: FloatArray) -> FloatArray:
    """Give an axis a place for each band, and return the places."""
    heads = [wording.short_hertz(float(f)) for f in centres_hz]
    every = 3 if len(heads) > 10 else 1
    at = np.arange(len(heads), dtype=np.float64)
    axes.set_xticks(at, [h if k % every == 0 else "" for k, h in enumerate(heads)])
    axes.set_xlim(-0.6, len(heads) - 0.4)
    axes.grid(alpha=0.25, axis="y")
    return at


# ---------------------------------------------------------------- absorption


def absorption_figure(answer: Result, true_absorption: FloatArray | None = None) -> Figure:
    """Return absorption over frequency, one panel a material, the last for the mean by area.

    Filled points are identifiable, hollow ones are not, diamonds were given; bars are 95 %
    intervals. `true_absorption`, shape (n_materials, n_bands), is drawn as crosses.
    """
    n, centres = len(answer.materials), answer.bands.centres_hz
    across = f"{answer.bands.kind} band centre (Hz)"
    figure, panels = panels_of(n + 1, across, "absorption coefficient", 2.45)
    given = answer.lower95 == answer.upper95
    kinds: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("identifiable", answer.identifiable & ~given, {"marker": "o"}),
        ("not identifiable", ~answer.identifiable & ~given, {"marker": "o", "mfc": "white"}),
        ("given", given, {"marker": "D", "ms": 5, "color": "black"}),
    )
    for i, axes in enumerate(panels[:n]):
        value = answer.absorption[i]
        rows = (value, answer.lower95[i], answer.upper95[i])
        _with_intervals(axes, centres, rows, wording.OKABE_ITO[0])
        for label, chosen, look in kinds:
            # an entry of the legend wherever any panel has such points
            if chosen.any():
                look = {"color": wording.OKABE_ITO[0], "label": label, "ls": "none", **look}
                axes.plot(centres[chosen[i]], value[chosen[i]], **look)
        if true_absorption is not None:
            look = {"color": wording.OKABE_ITO[1], "ms": 7, "mew": 2, "label": "true"}
            axes.plot(centres, true_absorption[i], "x", **look)
        name = literal(answer.materials[i], 20 if n < 3 else 16)
        axes.set_title(name, fontsize=10, loc="left", y=1.0)
        area = f"{wording.number(float(answer.areas_m2[i]), 1)} m²"
        words = f"{area}, {int(answer.identifiable[i].sum())}/{len(centres)}"
        axes.set_title(words, fontsize=8, loc="right", color="0.3", y=1.0)
    _with_intervals(panels[n], centres, tuple(answer.mean_absorption), "black")
    panels[n].plot(centres, answer.mean_absorption[0], "s", color="black", ms=5)
    panels[n].set_title("mean of the room", fontsize=10, loc="left", y=1.0)
    frequency_axis(panels[0], centres)
    panels[0].set_ylim(-0.03, 1.03)
    figure_legend(figure)
    return figure


def _with_intervals(
    axes: Axes, centres_hz: FloatArray, rows: Sequence[FloatArray], colour: str
) -> None:
    """Draw a value in every band, joined, and its bounds."""
    value, lower, upper = rows
    bars = np.maximum(np.array([value - lower, upper - value]), 0.0)
    axes.plot(centres_hz, value, "-", color=colour, lw=0.9, alpha=0.45)
    axes.errorbar(centres_hz, value, yerr=bars, fmt="none", ecolor=colour, capsize=2.5, lw=1.2)


# ---------------------------------------------------------------- decay curves


def decay_figure(answer: Result, *pairs: ComparedPair) -> Figure:
    """Return measured and predicted energy decay curves, one panel a band, of pairs with curves.

    Of several pairs, the curves and words of the i-th are in the SVG groups ``curve-i``, and a page
    shows one of them at a time; curves have fewer points then.
    """
    figure, panels = decay_panels(answer.bands.centres_hz)
    shown_s = 1e-3
    n_points = _POINTS_IN_ALL // (2 * len(pairs) * len(panels))
    n_points = int(np.clip(n_points, _FEWEST_POINTS, _MOST_POINTS)) if len(pairs) > 1 else 0
    for i, pair in enumerate(pairs):
        group = f"{CURVES}{i}" if len(pairs) > 1 else None
        for j, axes in enumerate(panels):
            shown_s = max(shown_s, _draw_decay(axes, pair, j, n_points, group))
        title = f"{literal(pair.source)} to {literal(pair.receiver)}"
        title += f", {literal(pair.state)}" if pair.state else ""
        title += "" if pair.use == "fit" else ", not fitted"
        title_of_pair(figure, title, group)
    panels[0].set_xlim(0.0, shown_s)
    figure_legend(figure, title=" ")  # the names of pairs stand in place of its title
    return figure


def decay_panels(centres_hz: FloatArray) -> tuple[Figure, list[Axes]]:
    """Return a figure for decay curves, one panel a band."""
    across, up = "time after emission (s)", "energy decay curve (dB)"
    figure, panels = panels_of(len(centres_hz), across, up, 2.3)
    for axes, centre in zip(panels, centres_hz, strict=True):
        axes.set_title(f"{centre:g} Hz", fontsize=9, loc="left", y=1.0)
    panels[0].set_ylim(LOWEST_DB, 2.0)
    return figure, panels


def title_of_pair(figure: Figure, title: str, group: str | None) -> None:
    """Name a pair above all panels, in place of the title of their legend."""
    top = 1.0 - 0.05 / figure.get_figheight()
    figure.text(0.5, top, title, ha="center", va="top", gid=group)


def words_of_panel(axes: Axes, words: str, group: str | None) -> None:
    """Write something about a pair above the right end of a panel."""
    where: dict[str, Any] = {"transform": axes.transAxes, "ha": "right", "va": "bottom"}
    axes.text(1.0, 1.03, words, fontsize=8, color="0.2", gid=group, **where)


def _draw_decay(
    axes: Axes, pair: ComparedPair, band: int, n_points: int, group: str | None
) -> float:
    """Draw what is known of a pair in a band; return how long the measured curve is, in s."""
    decay = pair.decay
    if decay is None:
        return 0.0
    whole, (words, evaluated) = axes.get_yaxis_transform(), evaluated_decay(pair, band)
    # added as artists: `plot` and its like look for new limits each time
    drawn: list[Artist] = []
    if evaluated is not None:
        low, high = evaluated
        look: dict[str, Any] = {"color": wording.OKABE_ITO[4], "alpha": 0.16, "lw": 0}
        look |= {"label": "evaluated range", "transform": whole}
        drawn.append(Rectangle((0.0, low), 1.0, high - low, **look))
    if decay.noise_db is not None and decay.noise_db[band] > LOWEST_DB - 15.0:
        look = {"color": "0.45", "lw": 1.0, "ls": ":", "label": "noise, subtracted"}
        drawn.append(Line2D([0.0, 1.0], [decay.noise_db[band]] * 2, transform=whole, **look))
    measured, predicted = decay.measured_db[band], decay.predicted_db[band]
    for label, level_db, colour, style in (
        ("measured", measured, "black", "-"),
        ("predicted", predicted, wording.OKABE_ITO[1], "--"),
    ):
        observed = np.where(level_db > LOWEST_DB - 15.0, level_db, np.nan)
        kept = np.flatnonzero(np.isfinite(observed))
        if 0 < n_points < kept.size:
            kept = kept[np.linspace(0, kept.size - 1, n_points).round().astype(int)]
        look = {"color": colour, "lw": 1.6, "ls": style, "label": label}
        drawn.append(Line2D(decay.time_s[kept], observed[kept], **look))
    for artist in drawn:
        artist.set_gid(group)
        axes.add_artist(artist)
    words_of_panel(axes, words, group)
    known = np.isfinite(measured) & (measured > LOWEST_DB)
    return float(decay.time_s[known].max(initial=0.0))


def evaluated_decay(pair: ComparedPair, band: int) -> tuple[str, tuple[float, float] | None]:
    """Return the decay time that is known best in words, and the levels that it was read between.

    "" where a measured or a predicted one is missing, None where no measured one is.
    """
    known = [k for k, c in pair.parameters.items() if np.isfinite(c.measured[band])]
    key = wording.decay_time_key(known)
    if key is None:
        return "", None
    measured, predicted = (
        wording.number(float(x[band]), 2)
        for x in (pair.parameters[key].measured, pair.parameters[key].predicted)
    )
    words = f"{wording.parameter(key).symbol} {measured} → {predicted} s"
    words = words if np.isfinite(pair.parameters[key].predicted[band]) else ""
    high, low = FIT_RANGES_DB[key]
    return words, (-low, -high)


# ---------------------------------------------------------------- recordings


def recording_figure(checked: CheckedRecordings) -> Figure:
    """Return energy-time and decay curves of recordings, one panel a band, those of one at a time.

    With the line of T30, or of T20 where noise hides the range of T30, the arrival of the direct
    sound by the geometry, and the noise.
    """
    pairs = [p for p in checked.pairs if p is not None]
    figure, panels = decay_panels(checked.bands.centres_hz)
    n_points = _POINTS_IN_ALL // (3 * len(pairs) * len(panels))
    n_points = int(np.clip(n_points, 2 * _FEWEST_POINTS, 2 * _MOST_POINTS))
    for i, pair in enumerate(pairs):
        group = f"{CURVES}{i}" if len(pairs) > 1 else None
        filtered = filter_pressure(pair.curve.bands, pair.response)
        for band, axes in enumerate(panels):
            for artist in _recording_artists(axes, pair, band, filtered[band] ** 2, n_points):
                artist.set_gid(group)
                axes.add_artist(artist)
            words_of_panel(axes, _line_words(pair, band), group)
        title = f"{literal(pair.measurement.source)} to {literal(pair.measurement.receiver)}"
        title_of_pair(figure, f"{title} ({literal(pair.measurement.name)})", group)
    ends = [float(p.curve.usable_end_s.max()) for p in pairs]
    panels[0].set_xlim(0.0, 1.4 * max(ends))
    panels[0].set_ylim(-80.0, 3.0)
    figure.supylabel("level (dB)", fontsize=10, x=0.08 / figure.get_figwidth())
    figure_legend(figure, title=" ")
    return figure


def _recording_artists(
    axes: Axes, pair: MeasuredPair, band: int, energy: FloatArray, n_points: int
) -> Iterator[Artist]:
    """Yield what is drawn of a recording in a band; levels are below the highest of each curve."""
    size = max(len(energy) // n_points, 1)
    mean = energy[: len(energy) // size * size].reshape(-1, size).mean(axis=1)
    time_s = (np.arange(len(mean)) + 0.5) * size / pair.response.sampling_rate_hz
    time_s -= pair.response.time_zero_s
    highest = mean.max() or 1.0
    with np.errstate(divide="ignore"):
        level_db = 10.0 * np.log10(mean / highest)
    known = np.isfinite(level_db)
    look: dict[str, Any] = {"color": "0.5", "lw": 0.6, "label": "energy-time curve"}
    yield Line2D(time_s[known], level_db[known], **look)
    curve, whole = pair.curve, axes.get_yaxis_transform()
    kept = np.linspace(0, len(curve.time_s) - 1, n_points).round().astype(int)
    decay_db = decay_curve_db(curve)[band][kept]
    known = np.isfinite(decay_db)
    yield Line2D(curve.time_s[kept][known], decay_db[known], color="black", label="decay curve")
    if curve.noise_reached[band]:
        noise_db = 10.0 * np.log10(pair.noise.floor[band] / highest)
        yield Line2D([0, 1], [noise_db] * 2, transform=whole, color="0.45", ls=":", label="noise")
    if (line := evaluated_line(curve, pair.parameters, band)) is not None:
        look = {"color": wording.OKABE_ITO[1], "lw": 2.6, "alpha": 0.7}
        yield Line2D(line.ends_s, line.levels_db, label="line of T30, or of T20", **look)
    across = axes.get_xaxis_transform()
    look = {"color": wording.OKABE_ITO[0], "lw": 0.8, "ls": "--"}
    label = "direct sound by the geometry"
    yield Line2D([pair.direct_s] * 2, [0, 1], transform=across, label=label, **look)


def _line_words(pair: MeasuredPair, band: int) -> str:
    line = evaluated_line(pair.curve, pair.parameters, band)
    if line is None:
        return "no T20"
    value_s = wording.number(float(pair.parameters.of(line.name)[band]), 2)
    bent = f"\N{GREEK SMALL LETTER XI} {wording.number(line.nonlinearity_permille, 0)} ‰"
    return f"{wording.parameter(line.name).symbol} {value_s} s, {bent}"


# ---------------------------------------------------------------- decay times


def decay_time_figure(
    centres_hz: FloatArray,
    series: Sequence[wording.Series],
    symbol: str = "T30",
    limits: Sequence[tuple[Sequence[float], float, float]] = (),
) -> Figure:
    """Return decay times over frequency with their intervals.

    Pale boxes are one just noticeable difference about the first of the two or three series, which
    differ by shape and colour; black lines are limits: bands, lowest and highest time.
    """
    figure, (axes,) = grid_of(1, 1, 7.6, 3.2)
    at = bands_side_by_side(axes, centres_hz)
    first = series[0].values_s
    step = jnd_of("T30_s", first)
    # a box a band, wide enough for the marks of all series, which stand side by side
    axes.bar(
        at, 2.0 * step, 0.5, first - step, color=wording.OKABE_ITO[4], alpha=0.3, lw=0.0,
        label="just noticeable difference",
    )  # fmt: skip
    highest = [0.0]
    shift = 0.24 / max(len(series) - 1, 1)
    for i, (one, mark) in enumerate(zip(series, "so^", strict=False)):
        x, colour = at + shift * i - 0.12, wording.OKABE_ITO[i]
        if one.lower95_s is not None and one.upper95_s is not None:
            axes.vlines(x, one.lower95_s, one.upper95_s, color=colour, lw=1.8)
            known = one.upper95_s[np.isfinite(one.upper95_s)]
            highest.append(float(np.quantile(known, 0.75)) if known.size else 0.0)
        label = literal(one.label, 60)
        axes.plot(x, one.values_s, mark, color=colour, ms=5, label=label, ls="-", lw=0.8)
        highest.append(float(np.nanmax(one.values_s, initial=0.0)))
    for bands_hz, *values in limits:
        chosen = np.flatnonzero(np.isin(centres_hz, bands_hz))
        for value in filter(np.isfinite, values if chosen.size else ()):
            ends = chosen - 0.4, chosen + 0.4
            axes.hlines([value] * chosen.size, *ends, color="black", lw=2.0, label="target")
            highest.append(value)
    axes.set_ylim(0.0, 1.15 * max(highest))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"{symbol} (s)")
    figure_legend(figure)
    return figure
