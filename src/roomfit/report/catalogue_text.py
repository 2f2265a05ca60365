"""The catalogue of materials as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.materials.catalogue import CatalogueEntry
from roomfit.materials.typical import OCTAVES_HZ
from roomfit.typing import FloatArray

_WIDTH = 34


def catalogue_text(entries: Sequence[CatalogueEntry]) -> str:
    """Return one line for each entry, under its group: name and absorption in octaves."""
    head = f"{'absorption at':<{_WIDTH}}" + "".join(f"{_hertz(f):>6}" for f in OCTAVES_HZ)
    lines = [head]
    group = None
    for entry in entries:
        if entry.group != group:
            group = entry.group
            lines += ["", group]
        lines.append(f"  {entry.name:<{_WIDTH - 2}}" + _row(entry.absorption))
    count = f"{len(entries)} materials" if len(entries) != 1 else "1 material"
    lines += ["", f"{count}. roomfit catalogue NAME shows one with its spread and sources."]
    return "\n".join(lines)


def entry_text(entry: CatalogueEntry) -> str:
    """Return one entry in full: middle, spread, and every reading with its source."""
    low, high = (
        1.0 / (1.0 + np.exp(-(entry.logit_mean + z * entry.logit_sd))) for z in (-1.96, 1.96)
    )
    rows: list[tuple[str, FloatArray]] = [
        ("absorption", entry.absorption),
        ("standard deviation", entry.sd),
        ("95 % from", low),
        ("95 % to", high),
    ]
    lines = [
        entry.name,
        f"{entry.description} ({entry.group})",
        "",
        f"{'octave, Hz':<{_WIDTH}}" + "".join(f"{_hertz(f):>6}" for f in OCTAVES_HZ),
        *(f"{label:<{_WIDTH}}{_row(values)}" for label, values in rows),
        "",
        "readings",
    ]
    for reading in entry.readings:
        lines += [
            f"{'':<{_WIDTH}}{_row(reading.absorption)}",
            f"  {reading.row}",
            f"    {reading.source}",
        ]
    lines += [
        "",
        "63 Hz and 8 kHz are carried on from their neighbours, with a wider spread, where no",
        f'reading has them. As a prior in a campaign: prior = "{entry.name}"',
    ]
    return "\n".join(lines)


def _row(values: FloatArray) -> str:
    return "".join(f"{'-':>6}" if np.isnan(v) else f"{v:6.2f}" for v in values)


def _hertz(frequency: float) -> str:
    return f"{frequency:g}" if frequency < 1000.0 else f"{frequency / 1000.0:g}k"
