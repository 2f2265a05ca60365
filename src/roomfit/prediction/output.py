"""A prediction as predicted.json and predicted.csv (format_version 1), as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from roomfit.cache import write_json_atomically, write_text_atomically
from roomfit.errors import InputError
from roomfit.io.encoding import csv_text, finding_content, numbers_or_null, provenance
from roomfit.prediction.decay import RELATIVE
from roomfit.report.figures import (
    LOWEST_DB,
    OKABE_ITO,
    band_panels,
    figure_legend,
    literal,
    new_figure,
)
from roomfit.report.text import findings_text
from roomfit.report.wording import decay_time_key, html_findings, html_table, parameter
from roomfit.signals.iso3382 import VALUE_NAMES, ValueName
from roomfit.typing import FloatArray

if TYPE_CHECKING:
    from roomfit.prediction.predict import Predicted, PredictedPair, PredictedValue

COLUMNS = (
    *("source", "receiver", "use", "parameter", "band_hz"),
    *("predicted", "lower95", "upper95", "measured", "jnd", "mean_of_others"),
    *("before", "before_lower95", "before_upper95", "change", "change_lower95", "change_upper95"),
    *("carried", "carried_lower95", "carried_upper95"),
)
_OF_A_CHANGE = COLUMNS[11:]


def write_predicted(folder: Path, predicted: Predicted, inputs: Iterable[Path]) -> None:
    """Write ``predicted.json`` and ``predicted.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    content = predicted_content(predicted, inputs)
    write_text_atomically(folder / "predicted.csv", predicted_csv(predicted))
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
        "changes": list(predicted.changes),
        "pairs": [
            {
                "source": p.source,
                "receiver": p.receiver,
                "use": p.use,
                "parameters": parameters_content(p.parameters),
            }
            for p in predicted.pairs
        ],
        "mean": parameters_content(predicted.mean),
        "findings": [finding_content(f) for f in predicted.findings],
        "prediction": {
            "draws": predicted.n_draws,
            "seed": predicted.seed,
            "seconds": round(predicted.seconds, 3),
        },
        "provenance": provenance(inputs),
    }


def predicted_rows(
    predicted: Predicted,
) -> Iterator[tuple[tuple[str, str, str, str], tuple[float, ...]]]:
    """Yield one row a pair, parameter and band: its texts and its numbers, NaN where unknown."""
    for pair in predicted.pairs:
        for name, v in pair.parameters.items():
            numbers_of = [v.predicted, v.lower95, v.upper95, v.measured, v.jnd, v.mean_of_others]
            unknown = np.full(len(predicted.bands), np.nan)
            numbers_of += [getattr(v.change, c, unknown) for c in _OF_A_CHANGE]
            for band, centre in enumerate(predicted.bands.centres_hz):
                values = (float(centre), *(float(n[band]) for n in numbers_of))
                yield (pair.source, pair.receiver, pair.use or "", name), values


def predicted_csv(predicted: Predicted) -> str:
    """Return one row a pair, parameter and band; empty cells where nothing is known."""
    rows = []
    for texts, (centre_hz, *values) in predicted_rows(predicted):
        cells = [f"{v:.4f}" if np.isfinite(v) else "" for v in values]
        rows.append([*texts, f"{centre_hz:g}", *cells])
    return csv_text(COLUMNS, rows)


def parameters_content(table: Mapping[ValueName, PredictedValue]) -> dict[str, Any]:
    """Return every parameter of a table with all its rows."""
    found: dict[str, Any] = {}
    for name, v in table.items():
        rows = asdict(v)
        rows |= rows.pop("change") or {}
        found[name] = {key: numbers_or_null(row) for key, row in rows.items()}
    return found


_SHOWN: tuple[tuple[ValueName, str, str], ...] = (
    ("T20_s", "T20 s", "{:.2f}"),
    ("T30_s", "T30 s", "{:.2f}"),
    ("EDT_s", "EDT s", "{:.2f}"),
    ("C50_dB", "C50 dB", "{:.1f}"),
    ("C80_dB", "C80 dB", "{:.1f}"),
    ("D50_percent", "D50 %", "{:.0f}"),
    ("TS_ms", "TS ms", "{:.0f}"),
    ("G_dB", "G dB", "{:.1f}"),
)
_MEAN = "Mean over the pairs (over those measured, where some are): predicted, 95 % interval"
_USES = {None: "not measured", "fit": "measured", "validate": "measured, kept for validation"}
_PAIRS_SHOWN = 12
# Of every pair one decay time and one measure of early against late: the first that is known.
_OF_A_PAIR: tuple[tuple[ValueName, ...], ...] = (
    ("T20_s", "T30_s", "EDT_s"),
    ("C80_dB", "C50_dB", "D50_percent", "TS_ms", "G_dB"),
)


def predict_text(predicted: Predicted) -> str:
    """Return the mean over the pairs, every pair, and all findings."""
    parts = []
    if predicted.changes:
        parts.append("Changed: " + "; ".join(predicted.changes))
    parts += [mean_table(predicted), pairs_text(predicted), findings_text(predicted.findings)]
    return "\n\n".join(p for p in parts if p).replace("result.json)", "predicted.json)")


def predicted_html(predicted: Predicted) -> str:
    """Return the mean over the pairs, and all findings, in HTML."""
    caption = "; ".join((_MEAN, *(f"changed: {c}" for c in predicted.changes)))
    columns = ("Hz", *(f"{f:g}" for f in predicted.bands.centres_hz))
    table = html_table(caption, columns, value_lines(predicted.mean))
    return table + html_findings(predicted.findings)


def mean_table(predicted: Predicted) -> str:
    """Return the mean of every parameter with its interval, and the measured mean below it."""
    return "\n".join([_MEAN, _head(predicted), *map(_justified, value_lines(predicted.mean))])


def pairs_text(predicted: Predicted) -> str:
    """Return T20 and C80, or what is nearest to them, of every pair, a dozen at most."""
    lines = ["By pair", _head(predicted)]
    for pair in predicted.pairs[:_PAIRS_SHOWN]:
        lines.append(f"{pair.source} to {pair.receiver}, {_USES[pair.use]}")
        chosen = [next((n for n in names if n in pair.parameters), None) for names in _OF_A_PAIR]
        shown = {name: value for name, value in pair.parameters.items() if name in chosen}
        lines += map(_justified, value_lines(shown))
    left = len(predicted.pairs) - _PAIRS_SHOWN
    if left > 0:
        lines.append(f"... and {left} more in predicted.csv")
    return "\n".join(lines)


def _head(predicted: Predicted) -> str:
    return _justified(["Hz", *(f"{f:g}" for f in predicted.bands.centres_hz)])


def _justified(cells: Sequence[str]) -> str:
    first, *others = cells
    return f"{first:<17}  " + "  ".join(f"{c:>20}" for c in others)


def value_lines(table: Mapping[ValueName, PredictedValue]) -> list[list[str]]:
    """Return the cells of a line a parameter, and of further ones: measured, before a change."""
    lines = []
    for name, label, form in _SHOWN:
        if name not in table:
            continue
        v = table[name]
        lines.append([label, *_with_bounds(form, v.predicted, v.lower95, v.upper95)])
        is_measured = np.isfinite(v.measured).any()
        c = v.change
        if c is None:
            if is_measured:
                lines.append(["  measured", *_measured_cells(v, form)])
            continue
        if is_measured:
            cells = [form.format(m) if np.isfinite(m) else "-" for m in v.measured]
            lines.append(["  measured before", *cells])
        before = _with_bounds(form, c.before, c.before_lower95, c.before_upper95)
        lines.append(["  model before", *before])
        if is_measured:
            carried = _with_bounds(form, c.carried, c.carried_lower95, c.carried_upper95)
            lines.append(["  carried over", *carried])
        rows = (c.change, c.change_lower95, c.change_upper95)
        if RELATIVE[VALUE_NAMES.index(name)]:
            lines.append(["  change %", *_with_bounds("{:+.0f}", *(100 * (r - 1) for r in rows))])
        else:
            signed = form.replace(":", ":+")
            unit = label.split()[1].replace("%", "points")
            lines.append([f"  change {unit}", *_with_bounds(signed, *rows)])
    return lines


def _with_bounds(
    form: str, values: FloatArray, lower95: FloatArray, upper95: FloatArray
) -> list[str]:
    return [
        f"{form.format(v)} ({form.format(low)} to {form.format(high)})" if np.isfinite(v) else "-"
        for v, low, high in zip(values, lower95, upper95, strict=True)
    ]


def _measured_cells(value: PredictedValue, form: str) -> list[str]:
    """Measured values; in brackets how far the prediction is above, in just noticeable steps."""
    cells = []
    for m, steps in zip(value.measured, value.jnd, strict=True):
        steps_text = f" ({steps:+.1f} jnd)" if np.isfinite(steps) else ""
        cells.append(f"{form.format(m)}{steps_text}" if np.isfinite(m) else "-")
    return cells


def change_figure(predicted: Predicted) -> Figure:
    """Return means over the pairs before and after a change, one panel a parameter, by band.

    Beside each other in every band: measured before, model before, model after, and measured before
    carried over by the model's change; bars are 95 % intervals.

    Raises
    ------
    InputError
        Nothing was changed, or what is replaced was not known.
    """
    compared = [(v.change, name) for name, v in predicted.mean.items() if v.change is not None]
    if not compared:
        raise InputError(
            "a picture of a change needs the room before and after it",
            found="a prediction of one state",
            needed="changes of materials whose absorption was found",
        )
    shown = [(c, n, label) for n, label, _ in _SHOWN for c, m in compared if m == n]
    shown = [row for row in shown if np.isfinite(row[0].change).any()]
    figure = new_figure(9.0, 2.2 * -(-len(shown) // 2) + 0.8)
    panels = figure.subplots(-(-len(shown) // 2), 2, sharex=True, squeeze=False).ravel()
    at = np.arange(len(predicted.bands))
    for unused in panels[len(shown) :]:
        unused.set_visible(False)
    for axes, (c, name, label) in zip(panels, shown, strict=False):
        v = predicted.mean[name]
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
        axes.set_xticks(at, [f"{f:g}" for f in predicted.bands.centres_hz])
        axes.tick_params(labelbottom=True)
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
            lw=0.0, label="95 % of the absorptions that are possible",
        )  # fmt: skip
        axes.plot(
            decay.time_s, decay.predicted_db[j], color=OKABE_ITO[1], lw=1.6, label="predicted"
        )
        if decay.before_db is not None:
            axes.plot(
                decay.time_s, decay.before_db[j], color=OKABE_ITO[0], lw=1.2, ls="--",
                label="predicted before the change",
            )  # fmt: skip
        if decay.measured_db is not None:
            axes.plot(decay.time_s, decay.measured_db[j], color="black", lw=1.4, label="measured")
        known = decay.predicted_db[j] > LOWEST_DB
        shown_s = max(shown_s, float(decay.time_s[known].max(initial=0.0)))
        label = f"{predicted.bands.centres_hz[j]:g} Hz"
        if key is not None and np.isfinite(times[key].predicted[j]):
            label += f": {parameter(key).symbol} {times[key].predicted[j]:.2f} s"
        axes.set_title(label, fontsize=9)
    panels[0].set_ylim(LOWEST_DB, 2.0)
    panels[0].set_xlim(0.0, shown_s)
    figure.supxlabel("time after emission (s)", fontsize=10)
    figure.supylabel("energy decay curve (dB)", fontsize=10)
    title = f"{literal(pair.source)} to {literal(pair.receiver)}"
    if predicted.changes:
        title += " with " + literal("; ".join(predicted.changes), 80)
    figure_legend(figure, panels[0], 3, title)
    return figure
