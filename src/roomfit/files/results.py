"""result.json and absorption.csv, format_version 1."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.files.store import write_json_atomically, write_text_atomically
from roomfit.findings import Finding
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer, ComparedPair


def write_result(folder: Path, answer: Answer, inputs: Iterable[Path]) -> None:
    """Write ``result.json`` and ``absorption.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    write_text_atomically(folder / "absorption.csv", absorption_csv(answer))
    write_json_atomically(folder / "result.json", result_content(answer, inputs))


def result_content(answer: Answer, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as bands_hz, null only inside pairs."""
    return {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": _numbers(answer.bands.centres_hz),
        "materials": {
            name: {
                "absorption": _numbers(answer.absorption[i]),
                "lower95": _numbers(answer.lower95[i]),
                "upper95": _numbers(answer.upper95[i]),
                "identifiable": [bool(b) for b in answer.identifiable[i]],
                "area_m2": round(float(answer.areas_m2[i]), 4),
            }
            for i, name in enumerate(answer.materials)
        },
        "combinations": _combinations(answer),
        "pairs": [_pair(p) for p in answer.pairs],
        "findings": [_finding(f) for f in answer.findings],
        "fit": {
            "method": answer.method,
            "model": answer.model,
            "cost": answer.cost,
            "phi": _numbers(answer.phi),
            "evaluations": answer.evaluations,
            "converged": [bool(b) for b in answer.converged],
            "seconds": round(answer.seconds, 3),
            "certified": None,
            "seed": answer.seed,
            "intervals": answer.interval_kind,
        },
        "provenance": {
            "roomfit": version("roomfit"),
            "inputs_sha256": {path.name: _sha256(path) for path in inputs},
            "speed_of_sound_m_s": answer.speed_of_sound_m_s,
            "speed_of_sound_formula": "Cramer 1993 as in pyfar, or as given by the campaign",
        },
    }


def absorption_csv(answer: Answer) -> str:
    """Return the absorption table: material, band_hz, absorption, bounds, identifiable."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["material", "band_hz", "absorption", "lower95", "upper95", "identifiable"])
    for i, name in enumerate(answer.materials):
        for j, centre in enumerate(answer.bands.centres_hz):
            values = (answer.absorption[i, j], answer.lower95[i, j], answer.upper95[i, j])
            told = "true" if answer.identifiable[i, j] else "false"
            writer.writerow([name, f"{centre:g}", *(f"{v:.5f}" for v in values), told])
    return stream.getvalue()


def _combinations(answer: Answer) -> list[dict[str, Any]]:
    """The mean over all walls: what a decay determines best, even where no wall can be told."""
    share = answer.areas_m2 / answer.areas_m2.sum()
    weights = {name: round(float(w), 6) for name, w in zip(answer.materials, share, strict=True)}
    return [
        {
            "band_hz": float(centre),
            "weights": weights,
            "absorption": float(mean),
            "lower95": float(lower),
            "upper95": float(upper),
        }
        for centre, (mean, lower, upper) in zip(
            answer.bands.centres_hz, answer.mean_absorption.T, strict=True
        )
    ]


def _pair(pair: ComparedPair) -> dict[str, Any]:
    return {
        "source": pair.source,
        "receiver": pair.receiver,
        "use": pair.use,
        "parameters": {
            name: {
                "measured": _numbers_or_null(c.measured),
                "predicted": _numbers_or_null(c.predicted),
                "jnd": _numbers_or_null(c.jnd),
                "mean_of_others": _numbers_or_null(c.null),
            }
            for name, c in pair.parameters.items()
        },
    }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "code": finding.code,
        "severity": finding.severity,
        "sentence": finding.sentence,
        "evidence": dict(finding.evidence),
    }


def _numbers(values: FloatArray) -> list[float]:
    return [float(v) for v in values]


def _numbers_or_null(values: FloatArray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
