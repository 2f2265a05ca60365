"""Formats without limits of their own: pyroomacoustics' arguments as JSON, and a wide CSV."""

from __future__ import annotations

import csv
import io
import json

from roomfit.files.exports.table import MaterialTable
from roomfit.typing import FloatArray


def pyroomacoustics_text(table: MaterialTable, scattering: FloatArray) -> str:
    """Return JSON that maps each material to the arguments of ``pyroomacoustics.Material``.

    ``pra.Material(**json.load(open(file))["brick"])``: ``energy_absorption`` and ``scattering``,
    each with ``coeffs`` and ``center_freqs`` in the bands of the result.
    """
    centres = [float(f) for f in table.bands.centres_hz]
    content = {
        name: {
            "energy_absorption": {
                "description": name,
                "coeffs": [round(float(v), 5) for v in table.absorption[i]],
                "center_freqs": centres,
            },
            "scattering": {
                "description": name,
                "coeffs": [round(float(v), 5) for v in scattering[i]],
                "center_freqs": centres,
            },
        }
        for i, name in enumerate(table.names)
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def csv_text(table: MaterialTable) -> str:
    """Return a table with one column a band: absorption, its interval, and whether it was told."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["material", "quantity", *(f"{f:g}" for f in table.bands.centres_hz)])
    quantities = [
        ("absorption", table.absorption),
        ("lower95", table.lower95),
        ("upper95", table.upper95),
    ]
    if table.scattering is not None:
        quantities.append(("scattering", table.scattering))
    for i, name in enumerate(table.names):
        for quantity, values in quantities:
            writer.writerow([name, quantity, *(f"{v:.5f}" for v in values[i])])
        sure = ["true" if t else "false" for t in table.identifiable[i]]
        writer.writerow([name, "identifiable", *sure])
    return stream.getvalue()
