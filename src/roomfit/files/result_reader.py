"""Absorption read back from ``result.json`` or ``absorption.csv``, with how sure one is of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.checks import float_array
from roomfit.errors import InputError, located
from roomfit.files.exports.table import read_material_table
from roomfit.typing import FloatArray
from roomfit.uncertainty.posterior import AbsorptionPosterior, covariance_from_intervals


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
    told = content.get("posterior")
    with located(str(path)):
        if told is None:
            covariance = covariance_from_intervals(table.absorption, table.lower95, table.upper95)
        else:
            covariance = _table(told, "logit_covariance")
        knows_prior = told is not None and "prior_logit_mean" in told
        return AbsorptionPosterior(
            *(table.names, table.bands, table.absorption, table.lower95, table.upper95),
            logit_covariance=covariance,
            prior_logit_mean=_table(told, "prior_logit_mean").T if knows_prior else None,
            prior_logit_sd=_table(told, "prior_logit_sd").T if knows_prior else None,
            scattering=_scattering(content, table.names),
            directivities=_directivities(content),
        )


def read_misfit(path: Path) -> FloatArray | None:
    """Return phi of every band of a ``result.json``, None for a table that does not tell it.

    Raises
    ------
    InputError
        There is no such file, or phi is no list of numbers.
    """
    path = Path(path)
    table = read_material_table(path)
    if path.suffix.lower() == ".csv":
        return None
    told = json.loads(path.read_text(encoding="utf-8")).get("fit", {}).get("phi")
    if told is None:
        return None
    with located(str(path)):
        return float_array("fit.phi", told, (len(table.bands),), low=0.0)


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


def _directivities(content: dict[str, Any]) -> dict[str, FloatArray]:
    """Return b of every source whose directivity was fitted."""
    try:
        told = content.get("directivity", {})
        return {name: np.array(one["b"], dtype=np.float64) for name, one in told.items()}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            "the directivity of the result is no table of numbers",
            where="directivity",
            found=f"{type(error).__name__}: {error}",
            needed="by source: b, three numbers for each band",
        ) from error


def _scattering(content: dict[str, Any], names: tuple[str, ...]) -> FloatArray | None:
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
