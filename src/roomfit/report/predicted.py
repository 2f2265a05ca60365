"""A prediction as blocks: one sentence, the decay time over frequency, means, and every pair."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import Code
from roomfit.base.table import Cell, Column, Table, Value
from roomfit.base.typing import FloatArray
from roomfit.files.encoding import finding_of
from roomfit.predict.diffuse_field import FORMULAS, DiffuseAbsorption
from roomfit.predict.prediction import PredictedValue, ValueChange, is_undetermined, named_values
from roomfit.report import wording
from roomfit.report.blocks import (
    Block,
    Blocks,
    Drawing,
    Findings,
    Listed,
    Part,
    Sentence,
    Terms,
)
from roomfit.report.doubts import serious_lines
from roomfit.report.tables import bounded_cells
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import ValueName
from roomfit.signals.speech import sti_missing

if TYPE_CHECKING:
    from roomfit.predict.prediction import Predicted
    from roomfit.room.scene import Scene

# ---------------------------------------------------------------- the decay time


_Limit: TypeAlias = tuple[Sequence[float], float, float]  # bands in Hz, lowest and highest


class DecayAnswer(NamedTuple):
    """The decay time of a prediction, before and after a change or beside what was measured."""

    symbol: str  # T30, or what is known in its place
    sentence: str  # of the mean at mid frequencies
    centres_hz: FloatArray
    series: tuple[wording.Series, ...]

    def _limit_rows(self, limits: Sequence[_Limit]) -> Iterator[list[str]]:
        for words, at in (("target, at least", 1), ("target, at most", 2)):
            own = [[x[at] for x in limits if f in x[0]] for f in self.centres_hz.tolist()]
            cells = [" ".join(f"{x:.3g}" for x in every if np.isfinite(x)) for every in own]
            if any(cells):
                yield [words, *cells]

    def drawing(self, limits: Sequence[_Limit] = ()) -> Drawing:
        """Return the decay time over frequency, with limits where there are some."""
        of = self.centres_hz, self.series, self.symbol, limits
        caption = (
            "Means over the positions; bars are 95 % intervals. A listener does not notice what "
            "stays within the pale box of a band."
        )
        title = "Decay times over frequency"
        return Drawing("decay_times", title, caption, "decay_time_figure", of)

    def tables(self, limits: Sequence[_Limit] = ()) -> tuple[Table, ...]:
        """Return the decay time by band: before, the limits, after, and its 95 % interval."""
        rows: list[list[str]] = []
        for one in self.series:
            if one is self.series[-1]:
                rows += self._limit_rows(limits)
            rows.append([one.label, *(wording.number(x, 2) for x in one.values_s)])
            if one.lower95_s is not None and one.upper95_s is not None:
                both = zip(one.lower95_s, one.upper95_s, strict=True)
                ends = ([wording.number(x, 2) for x in own] for own in both)
                cells = (wording.DASH.join(x) if wording.DASH not in x else "" for x in ends)
                rows.append(["its interval, 95 %", *cells])
        caption = f"{self.symbol} in s, mean over the positions"
        return wording.band_tables(caption, "", self.centres_hz, rows)


def decay_answer(
    bands: Bands,
    means: Mapping[str, PredictedValue],
    *,
    is_changed: bool,
    before: str = "",
    after: str = "after the change",
    open_for: Sequence[str] = (),
) -> DecayAnswer | None:
    """Return the answer of a table of means; None where it has no decay time.

    `before` and `after` say in a word what the room is before and after the change, or are left
    out: whether it was measured. `open_for` is that of `parameter_rows`.
    """
    known = [name for name, v in means.items() if np.isfinite(v.predicted).any()]
    name = wording.decay_time_key(known)
    if name is None:
        return None
    v, symbol, centres_hz = means[name], wording.parameter(name).symbol, bands.centres_hz
    where, is_measured = wording.mid_words(centres_hz, v.predicted), np.isfinite(v.measured)
    what = f"{symbol} at {where}"
    if not is_changed or v.change is None:
        label = after if is_changed else "predicted"
        later = wording.Series(label, v.predicted, v.lower95, v.upper95)
        text = f"{what} is predicted as {wording.with_interval(*later.mid_s(centres_hz))}"
        if is_changed or not is_measured.any():
            return DecayAnswer(symbol, f"{text}.", centres_hz, (later,))
        earlier = wording.Series("measured", v.measured)
        text += f"; measured {wording.number(earlier.mid_s(centres_hz)[0], 2)} s"
        own = wording.mid_words(centres_hz, v.measured)
        text += "." if own == where else f" at {own}."
        return DecayAnswer(symbol, text, centres_hz, (earlier, later))
    c = v.change
    later = wording.Series(after, v.predicted, v.lower95, v.upper95)
    # where a measured mean has an interval of its own, it stands in place of a model's
    is_alone = is_measured & (c.before != v.measured)
    first = "measured before" if is_measured.all() else "predicted before"
    if is_measured.any() and not is_measured.all():
        first = "before, measured where it was"
    bounds = (np.where(is_alone, np.nan, x) for x in (c.before_lower95, c.before_upper95))
    earlier = wording.Series(before or first, np.where(is_measured, v.measured, c.before), *bounds)
    # of a band that the mid frequencies are made of
    mid = np.isin(centres_hz, wording.MID_HZ)
    unknown = is_undetermined(name, c) & (mid if mid.any() else True)
    why = next((w for w, is_open in zip(open_for, unknown, strict=False) if w and is_open), "")
    factor = wording.Series("", c.change, c.change_lower95, c.change_upper95).mid_s(centres_hz)
    text = f"{what} {_change_words(earlier, later, factor, why, centres_hz)}."
    return DecayAnswer(symbol, text, centres_hz, (earlier, later))


def _change_words(
    earlier: wording.Series,
    later: wording.Series,
    factor: Sequence[float],
    why: str,
    centres_hz: FloatArray,
) -> str:
    """Return what a decay time does at mid frequencies, or `why` that is not determined."""
    (value, low, high), then = earlier.mid_s(centres_hz), later.mid_s(centres_hz)
    now, after = f"{wording.number(value, 2)} s", wording.with_interval(*then)
    label = earlier.label.removesuffix(" before")
    if np.isfinite([low, high]).all():
        label += f", {wording.number(low, 2)} to {wording.number(high, 2)}"
    if why:
        return f"is {now} ({label}); what the change does to it is not determined ({why})"
    if abs(then[0] - value) < 0.005:
        return f"stays at {now} ({label}): {after} after the change"
    way = "falls" if then[0] < value else "rises"
    # without an interval, the likeliest is all that is known
    if not factor[1] <= 1.0 <= factor[2]:
        return f"{way} from {now} ({label}) to {after}"
    return (
        f"is {now} ({label}), and {after} is expected after the change; whether it {way} is not "
        "determined"
    )


# ---------------------------------------------------------------- the blocks


_MEAN = "Mean over the pairs (over those measured, where some are): predicted, 95 % interval"
_STI = "Speech transmission index (IEC 60268-16), 95 % interval"
_NEXT = "Next: search what to hang where, or measure again after a change."
_USES = {None: "not measured", "fit": "measured", "validate": "measured, kept for validation"}
_MOST_PICTURES, _MOST_IN_TEXT = 24, 4
_OPEN = ((Code.CHANGE_PRIOR_DOMINATED, "prior alone"), (Code.RESULT_DOUBTED, "result doubted"))


def describe(predicted: Predicted, limits: Sequence[_Limit] = ()) -> Blocks:
    """Return the answer in a sentence and a few numbers, findings, means, and every pair.

    Of a change each parameter has what was measured before, or is expected where nothing was, what
    is expected after, and the change, with their intervals. `limits` are of the decay time.
    """
    is_changed, centres_hz = bool(predicted.changes), predicted.bands.centres_hz
    said = [(why, f.about) for code, why in _OPEN for f in predicted.findings if f.code is code]
    # by band why the absorption may be split otherwise among walls; "" where it may not
    open_for = tuple(
        next((why for why, about in said if about.in_band(f)), "") for f in centres_hz.tolist()
    )
    means = named_values(predicted.mean, None)
    answer = decay_answer(predicted.bands, means, is_changed=is_changed, open_for=open_for)
    # nobody reads a value a band in a sentence
    named = [c if c.count(",") < 2 else f"{c.split('=')[0]} by bands" for c in predicted.changes]
    lead = [f"With {'; '.join(named)}:"] if named else []
    lead += [] if answer is None else [answer.sentence]
    head: list[Block] = [Sentence(" ".join(lead), "lead")] if lead else []
    head += [Terms(numbers, are_numbers=True)] if (numbers := tuple(_numbers(predicted))) else []
    head += [] if answer is None else [answer.drawing(limits)]
    if answer is not None and (is_changed or not predicted.variants):
        head += answer.tables(limits)
    head += variant_tables(predicted.variants)
    head += [Listed(serious_lines(predicted.findings)), Sentence(_NEXT)]

    def shown(title: str, values: Mapping[ValueName, PredictedValue]) -> tuple[Table, ...]:
        rows = parameter_rows(named_values(values, None), is_changed=is_changed, open_for=open_for)
        return wording.band_tables(title, "parameter", centres_hz, rows)

    titled = [(f"{p.source} to {p.receiver}, {_USES[p.use]}", p) for p in predicted.pairs]
    sti = [("mean over the pairs", predicted.sti), *((title, p.sti) for title, p in titled)]
    rows = [
        row
        for title, value in sti
        if value is not None
        for row in parameter_rows({"STI": value}, is_changed=is_changed, title=title)
    ]
    speech: Block = Sentence(f"STI is not predicted: {sti_missing(predicted.bands)}.")
    if rows:
        speech = Table(_STI, ("pair", "125 Hz to 8 kHz"), rows)
    blocks: list[Block] = [
        Findings(predicted.findings),
        Part("Means", (*shown(_MEAN, predicted.mean), speech), folded=True),
    ]
    if titled:
        tables = tuple(table for title, p in titled for table in shown(title, p.parameters))
        words = f"{len(titled)} of source and receiver; the first in full, all in predicted.csv"
        few = len(titled) <= _MOST_IN_TEXT
        blocks.append(Part("Pair by pair", tables, "", words, folded=True, in_text=few))
    title = "Before and after" if predicted.compares_states else "Predicted"
    return Blocks(title, tuple(head), tuple(blocks), "predicted.json")


_OF_VARIANTS = ("EDT_s", "C50_dB", "C80_dB", "STI")


def variant_tables(variants: Mapping[str, Predicted]) -> tuple[Table, ...]:
    """Return variants of a room side by side: decay time by band, more at mid frequencies.

    The first row is the room before any change.
    """
    rows: list[list[Value]] = []
    further: list[list[Value]] = []
    symbol, centres_hz, keys = "", np.zeros(0), [""]
    for name, one in variants.items():
        values, centres_hz = named_values(one.mean, one.sti), one.bands.centres_hz
        answer = decay_answer(one.bands, values, is_changed=True, after=name)
        if answer is None:
            continue
        symbol, series = answer.symbol, answer.series
        keys = [key for key in _OF_VARIANTS if key in values]
        for own in series[-1:] if rows else series:
            rows.append([own.label, *_with_bounds(2, *own.bounded())])
        if not further:
            further.append([series[0].label, *_mid_cells(centres_hz, values, keys, before=True)])
        further.append([name, *_mid_cells(centres_hz, values, keys)])
    if not rows:
        return ()
    tables = wording.band_tables(f"Variants: {symbol} in s, 95 % interval", "", centres_hz, rows)
    heads = ("", *(wording.PARAMETERS[key].label for key in keys))
    caption = f"Variants: means at {wording.mid_words(centres_hz, centres_hz)}, 95 % interval"
    return *tables, Table(caption, heads, further)


def _mid_cells(
    centres_hz: FloatArray,
    values: Mapping[str, PredictedValue],
    keys: Sequence[str],
    *,
    before: bool = False,
) -> Iterator[Cell]:
    """Yield what parameters of a variant are at mid frequencies, or were before it."""
    for key in keys:
        v, decimals = values[key], wording.PARAMETERS[key].decimals
        series = wording.Series("", v.predicted, v.lower95, v.upper95)
        if before and (c := v.change) is not None:
            is_known = np.isfinite(v.measured)
            series = wording.Series("", np.where(is_known, v.measured, c.before))
        at_hz = centres_hz if key != "STI" else np.array([1000.0])
        three = (np.atleast_1d(x) for x in series.mid_s(at_hz))
        yield _with_bounds(decimals, *three)[0]


def pair_drawings(predicted: Predicted) -> tuple[Drawing, ...]:
    """Return the decay curves of the first pairs, which are files beside the page."""
    pairs = predicted.pairs[:_MOST_PICTURES]
    names = tuple(
        f"predicted_{i:02d}_{wording.in_file_name(pair.source, pair.receiver)}"
        for i, pair in enumerate(pairs, start=1)
    )
    maker = "prediction_figures.predicted_decay_figure"
    of, title = (predicted, *pairs), "Energy decay curves"
    return (Drawing("predicted", title, "", maker, of, choices=names, files=names),) * bool(pairs)


def grid_drawings(predicted: Predicted, scene: Scene) -> tuple[Drawing, ...]:
    """Return the maps of every source."""
    maker, of = "prediction_figures.grid_figure", (predicted, scene)
    sources = dict.fromkeys(pair.source for pair in predicted.pairs)
    return tuple(
        Drawing(f"grid_{i:02d}_{wording.in_file_name(source)}", "Maps", "", maker, (*of, source))
        for i, source in enumerate(sources, start=1)
    )


def _numbers(predicted: Predicted) -> Iterator[tuple[str, str]]:
    """Yield what is predicted at mid frequencies beside the decay time."""
    named = named_values(predicted.mean, predicted.sti)
    centres = predicted.bands.centres_hz
    for key in ("C50_dB", "G_dB", "STI"):
        if (v := named.get(key)) is None:
            continue
        how, rows = wording.PARAMETERS[key], (v.predicted, v.lower95, v.upper95)
        values = ((r[0] if key == "STI" else wording.mid_mean(centres, r)) for r in rows)
        value, low, high = (wording.number(x, how.decimals) for x in values)
        if value != wording.DASH:
            where = "" if key == "STI" else f" at {wording.mid_words(centres, v.predicted)}"
            yield value, f"{how.label}{where}, predicted; {low} to {high} at 95 %"


def parameter_rows(
    table: Mapping[str, PredictedValue],
    *,
    is_changed: bool,
    open_for: Sequence[str] = (),
    title: str = "",
) -> list[tuple[Cell, ...]]:
    """Return the rows of a table of parameters in the order of time; each name stands once.

    What was measured is set against the model of the room as it was measured, never against a
    changed one. `open_for` says by band why the absorption may be split otherwise among walls: a
    change of which `is_undetermined` holds is not determined there, and the reason stands beside.
    `title` stands in place of the names.
    """
    rows = []
    for name in (name for name in wording.PARAMETERS if name in table):
        v, c = table[name], table[name].change
        label, decimals = wording.PARAMETERS[name].label, wording.PARAMETERS[name].decimals
        has_measured = bool(np.isfinite(v.measured).any())
        steps = [f"{wording.number(x, 1, signed=True)} JND" for x in v.jnd]
        measured = [
            Cell(wording.number(m, decimals), (step,) * (c is None and wording.DASH not in step))
            for m, step in zip(v.measured, steps, strict=True)
        ]
        predicted = _with_bounds(decimals, v.predicted, v.lower95, v.upper95)
        lines = {"predicted": predicted, "measured": measured}
        if is_changed:
            lines = {"measured": measured, "expected after": predicted}
        if is_changed and c is not None:
            lines = {"measured before": measured}
            # means of fitted pairs are those measured
            if not np.allclose(c.before, v.measured, rtol=1e-6):
                before = (c.before, c.before_lower95, c.before_upper95)
                lines["expected before"] = _with_bounds(decimals, *before)
            lines["expected after"] = predicted
            lines |= dict([_change_cells(name, c, decimals, open_for)])
            if name == "T30_s" and np.isfinite(c.sabine).any():
                lines["after, by Sabine"] = [Cell(wording.number(s, decimals)) for s in c.sabine]
        if not has_measured:
            of_measured = ("measured", "measured before")
            lines = {what: cells for what, cells in lines.items() if what not in of_measured}
        heads = [title or label] + [""] * len(lines)
        rows += [
            (Cell(head, (what,)), *cells)
            for head, (what, cells) in zip(heads, lines.items(), strict=False)
        ]
    return rows


def _change_cells(
    name: str, c: ValueChange, decimals: int, open_for: Sequence[str]
) -> tuple[str, list[Cell]]:
    """Return the name of a change with its unit, and its cells."""
    rows = np.array([c.change, c.change_lower95, c.change_upper95])
    label = f"change {wording.parameter(name).unit.replace('%', 'points')}".rstrip()
    if name in FIT_RANGES_DB:
        label, decimals, rows = "change %", 0, 100.0 * (rows - 1.0)
    cells, unknown = _with_bounds(decimals, *rows, signed=True), is_undetermined(name, c)
    for band, why in enumerate(open_for[: unknown.size]):
        if why and unknown[band]:
            cells[band] = Cell("not determined", (why,))
    return label, cells


def _with_bounds(decimals: int, *rows: FloatArray, signed: bool = False) -> list[Cell]:
    """Return cells of values, lower and upper bounds."""
    cells = []
    for each in zip(*rows, strict=True):
        value, low, high = (wording.number(x, decimals, signed=signed) for x in each)
        is_alone = wording.DASH in (value, low, high)
        cells.append(Cell(value, () if is_alone else (f"{low} to {high}",)))
    return cells


def listen_blocks(content: Mapping[str, Any]) -> Blocks:
    """Return what was changed, and from when on noise carries what is predicted of the tail."""
    changed = "; ".join(content["changes"]) or "nothing: every response as it was"
    caption = f"Changed: {changed}\n"
    caption += "From these times after emission the measured noise carries the predicted tail, s:"
    rows = [(f"{r['source']} to {r['receiver']}", *r["noise_from_s"]) for r in content["responses"]]
    bands = [f"{f:g}" for f in content["bands_hz"]]
    note = f"Below {bands[0]} and above {bands[-1]} Hz the nearest band stands for all."
    shown = Table(caption, ("Hz", *bands), rows, (note,), ".2f")
    findings = tuple(finding_of(one, "findings") for one in content["findings"])
    return Blocks("Listen", (shown,), (Findings(findings),), "listen.json")


# ---------------------------------------------------------------- decay times alone


_DIFFUSE = (
    "Decay times determine the mean alone, as far as the field is diffuse; the formulas "
    "differ by what that means, and intervals allow for it where priors tell walls apart; "
    "elsewhere walls are taken to be alike. What stands for single materials is their priors, "
    "moved together until they give this mean: nothing more is known of any of them. Where "
    "walls are much alike Eyring was nearest in trials, in flat rooms with one soft surface "
    "Fitzroy. Impulse "
    "responses and positions would separate them (roomfit identify)."
)


def diffuse_blocks(found: DiffuseAbsorption) -> Blocks:
    """Return the mean by Eyring, decay times, and mean and materials by each formula."""
    centres = found.bands.centres_hz
    measured = zip(found.decay_s.tolist(), found.decay_sd_s.tolist(), strict=True)
    times = [Cell(f"{wording.number(t, 2)} ± {wording.number(sd, 2)}") for t, sd in measured]
    tables = list(
        wording.band_tables(
            "Mean over positions, with its standard deviation", "", centres,
            [("decay time, s", *times)],
        )
    )  # fmt: skip
    for formula, mean, absorption in zip(FORMULAS, found.mean, found.absorption, strict=True):
        named = zip(found.materials, absorption, strict=True)
        rows = [(name, *bounded_cells(values)) for name, values in named]
        rows.append((Cell("mean of the room", style="total"), *bounded_cells(mean)))
        caption = f"Absorption by {formula}, 95 % interval; materials are their priors, moved"
        tables += wording.band_tables(caption, "material", centres, rows)
    middle = int(np.argmin(np.abs(np.log(centres / 500.0))))
    value, low, high = (
        wording.number(x, 2) for x in found.mean[FORMULAS.index("Eyring"), :, middle]
    )
    lead = (
        f"By Eyring the mean absorption of the room at {wording.hertz(centres[middle])} is {value} "
        f"({low} to {high})."
    )
    head = (Sentence(lead, "lead"), Sentence(_DIFFUSE))
    doubts = (Findings(found.findings),) if found.findings else ()
    return Blocks("Mean absorption from decay times", head, (*doubts, *tables))


def diffuse_records(found: DiffuseAbsorption) -> Table:
    """Return the content of reverberation.csv; material "" is the mean of the room."""
    rows = []
    for i, formula in enumerate(FORMULAS):
        named = (("", found.mean[i]), *zip(found.materials, found.absorption[i], strict=True))
        for name, values in named:
            for centre, column in zip(found.bands.centres_hz, values.T, strict=True):
                rows.append((formula, name, centre, *column))
    names = ("absorption", "lower95", "upper95")
    return Table("", ("formula", "material", Column("band_hz"), *names), rows, form=".5f")
