"""result.json and impedance.csv of ``roomfit impedance``, format_version 1."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.files.numbers_json import numbers, numbers_or_null
from roomfit.files.results import finding_content, input_digests
from roomfit.files.store import write_json_atomically, write_text_atomically
from roomfit.impedance.answer import ImpedanceAnswer
from roomfit.impedance.intervals import MaterialAnswer
from roomfit.typing import ComplexArray

_COLUMNS = (
    "r0_real", "r0_imag", "absorption_normal", "absorption_random",
    "admittance_real", "admittance_imag", "z_real", "z_imag",
)  # fmt: skip


def write_impedance(folder: Path, answer: ImpedanceAnswer, inputs: Iterable[Path]) -> None:
    """Write ``result.json`` and ``impedance.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    write_text_atomically(folder / "impedance.csv", impedance_csv(answer))
    write_json_atomically(folder / "result.json", impedance_content(answer, inputs))


def impedance_content(answer: ImpedanceAnswer, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as frequency_hz, null where Z is not shown."""
    return {
        "format": "roomfit-impedance",
        "format_version": 1,
        "frequency_hz": numbers(answer.frequency_hz),
        "tau_s": answer.tau_s,
        "materials": {m.name: _material(answer, m) for m in answer.materials},
        "nuisances": [
            {
                "name": n.name,
                "unit": n.unit,
                "value": float(n.value),
                "lower95": float(n.lower95),
                "upper95": float(n.upper95),
                "prior_sd": float(n.prior_sd),
            }
            for n in answer.nuisances
        ],
        "verdict": {
            "word": answer.verdict.word,
            "cause": answer.verdict.cause,
            "sentence": answer.verdict.sentence,
            "weaker": answer.verdict.weaker,
        },
        "findings": [finding_content(f) for f in answer.findings],
        "pairs": [_pair(answer, i) for i in range(len(answer.pairs))],
        "fit": {
            "chi2": _or_null(answer.chi2),
            "model_error": _or_null(answer.model_error),
            "condition": _or_null(answer.condition),
            "starts": answer.n_starts,
            "agreeing_starts": answer.agreeing_starts,
            "ending": answer.ending,
            "evaluations": answer.evaluations,
            "rounds": answer.rounds,
            "seconds": round(answer.seconds, 3),
            "seed": answer.seed,
        },
        "provenance": {
            "roomfit": version("roomfit"),
            "inputs_sha256": input_digests(tuple(inputs)),
        },
    }


def _material(answer: ImpedanceAnswer, material: MaterialAnswer) -> dict[str, Any]:
    content: dict[str, Any] = {"frequency_hz": numbers(answer.frequency_hz), "model": material.kind}
    for name in _COLUMNS:
        for ending in ("", "_lower95", "_upper95"):
            content[name + ending] = numbers_or_null(_column(material, name, ending))
    content["identified"] = [bool(b) for b in material.identified]
    content["parameters"] = {
        name: {"unit": unit, "value": value, "lower95": lower, "upper95": upper}
        for name, unit, value, lower, upper in material.parameters
    }
    return content


def _column(material: MaterialAnswer, name: str, ending: str) -> np.ndarray[Any, Any]:
    field, _, axis = name.rpartition("_")
    if axis not in ("real", "imag"):
        return np.asarray(getattr(material, name + ending))
    values: ComplexArray = getattr(material, {"z": "impedance"}.get(field, field) + ending)
    return np.asarray(values.real if axis == "real" else values.imag)


def _pair(answer: ImpedanceAnswer, i: int) -> dict[str, Any]:
    fitted = answer.evaluations > 0
    measured, predicted = answer.measured[i], answer.predicted[i]
    return {
        "source": answer.pairs[i][0],
        "receiver": answer.pairs[i][1],
        "measured_real": numbers(measured.real),
        "measured_imag": numbers(measured.imag),
        "predicted_real": numbers(predicted.real) if fitted else None,
        "predicted_imag": numbers(predicted.imag) if fitted else None,
        "expected_rms": numbers(answer.expected_rms[i]),
    }


def _or_null(value: float) -> float | None:
    return value if math.isfinite(value) else None


def impedance_csv(answer: ImpedanceAnswer) -> str:
    """Return one row a material and frequency; cells of Z are empty where it is not shown."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = [n + e for n in _COLUMNS for e in ("", "_lower95", "_upper95")]
    writer.writerow(["material", "frequency_hz", *names, "identified"])
    for material in answer.materials:
        columns = [_column(material, n, e) for n in _COLUMNS for e in ("", "_lower95", "_upper95")]
        for j, frequency in enumerate(answer.frequency_hz):
            cells = [f"{c[j]:.6g}" if np.isfinite(c[j]) else "" for c in columns]
            told = "true" if material.identified[j] else "false"
            writer.writerow([material.name, f"{frequency:g}", *cells, told])
    return stream.getvalue()
