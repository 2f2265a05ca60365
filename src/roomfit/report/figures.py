"""Figures by matplotlib: what all share, SVG and PNG, and those of an identification."""

from __future__ import annotations

import html
import io
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch, Rectangle
from matplotlib.path import Path as MplPath
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from matplotlib.transforms import IdentityTransform

from roomfit.base.logit import expit
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_bytes_atomically, write_text_atomically
from roomfit.report.blocks import Blocks
from roomfit.report.decay_times import Limit, Series
from roomfit.report.wording import (
    OKABE_ITO,
    decay_time_key,
    number,
    parameter,
    short_hertz,
    shortened,
)
from roomfit.result import ComparedPair, Decay, Result
from roomfit.signals.decay import jnd_of
from roomfit.uncertainty.gaussian import WIDEST_IDENTIFIABLE
from roomfit.uncertainty.profile import RISE95, Profile, profile_curve


def write_pictures(folder: Path, answer: Blocks, *, png_too: bool = False) -> None:
    """Write the figures of an answer as SVG files, the same that its page shows; PNG beside them.

    Of figures that show one of several choices, each of the first choices is a file.
    """
    for shown in answer.drawings():
        if not shown.choices:
            write_text_atomically(folder / f"{shown.name}.svg", svg_file(shown.svg))
            if png_too:
                write_bytes_atomically(folder / f"{shown.name}.png", png(shown.figure))
            continue
        alone = len(shown.choices) == 1
        for i, name in enumerate(shown.files):
            one = shown.svg if alone else _with_curves(shown.svg, i)
            write_text_atomically(folder / f"{name}.svg", svg_file(one))
        if png_too:
            pictures = [png(shown.figure)] if alone else _one_by_one(shown.figure, shown.files)
            for name, picture in zip(shown.files, pictures, strict=True):
                write_bytes_atomically(folder / f"{name}.png", picture)


def svg_file(element: str) -> str:
    """Return an SVG element as a file."""
    return element.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"


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


MOST_PROFILES = 12


def shown_profiles(answer: Result) -> list[tuple[int, Profile]]:
    """Return bands and profiles that replaced a Gaussian, the widest.

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


_WIDTH_IN = 10.2
_MANY_PANELS = 12
"""More than so many panels are drawn smaller, four in a row."""
LOWEST_DB = -45.0
# Curves of many pairs in one figure: about ten characters a point keep them below a megabyte.
_POINTS_IN_ALL, _FEWEST_POINTS, _MOST_POINTS = 60_000, 16, 120


# ---------------------------------------------------------------- what all figures share


class PlainFigure(Figure):
    """A figure whose texts are no formulas: names may have two dollar signs."""

    def draw(self, renderer: Any) -> None:
        """Draw on a renderer, as every way of showing and saving a figure does."""
        for text in _texts(self):
            text.set_parse_math(False)
        # ticks get their texts when they are drawn
        with mpl.rc_context({"text.parse_math": False}), _unknown_letters_as_boxes():
            super().draw(renderer)


@contextmanager
def _unknown_letters_as_boxes() -> Iterator[None]:
    # control characters have been refused in names, and what else the type lacks is a box
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


def _texts(artist: Artist) -> Iterator[Text]:
    """Yield the texts within an artist, but for hidden ones: axes would make ticks for nothing."""
    if isinstance(artist, Text):
        yield artist
    elif artist.get_visible():
        for child in artist.get_children():
            yield from _texts(child)


def new_figure(width_in: float, height_in: float, *, formulas: bool = False) -> Figure:
    """Return an empty figure whose labels never overlap; `formulas`: what stands in $ is one."""
    kind = Figure if formulas else PlainFigure
    figure = kind(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, dpi: int = 130) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    # the same bytes as `savefig`, which draws everything twice
    figure.set_dpi(dpi)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return _encoded(canvas)


def _encoded(canvas: Any) -> bytes:
    """Return what has been drawn as a PNG file."""
    stream, dpi = io.BytesIO(), canvas.figure.dpi
    # two thirds of the time of the usual level, for files a fifteenth larger
    fast = {"compress_level": 3, "dpi": (dpi, dpi)}
    imsave(stream, canvas.buffer_rgba(), format="png", dpi=dpi, pil_kwargs=fast)
    return stream.getvalue()


def _one_by_one(figure: Figure, files: Sequence[str], dpi: int = 130) -> list[bytes]:
    """Return a picture of the first pairs of `decay_figure`; what they share is drawn once."""
    figure.set_dpi(dpi)
    canvas: Any = FigureCanvasAgg(figure)
    own: dict[int, list[Artist]] = {i: [] for i in range(len(files))}
    for artist in (a for x in (figure, *figure.axes) for a in x.get_children()):
        group = str(artist.get_gid() or "").removeprefix(_CURVES)
        if group.isdecimal():
            artist.set_visible(False)
            own.setdefault(int(group), []).append(artist)
    canvas.draw()
    shared, pictures = canvas.copy_from_bbox(figure.bbox), []
    with _unknown_letters_as_boxes():
        for artists in (own[i] for i in range(len(files))):
            canvas.restore_region(shared)
            for artist in sorted(artists, key=lambda a: a.get_zorder()):
                artist.set_visible(True)
                artist.draw(canvas.get_renderer())
                artist.set_visible(False)
            pictures.append(_encoded(canvas))
    return pictures


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
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
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


def literal(name: str, longest: int = 34) -> str:
    """Return a name, cut where it is long; an underscore in front hides no entry of a legend."""
    shown = shortened(" ".join(name.split()), longest)
    return f"\N{ZERO WIDTH SPACE}{shown}" if shown.startswith("_") else shown


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
    axes.xaxis.set_major_formatter(FuncFormatter(lambda f, _: short_hertz(f)))
    axes.set_xlim(centres_hz[0] / 1.32, centres_hz[-1] * 1.32)


def band_panels(
    n: int,
    height_in: float,
    *,
    most_columns: int = 3,
    sharex: bool = True,
) -> tuple[Figure, list[Axes]]:
    """Return a figure with n panels in rows that share their y scale, and the panels.

    `frame_panels` completes it.
    """
    columns = min(n, most_columns if n <= _MANY_PANELS else 4)
    rows = -(-n // columns)
    # a single panel must leave room for the legend above it
    size_in = max(_WIDTH_IN / max(columns, 3) * columns, 4.6), height_in * rows + 0.6
    if columns > 3:
        size_in = size_in[0], 0.75 * height_in * rows + 0.6
    figure = PlainFigure(figsize=size_in)
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, sharex=sharex, sharey=True, squeeze=False)
    for unused in grid.ravel()[n:]:
        unused.set_visible(False)
    return figure, list(grid.ravel()[:n])


class _Scales(Artist):
    """Grid, ticks and numbers of panels, wherever their limits are: two lines and one text.

    matplotlib's own are five artists a tick, made and measured anew for every panel.
    """

    def __init__(self, panels: Sequence[Axes], columns: int, *, each_x: bool) -> None:
        super().__init__()
        self.panels, self.columns, self.each_x = panels, columns, each_x
        self.set_zorder(-1.0)
        for part in (part for axes in panels for part in (axes.xaxis, axes.yaxis, axes.patch)):
            part.set_visible(False)

    def draw(self, renderer: Any) -> None:
        """Draw below the curves of all panels."""
        figure: Any = self.get_figure()
        point, shown = renderer.points_to_pixels(1.0), Text(parse_math=False)
        shown.set_figure(figure)
        grid, ticks = [], []
        for i, axes in enumerate(self.panels):
            numbered = self.each_x or i + self.columns >= len(self.panels), i % self.columns == 0
            for along, axis in enumerate((axes.xaxis, axes.yaxis)):
                low, high = np.sort(axis.get_view_interval())
                at = np.array([x for x in axis.get_majorticklocs() if low <= x <= high])
                feet, up = np.tile(axes.bbox.min, (len(at), 1)), np.eye(2)[1 - along]
                feet[:, along] = axes.transData.transform(np.column_stack((at, at)))[:, along]
                grid.append(np.stack((feet, feet + axes.bbox.size * up), axis=1))
                ticks.append(np.stack((feet, feet - 3.5 * point * up), axis=1))
                words = axis.get_major_formatter().format_ticks(list(at)) if numbered[along] else []
                shown.set(ha=("center", "right")[along], va=("top", "center_baseline")[along])
                for foot, word in zip(feet - 7.0 * point * up, words, strict=False):
                    shown.set(position=foot, text=word)
                    shown.draw(renderer)
        for ends, colour, alpha in ((grid, "#b0b0b0", 0.25), (ticks, "#000000", 1.0)):
            points = np.concatenate(ends).reshape(-1, 2)
            path = MplPath(points, np.tile([MplPath.MOVETO, MplPath.LINETO], len(points) // 2))
            line = PathPatch(path, fill=False, ec=colour, alpha=alpha, lw=0.8, snap=True)
            line.set_figure(figure)
            line.set_transform(IdentityTransform())
            line.draw(renderer)


def frame_panels(
    figure: Figure,
    panels: Sequence[Axes],
    across: str,
    up: str,
    *,
    legend_columns: int = 4,
    title: str = "",
    gap_in: float = 0.27,
    each_x: bool = False,
) -> None:
    """Give `band_panels` grid, numbers, labels and a legend below its title, and all its place.

    `gap_in` is between panels, in inches; with `each_x` they have x scales of their own.
    """
    grid = panels[0].get_subplotspec().get_gridspec()  # type: ignore[union-attr]
    rows, columns = grid.nrows, grid.ncols
    figure.add_artist(_Scales(panels, columns, each_x=each_x))
    legend = figure_legend(figure, panels[0], legend_columns, title)
    above = -(-len(legend.texts) // legend_columns)
    width_in, height_in = figure.get_size_inches()
    # words of 9 and 10 points with the space around them
    left_in, right_in, bottom_in = 0.62, 0.14, 0.57
    top_in = 0.35 + 0.19 * above + (0.22 if title else 0.0)
    between_in = 0.53 if each_x or len(panels) % columns else 0.34
    wide_in = (width_in - left_in - right_in - gap_in * (columns - 1)) / columns
    tall_in = (height_in - bottom_in - top_in - between_in * (rows - 1)) / rows
    figure.subplots_adjust(
        left=left_in / width_in, right=1.0 - right_in / width_in, wspace=gap_in / wide_in,
        bottom=bottom_in / height_in, top=1.0 - top_in / height_in, hspace=between_in / tall_in,
    )  # fmt: skip
    middle = 0.5 * (bottom_in + height_in - top_in) / height_in
    figure.supxlabel(across, fontsize=10, y=0.1 / height_in)
    figure.supylabel(up, fontsize=10, x=0.08 / width_in, y=middle, ha="left")


def figure_legend(figure: Figure, axes: Axes, columns: int, title: str = "") -> Legend:
    found = (a.get_legend_handles_labels() for a in (axes, *figure.axes))
    # what is only in another panel is named, too
    once = {x: h for handles, labels in found for h, x in zip(handles, labels, strict=True)}
    return figure.legend(
        once.values(), once, loc="outside upper center", ncols=columns, frameon=False, fontsize=9,
        title=title or None,
    )  # fmt: skip


# ---------------------------------------------------------------- absorption


def absorption_figure(
    answer: Result,
    true_absorption: FloatArray | None = None,
    say: Callable[[str], str] = str,
) -> Figure:
    """Return absorption over frequency, one panel a material, the last for the mean by area.

    Filled points are identifiable, hollow ones are not, diamonds were given; bars are 95 %
    intervals. `true_absorption`, shape (n_materials, n_bands), is drawn as crosses.
    """
    n = len(answer.materials)
    figure, panels = band_panels(n + 1, 2.45, most_columns=4)
    centres = answer.bands.centres_hz
    given = answer.lower95 == answer.upper95
    kinds: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("identifiable", answer.identifiable & ~given, {"marker": "o", "color": OKABE_ITO[0]}),
        (
            "not identifiable",
            ~answer.identifiable & ~given,
            {"marker": "o", "color": OKABE_ITO[0], "mfc": "white"},
        ),
        ("given", given, {"marker": "D", "ms": 5, "color": "black"}),
    )
    # a stated y of titles spares measuring every axis once more
    for i, axes in enumerate(panels[:n]):
        value, low, high = answer.absorption[i], answer.lower95[i], answer.upper95[i]
        _intervals(axes, centres, value, low, high, OKABE_ITO[0])
        for label, chosen, look in kinds:
            # an entry of the legend wherever any panel has such points
            if chosen.any():
                at = chosen[i]
                axes.plot(centres[at], value[at], ls="none", label=say(label), **look)
        if true_absorption is not None:
            axes.plot(
                centres, true_absorption[i], "x", color=OKABE_ITO[1], ms=7, mew=2, label=say("true")
            )
        found = int(answer.identifiable[i].sum())
        longest = 20 if n < 3 else 16
        axes.set_title(literal(answer.materials[i], longest), fontsize=10, loc="left", y=1.0)
        axes.set_title(
            f"{number(float(answer.areas_m2[i]), 1)} m², {found}/{len(centres)}",
            fontsize=8, loc="right", color="0.3", y=1.0,
        )  # fmt: skip
    mean, low, high = answer.mean_absorption
    _intervals(panels[n], centres, mean, low, high, "black")
    panels[n].plot(centres, mean, "s", color="black", ms=5)
    panels[n].set_title(say("mean of the room"), fontsize=10, loc="left", y=1.0)
    frequency_axis(panels[0], centres)
    panels[0].set_ylim(-0.03, 1.03)
    frame_panels(
        figure, panels, say(f"{answer.bands.kind} band centre (Hz)"), say("absorption coefficient"),
        gap_in=0.17,
    )  # fmt: skip
    return figure


def _intervals(
    axes: Axes,
    centres_hz: FloatArray,
    value: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    colour: str,
) -> None:
    bars = np.maximum(np.array([value - lower, upper - value]), 0.0)
    axes.plot(centres_hz, value, "-", color=colour, lw=0.9, alpha=0.45)
    axes.errorbar(centres_hz, value, yerr=bars, fmt="none", ecolor=colour, capsize=2.5, lw=1.2)


# ---------------------------------------------------------------- how sure


def identifiability_figure(answer: Result) -> Figure:
    """Return a matrix of materials by bands: the darker, the narrower the 95 % interval.

    The scale ends at the width beyond which nothing is identifiable. A tick marks what is
    identifiable, G what was given.
    """
    width = answer.upper95 - answer.lower95
    n, m = width.shape
    figure = new_figure(min(3.4 + 0.62 * m, _WIDTH_IN), 1.4 + 0.36 * n)
    axes = figure.subplots()
    # distinguishable steps instead of a bitmap: SVG stays lines and words. Nothing wider than the
    # limit is identifiable, so that all of the scale lies below it
    steps = np.linspace(0.0, WIDEST_IDENTIFIABLE, 9)
    blues = ListedColormap(mpl.colormaps["Blues_r"](np.linspace(0.0, 0.85, 8)), over="#f3ead9")
    norm = BoundaryNorm(steps, 8)
    image = axes.pcolormesh(
        np.ma.masked_invalid(width), cmap=blues, norm=norm, edgecolors="white", lw=1.0
    )
    beside = " " if m <= _MANY_PANELS else "\n"
    for i, j in np.ndindex(n, m):
        given = width[i, j] == 0.0
        mark = "G" if given else "\N{CHECK MARK}" if answer.identifiable[i, j] else ""
        known = np.isfinite(width[i, j])
        text = "" if given or not known else f"{width[i, j]:.2f}".removeprefix("0")
        # colours that no page turns round: they stand on those of the matrix
        ink = "#fffffe" if known and width[i, j] < 0.5 * WIDEST_IDENTIFIABLE else "#000001"
        axes.text(
            j + 0.5, i + 0.5, f"{mark}{beside}{text}".strip(), ha="center", va="center", color=ink,
            size=8 if m <= _MANY_PANELS else 6.5, linespacing=1.0,
        )  # fmt: skip
    axes.invert_yaxis()
    axes.set_xticks(np.arange(m) + 0.5, [short_hertz(f) for f in answer.bands.centres_hz])
    if m > 16:
        axes.tick_params(axis="x", rotation=60)
    axes.set_yticks(np.arange(n) + 0.5, [literal(name, 24) for name in answer.materials])
    axes.tick_params(length=0)
    axes.set_xlabel(f"{answer.bands.kind} band centre (Hz)")
    axes.set_title("\N{CHECK MARK} identifiable, G given", fontsize=9, loc="left", y=1.0)
    bar = figure.colorbar(image, ax=axes, ticks=steps[::2], extend="max", format="%.2f")
    bar.set_label("width of the\n95 % interval" if n < 4 else "width of the 95 % interval")
    return figure


def profiles_figure(answer: Result) -> Figure:
    """Return the profiles that replaced Gaussian intervals, twelve at most."""
    shown = shown_profiles(answer)
    figure, panels = band_panels(len(shown), 2.1, sharex=False)
    for axes, (band, line) in zip(panels, shown, strict=True):
        a, low, high = (
            float(x[line.entry, band]) for x in (answer.absorption, answer.lower95, answer.upper95)
        )
        at = expit(line.points)
        axes.axvspan(low, high, color=OKABE_ITO[4], alpha=0.25, lw=0, label="95 % interval")
        axes.axhline(RISE95, color="black", lw=0.8, ls=":", label="1.92")
        free, rise = profile_curve(line)
        axes.plot(at, line.rise, "o", ms=3.5, color=OKABE_ITO[0])
        between = expit(free)
        axes.plot(between, rise, "-", lw=1.2, color=OKABE_ITO[0], label="profile")
        axes.axvline(a, color=OKABE_ITO[1], lw=1.0, label="answer")
        axes.set_ylim(0.0, 5.0)
        centre = answer.bands.centres_hz[band]
        title = f"{literal(answer.materials[line.entry], 24)}, {centre:g} Hz"
        axes.set_title(title, fontsize=9, y=1.0)
    up = "rise of the cost, all else fitted again"
    frame_panels(figure, panels, "absorption coefficient", up, each_x=True)
    return figure


# ---------------------------------------------------------------- decay curves


_CURVES = "class:curve-"


def decay_figure(answer: Result, *pairs: ComparedPair) -> Figure:
    """Return measured and predicted energy decay curves, one panel a band, of pairs with curves.

    Of several pairs, the curves and words of the i-th are in the SVG groups ``curve-i``, and a page
    shows one of them at a time; curves have fewer points then.
    """
    decays = [pair.decay for pair in pairs if pair.decay is not None]
    figure, panels = band_panels(len(answer.bands), 2.3)
    groups = [f"{_CURVES}{i}" if len(pairs) > 1 else None for i in range(len(pairs))]
    share = _POINTS_IN_ALL // (2 * len(pairs) * len(panels))
    n_points = int(np.clip(share, _FEWEST_POINTS, _MOST_POINTS)) if len(pairs) > 1 else None
    shown_s = 1e-3
    for j, axes in enumerate(panels):
        axes.set_title(f"{answer.bands.centres_hz[j]:g} Hz", fontsize=9, loc="left", y=1.0)
        for pair, decay, group in zip(pairs, decays, groups, strict=True):
            _decay_curves(axes, decay, j, n_points, group, evaluated_range_db(pair, j))
            axes.text(
                1.0, 1.03, decay_times(pair, j), transform=axes.transAxes, ha="right", va="bottom",
                fontsize=8, color="0.2", gid=group,
            ).set_in_layout(False)  # fmt: skip
            known = np.isfinite(decay.measured_db[j]) & (decay.measured_db[j] > LOWEST_DB)
            shown_s = max(shown_s, float(decay.time_s[known].max(initial=0.0)))
    panels[0].set_ylim(LOWEST_DB, 2.0)
    panels[0].set_xlim(0.0, shown_s)
    # the titles stand where that of the legend would
    frame_panels(figure, panels, "time after emission (s)", "energy decay curve (dB)", title=" ")
    top = 1.0 - 0.1 / figure.get_figheight()
    for pair, group in zip(pairs, groups, strict=True):
        title = f"{literal(pair.source)} to {literal(pair.receiver)}"
        title += f", {literal(pair.state)}" if pair.state else ""
        title += "" if pair.use == "fit" else ", not fitted"
        figure.text(0.5, top, title, ha="center", va="top", gid=group, parse_math=False)
    return figure


def _decay_curves(
    axes: Axes,
    decay: Decay,
    band: int,
    n_points: int | None,
    group: str | None,
    evaluated: tuple[float, float] | None,
) -> None:
    looks: tuple[tuple[str, FloatArray, dict[str, Any]], ...] = (
        ("measured", decay.measured_db[band], {"color": "black", "lw": 1.6}),
        ("predicted", decay.predicted_db[band], {"color": OKABE_ITO[1], "lw": 1.6, "ls": "--"}),
    )
    # added as artists: `plot` and its like look for new limits each time
    look: dict[str, Any]
    drawn: list[Artist] = []
    whole = axes.get_yaxis_transform()
    if evaluated is not None:
        low, high = evaluated
        look = {"color": OKABE_ITO[4], "alpha": 0.16, "lw": 0, "label": "evaluated range"}
        drawn.append(Rectangle((0.0, low), 1.0, high - low, transform=whole, **look))
    if decay.noise_db is not None and decay.noise_db[band] > LOWEST_DB - 15.0:
        floor = float(decay.noise_db[band])
        look = {"color": "0.45", "lw": 1.0, "ls": ":", "label": "noise, subtracted"}
        drawn.append(Line2D([0.0, 1.0], [floor, floor], transform=whole, **look))
    for label, level_db, look in looks:
        observed = np.where(level_db > LOWEST_DB - 15.0, level_db, np.nan)
        known = np.flatnonzero(np.isfinite(observed))
        kept = known
        if n_points is not None and known.size > n_points:
            kept = known[np.linspace(0, known.size - 1, n_points).round().astype(int)]
        drawn.append(Line2D(decay.time_s[kept], observed[kept], label=label, **look))
    for artist in drawn:
        artist.set_gid(group)
        axes.add_artist(artist)


# ISO 3382-1:2009, section 3 and 5: below the level of steady state.
_EVALUATED_DB = {"T20_s": (-25.0, -5.0), "T30_s": (-35.0, -5.0), "EDT_s": (-10.0, 0.0)}


def evaluated_range_db(pair: ComparedPair, band: int) -> tuple[float, float] | None:
    """Return the levels between which `decay_times` were read; None where none was."""
    key = decay_time_key(pair.parameters)
    if key is None or not np.isfinite(pair.parameters[key].measured[band]):
        return None
    return _EVALUATED_DB[key]


def decay_times(pair: ComparedPair, band: int) -> str:
    """Return the decay time that is known best, measured and predicted; "" where none is."""
    key = decay_time_key(pair.parameters)
    if key is None:
        return ""
    t = pair.parameters[key]
    if not np.isfinite(t.measured[band]) or not np.isfinite(t.predicted[band]):
        return ""
    measured, predicted = number(t.measured[band], 2), number(t.predicted[band], 2)
    return f"{parameter(key).symbol} {measured} → {predicted} s"


# ---------------------------------------------------------------- decay times


def measured_decay_figure(
    centres_hz: FloatArray, named: Sequence[tuple[str, FloatArray]], symbol: str
) -> Figure:
    """Return decay times over frequency by their names, without intervals."""
    return decay_time_figure(centres_hz, [Series(*one) for one in named], symbol)


def decay_time_figure(
    centres_hz: FloatArray,
    series: Sequence[Series],
    symbol: str = "T30",
    limits: Sequence[Limit] = (),
) -> Figure:
    """Return decay times over frequency with their intervals.

    Pale boxes are one just noticeable difference about the first of the two or three series, which
    differ by shape and colour; black lines are limits.
    """
    figure = new_figure(7.6, 3.2)
    axes, at = figure.add_subplot(), np.arange(len(centres_hz), dtype=np.float64)
    first = series[0].values_s
    step = jnd_of("T30_s", first)
    # a box a band, wide enough for the marks of all series, which stand side by side
    axes.bar(
        at, 2.0 * step, 0.5, first - step, color=OKABE_ITO[4], alpha=0.3, lw=0.0,
        label="just noticeable difference",
    )  # fmt: skip
    highest = [float(np.nanmax(first, initial=0.0))]
    shift = 0.24 / max(len(series) - 1, 1)
    for i, (one, mark) in enumerate(zip(series, "so^", strict=False)):
        x, colour = at + shift * i - 0.12, OKABE_ITO[i]
        if one.lower95_s is not None and one.upper95_s is not None:
            axes.vlines(x, one.lower95_s, one.upper95_s, color=colour, lw=1.8)
            known = one.upper95_s[np.isfinite(one.upper95_s)]
            highest.append(float(np.quantile(known, 0.75)) if known.size else 0.0)
        axes.plot(
            x, one.values_s, mark, color=colour, ms=5, label=literal(one.label, 60), ls="-", lw=0.8
        )
        highest.append(float(np.nanmax(one.values_s, initial=0.0)))
    label = "target"
    for limit in limits:
        chosen = np.flatnonzero(np.isin(centres_hz, limit.bands_hz))
        for value in (limit.low_s, limit.high_s):
            if np.isfinite(value) and chosen.size:
                axes.hlines(
                    np.full(chosen.size, value), chosen - 0.4, chosen + 0.4, color="black", lw=2.0,
                    label=label,
                )  # fmt: skip
                highest.append(value)
                label = "_"
    heads = [short_hertz(float(f)) for f in centres_hz]
    if len(heads) > 10:
        heads = [h if k % 3 == 0 else "" for k, h in enumerate(heads)]
    axes.set_xticks(at, heads)
    axes.set_xlim(-0.6, len(at) - 0.4)
    axes.set_ylim(0.0, 1.15 * max(highest))
    axes.set_xlabel("frequency (Hz)")
    axes.set_ylabel(f"{symbol} (s)")
    axes.grid(alpha=0.25, axis="y")
    figure_legend(figure, axes, 4)
    return figure
