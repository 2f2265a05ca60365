"""Room parameters over the bands as drawings, in the colours of the page.

By hand: `ui.echart` would add 1.7 MB of script, draws intervals only by a function in JavaScript,
and takes neither the page's colours nor a text that says what is drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from matplotlib.ticker import MaxNLocator

from roomfit.report.wording import parameter, short_hertz

TIMES = "T30_s"
"""What decay times alone give."""
LABELS = {
    name: " in ".join(filter(None, (parameter(name).symbol, parameter(name).unit)))
    for name in (TIMES, "T20_s", "EDT_s", "C80_dB", "D50_percent", "STI")
}
_MOST = {"D50_percent": 100.0, "STI": 1.0}
_SPEECH = "125 Hz to 8 kHz together"
_MOST_PAIRS = 200
_WIDE, _HIGH, _LEFT, _BELOW = 320.0, 190.0, 44.0, 24.0
Known = Sequence[float | None]


class _Axes:
    """Where bands and values lie in a chart, in the units of its drawing."""

    def __init__(self, words: Sequence[str], ticks: Sequence[float]) -> None:
        self.words, self.ticks = words, ticks  # of the bands; from the lowest value to the highest
        left, step = _LEFT + 16.0, (_WIDE - _LEFT - 24.0) / max(len(words) - 1, 1)
        self.x = [left + step * i for i in range(len(words))]
        if len(words) == 1:
            self.x = [0.5 * (_WIDE + _LEFT)]

    def y(self, value: float) -> float:
        low, high = self.ticks[0], self.ticks[-1]
        inside = min(max(value, low), high)
        return float(10.0 + (_HIGH - 10.0 - _BELOW) * (high - inside) / (high - low))

    def grid(self) -> str:
        """Return a line and a number for each tick, and a word for each band."""
        parts = [
            _line(_LEFT, _WIDE, self.y(tick), self.y(tick), 'stroke="var(--line)"')
            + _text(_LEFT - 4, self.y(tick) + 4, "end", f"{tick:.6g}")
            for tick in self.ticks
        ]
        parts += [_text(_LEFT - 4, _HIGH - 6, "end", "Hz")] if len(self.words) > 1 else []
        words = zip(self.x, self.words, strict=True)
        return "".join([*parts, *(_text(x, _HIGH - 6, "middle", word) for x, word in words)])

    def line(self, values: Known, style: str) -> str:
        """Return a line through values, those left out that are not known."""
        at = [(x, self.y(v)) for x, v in zip(self.x, values, strict=True) if v is not None]
        if len(self.words) == 1:  # a line of one point is not seen
            at = [(x + dx, y) for x, y in at for dx in (-30.0, 30.0)]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
        return f'<polyline points="{points}" fill="none" {style}/>'

    def bars(self, lower: Known, upper: Known, style: str, beside: float = 0.0) -> str:
        """Return an upright bar for each interval, cut off at the edges."""
        return "".join(
            _line(x + beside, x + beside, self.y(a), self.y(b), style)
            for x, a, b in zip(self.x, lower, upper, strict=True)
            if a is not None and b is not None and a < self.ticks[-1] and b > self.ticks[0]
        )

    def limit(self, limit: Mapping[str, Any], bands_hz: Sequence[float]) -> str:
        """Return the line of a limit across the bands in which it holds."""
        at = [x for x, f in zip(self.x, bands_hz, strict=False) if f in limit["bands_hz"]]
        left, right = _LEFT, _WIDE
        if at and len(self.words) > 1:
            left, right = min(at) - 14.0, max(at) + 14.0
        y, style = self.y(limit["value"]), 'stroke="var(--bad)" stroke-width="2"'
        return _line(left, right, y, y, f'class="limit" {style} stroke-dasharray="9 3"')


def _line(x1: float, x2: float, y1: float, y2: float, style: str) -> str:
    return f'<line x1="{x1:.1f}" x2="{x2:.1f}" y1="{y1:.1f}" y2="{y2:.1f}" {style}/>'


def _text(x: float, y: float, anchor: str, text: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _ticks(name: str, shown: Sequence[float], ends: Iterable[float]) -> list[float]:
    """Return the ticks of a parameter's chart, from all values that it shows, and interval ends.

    An interval may be endless: it ends at the edge then, and does not make all else small.
    """
    is_time = name.endswith("_s")
    wide = max(shown) - (0.0 if is_time else min(shown)) or 1.0
    every = [*shown, *ends]
    low = 0.0 if is_time else max(min(every), min(shown) - wide)
    high, most = min(max(every), max(shown) + wide), _MOST.get(name)
    drawn = map(float, MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    ticks = [t for t in drawn if most is None or 0.0 <= t <= most]
    return ticks if len(ticks) > 1 else [0.0, most or 1.0]


def chart_svg(
    view: Mapping[str, Any],
    name: str,
    bands_hz: Sequence[float],
    limits: Sequence[Mapping[str, Any]],
) -> str:
    """Return one room parameter over the bands as a drawing."""
    label, mean = LABELS[name], view["mean"][name]
    pairs = [pair[name]["predicted"] for pair in view["pairs"]]
    own = [limit["value"] for limit in limits]
    lines = (mean["predicted"], mean.get("before", ()), own, *pairs)
    known = [v for line in lines for v in line if v is not None]
    if not known:
        return f"<p>{escape(label)}: not known</p>"
    ends = [v for v in (*mean["lower95"], *mean["upper95"]) if v is not None]
    words = [_SPEECH] if name == "STI" else [short_hertz(f) for f in bands_hz]
    axes = _Axes(words, _ticks(name, known, ends))
    thin = 'stroke="var(--soft)" stroke-width="0.6" opacity="0.6"'
    parts = [axes.grid(), *(axes.line(p, thin) for p in pairs[:_MOST_PAIRS])]
    if "before" in mean:
        ink = 'stroke="var(--ink)"'
        parts.append(axes.line(mean["before"], f'{ink} stroke-dasharray="5 4"'))
        before = mean["before_lower95"], mean["before_upper95"]
        parts.append(axes.bars(*before, f'{ink} stroke-width="1.2"', -5.0))
    accent = 'stroke="var(--accent)"'
    wide = f'{accent} stroke-width="5" opacity="0.45"'
    parts.append(axes.bars(mean["lower95"], mean["upper95"], wide))
    parts.append(axes.line(mean["predicted"], f'{accent} stroke-width="2.4"'))
    parts += [axes.limit(limit, bands_hz) for limit in limits]
    means = ", ".join("unknown" if v is None else f"{v:.2f}" for v in mean["predicted"])
    of = "" if name == TIMES else ", mean over the pairs"
    stated = ", ".join(f"{v:.2f}" for v in own)
    spoken = escape(f"{label}{of} by band: {means}; limits: {stated or 'none'}")
    return (
        f"<h2>{escape(label)}</h2>"
        f'<svg viewBox="0 0 {_WIDE:.0f} {_HIGH:.0f}" role="img" font-size="13" fill="currentColor" '
        f'aria-label="{spoken}">{"".join(parts)}</svg>'
    )
