"""Maps: predictions over a horizontal plane, and how wide their intervals are there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roomfit.base.errors import InputError
from roomfit.base.table import Column, Table
from roomfit.predict.prediction import Predicted, named_values
from roomfit.room.scene import Point, Scene, is_clear_of_walls, pair_states

MAPPED = ("T30_s", "EDT_s", "C80_dB", "D50_percent", "STI", "G_dB")


def grid_scene(scene: Scene, height_m: float, spacing_m: float) -> Scene:
    """Return a scene whose receivers are a grid over the room, each with every source.

    The grid is centred in the room's box. Left out are points outside of the room or within 10 cm
    of a wall, and of each source those nearer than 50 cm, where direct sound is all there is.
    """
    if not (0.0 < height_m < np.inf and 0.0 < spacing_m < np.inf):
        raise InputError(
            "a grid needs a height and a spacing",
            found=f"{height_m:g} m and {spacing_m:g} m",
            needed="both above 0, as 1.2,0.5",
            hint="--grid 1.2,0.5 is 1.2 m above the floor, a point every 0.5 m",
        )
    vertices = scene.room.mesh.vertices_m
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    counts = np.floor(np.maximum((high - low)[:2] / spacing_m + 1e-9, 1.0))
    most = 2000
    if counts.max() > most or counts.prod() * len(scene.sources) > most:
        raise InputError(
            "a grid of more pairs than can be predicted",
            found=f"{counts[0]:g} x {counts[1]:g} points, {len(scene.sources)} sources",
            needed=f"at most {most} pairs",
            hint="a wider spacing",
        )
    axes = [
        0.5 * (low[k] + high[k]) + spacing_m * (np.arange(n) - 0.5 * (n - 1))
        for k, n in enumerate(counts)
    ]
    x, y = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    points = np.stack((x, y, np.full(x.size, low[2] + height_m)), axis=1)
    sources_m = np.array([s.position_m for s in scene.sources]).reshape(-1, 1, 3)
    is_far = np.linalg.norm(points - sources_m, axis=2) >= 0.5  # (n_sources, n_points)
    kept = is_clear_of_walls(scene.room, points, 0.1) & is_far.any(axis=0)
    if not kept.any():
        raise InputError(
            "no point of the grid can be predicted",
            found=f"height {height_m:g} m, spacing {spacing_m:g} m",
            needed="points 10 cm within the room and 50 cm from a source",
            hint="a height below the ceiling, or a smaller spacing",
        )
    receivers = tuple(Point(f"G{i}", at.round(4)) for i, at in enumerate(points[kept], start=1))
    pairs = np.argwhere(is_far[:, kept])
    states = np.full(len(pairs), pair_states(scene)[0] if len(scene.pairs) else 0)
    return replace(scene, receivers=receivers, pairs=pairs, pair_state=states, groups=())


def grid_records(predicted: Predicted, scene: Scene) -> Table:
    """Return the content of grid.csv: a row for each source, point, parameter and band.

    The speech transmission index, which has no band, has an empty one.
    """
    positions = {p.name: p.position_m for p in scene.receivers}
    rows = []
    for pair in predicted.pairs:
        for name, v in named_values(pair.parameters, pair.sti).items():
            bands = [None] if name == "STI" else predicted.bands.centres_hz.tolist()
            for band_hz, *numbers in zip(bands, v.predicted, v.lower95, v.upper95, strict=True):
                if name in MAPPED:
                    width = numbers[2] - numbers[1]
                    at_m = positions[pair.receiver]
                    rows.append((pair.source, *at_m, name, band_hz, *numbers, width))
    columns = (
        *("source", Column("x_m", ".3f"), Column("y_m", ".3f"), Column("z_m", ".3f")),
        *("parameter", Column("band_hz"), "predicted", "lower95", "upper95", "width95"),
    )
    return Table("", columns, rows, form=".4f")
