"""Absorption read back from ``result.json`` or ``absorption.csv``, with how sure one is of it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from roomfit.errors import InputError, located
from roomfit.files.exports.table import read_material_table
from roomfit.uncertainty.posterior_draws import AbsorptionPosterior, covariance_from_intervals


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
    told = None
    if path.suffix.lower() != ".csv":
        told = json.loads(path.read_text(encoding="utf-8")).get("posterior")
    with located(str(path)):
        if told is None:
            covariance = covariance_from_intervals(table.absorption, table.lower95, table.upper95)
        else:
            try:
                covariance = np.array(told["logit_covariance"], dtype=np.float64)
            except (KeyError, TypeError, ValueError) as error:
                raise InputError(
                    "the posterior of the result is incomplete",
                    where="posterior",
                    found=f"{type(error).__name__}: {error}",
                    needed="logit_covariance: for each band a matrix over the materials",
                ) from error
        return AbsorptionPosterior(
            table.names, table.bands, table.absorption, table.lower95, table.upper95, covariance
        )
