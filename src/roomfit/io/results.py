"""result.json and absorption.csv, format_version 1.

Arrays as JSON holds them.

What result.json tells of how sure an answer is: shares, priors, groups, samples.

Absorption read back from ``result.json`` or ``absorption.csv``, with how sure one is of it.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.cache import write_json_atomically, write_text_atomically
from roomfit.certified.certificate import Certificate
from roomfit.errors import InputError, StoreError, located
from roomfit.findings import Finding
from roomfit.io.exports import read_material_table
from roomfit.objective.coherent import FittedGeometry
from roomfit.response.directivity import FirstOrderBands
from roomfit.results import Answer, ComparedPair, certificate_distance
from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import AbsorptionPosterior, covariance_from_intervals, logit


def numbers(values: FloatArray) -> list[float]:
    """Return an array of known values as a list."""
    return [float(v) for v in values]


def numbers_or_null(values: FloatArray) -> list[float | None]:
    """Return an array as a list, None for what is unknown."""
    return [float(v) if np.isfinite(v) else None for v in values]


def shares_content(answer: Answer, material: int) -> dict[str, list[float]]:
    """Of the room's absorption, air left out."""
    if answer.shares is None:
        return {}
    names = ("share", "share_lower95", "share_upper95")
    return {name: numbers(part[material]) for name, part in zip(names, answer.shares, strict=True)}


def prior_content(answer: Answer, material: int) -> dict[str, Any]:
    """The prior beside the answer, and how each interval was made."""
    content: dict[str, Any] = {}
    if answer.prior is not None:
        names = ("absorption", "lower95", "upper95")
        parts = zip(names, answer.prior, strict=True)
        content["prior"] = {name: numbers(part[material]) for name, part in parts}
    if answer.interval_kinds and all(answer.interval_kinds):
        content["interval"] = [kinds[material] for kinds in answer.interval_kinds]
    return content


def sampling_content(answer: Answer) -> list[dict[str, Any]]:
    """How the samples of each band came about."""
    return [
        {
            "band_hz": float(centre),
            "converged": s.converged,
            "evaluations": s.evaluations,
            "independent": round(s.effective, 1),
            "autocorrelation": round(float(s.autocorrelation.max()), 2),
            "r_hat": round(float(s.r_hat.max()), 4),
            "acceptance": round(s.acceptance, 3),
        }
        for centre, s in zip(answer.bands.centres_hz, answer.sampling, strict=False)
        if s is not None
    ]


def combinations_content(answer: Answer) -> list[dict[str, Any]]:
    """Means over groups of materials that the data determine, the whole room's first."""
    return [
        {
            "band_hz": float(centre),
            "kind": "mean",
            "weights": _weights(answer, c.weights),
            "absorption": c.value,
            "lower95": c.lower95,
            "upper95": c.upper95,
            "determined": c.determined,
            "differences": [
                {
                    "kind": "difference",
                    "weights": _weights(answer, d.weights),
                    "absorption": d.value,
                    "lower95": d.lower95,
                    "upper95": d.upper95,
                    "determined": d.determined,
                }
                for d in c.differences
            ],
            **({"sentence": sentence} if number == 0 and sentence else {}),
        }
        for centre, band, sentence in zip(
            answer.bands.centres_hz, answer.combinations, _sentences(answer), strict=True
        )
        for number, c in enumerate(band)
    ]


def _sentences(answer: Answer) -> tuple[str, ...]:
    return answer.sentences or ("",) * len(answer.combinations)


def _weights(answer: Answer, weights: FloatArray) -> dict[str, float]:
    named = zip(answer.materials, weights, strict=True)
    return {name: round(float(w), 6) for name, w in named if w != 0.0}


def read_result(path: Path) -> AbsorptionPosterior:
    """Return the absorption of a result with its posterior.

    A ``result.json`` tells how materials go together; from an ``absorption.csv``, or a result
    without ``posterior``, the intervals are taken as independent.

    Raises
    ------
    InputError
        There is no such file, it is neither of the two, or its numbers are out of range.
    """
    path = Path(path)
    table = read_material_table(path)
    content = {} if path.suffix.lower() == ".csv" else json.loads(path.read_text(encoding="utf-8"))
    posterior_content = content.get("posterior")
    with located(str(path)):
        if posterior_content is None:
            covariance = covariance_from_intervals(table.absorption, table.lower95, table.upper95)
        else:
            covariance = _table(posterior_content, "logit_covariance")
        has_prior = posterior_content is not None and "prior_logit_mean" in posterior_content
        return AbsorptionPosterior(
            *(table.names, table.bands, table.absorption, table.lower95, table.upper95),
            logit_covariance=covariance,
            prior_logit_mean=_table(posterior_content, "prior_logit_mean").T if has_prior else None,
            prior_logit_sd=_table(posterior_content, "prior_logit_sd").T if has_prior else None,
            scattering=_result_reader_scattering(content, table.names),
            directivities=_directivities(content),
            chi2_reduced=content.get("fit", {}).get("phi"),
        )


def _table(posterior: Any, name: str) -> FloatArray:
    try:
        return np.array(posterior[name], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "the posterior of the result is incomplete",
            where="posterior",
            found=f"{type(error).__name__}: {error}",
            needed="logit_covariance: for each band a matrix over the materials",
        ) from error


def _directivities(content: dict[str, Any]) -> dict[str, FirstOrderBands]:
    """Return the directivity of every source for which it was fitted."""
    try:
        by_source = content.get("directivity", {})
        return {name: FirstOrderBands(np.array(one["b"])) for name, one in by_source.items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            "the directivity of the result is no table of numbers",
            where="directivity",
            found=f"{type(error).__name__}: {error}",
            needed="by source: b, three numbers for each band",
        ) from error


def _result_reader_scattering(content: dict[str, Any], names: tuple[str, ...]) -> FloatArray | None:
    """Return what the walls scattered in that fit, None where the file does not tell all of it."""
    rows = [content.get("materials", {}).get(name, {}).get("scattering") for name in names]
    if not rows or any(row is None for row in rows):
        return None
    try:
        return np.array(rows, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            "the scattering of the result is no table of numbers",
            where="materials",
            needed="one number per band",
        ) from error


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
                **_results_scattering(answer, i),
                **shares_content(answer, i),
                **prior_content(answer, i),
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
            "phi": numbers(answer.chi2_reduced),
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


def _results_scattering(answer: Answer, material: int) -> dict[str, list[float]]:
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
        "told_sd": numbers(geometry.prior_sd),
    }


def absorption_csv(answer: Answer) -> str:
    """Return the absorption table: material, band_hz, absorption, bounds, identifiable."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["material", "band_hz", "absorption", "lower95", "upper95", "identifiable"])
    for i, name in enumerate(answer.materials):
        for j, centre in enumerate(answer.bands.centres_hz):
            values = (answer.absorption[i, j], answer.lower95[i, j], answer.upper95[i, j])
            identifiable = "true" if answer.identifiable[i, j] else "false"
            writer.writerow([name, f"{centre:g}", *(f"{v:.5f}" for v in values), identifiable])
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
        "code": finding.code.value,
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
    return {_relative_to(folder, path): _sha256(path) for path in inputs}


def _relative_to(folder: Path, path: Path) -> str:
    return path.relative_to(folder).as_posix() if path.is_relative_to(folder) else str(path)


def _sha256(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise StoreError(
            "an input file cannot be read again", where=str(path), found=str(error)
        ) from error
