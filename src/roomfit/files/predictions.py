"""predicted.json and predicted.csv, format_version 1."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.files.numbers_json import numbers, numbers_or_null
from roomfit.files.results import finding_content, input_digests
from roomfit.files.store import write_json_atomically, write_text_atomically
from roomfit.signals.parameter_gradients import ValueName
from roomfit.uncertainty.prediction import Predicted, PredictedPair, PredictedValue

_COLUMNS = (
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
        "bands_hz": numbers(predicted.bands.centres_hz),
        "materials": {
            name: {
                "absorption": numbers(predicted.absorption[i]),
                "lower95": numbers(predicted.lower95[i]),
                "upper95": numbers(predicted.upper95[i]),
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
        "provenance": {
            "roomfit": version("roomfit"),
            "inputs_sha256": input_digests(tuple(inputs)),
        },
    }


def predicted_csv(predicted: Predicted) -> str:
    """Return one row a pair, parameter and band; empty cells where nothing is known."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for pair in predicted.pairs:
        for name, value in pair.parameters.items():
            for band, centre in enumerate(predicted.bands.centres_hz):
                writer.writerow(_row(pair, name, value, band, float(centre)))
    return stream.getvalue()


def _row(
    pair: PredictedPair, name: ValueName, value: PredictedValue, band: int, centre_hz: float
) -> list[str]:
    told = (
        *(value.predicted, value.lower95, value.upper95),
        *(value.measured, value.jnd, value.null),
    )
    cells = [f"{v[band]:.4f}" if np.isfinite(v[band]) else "" for v in told]
    return [pair.source, pair.receiver, pair.use or "", name, f"{centre_hz:g}", *cells]


def _parameters(table: Mapping[ValueName, PredictedValue]) -> dict[str, Any]:
    return {
        name: {
            "predicted": numbers_or_null(v.predicted),
            "lower95": numbers_or_null(v.lower95),
            "upper95": numbers_or_null(v.upper95),
            "sd_absorption": numbers_or_null(v.sd_absorption),
            "sd_rest": numbers_or_null(v.sd_rest),
            "measured": numbers_or_null(v.measured),
            "jnd": numbers_or_null(v.jnd),
            "mean_of_others": numbers_or_null(v.null),
        }
        for name, v in table.items()
    }
