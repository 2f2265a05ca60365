"""Numbers, names and bands as a reader expects them: sensible digits, units, no NaN."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from itertools import groupby
from typing import NamedTuple, TypeAlias

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.table import Table, Value
from roomfit.base.typing import BoolArray, FloatArray

DASH = "\N{EN DASH}"
Translator: TypeAlias = Callable[[str], str]
"""Gives an English text in another language."""

# M. Okabe, K. Ito, "Color Universal Design" (2008), without the yellow that vanishes on white
OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
# P. Tol, "Colour schemes", SRON/EPS/TN/09-002 (2021), "muted", then Okabe and Ito (2008):
# distinguishable with every kind of colour vision; repeated from the 17th material on
COLOURS = (
    *("#88CCEE", "#CC6677", "#DDCC77", "#117733", "#332288", "#AA4499", "#44AA99", "#999933"),
    *("#882255", "#E69F00", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#666666", "#BBBBBB"),
)


def material_colour(index: int) -> str:
    """Return the colour of a material, so pale that words and points can be read on it."""
    colour = COLOURS[index % len(COLOURS)]
    parts = (0.6 * int(colour[i : i + 2], 16) / 255.0 + 0.4 for i in (1, 3, 5))
    return "#" + "".join(f"{round(255.0 * part):02x}" for part in parts)


# ---------------------------------------------------------------- languages

_HOLE = re.compile(r"{(\w+)}")
_UNITS = r"k?Hz|kPa|m?s|dB|m[²³2]?|T20|T30|EDT|C50|C80|D50|G|STI|J?NDs?"
_SIGNS = r"\s()±+\N{MINUS SIGN}\N{EN DASH}→:;,/%°<>=~▲?|\N{MULTIPLICATION SIGN}-"
_NUMBERS = re.compile(rf"(?:[{_SIGNS}]|\d+(?!\d)(?:\.\d+(?!\d))?k?|\b(?:{_UNITS})\b)+")
_SHORT = 8  # a short entry, as of "and", joins parts of a sentence, never a whole one
_NAMED = ("source", "receiver")  # words between braces that stand for names alone
_VEIL = 0xF0000  # letters that no text has


@cache
def translator(language: str, names: frozenset[str] = frozenset()) -> Translator:
    """Return what gives a text of a page in its language; what has no translation stays English.

    Its table is ``templates/LANGUAGE.toml``; for `names` see `translator_by`.
    """
    if language == "en":
        return str
    words = files("roomfit.report").joinpath(f"templates/{language}.toml")
    if not words.is_file():
        what, hint = "no words of this language", "set language to one of them, or leave it out"
        raise InputError(what, found=repr(language), needed='"en", "de" or "fr"', hint=hint)
    return translator_by(tomllib.loads(words.read_text("utf-8")), names)


def translator_by(table: Mapping[str, str], names: Collection[str] = ()) -> Translator:
    """Return what translates whole texts by a table of them.

    Words between braces in an entry stand for names, numbers and other entries. Numbers have the
    decimal separator and the space of the entry "0.1 %". `names`, which others gave to walls,
    places and files, stay as they are, be they words of the table.

    Examples
    --------
    >>> say = translator_by({"{n} of {all} bands": "{n} von {all} Bändern", "0.1 %": "0,1 %"})
    >>> say("3 of 6 bands"), say("0.25 s"), say("brick")
    ('3 von 6 Bändern', '0,25 s', 'brick')
    >>> translator_by({"all": "alle", "{a} and {b}": "{a} und {b}"}, ["all"])("all and all")
    'all und all'
    """
    example = table.get("0.1 %", "0.1 %")
    holes = []
    # the longest first, so that what is most said decides; short ones as they are written
    lengths = {e: max(len(_HOLE.sub("", e)), _SHORT) for e in table if _HOLE.search(e)}
    for english in sorted(lengths, key=lengths.__getitem__, reverse=True):
        literal = re.escape(english).replace(r"\{", "{").replace(r"\}", "}")
        literal = literal.replace("{names}", "(?P<names>[^;]+?)")  # of one clause
        holes.append((re.compile(_HOLE.sub(r"(?P<\1>.+?)", literal), re.DOTALL), english))
    # a name with a word that joins parts of a sentence is one letter meanwhile
    short = [_HOLE.split(entry)[2:-1:2] for entry, n in lengths.items() if n == _SHORT]
    joints = {word for words in short for word in words if word.strip()}
    parted = sorted((n for n in names if any(j in n for j in joints)), key=len, reverse=True)
    veils = {name: chr(_VEIL + i) for i, name in enumerate(parted)}
    own = {veils.get(name, name) for name in names}

    def say(text: str) -> str:
        for name, veil in veils.items():
            text = text.replace(name, veil)
        text = said(text)
        for name, veil in veils.items():
            text = text.replace(veil, name)
        return text

    @cache
    def said(text: str) -> str:
        if text in own:
            return text
        if text in table:
            return table[text]
        if not text.strip() or _NUMBERS.fullmatch(text):
            text = re.sub(r"(?<=\d)\.(?=\d)", example[1], text)
            return re.sub(r"(?<=\d) (?=[%°a-zA-Z])", example[3], text)
        for pattern, english in holes:
            found = pattern.fullmatch(text)
            if found is None or (lengths[english] == _SHORT and text.endswith(".")):
                continue
            parts = found.groupdict()
            if all(parts[hole] in own for hole in _NAMED if hole in parts):
                return table[english].format(**{hole: said(x) for hole, x in parts.items()})
        return text

    return say


# ---------------------------------------------------------------- numbers


def number(value: float, decimals: int, *, signed: bool = False) -> str:
    """Return a number with a true minus sign, never "-0.0"; a dash where there is none.

    Examples
    --------
    >>> number(-0.04, 1, signed=True), number(1.25, 2), number(float("nan"), 1)
    ('0.0', '1.25', '–')
    """
    if not np.isfinite(value):
        return DASH
    rounded = round(float(value), decimals) + 0.0
    if rounded == 0.0:
        return f"{0.0:.{decimals}f}"
    return f"{rounded:{'+' if signed else ''}.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def coefficient(value: float, upper: float) -> str:
    """Return an absorption coefficient with two decimals; three where all of it is below 0.1."""
    return number(value, 3 if upper < 0.1 else 2)


def area(value_m2: float) -> str:
    """Return an area or absorption area in m2 with about three digits."""
    return number(value_m2, 2 if abs(value_m2) < 9.995 else 1)


def hertz(frequency_hz: float) -> str:
    """Return a frequency with its unit, as "125 Hz" or "2 kHz"."""
    if frequency_hz >= 1000.0:
        return f"{frequency_hz / 1000.0:g} kHz"
    return f"{frequency_hz:g} Hz"


def short_hertz(frequency_hz: float) -> str:
    """Return a frequency as an axis in Hz names it: 500, 2k."""
    return f"{frequency_hz / 1000:g}k" if frequency_hz >= 1000 else f"{frequency_hz:g}"


# ---------------------------------------------------------------- names


def count(number_of: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun, as "1 pair" or "3 pairs"."""
    return f"{number_of} {singular if number_of == 1 else plural or singular + 's'}"


def listing(words: Sequence[str]) -> str:
    """Return words as a sentence lists them: "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def shortened(name: str, longest: int = 34) -> str:
    """Return a name that fits above a panel: the end of a long one is cut."""
    return name if len(name) <= longest else name[: longest - 1] + "…"


def in_file_name(*names: str) -> str:
    """Return names joined by underscores, without the characters that have a meaning in paths."""
    plain = ("".join(c if c.isalnum() or c in "-_." else "_" for c in name)[:60] for name in names)
    return "_".join(plain)


# ---------------------------------------------------------------- room parameters


class Parameter(NamedTuple):
    """How a room-acoustic parameter is written."""

    symbol: str
    unit: str
    decimals: int  # of a value in `unit`
    error_unit: str  # "%" where errors are relative to the measured value
    error_decimals: int

    @property
    def label(self) -> str:
        """Symbol and unit, as "T20 s"."""
        return f"{self.symbol} {self.unit}".rstrip()


PARAMETERS = {
    "T20_s": Parameter("T20", "s", 2, "%", 1),
    "T30_s": Parameter("T30", "s", 2, "%", 1),
    "EDT_s": Parameter("EDT", "s", 2, "%", 1),
    "C50_dB": Parameter("C50", "dB", 1, "dB", 2),
    "C80_dB": Parameter("C80", "dB", 1, "dB", 2),
    "D50_percent": Parameter("D50", "%", 0, "points", 1),
    "TS_ms": Parameter("TS", "ms", 0, "ms", 1),
    "G_dB": Parameter("G", "dB", 1, "dB", 2),
    "STI": Parameter("STI", "", 2, "", 2),
}
"""In the order in which tables show them; those of ISO 3382-1, and of IEC 60268-16."""


def parameter(key: str) -> Parameter:
    """Return how a parameter is written; of an unknown one the key has symbol and unit."""
    symbol, _, unit = key.partition("_")
    return PARAMETERS.get(key) or Parameter(symbol, unit, 2, unit, 2)


def decay_time_key(known: Iterable[str]) -> str | None:
    """Return which of the known parameters is the decay time that a client asks for, or None."""
    found = set(known)
    return next((key for key in ("T30_s", "T20_s", "EDT_s") if key in found), None)


# Of these the mean is the single number of a decay time (ISO 3382-1:2009, table A.1).
MID_HZ = (500.0, 1000.0)


class Series(NamedTuple):
    """One decay time in every band, all of shape (n_bands,), NaN where unknown."""

    label: str
    values_s: FloatArray
    lower95_s: FloatArray | None = None  # None: without an interval
    upper95_s: FloatArray | None = None

    def bounded(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return values and bounds, NaN where there are none."""
        unknown = np.full_like(self.values_s, np.nan)
        low, high = (unknown if x is None else x for x in (self.lower95_s, self.upper95_s))
        return self.values_s, low, high

    def mid_s(self, centres_hz: FloatArray) -> tuple[float, float, float]:
        """Return the mean at mid frequencies, and its bounds, NaN where a band of it has none."""
        own, bounds = _mid_bands(centres_hz, self.values_s), self.bounded()[1:]
        low, high = (float(b[own].mean()) if own.any() else np.nan for b in bounds)
        return mid_mean(centres_hz, self.values_s), low, high


def mid_mean(centres_hz: FloatArray, values: FloatArray) -> float:
    """Return the mean at 500 and 1000 Hz; of the nearest band where neither is known.

    Examples
    --------
    >>> mid_mean(np.array([250.0, 500.0, 1000.0]), np.array([0.9, 0.5, 0.7]))
    0.6
    """
    own = _mid_bands(centres_hz, values)
    return float(values[own].mean()) if own.any() else float("nan")


def _mid_bands(centres_hz: FloatArray, values: FloatArray) -> BoolArray:
    """Return which bands `mid_mean` is of, shape (n_bands,); none where no value is known."""
    known = np.isfinite(values)
    own = np.asarray(known & np.isin(centres_hz, MID_HZ))
    if known.any() and not own.any():
        own[np.argmin(np.where(known, np.abs(np.log(centres_hz / 700.0)), np.inf))] = True
    return own


def mid_words(centres_hz: FloatArray, values: FloatArray) -> str:
    """Return which bands `mid_mean` is of: "mid frequencies", or the one that is known.

    Examples
    --------
    >>> mid_words(np.array([500.0, 1000.0, 2000.0]), np.array([np.nan, np.nan, 0.8]))
    '2 kHz'
    """
    own = _mid_bands(centres_hz, values)
    return "mid frequencies" if own.sum() == len(MID_HZ) else band_ranges(centres_hz, own)


def with_interval(value: float, low: float, high: float) -> str:
    """Return a decay time with its interval, as in "0.50 s (0.41 to 0.58)"."""
    if not np.isfinite([low, high]).all():
        return f"{number(value, 2)} s"
    return f"{number(value, 2)} s ({number(low, 2)} to {number(high, 2)})"


# ---------------------------------------------------------------- bands


def band_ranges(centres_hz: FloatArray, chosen: BoolArray) -> str:
    """Return the chosen bands in words; neighbours are joined: "125 Hz and 500 Hz to 2 kHz"."""
    runs = []
    for wanted, members in groupby(range(len(centres_hz)), key=lambda j: bool(chosen[j])):
        run = list(members)
        if wanted:
            ends = dict.fromkeys(hertz(float(centres_hz[j])) for j in (run[0], run[-1]))
            runs.append(" to ".join(ends))
    return listing(runs)


BANDS_AT_MOST = 8
"""Columns that fit on a sheet of A4; further bands go into a table below."""


def band_tables(
    caption: str,
    corner: str,
    centres_hz: FloatArray,
    rows: Sequence[Sequence[Value]],
    *,
    before: tuple[str, ...] = (),
    after: tuple[str, ...] = (),
) -> tuple[Table, ...]:
    """Return a table with a column a band; several, evenly filled, where there are many bands.

    A row has a head, the cells of `before`, one a band, and those of `after`.
    """
    n, first = len(centres_hz), 1 + len(before)
    heads = (corner, *before, *(hertz(float(f)) for f in centres_hz), *after)
    tables = []
    for block in np.array_split(np.arange(first, first + n), -(-n // BANDS_AT_MOST)):
        words = caption
        if len(block) < n:
            words += f"; {heads[block[0]]} to {heads[block[-1]]}"
        last = range(first + n, len(heads)) if block[-1] == first + n - 1 else ()
        chosen = [*range(first), *block, *last]
        shown = [[row[k] for k in chosen] for row in rows]
        tables.append(Table(words, [heads[k] for k in chosen], shown, kind="wide"))
    return tuple(tables)
