"""result.json and absorption.csv, format_version 1."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.errors import StoreError
from roomfit.files.numbers_json import numbers, numbers_or_null
from roomfit.files.result_certainty import (
    beforehand_content,
    combinations_content,
    sampling_content,
    shares_content,
)
from roomfit.files.store import write_json_atomically, write_text_atomically
from roomfit.findings import Finding
from roomfit.identification.certified.certificate import Certificate
from roomfit.uncertainty.answer import (
    Answer,
    ComparedPair,
    FittedGeometry,
    certificate_distance,
)
from roomfit.uncertainty.posterior import logit


def write_result(folder: Path, answer: Answer, inputs: Iterable[Path]) -> None:
    """Write ``result.json`` and ``absorption.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    content = result_content(answer, inputs)
    write_text_atomically(folder / "absorption.csv", absorption_csv(answer))
    write_json_atomically(folder / "result.json", content)


def result_content(answer: Answer, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what result.json holds: lists as long as bands_hz, null only inside pairs.

    The first of the inputs is the campaign; the others are named as seen from its folder.
    ``posterior`` tells the Gaussian of logit absorption in each band, where the answer has it.
    """
    content: dict[str, Any] = {
        "format": "roomfit-result",
        "format_version": 1,
        "bands_hz": numbers(answer.bands.centres_hz),
        "materials": {
            name: {
                "absorption": numbers(answer.absorption[i]),
                "lower95": numbers(answer.lower95[i]),
                "upper95": numbers(answer.upper95[i]),
                "identifiable": [bool(b) for b in answer.identifiable[i]],
                "area_m2": round(float(answer.areas_m2[i]), 4),
                **_scattering(answer, i),
                **shares_content(answer, i),
                **beforehand_content(answer, i),
            }
            for i, name in enumerate(answer.materials)
        },
        "combinations": combinations_content(answer),
        "pairs": [_pair(p) for p in answer.pairs],
        "findings": [finding_content(f) for f in answer.findings],
        "fit": {
            "method": answer.method,
            "model": answer.model,
            "cost": answer.cost,
            "models": list(answer.models),
            "phi": numbers(answer.phi),
            "evaluations": answer.evaluations,
            "converged": [bool(b) for b in answer.converged],
            "seconds": round(answer.seconds, 3),
            "certified": _certified(answer),
            "seed": answer.seed,
            "intervals": answer.interval_kind,
            "method_chosen": answer.method,
            "reasons": list(answer.reasons),
            **({"sampling": sampling_content(answer)} if any(answer.sampling) else {}),
        },
        "provenance": {
            "roomfit": version("roomfit"),
            "inputs_sha256": input_digests(tuple(inputs)),
            "speed_of_sound_m_s": answer.speed_of_sound_m_s,
            "speed_of_sound_formula": "Cramer 1993 as in pyfar, or as given by the campaign",
        },
    }
    if answer.directivities:
        content["directivity"] = {
            d.source: {"b": [numbers(r) for r in d.b], "sd": [numbers(r) for r in d.sd]}
            for d in answer.directivities
        }
    if answer.geometry is not None:
        content["geometry"] = _geometry(answer.geometry)
    if answer.logit_covariance is not None:
        content["posterior"] = {
            "materials": list(answer.materials),
            "logit_mean": [numbers(band) for band in logit(answer.absorption).T],
            "logit_covariance": [[numbers(r) for r in band] for band in answer.logit_covariance],
        }
        if answer.logit_prior is not None:
            mean, sd = answer.logit_prior
            content["posterior"]["prior_logit_mean"] = [numbers(band) for band in mean.T]
            content["posterior"]["prior_logit_sd"] = [numbers(band) for band in sd.T]
    return content


def _certified(answer: Answer) -> dict[str, Any] | None:
    """What was proven of the cost of energies, their weights held: bands add up."""
    proven = [
        (float(centre), certificate_content(proof) | {"distance": certificate_distance(answer, j)})
        for j, (centre, proof) in enumerate(
            zip(answer.bands.centres_hz, answer.certificates, strict=False)
        )
        if proof is not None
    ]
    if not proven:
        return None
    sums = ("value", "lower_bound", "delta", "open", "boxes", "seconds")
    statuses = {content["status"] for _, content in proven}
    return {
        "status": next(s for s in ("stopped", "unresolved", "certified") if s in statuses),
        "objective": "energies of the windows, weights held",
        **{name: sum(content[name] for _, content in proven) for name in sums},
        "clusters": [
            {"band_hz": centre, **cluster}
            for centre, content in proven
            for cluster in content.pop("clusters")
        ],
        "bands": [{"band_hz": centre, **content} for centre, content in proven],
    }


def certificate_content(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate as JSON holds it; absorptions and gains in the order of the names."""
    return {
        "status": certificate.status,
        "sentence": certificate.sentence,
        "unknowns": list(certificate.coordinates),
        "value": certificate.value,
        "lower_bound": certificate.lower_bound,
        "delta": certificate.delta,
        "clusters": [
            {
                "lower": numbers(c.lower),
                "upper": numbers(c.upper),
                "minimiser": numbers(c.minimiser),
                "value": c.value,
                "unique": c.unique,
            }
            for c in certificate.clusters
        ],
        "open": certificate.n_open,
        "boxes": certificate.boxes,
        "seconds": round(certificate.seconds, 3),
    }


def _scattering(answer: Answer, material: int) -> dict[str, list[float]]:
    if answer.scattering is None:
        return {}
    return {"scattering": numbers(answer.scattering[material])}


def _geometry(geometry: FittedGeometry) -> dict[str, Any]:
    """What arrival times were found to need: no measurement of places."""
    return {
        "note": "fitted to arrival times; these absorb errors of the model, too",
        "speed_of_sound_m_s": geometry.speed_of_sound_m_s,
        "labels": list(geometry.labels),
        "change": numbers(geometry.change),
        "sd": numbers(geometry.sd),
        "told_sd": numbers(geometry.told_sd),
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


def _pair(pair: ComparedPair) -> dict[str, Any]:
    return {
        "source": pair.source,
        "receiver": pair.receiver,
        "use": pair.use,
        "parameters": {
            name: {
                "measured": numbers_or_null(c.measured),
                "predicted": numbers_or_null(c.predicted),
                "jnd": numbers_or_null(c.jnd),
                "mean_of_others": numbers_or_null(c.null),
            }
            for name, c in pair.parameters.items()
        },
    }


def finding_content(finding: Finding) -> dict[str, Any]:
    """Return a finding as JSON holds it."""
    return {
        "code": finding.code,
        "severity": finding.severity,
        "sentence": finding.sentence,
        "evidence": _plain(finding.evidence),
    }


def _plain(value: Any) -> Any:
    """Return what JSON can hold; numbers that are not finite become text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | int | str) or (isinstance(value, float) and np.isfinite(value)):
        return value
    return str(value)


def input_digests(inputs: tuple[Path, ...]) -> dict[str, str]:
    """Return the SHA-256 of every file, named as seen from the folder of the first.

    Raises
    ------
    StoreError
        A file cannot be read again.
    """
    folder = inputs[0].parent if inputs else Path()
    return {_seen_from(folder, path): _sha256(path) for path in inputs}


def _seen_from(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise StoreError(
            "an input file cannot be read again", where=str(path), found=str(error)
        ) from error
