"""How sources were found to radiate, in tables."""

from __future__ import annotations

import numpy as np

from roomfit.report.html.tables import (
    Cell,
    Row,
    Table,
    band_blocks,
    band_heads,
    block_caption,
)
from roomfit.report.html.wording import number
from roomfit.typing import IntArray
from roomfit.uncertainty.answer import Answer, FittedDirectivity


def source_tables(answer: Answer) -> tuple[Table, ...]:
    """Return a table of every source whose directivity was fitted, none where none was."""
    centres = answer.bands.centres_hz
    return tuple(
        Table(
            block_caption(
                f"Directivity of {found.source}: amplitude 1 + b cos of the angle to its axis",
                centres,
                block,
            ),
            "b",
            band_heads(centres, block),
            _rows(found, block),
        )
        for found in answer.directivities
        for block in band_blocks(len(centres))
    )


def _rows(found: FittedDirectivity, block: IntArray) -> tuple[Row, ...]:
    length = np.linalg.norm(found.b, axis=1)
    whole = tuple(Cell(number(float(length[j]), 2)) for j in block)
    rows = [Row("strength |b|", whole, "0 omnidirectional, 1 cardioid")]
    for axis, name in enumerate("xyz"):
        cells = tuple(
            Cell(
                number(float(found.b[j, axis]), 2, signed=True),
                (f"± {number(float(found.sd[j, axis]), 2)}",),
            )
            for j in block
        )
        rows.append(Row(f"along {name}", cells, "± standard deviation"))
    return tuple(rows)
