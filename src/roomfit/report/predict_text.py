"""A prediction in words and tables, for a terminal."""

from __future__ import annotations

import numpy as np

from roomfit.report.answer_text import findings_text
from roomfit.signals.parameter_gradients import ValueName
from roomfit.uncertainty.prediction import Predicted, PredictedPair, PredictedValue

_SHOWN: tuple[tuple[ValueName, str, str], ...] = (
    ("T20_s", "T20 s", "{:.2f}"),
    ("T30_s", "T30 s", "{:.2f}"),
    ("EDT_s", "EDT s", "{:.2f}"),
    ("C80_dB", "C80 dB", "{:.1f}"),
    ("D50_percent", "D50 %", "{:.0f}"),
    ("TS_ms", "TS ms", "{:.0f}"),
    ("G_dB", "G dB", "{:.1f}"),
)
_PAIRS_SHOWN = 12


def predict_text(predicted: Predicted) -> str:
    """Return the mean over the pairs, every pair, and all findings."""
    parts = []
    if predicted.changes:
        parts.append("Changed: " + "; ".join(predicted.changes))
    parts += [mean_table(predicted), pairs_text(predicted), findings_text(predicted.findings)]
    return "\n\n".join(p for p in parts if p).replace("result.json)", "predicted.json)")


def mean_table(predicted: Predicted) -> str:
    """Return the mean of every parameter with its interval, and the measured mean below it."""
    lines = [
        "Mean over the pairs (over those measured, where some are): predicted, 95 % interval",
        _head(predicted),
    ]
    for name, label, form in _SHOWN:
        value = predicted.mean[name]
        lines.append(_line(label, value, form))
        if np.isfinite(value.measured).any():
            lines.append(_measured_line(value, form))
    return "\n".join(lines)


def pairs_text(predicted: Predicted) -> str:
    """Return T20 and C80 of every pair, of the first dozen where there are many."""
    lines = ["By pair", _head(predicted)]
    for pair in predicted.pairs[:_PAIRS_SHOWN]:
        lines.append(f"{pair.source} to {pair.receiver}{_use(pair)}")
        for name, label, form in (_SHOWN[0], _SHOWN[3]):
            value = pair.parameters[name]
            lines.append(_line(label, value, form))
            if np.isfinite(value.measured).any():
                lines.append(_measured_line(value, form))
    left = len(predicted.pairs) - _PAIRS_SHOWN
    if left > 0:
        lines.append(f"... and {left} more in predicted.csv")
    return "\n".join(lines)


def _head(predicted: Predicted) -> str:
    cells = "  ".join(f"{f:>20g}" for f in predicted.bands.centres_hz)
    return f"{'Hz':<10}  {cells}"


def _use(pair: PredictedPair) -> str:
    if pair.use is None:
        return ", not measured"
    return ", measured" if pair.use == "fit" else ", measured, kept for validation"


def _line(label: str, value: PredictedValue, form: str) -> str:
    cells = [
        f"{form.format(v)} ({form.format(low)} to {form.format(high)})" if np.isfinite(v) else "-"
        for v, low, high in zip(value.predicted, value.lower95, value.upper95, strict=True)
    ]
    return f"{label:<10}  " + "  ".join(f"{c:>20}" for c in cells)


def _measured_line(value: PredictedValue, form: str) -> str:
    """Measured values; in brackets how far the prediction is above, in just noticeable steps."""
    cells = []
    for m, steps in zip(value.measured, value.jnd, strict=True):
        told = f" ({steps:+.1f} jnd)" if np.isfinite(steps) else ""
        cells.append(f"{form.format(m)}{told}" if np.isfinite(m) else "-")
    return f"{'  measured':<10}  " + "  ".join(f"{c:>20}" for c in cells)
