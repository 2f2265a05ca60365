"""A table as the template draws it: captions, heads and cells of text, no numbers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from roomfit.report.html.wording import hertz
from roomfit.typing import FloatArray, IntArray

BANDS_AT_MOST = 8
"""Columns that fit on a sheet of A4; further bands go into a table below."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Text, smaller lines below it, and the style sheet's name for what it means."""

    text: str
    small: tuple[str, ...] = ()
    style: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """The head of a row, a colour beside it (CSS, or none), and its cells."""

    head: str
    cells: tuple[Cell, ...]
    small: str = ""
    colour: str = ""
    style: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A captioned table; `corner` heads the column of row heads."""

    caption: str
    corner: str
    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def band_blocks(n_bands: int) -> Iterator[IntArray]:
    """Yield the indices of the bands of each table, evenly shared out."""
    n_blocks = -(-n_bands // BANDS_AT_MOST)
    yield from np.array_split(np.arange(n_bands), n_blocks)


def band_heads(centres_hz: FloatArray, block: IntArray) -> tuple[str, ...]:
    """Return the column heads of the bands of a block."""
    return tuple(hertz(float(f)) for f in centres_hz[block])


def block_caption(caption: str, centres_hz: FloatArray, block: IntArray) -> str:
    """Return a caption that tells the bands where one table does not hold them all."""
    if len(block) == len(centres_hz):
        return caption
    low, high = (hertz(float(centres_hz[j])) for j in (block[0], block[-1]))
    return f"{caption}; {low} to {high}"
