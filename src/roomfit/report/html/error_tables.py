"""How far predictions are off on average, beside a guess that knows no room model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.report.html.pair_tables import known_mean, parameter_keys
from roomfit.report.html.tables import (
    Cell,
    Row,
    Table,
    band_blocks,
    band_heads,
    block_caption,
)
from roomfit.report.html.wording import DASH, count, number, parameter
from roomfit.typing import FloatArray
from roomfit.uncertainty.answer import Answer, ComparedPair, Use

WORSE = "▲"


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Absolute errors of one parameter, percent or in its unit; shape (n_pairs, n_bands).

    NaN where one of the two cannot be compared. Where any null model exists, `model` holds
    only what `null` holds as well, so that both are means over the same pairs.
    """

    model: FloatArray
    null: FloatArray


def errors_of(pairs: Sequence[ComparedPair], key: str) -> Errors:
    """Return the errors of the model's and of the null model's predictions of a parameter."""
    compared = [pair.parameters[key] for pair in pairs if key in pair.parameters]
    measured = np.array([c.measured for c in compared])
    scale = np.where(measured == 0.0, np.nan, measured) / 100.0
    if parameter(key).error_unit != "%":
        scale = np.ones_like(measured)
    model = np.abs(np.array([c.predicted for c in compared]) - measured) / scale
    null = np.abs(np.array([c.null for c in compared]) - measured) / scale
    both = np.isfinite(model) & np.isfinite(null)
    if not both.any():
        return Errors(model, np.full_like(model, np.nan))
    return Errors(np.where(both, model, np.nan), np.where(both, null, np.nan))


def error_tables(answer: Answer) -> tuple[Table, ...]:
    """Return mean |error| per parameter and band, model beside null model, by use of the pairs."""
    uses: tuple[tuple[Use, str], ...] = (("validate", "not fitted"), ("fit", "fitted"))
    tables: list[Table] = []
    for use, words in uses:
        pairs = [pair for pair in answer.pairs if pair.use == use]
        if parameter_keys(pairs):
            tables += _tables(answer, pairs, f"Mean error over {count(len(pairs), 'pair')} {words}")
    return tuple(tables)


def _tables(answer: Answer, pairs: Sequence[ComparedPair], caption: str) -> list[Table]:
    centres = answer.bands.centres_hz
    keys = parameter_keys(pairs)
    found = {key: errors_of(pairs, key) for key in keys}
    everything = list(range(len(centres)))
    tables = []
    for block in band_blocks(len(centres)):
        last = ["all bands"] if block[-1] == everything[-1] else []
        groups = [[int(j)] for j in block] + [everything for _ in last]
        rows = tuple(
            Row(
                parameter(key).symbol,
                tuple(_cell(key, found[key], group) for group in groups),
                small=f"in {parameter(key).error_unit}",
            )
            for key in keys
        )
        columns = (*band_heads(centres, block), *last)
        tables.append(Table(block_caption(caption, centres, block), "parameter", columns, rows))
    return tables


def _cell(key: str, errors: Errors, bands: list[int]) -> Cell:
    model, null = known_mean(errors.model[:, bands]), known_mean(errors.null[:, bands])
    if not np.isfinite(model):
        return Cell(DASH, ("not comparable",), "missing")
    decimals = parameter(key).error_decimals
    text = number(model, decimals)
    if not np.isfinite(null):
        return Cell(text, ("no others",))
    if round(model, decimals) > round(null, decimals):
        return Cell(f"{WORSE} {text}", (f"others {number(null, decimals)}",), "worse")
    return Cell(text, (f"others {number(null, decimals)}",))
