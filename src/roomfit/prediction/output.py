"""A prediction as predicted.json and predicted.csv (format_version 1), as text, and as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from roomfit.cache import write_json_atomically, write_text_atomically
from roomfit.io.encoding import csv_text, finding_content, numbers_or_null, provenance
from roomfit.report.figures import LOWEST_DB, OKABE_ITO, band_panels, figure_legend, literal
from roomfit.report.text import findings_text
from roomfit.report.wording import decay_time_key, html_findings, html_table, parameter
from roomfit.signals.iso3382 import ValueName

if TYPE_CHECKING:
    from roomfit.prediction.predict import Predicted, PredictedPair, PredictedValue

COLUMNS = (
    *("source", "receiver", "use", "parameter", "band_hz"),
    *("predicted", "lower95", "upper95", "measured", "jnd", "mean_of_others"),
)


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
                "parameters": _parameters(p.parameters),
            }
            for p in predicted.pairs
        ],
        "mean": _parameters(predicted.mean),
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
            numbers_of = (v.predicted, v.lower95, v.upper95, v.measured, v.jnd, v.mean_of_others)
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


def _parameters(table: Mapping[ValueName, PredictedValue]) -> dict[str, Any]:
    return {
        name: {key: numbers_or_null(row) for key, row in asdict(v).items()}
        for name, v in table.items()
    }


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
    table = html_table(caption, columns, _lines(predicted.mean))
    return table + html_findings(predicted.findings)


def mean_table(predicted: Predicted) -> str:
    """Return the mean of every parameter with its interval, and the measured mean below it."""
    return "\n".join([_MEAN, _head(predicted), *map(_justified, _lines(predicted.mean))])


def pairs_text(predicted: Predicted) -> str:
    """Return T20 and C80, or what is nearest to them, of every pair, a dozen at most."""
    lines = ["By pair", _head(predicted)]
    for pair in predicted.pairs[:_PAIRS_SHOWN]:
        lines.append(f"{pair.source} to {pair.receiver}, {_USES[pair.use]}")
        chosen = [next((n for n in names if n in pair.parameters), None) for names in _OF_A_PAIR]
        shown = {name: value for name, value in pair.parameters.items() if name in chosen}
        lines += map(_justified, _lines(shown))
    left = len(predicted.pairs) - _PAIRS_SHOWN
    if left > 0:
        lines.append(f"... and {left} more in predicted.csv")
    return "\n".join(lines)


def _head(predicted: Predicted) -> str:
    return _justified(["Hz", *(f"{f:g}" for f in predicted.bands.centres_hz)])


def _justified(cells: Sequence[str]) -> str:
    first, *others = cells
    return f"{first:<10}  " + "  ".join(f"{c:>20}" for c in others)


def _lines(table: Mapping[ValueName, PredictedValue]) -> list[list[str]]:
    """Return the cells of a line a parameter, and of a second one where it was measured."""
    lines = []
    for name, label, form in _SHOWN:
        if name not in table:
            continue
        value = table[name]
        bounds = zip(value.predicted, value.lower95, value.upper95, strict=True)
        cells = [
            f"{form.format(v)} ({form.format(low)} to {form.format(high)})"
            if np.isfinite(v)
            else "-"
            for v, low, high in bounds
        ]
        lines.append([label, *cells])
        if np.isfinite(value.measured).any():
            lines.append(["  measured", *_measured_cells(value, form)])
    return lines


def _measured_cells(value: PredictedValue, form: str) -> list[str]:
    """Measured values; in brackets how far the prediction is above, in just noticeable steps."""
    cells = []
    for m, steps in zip(value.measured, value.jnd, strict=True):
        steps_text = f" ({steps:+.1f} jnd)" if np.isfinite(steps) else ""
        cells.append(f"{form.format(m)}{steps_text}" if np.isfinite(m) else "-")
    return cells


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
