"""Predicted parameters beside measured ones, in just noticeable differences, pair by pair."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from roomfit.report.html.tables import (
    Cell,
    Row,
    Table,
    band_blocks,
    band_heads,
    block_caption,
)
from roomfit.report.html.wording import DASH, PARAMETERS, number, parameter
from roomfit.signals.jnd import in_jnd
from roomfit.typing import FloatArray, IntArray
from roomfit.uncertainty.answer import Answer, Compared, ComparedPair

NEAR_JND, FAR_JND = 1.0, 2.0
"""Up to the first nobody hears a difference; above the second it is plain."""


@dataclass(frozen=True, slots=True)
class PairSection:
    """What the report shows of one pair below its name."""

    title: str
    tables: tuple[Table, ...]
    open: bool


def pair_title(pair: ComparedPair) -> str:
    """Return "LS1 to MP2", and whether the pair was kept out of the fit."""
    return f"{pair.source} to {pair.receiver}{'' if pair.use == 'fit' else ' (not fitted)'}"


def parameter_keys(pairs: Iterable[ComparedPair]) -> tuple[str, ...]:
    """Return the parameters that any pair has a number for, in the order of ISO 3382-1."""
    found = {
        key
        for pair in pairs
        for key, c in pair.parameters.items()
        if np.isfinite(c.measured).any() or np.isfinite(c.predicted).any()
    }
    known = tuple(key for key in PARAMETERS if key in found)
    return (*known, *sorted(found - set(known)))


def null_jnd(key: str, compared: Compared) -> FloatArray:
    """Return the null model's error in just noticeable differences, shape (n_bands,)."""
    if key not in PARAMETERS:
        return np.full(compared.measured.shape, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        return in_jnd(key, compared.measured, compared.null)


def mean_abs_jnd(pair: ComparedPair) -> float:
    """Return the mean |JND| over all parameters and bands that can be compared; NaN where none."""
    return known_mean(
        np.concatenate([np.zeros(0), *(abs(c.jnd) for c in pair.parameters.values())])
    )


def known_mean(values: FloatArray) -> float:
    """Return the mean of the finite values, NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def pair_sections(answer: Answer, *, opened: int = 2) -> tuple[PairSection, ...]:
    """Return the tables of every pair; the first few are shown unfolded."""
    keys = parameter_keys(answer.pairs)
    return tuple(
        PairSection(pair_title(pair), _pair_tables(answer, pair, keys), number_of < opened)
        for number_of, pair in enumerate(answer.pairs)
    )


def _pair_tables(answer: Answer, pair: ComparedPair, keys: Sequence[str]) -> tuple[Table, ...]:
    centres = answer.bands.centres_hz
    caption = f"{pair_title(pair)}: predicted minus measured in JND"
    return tuple(
        Table(
            block_caption(caption, centres, block),
            "parameter",
            band_heads(centres, block),
            tuple(_parameter_row(pair, key, block) for key in keys),
        )
        for block in band_blocks(len(centres))
    )


def _parameter_row(pair: ComparedPair, key: str, block: IntArray) -> Row:
    how = parameter(key)
    compared = pair.parameters.get(key)
    if compared is None:
        return Row(how.symbol, tuple(Cell(DASH, ("not given",), "missing") for _ in block))
    null = null_jnd(key, compared)
    cells = tuple(_jnd_cell(compared, float(null[j]), j, how.decimals) for j in block)
    return Row(how.symbol, cells, small=f"in {how.unit}" if how.unit else "")


def _jnd_cell(compared: Compared, null: float, band: int, decimals: int) -> Cell:
    measured, predicted = float(compared.measured[band]), float(compared.predicted[band])
    if not np.isfinite(measured):
        guess = [f"predicted {number(predicted, decimals)}"] if np.isfinite(predicted) else []
        return Cell(DASH, ("not measured", *guess), "missing")
    if not np.isfinite(predicted):
        told = number(measured, decimals)
        return Cell(DASH, ("not predicted", f"measured {told}"), "missing")
    values = f"{number(measured, decimals)} → {number(predicted, decimals)}"
    beside = f"others {number(null, 1, signed=True)}" if np.isfinite(null) else "no others"
    jnd = float(compared.jnd[band])
    return Cell(number(jnd, 1, signed=True), (values, beside), jnd_style(jnd))


def jnd_style(jnd: float) -> str:
    """Return the style sheet's name for how audible an error is."""
    if not np.isfinite(jnd):
        return "missing"
    size = abs(round(jnd, 1))
    return "near" if size <= NEAR_JND else "middle" if size <= FAR_JND else "far"


def overview_table(answer: Answer) -> Table | None:
    """Return the mean |JND| over bands of every pair and parameter beside the null model's."""
    keys = parameter_keys(answer.pairs)
    if not keys:
        return None
    return Table(
        "Mean size of the error over all bands in JND, beside that of the mean of the others",
        "pair",
        tuple(parameter(key).symbol for key in keys),
        tuple(
            Row(pair_title(pair), tuple(_overview_cell(pair, key) for key in keys))
            for pair in answer.pairs
        ),
    )


def _overview_cell(pair: ComparedPair, key: str) -> Cell:
    compared = pair.parameters.get(key)
    if compared is None:
        return Cell(DASH, ("not given",), "missing")
    ours, null = known_mean(abs(compared.jnd)), known_mean(abs(null_jnd(key, compared)))
    if not np.isfinite(ours):
        why = "not predicted" if np.isfinite(compared.measured).any() else "not measured"
        return Cell(DASH, (why,), "missing")
    beside = f"others {number(null, 1)}" if np.isfinite(null) else "no others"
    return Cell(number(ours, 1), (beside,), jnd_style(ours))
