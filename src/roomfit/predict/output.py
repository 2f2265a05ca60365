"""A prediction as predicted.json and predicted.csv (format_version 1), as text, page and figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from roomfit.base.bands import Bands
from roomfit.base.errors import InputError
from roomfit.base.findings import Code, Finding
from roomfit.base.table import Cell, Column, Table, Value, csv_of, html_of, text_of
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically, write_text_atomically
from roomfit.files.encoding import finding_content, finding_of, numbers_or_null, provenance
from roomfit.predict.answer import DecayAnswer, decay_answer
from roomfit.predict.changes import Change, change_text
from roomfit.predict.tables import (
    PredictedPair,
    PredictedValue,
    ValueChange,
    is_undetermined,
    named_values,
)
from roomfit.report.decay_times import mid_mean, mid_words
from roomfit.report.figures import (
    LOWEST_DB,
    OKABE_ITO,
    band_panels,
    figure_legend,
    frame_panels,
    literal,
    new_figure,
)
from roomfit.report.html import answer_page
from roomfit.report.text import findings_text
from roomfit.report.wording import band_tables, decay_time_key, html_findings, parameter
from roomfit.signals.decay import FIT_RANGES_DB
from roomfit.signals.iso3382 import ValueName
from roomfit.signals.speech import sti_missing

if TYPE_CHECKING:
    from roomfit.predict.listen import ChangedResponse
    from roomfit.predict.other_walls import Predicted

COLUMNS = (
    *("source", "receiver", "use", "parameter", "band_hz"),
    *("predicted", "lower95", "upper95", "measured", "jnd", "mean_of_others"),
    *("before", "before_lower95", "before_upper95", "change", "change_lower95", "change_upper95"),
    *("carried", "carried_lower95", "carried_upper95"),
)
_OF_A_CHANGE = COLUMNS[11:]


def write_predicted(folder: Path, predicted: Predicted, inputs: Iterable[Path]) -> None:
    """Write ``predicted.json``, ``predicted.csv`` and ``predicted.html`` into a folder."""
    content = predicted_content(predicted, inputs)
    write_text_atomically(folder / "predicted.csv", predicted_csv(predicted))
    write_text_atomically(folder / "predicted.html", predicted_page(predicted))
    write_json_atomically(folder / "predicted.json", content)


def predicted_content(predicted: Predicted, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what predicted.json holds: lists as long as bands_hz, null where nothing is known.

    The first of the inputs is the campaign; the others are named as seen from its folder.
    """
    return {
        "format": "roomfit-predicted",
        "format_version": 1,
        "bands_hz": predicted.bands.centres_hz,
        "materials": {
            name: {
                "absorption": predicted.absorption[i],
                "lower95": predicted.lower95[i],
                "upper95": predicted.upper95[i],
            }
            for i, name in enumerate(predicted.materials)
        },
        **(
            {"objects": {k: _object_content(v) for k, v in predicted.objects_m2.items()}}
            if predicted.objects_m2
            else {}
        ),
        "changes": list(predicted.changes),
        "pairs": [
            {
                "source": p.source,
                "receiver": p.receiver,
                "use": p.use,
                "parameters": parameters_content(p.parameters),
                "sti": one_number(p.sti),
            }
            for p in predicted.pairs
        ],
        "mean": parameters_content(predicted.mean),
        "sti": one_number(predicted.sti),
        "sti_missing": sti_missing(predicted.bands) or None,
        "findings": [finding_content(f) for f in predicted.findings],
        "prediction": {
            "draws": predicted.n_draws,
            "seed": predicted.seed,
            "seconds": round(predicted.seconds, 3),
        },
        "provenance": provenance(inputs),
    }


def _object_content(areas_m2: FloatArray) -> dict[str, Any]:
    return dict(zip(("absorption_area_m2", "lower95_m2", "upper95_m2"), areas_m2, strict=True))


def predicted_records(predicted: Predicted) -> Table:
    """Return the content of predicted.csv: one row a pair, parameter and band, NaN where unknown.

    The speech transmission index has one row a pair, and no band.
    """
    rows = []
    for pair in predicted.pairs:
        for name, v in named_values(pair.parameters, pair.sti).items():
            numbers_of = [v.predicted, v.lower95, v.upper95, v.measured, v.jnd, v.mean_of_others]
            unknown = np.full(v.predicted.size, np.nan)
            numbers_of += [getattr(v.change, c, unknown) for c in _OF_A_CHANGE]
            centres_hz = predicted.bands.centres_hz.tolist() if name != "STI" else [np.nan]
            for centre, *values in zip(centres_hz, *numbers_of, strict=True):
                own = (pair.source, pair.receiver, pair.use or "", name)
                rows.append((*own, centre, *map(float, values)))
    columns = [Column(name, "g" if name == "band_hz" else ".4f") for name in COLUMNS]
    return Table("", columns, rows)


def predicted_csv(predicted: Predicted) -> str:
    """Return one row a pair, parameter and band; empty cells where nothing is known."""
    return csv_of(predicted_records(predicted))


def parameters_content(table: Mapping[ValueName, PredictedValue]) -> dict[str, Any]:
    """Return every parameter of a table with all its rows."""
    return {name: _rows_of(v) for name, v in table.items()}


def _rows_of(value: PredictedValue) -> dict[str, list[float | None]]:
    rows = asdict(value)
    rows |= rows.pop("change") or {}
    return {key: numbers_or_null(row) for key, row in rows.items()}


def one_number(value: PredictedValue | None) -> dict[str, float | None] | None:
    """Return all rows of the speech transmission index, None where there is none."""
    return None if value is None else {key: row[0] for key, row in _rows_of(value).items()}


_SHOWN: tuple[tuple[str, str, str], ...] = (
    ("T20_s", "T20 s", "{:.2f}"),
    ("T30_s", "T30 s", "{:.2f}"),
    ("EDT_s", "EDT s", "{:.2f}"),
    ("C50_dB", "C50 dB", "{:.1f}"),
    ("C80_dB", "C80 dB", "{:.1f}"),
    ("D50_percent", "D50 %", "{:.0f}"),
    ("TS_ms", "TS ms", "{:.0f}"),
    ("G_dB", "G dB", "{:.1f}"),
    ("STI", "STI", "{:.2f}"),
)
_MEAN = "Mean over the pairs (over those measured, where some are): predicted, 95 % interval"
_STI = "Speech transmission index (IEC 60268-16), mean over the pairs, 95 % interval"
_USES = {None: "not measured", "fit": "measured", "validate": "measured, kept for validation"}
_PAIRS_SHOWN = 12
# Of every pair one decay time and one measure of early against late: the first that is known.
_OF_A_PAIR: tuple[tuple[ValueName, ...], ...] = (
    ("T20_s", "T30_s", "EDT_s"),
    ("C80_dB", "C50_dB", "D50_percent", "TS_ms", "G_dB"),
)


def predict_text(predicted: Predicted) -> str:
    """Return the mean over the pairs, every pair, and all findings."""
    parts = [" ".join(_lead(predicted))]
    parts += map(text_of, _mean_tables(predicted, _MEAN))
    if predicted.pairs and predicted.sti is None:
        parts.append(f"STI is not predicted: {sti_missing(predicted.bands)}.")
    parts += [text_of(pairs_table(predicted))] if predicted.pairs else []
    parts.append(findings_text(predicted.findings))
    return "\n\n".join(p for p in parts if p).replace("result.json)", "predicted.json)")


def predicted_html(predicted: Predicted) -> str:
    """Return the mean over the pairs, and all findings, in HTML."""
    caption = "; ".join((_MEAN, *(f"changed: {c}" for c in predicted.changes)))
    tables = map(html_of, _mean_tables(predicted, caption))
    return "".join([*tables, html_findings(predicted.findings)])


def _mean_tables(predicted: Predicted, caption: str) -> list[Table]:
    """Return the mean of every parameter, and that of the speech transmission index if known."""
    is_changed = bool(predicted.changes)
    rows = parameter_rows(
        named_values(predicted.mean, None), is_changed=is_changed, open_for=_open_for(predicted)
    )
    tables = [Table(caption, _heads(predicted), rows)]
    if predicted.sti is not None:
        sti = parameter_rows({"STI": predicted.sti}, is_changed=is_changed)
        tables.append(Table(_STI, ("", "mean"), sti))
    return tables


def pairs_table(predicted: Predicted) -> Table:
    """Return T20 and C80, or what is nearest to them, and STI of every pair, a dozen at most."""
    rows: list[Sequence[Value]] = []
    for pair in predicted.pairs[:_PAIRS_SHOWN]:
        rows.append([f"{pair.source} to {pair.receiver}, {_USES[pair.use]}"])
        chosen = [next((n for n in names if n in pair.parameters), None) for names in _OF_A_PAIR]
        shown = {name: value for name, value in pair.parameters.items() if name in chosen}
        own = parameter_rows(
            named_values(shown, pair.sti),
            is_changed=bool(predicted.changes),
            open_for=_open_for(predicted),
        )
        # the speech transmission index has no band
        rows += [[*row, *[""] * (len(predicted.bands) + 1 - len(row))] for row in own]
    left = len(predicted.pairs) - _PAIRS_SHOWN
    notes = [f"... and {left} more in predicted.csv"] if left > 0 else []
    return Table("By pair", _heads(predicted), rows, notes)


def _heads(predicted: Predicted) -> tuple[str, ...]:
    return ("Hz", *(f"{f:g}" for f in predicted.bands.centres_hz))


_OPEN = ((Code.CHANGE_PRIOR_DOMINATED, "prior alone"), (Code.RESULT_DOUBTED, "result doubted"))


def _open_for(predicted: Predicted) -> tuple[str, ...]:
    """Return by band why the absorption may be split otherwise among walls; "" where it may not."""
    centres_hz, found = predicted.bands.centres_hz.tolist(), predicted.findings
    return tuple(
        next((why for code, why in _OPEN if _is_said(found, code, f)), "") for f in centres_hz
    )


def _is_said(findings: Sequence[Finding], code: Code, band_hz: float) -> bool:
    return any(f.code is code and f.about.in_band(band_hz) for f in findings)


def parameter_lines(
    table: Mapping[str, PredictedValue], *, is_changed: bool, open_for: Sequence[str] = ()
) -> list[tuple[str, str, list[Cell]]]:
    """Return name, what is said of it, and cells of every line of a table.

    What was measured is set against the model of the room as it was measured, never against a
    changed one.
    """
    lines = []
    for name, label, form in _SHOWN:
        if name not in table:
            continue
        v, c = table[name], table[name].change
        after = _with_bounds(form, v.predicted, v.lower95, v.upper95)
        is_measured = np.isfinite(v.measured).any()
        lines.append((label, "model after" if is_changed else "predicted", after))
        if is_measured and c is not None:
            cells = [Cell(form.format(m) if np.isfinite(m) else "-") for m in v.measured]
            lines.append((label, "measured before", cells))
        elif is_measured:
            lines.append((label, "measured", _measured_cells(v, form)))
        if is_changed and c is not None:
            lines += [
                (label, what, cells)
                for what, cells in _change_cells(name, c, form, open_for)
                if is_measured or what != "carried over"
            ]
    return lines


def _change_cells(
    name: str, c: ValueChange, form: str, open_for: Sequence[str]
) -> Iterator[tuple[str, list[Cell]]]:
    yield "model before", _with_bounds(form, c.before, c.before_lower95, c.before_upper95)
    yield "carried over", _with_bounds(form, c.carried, c.carried_lower95, c.carried_upper95)
    rows = (c.change, c.change_lower95, c.change_upper95)
    label, cells = "change %", _with_bounds("{:+.0f}", *(100 * (r - 1) for r in rows))
    if name not in FIT_RANGES_DB:
        unit = {n: label for n, label, _ in _SHOWN}[name].partition(" ")[2].replace("%", "points")
        label, cells = f"change {unit}".rstrip(), _with_bounds(form.replace(":", ":+"), *rows)
    unknown = is_undetermined(name, c)
    for band, why in enumerate(open_for[: unknown.size]):
        if why and unknown[band]:
            cells[band] = Cell("not determined", (why,))
    yield label, cells


def parameter_rows(
    table: Mapping[str, PredictedValue], *, is_changed: bool, open_for: Sequence[str] = ()
) -> list[tuple[Value, ...]]:
    """Return rows as text has them: the name of a parameter stands above its other lines."""
    return [
        ({"predicted": label, "model after": f"{label} after"}.get(what, f"  {what}"), *cells)
        for label, what, cells in parameter_lines(table, is_changed=is_changed, open_for=open_for)
    ]


# Of a change, in the order of time.
_IN_A_PAGE = ("predicted", "measured", "measured before", "model before", "model after")


def predicted_page(predicted: Predicted) -> str:
    """Return the answer as a page, under the policy of the report; means and pairs are folded.

    Of a change each parameter has what was measured before, the model before and after, what was
    measured carried over by the change, and the change, with their intervals.
    """

    is_changed, centres_hz = bool(predicted.changes), predicted.bands.centres_hz
    titled = [
        (_MEAN, predicted.mean),
        *((f"{p.source} to {p.receiver}, {_USES[p.use]}", p.parameters) for p in predicted.pairs),
    ]
    shown, open_for = [], _open_for(predicted)
    for title, values in titled:
        named = named_values(values, None)
        lines = parameter_lines(named, is_changed=is_changed, open_for=open_for)
        shown.append(band_tables(title, "parameter", centres_hz, _page_rows(lines)))
    sti = [("mean over the pairs", predicted.sti)]
    sti += [(f"{p.source} to {p.receiver}", p.sti) for p in predicted.pairs]
    rows = []
    for title, value in sti:
        if value is not None:
            lines = parameter_lines({"STI": value}, is_changed=is_changed)
            rows += _page_rows([(title, what, cells) for _, what, cells in lines])
    if rows:
        shown.insert(1, (Table(_STI, ("pair", "125 Hz to 8 kHz"), rows),))
    missing = "" if rows else f"STI is not predicted: {sti_missing(predicted.bands)}."
    title = "Before and after" if predicted.compares_states else "Predicted"
    answer = _answer(predicted)
    n_means = 2 if rows and len(shown) > 1 else 1
    folded = [("Means", missing, [t for tables in shown[:n_means] for t in tables])]
    if len(shown) > n_means:
        words = f"{len(predicted.pairs)} of source and receiver"
        folded.append(("Pair by pair", words, [t for tables in shown[n_means:] for t in tables]))
    return answer_page(
        title,
        " ".join(_lead(predicted)),
        None if answer is None else answer.figure(),
        _key_figures(predicted, answer),
        predicted.findings,
        folded,
    )


def _answer(predicted: Predicted) -> DecayAnswer | None:
    means = named_values(predicted.mean, None)
    is_changed, open_for = bool(predicted.changes), _open_for(predicted)
    return decay_answer(predicted.bands, means, is_changed=is_changed, open_for=open_for)


def _lead(predicted: Predicted) -> list[str]:
    """Return what was changed, and what the decay time does then."""
    answer = _answer(predicted)
    lead = [f"With {'; '.join(predicted.changes)}:"] if predicted.changes else []
    return lead + ([] if answer is None else [answer.sentence])


def _key_figures(predicted: Predicted, answer: DecayAnswer | None) -> list[tuple[str, str]]:
    """Return at most four numbers and what they are."""
    shown = [] if answer is None else answer.figures
    named = named_values(predicted.mean, predicted.sti)
    centres = predicted.bands.centres_hz
    for key, label, form in _SHOWN:
        v = named.get(key)
        if len(shown) >= 4 or key not in ("C50_dB", "STI", "G_dB") or v is None:
            continue
        rows = (v.predicted, v.lower95, v.upper95)
        value, low, high = ((r[0] if key == "STI" else mid_mean(centres, r)) for r in rows)
        if np.isfinite(value):
            where = "" if key == "STI" else f" at {mid_words(centres)}"
            words = f"{label}{where}, predicted; {form.format(low)} to {form.format(high)} at 95 %"
            shown.append((form.format(value), words))
    return shown


def _page_rows(lines: Sequence[tuple[str, str, list[Cell]]]) -> list[tuple[Cell, ...]]:
    """Return lines in the order of time; each name stands once."""
    rows = []
    order = {what: i for i, what in enumerate(_IN_A_PAGE)}
    for label, own in groupby(lines, key=itemgetter(0)):
        ordered = sorted(own, key=lambda line: order.get(line[1], len(order)))
        for i, (_, what, cells) in enumerate(ordered):
            rows.append((Cell(label if i == 0 else "", (what,)), *cells))
    return rows


def _with_bounds(
    form: str, values: FloatArray, lower95: FloatArray, upper95: FloatArray
) -> list[Cell]:
    return [
        Cell(form.format(v), (f"{form.format(low)} to {form.format(high)}",))
        if np.isfinite(v)
        else Cell("-")
        for v, low, high in zip(values, lower95, upper95, strict=True)
    ]


def _measured_cells(value: PredictedValue, form: str) -> list[Cell]:
    """Measured values; below how far the prediction is above, in just noticeable steps."""
    return [
        Cell(form.format(m), (f"{steps:+.1f} jnd",) if np.isfinite(steps) else ())
        if np.isfinite(m)
        else Cell("-")
        for m, steps in zip(value.measured, value.jnd, strict=True)
    ]


def change_figure(predicted: Predicted) -> Figure:
    """Return means over the pairs before and after a change, one panel a parameter, by band.

    Beside each other in every band: measured before, model before, model after, and measured before
    carried over by the model's change; bars are 95 % intervals.
    """
    means = named_values(predicted.mean, predicted.sti)
    compared = [(v.change, name) for name, v in means.items() if v.change is not None]
    if not compared:
        raise InputError(
            "a picture of a change needs the room before and after it",
            found="a prediction of one state",
            needed="changes of materials whose absorption was found",
            hint="predict with --set MATERIAL=VALUE",
        )
    shown = [(c, n, label) for n, label, _ in _SHOWN for c, m in compared if m == n]
    shown = [row for row in shown if np.isfinite(row[0].change).any()]
    heads = [f"{f:g}" for f in predicted.bands.centres_hz]
    figure = new_figure(9.0, 2.2 * -(-len(shown) // 2) + 0.8)
    panels = figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel()
    for unused in panels[len(shown) :]:
        unused.set_visible(False)
    for axes, (c, name, label) in zip(panels, shown, strict=False):
        v, at = means[name], np.arange(means[name].predicted.size)
        series = (
            ("measured before", "black", v.measured, v.measured, v.measured),
            ("model before", OKABE_ITO[0], c.before, c.before_lower95, c.before_upper95),
            ("model after", OKABE_ITO[1], v.predicted, v.lower95, v.upper95),
            ("measured before, carried over", OKABE_ITO[2],
             c.carried, c.carried_lower95, c.carried_upper95),
        )  # fmt: skip
        for i, (text, color, middle, low, high) in enumerate(series):
            x = at + 0.16 * (i - 1.5)
            axes.vlines(x, low, high, color=color, lw=1.6)
            axes.plot(x, middle, "o", color=color, ms=4, label=text)
        axes.set_title(label, fontsize=9)
        axes.set_xticks(at, ["125 to 8000"] if name == "STI" else heads)
        axes.set_xlim(-0.6, at.size - 0.4)
        axes.grid(alpha=0.25, axis="y")
    figure.supxlabel("frequency (Hz)", fontsize=10)
    figure_legend(figure, panels[0], 4, "mean with " + literal("; ".join(predicted.changes), 80))
    return figure


def predicted_decay_figure(predicted: Predicted, pair: PredictedPair) -> Figure:
    """Return predicted energy decay curves of one pair, one panel a band, measured ones beside."""
    figure, panels = band_panels(len(predicted.bands), 2.3)
    decay = pair.decay
    times = {str(name): value for name, value in pair.parameters.items()}
    key = decay_time_key(times)
    shown_s = 1e-3
    for j, axes in enumerate(panels):
        axes.fill_between(
            decay.time_s, decay.lower_db[j], decay.upper_db[j], color=OKABE_ITO[1], alpha=0.25,
            lw=0.0, label="95 % interval (absorption alone)",
        )  # fmt: skip
        axes.plot(
            decay.time_s,
            decay.predicted_db[j],
            color=OKABE_ITO[1],
            lw=1.6,
            label="predicted after the change" if predicted.changes else "predicted",
        )
        if decay.before_db is not None:
            axes.plot(
                decay.time_s, decay.before_db[j], color=OKABE_ITO[0], lw=1.2, ls="--",
                label="predicted before the change",
            )  # fmt: skip
        if decay.measured_db is not None:
            label = "measured before the change" if predicted.compares_states else "measured"
            axes.plot(decay.time_s, decay.measured_db[j], color="black", lw=1.4, label=label)
        known = decay.predicted_db[j] > LOWEST_DB
        shown_s = max(shown_s, float(decay.time_s[known].max(initial=0.0)))
        label = f"{predicted.bands.centres_hz[j]:g} Hz"
        if key is not None and np.isfinite(times[key].predicted[j]):
            label += f": {parameter(key).symbol} {times[key].predicted[j]:.2f} s"
        axes.set_title(label, fontsize=9)
    panels[0].set_ylim(LOWEST_DB, 2.0)
    panels[0].set_xlim(0.0, shown_s)
    title = f"{literal(pair.source)} to {literal(pair.receiver)}"
    if predicted.changes:
        title += " with " + literal("; ".join(predicted.changes), 80)
    frame_panels(
        figure, panels, "time after emission (s)", "energy decay curve (dB)",
        legend_columns=3, title=title,
    )  # fmt: skip
    return figure


def listen_content(
    bands: Bands,
    changes: Sequence[Change],
    made: Sequence[ChangedResponse],
    findings: Sequence[Finding],
    inputs: Iterable[Path],
) -> dict[str, Any]:
    """Return what listen.json holds, apart from the names of the sound files."""
    return {
        "format": "roomfit-listen",
        "format_version": 1,
        "bands_hz": bands.centres_hz,
        "changes": [change_text(c) for c in changes],
        "responses": [
            {
                "source": c.measurement.source,
                "receiver": c.measurement.receiver,
                "noise_from_s": numbers_or_null(c.noise_from_s),
            }
            for c in made
        ],
        "findings": [finding_content(f) for f in findings],
        "provenance": provenance(inputs),
    }


def listen_text(content: Mapping[str, Any]) -> str:
    """Return what was changed, and from when on noise carries what is predicted of the tail."""
    changed = "; ".join(content["changes"]) or "nothing: every response as it was"
    caption = f"Changed: {changed}\n"
    caption += "From these times after emission the measured noise carries the predicted tail, s:"
    rows = [(f"{r['source']} to {r['receiver']}", *r["noise_from_s"]) for r in content["responses"]]
    bands = [f"{f:g}" for f in content["bands_hz"]]
    note = f"Below {bands[0]} and above {bands[-1]} Hz the nearest band stands for all."
    shown = text_of(Table(caption, ("Hz", *bands), rows, (note,), ".2f"))
    doubts = findings_text(tuple(finding_of(one, "findings") for one in content["findings"]))
    return f"{shown}\n\n{doubts}".rstrip().replace("result.json)", "listen.json)")
