"""design.json and design.csv, format_version 1."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from roomfit.files.numbers_json import numbers, numbers_or_null
from roomfit.files.results import finding_content, input_digests
from roomfit.files.store import write_json_atomically, write_text_atomically
from roomfit.placement.answer import Design, mean_widths, widest
from roomfit.typing import FloatArray

_COLUMNS = (
    *("number", "source", "source_x_m", "source_y_m", "source_z_m"),
    *("receiver", "receiver_x_m", "receiver_y_m", "receiver_z_m"),
    *("distance_m", "mean_width95"),
)


def write_design(folder: Path, design: Design, inputs: Iterable[Path]) -> None:
    """Write ``design.json`` and ``design.csv`` into a folder.

    Raises
    ------
    StoreError
        The disk refuses.
    """
    write_text_atomically(folder / "design.csv", design_csv(design))
    write_json_atomically(folder / "design.json", design_content(design, inputs))


def design_content(design: Design, inputs: Iterable[Path]) -> dict[str, Any]:
    """Return what design.json holds: lists over bands are as long as bands_hz."""
    means = mean_widths(design)
    return {
        "format": "roomfit-design",
        "format_version": 1,
        "bands_hz": numbers(design.bands.centres_hz),
        "chosen": [
            {
                "source": source,
                "source_m": numbers(source_m),
                "receiver": receiver,
                "receiver_m": numbers(receiver_m),
                "mean_width95": float(means[i + 1]),
                "width95": _by_material(design, design.widths[i + 1]),
            }
            for i, (source, source_m, receiver, receiver_m) in enumerate(_places(design))
        ],
        "before": {
            "mean_width95": float(means[0]),
            "width95": _by_material(design, design.widths[0]),
            "after_fit": design.after_fit,
            "measured_pairs": design.n_held,
        },
        "widest": _widest(design),
        "random": _random(design),
        "candidates": len(design.scene.pairs) - design.n_held,
        "assumed": {
            "model": design.model,
            "criterion": design.criterion,
            "draws": design.n_draws,
            "absorption": _by_material(design, design.absorption),
            "source_distance_m": design.source_distance_m,
            "receiver_distance_m": design.receiver_distance_m,
            "wall_distance_m": design.wall_distance_m,
        },
        "findings": [finding_content(f) for f in design.findings],
        "design": {"seed": design.seed, "seconds": round(design.seconds, 3)},
        "provenance": {
            "roomfit": version("roomfit"),
            "inputs_sha256": input_digests(tuple(inputs)),
        },
    }


def design_csv(design: Design) -> str:
    """Return one row a chosen pair: its places, and the mean width of the intervals after it."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    after = mean_widths(design)[1:]
    for i, (source, source_m, receiver, receiver_m) in enumerate(_places(design)):
        at = [[f"{x:.3f}" for x in place] for place in (source_m, receiver_m)]
        distance = float(np.linalg.norm(source_m - receiver_m))
        row = [i + 1, source, *at[0], receiver, *at[1], f"{distance:.3f}", f"{after[i]:.4f}"]
        writer.writerow(row)
    return stream.getvalue()


def _places(design: Design) -> list[tuple[str, FloatArray, str, FloatArray]]:
    found = []
    for s, r in design.scene.pairs[design.chosen]:
        source, receiver = design.scene.sources[s], design.scene.receivers[r]
        found.append((source.name, source.position_m, receiver.name, receiver.position_m))
    return found


def _by_material(design: Design, table: FloatArray) -> dict[str, list[float]]:
    return {name: numbers(row) for name, row in zip(design.materials, table, strict=True)}


def _widest(design: Design) -> dict[str, Any]:
    material, band = widest(design)
    return {
        "material": design.materials[material],
        "band_hz": float(design.bands.centres_hz[band]),
        "width95": numbers(design.widths[:, material, band]),
    }


def _random(design: Design) -> dict[str, Any]:
    """Return how random designs do after 0 to n pairs: null where none went so far."""
    means = design.random_means
    reached = np.isfinite(means).any(axis=0)
    out: dict[str, Any] = {"designs": len(means)}
    for name, share in (("median", 0.5), ("lower5", 0.05), ("upper95", 0.95)):
        row = np.full(means.shape[1], np.nan)
        if len(means):
            row[reached] = np.nanquantile(means[:, reached], share, axis=0)
        out[f"mean_width95_{name}"] = numbers_or_null(row)
    return out
