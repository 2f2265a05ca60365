"""A prediction as predicted.json and predicted.csv (format_version 1)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from roomfit.base.bands import Bands
from roomfit.base.findings import Finding
from roomfit.base.table import Column, Table, csv_of
from roomfit.base.typing import FloatArray
from roomfit.base.whole_files import write_json_atomically, write_text_atomically
from roomfit.files.encoding import finding_content, numbers_or_null, provenance
from roomfit.predict.changes import Change, change_text
from roomfit.predict.prediction import PredictedValue, named_values
from roomfit.signals.iso3382 import ValueName
from roomfit.signals.speech import sti_missing

if TYPE_CHECKING:
    from roomfit.predict.listen import ChangedResponse
    from roomfit.predict.prediction import Predicted

COLUMNS = (
    *("source", "receiver", "use", "parameter", "band_hz"),
    *("predicted", "lower95", "upper95", "measured", "jnd", "mean_of_others"),
    *("before", "before_lower95", "before_upper95", "change", "change_lower95", "change_upper95"),
)
_OF_A_CHANGE = COLUMNS[11:]


def write_predicted(folder: Path, predicted: Predicted, inputs: Iterable[Path]) -> None:
    """Write ``predicted.json`` and ``predicted.csv`` into a folder."""
    write_text_atomically(folder / "predicted.csv", csv_of(predicted_records(predicted)))
    write_json_atomically(folder / "predicted.json", predicted_content(predicted, inputs))


def predicted_content(predicted: Predicted, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what predicted.json holds: lists as long as bands_hz, null where nothing is known.

    The first of the inputs is the campaign; the others are named as seen from its folder.
    """
    rows = (predicted.absorption, predicted.lower95, predicted.upper95)
    tables = {
        "materials": _named(("absorption", "lower95", "upper95"), predicted.materials, *rows),
        "objects": _named(
            ("absorption_area_m2", "lower95_m2", "upper95_m2"),
            predicted.objects_m2,
            *zip(*predicted.objects_m2.values(), strict=True),
        ),
    }
    return {
        "format": "roomfit-predicted",
        "format_version": 1,
        "bands_hz": predicted.bands.centres_hz,
        **{name: table for name, table in tables.items() if table or name == "materials"},
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
        **_means(predicted),
        "variants": {
            name: {"changes": list(one.changes), **_means(one)}
            for name, one in predicted.variants.items()
        },
        "sti_missing": sti_missing(predicted.bands) or None,
        "findings": [finding_content(f) for f in predicted.findings],
        "prediction": {
            "draws": predicted.n_draws,
            "seed": predicted.seed,
            "seconds": round(predicted.seconds, 3),
        },
        "provenance": provenance(inputs),
    }


def _means(predicted: Predicted) -> dict[str, Any]:
    return {"mean": parameters_content(predicted.mean), "sti": one_number(predicted.sti)}


def _named(
    keys: tuple[str, ...], names: Iterable[str], *rows: Iterable[FloatArray]
) -> dict[str, dict[str, FloatArray]]:
    """Return a value with its bounds by key, and these by name."""
    each = zip(*rows, strict=True)
    return {name: dict(zip(keys, own, strict=True)) for name, own in zip(names, each, strict=False)}


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
