"""The room in space: materials half transparent, sources and receivers with their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roomfit.geometry.mesh import area_vectors_m2, corners_m, triangle_areas_m2
from roomfit.report.html.plots import (
    GRID,
    INK,
    SECOND,
    Figure,
    Plot,
    base_layout,
    label,
    material_colour,
    rounded,
)
from roomfit.report.html.room_outline import outline_m
from roomfit.report.html.tables import Cell, Row, Table
from roomfit.report.html.wording import DASH, area, count, number, shortened
from roomfit.scene.room import Room, material_areas_m2, triangle_material
from roomfit.scene.scene import Point, Scene
from roomfit.typing import BoolArray, FloatArray

_HEIGHT_PX = 520
_MOST_EDGES = 3000
_MOST_TRIANGLES = 40_000
_SURFACES_SHOWN = 6
_MOST_NAMES = 12
_FLAT_M = 0.01


def room_plot(scene: Scene) -> Plot:
    """Return the room seen from above one corner, all axes to the same scale."""
    # a legend of many materials takes room below the picture
    height_px = _HEIGHT_PX + 20 * max(-(-len(scene.room.materials) // 3) - 2, 0)
    layout = base_layout(height_px)
    layout["margin"] = {"l": 0, "r": 0, "t": 0, "b": 0}
    layout["legend"] |= {"y": 0.0, "yanchor": "top"}
    layout["scene"] = _space(scene.room)
    edges = _edges(scene.room)
    caption = "Drag to turn; a click on a material in the legend hides it."
    if len(scene.room.mesh.triangles) > _MOST_TRIANGLES:
        caption += f" Only the largest {_MOST_TRIANGLES} faces are drawn."
    data = [
        *_walls(scene.room),
        *([edges] if edges else []),
        *([_names(scene.room)] if len(scene.room.materials) <= _MOST_NAMES else []),
        _points("source", scene.sources, SECOND, "diamond"),
        _points("receiver", scene.receivers, INK, "circle"),
    ]
    return Plot(
        "room",
        {"data": data, "layout": layout},
        height_px,
        f"The room in three dimensions with {count(len(scene.room.materials), 'material')}, "
        f"{count(len(scene.sources), 'source')} and {count(len(scene.receivers), 'receiver')}; "
        "the plan and the tables below tell the same in numbers.",
        caption,
    )


def _space(room: Room) -> Figure:
    axis: Figure = {
        "nticks": 7,
        "gridcolor": GRID,
        "showbackground": False,
        "zeroline": False,
        "showspikes": False,
    }
    size = np.ptp(room.mesh.vertices_m, axis=0)
    # a wide, low room is looked at from higher up, and everything from far enough to be seen whole
    height = 0.9 + 0.5 * float(max(size[0], size[1]) / max(size.sum(), 1e-9))
    return {
        "aspectmode": "data",
        "xaxis": axis | {"title": {"text": "x (m)"}},
        "yaxis": axis | {"title": {"text": "y (m)"}},
        "zaxis": axis | {"title": {"text": "z (m)"}, "nticks": 5},
        "camera": {
            "eye": {"x": -1.02, "y": -1.66, "z": height},
            "center": {"x": 0.0, "y": 0.0, "z": -0.17},
        },
    }


def _walls(room: Room) -> list[Figure]:
    """Return one half-transparent mesh for each material that has faces."""
    owner = np.where(_drawn(room), triangle_material(room), -1)
    meshes = []
    for i, name in enumerate(room.materials):
        mine = room.mesh.triangles[owner == i]
        if not len(mine):
            continue
        used, corners = np.unique(mine, return_inverse=True)
        corners = corners.reshape(mine.shape)
        vertices = room.mesh.vertices_m[used]
        meshes.append(
            {
                "type": "mesh3d",
                "name": label(name),
                "showlegend": True,
                **{axis: rounded(vertices[:, k], 3) for k, axis in enumerate("xyz")},
                **{axis: corners[:, k].tolist() for k, axis in enumerate("ijk")},
                "color": material_colour(i),
                "opacity": 0.3,
                "flatshading": True,
                "lighting": {"ambient": 0.9, "diffuse": 0.25, "specular": 0.0},
                "hoverinfo": "name",
            }
        )
    return meshes


def _drawn(room: Room) -> BoolArray:
    """Return which triangles are drawn: all, or the largest of very many."""
    n = len(room.mesh.triangles)
    drawn = np.zeros(n, dtype=np.bool_)
    drawn[np.argsort(-triangle_areas_m2(room.mesh), kind="stable")[:_MOST_TRIANGLES]] = True
    return drawn


def _edges(room: Room) -> Figure | None:
    ends = outline_m(room, _MOST_EDGES)
    if not len(ends):
        return None
    gap: FloatArray = np.full((len(ends), 1, 3), np.nan)
    path = np.concatenate([ends, gap], axis=1).reshape(-1, 3)
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": "edges",
        **{axis: rounded(path[:, k], 3) for k, axis in enumerate("xyz")},
        "line": {"color": "#555555", "width": 2},
        "hoverinfo": "skip",
        "showlegend": False,
    }


def _names(room: Room) -> Figure:
    """Return the name of each material, in the middle of its largest plane."""
    at = np.array([_middle_of_largest_plane(room, i) for i in range(len(room.materials))])
    return {
        "type": "scatter3d",
        "mode": "text",
        "name": "names of materials",
        **{axis: rounded(at[:, k], 3) for k, axis in enumerate("xyz")},
        "text": [_in_space(shortened(name, 20)) for name in room.materials],
        "textfont": {"color": "#444444", "size": 11},
        "hoverinfo": "skip",
    }


def _middle_of_largest_plane(room: Room, material: int) -> FloatArray:
    """Return the centroid, shape (3,), of all faces that lie in the plane of the largest face."""
    mine = triangle_material(room) == material
    if not mine.any():
        return np.full(3, np.nan)
    vectors = area_vectors_m2(room.mesh)[mine]
    middles = corners_m(room.mesh)[mine].mean(axis=1)
    areas = np.linalg.norm(vectors, axis=1)
    largest = int(np.argmax(areas))
    normal = vectors[largest] / max(float(areas[largest]), 1e-12)
    off = np.abs((middles - middles[largest]) @ normal)
    weight = areas * ((off < _FLAT_M) & (vectors @ normal > 0.999 * areas))
    total = float(weight.sum())
    return np.asarray(weight @ middles / total) if total > 0.0 else middles[largest]


def _points(kind: str, points: Sequence[Point], colour: str, symbol: str) -> Figure:
    at = np.array([p.position_m for p in points]).reshape(-1, 3)
    return {
        "type": "scatter3d",
        "mode": "markers+text",
        "name": f"{kind}s",
        **{axis: rounded(at[:, k], 3) for k, axis in enumerate("xyz")},
        "text": [_in_space(p.name) for p in points],
        "hovertext": [label(p.name) for p in points],
        "textposition": "top center",
        "textfont": {"color": colour, "size": 13},
        "marker": {"symbol": symbol, "size": 5, "color": colour},
        "hoverinfo": "text",
    }


def _in_space(name: str) -> str:
    """Return a name for a label in space: markup there is obeyed, entities are not known."""
    return name.translate(
        {
            ord("<"): "\N{SINGLE LEFT-POINTING ANGLE QUOTATION MARK}",
            ord(">"): "\N{SINGLE RIGHT-POINTING ANGLE QUOTATION MARK}",
        }
    )


def material_table(room: Room) -> Table:
    """Return colour, area, share and surfaces of each material: the legend of the picture."""
    areas = material_areas_m2(room)
    whole = float(areas.sum())
    rows = [
        Row(
            name,
            (
                Cell(area(float(areas[i]))),
                Cell(f"{number(100.0 * areas[i] / whole, 1) if whole > 0.0 else DASH} %"),
                Cell(_surfaces(room, i), style="words"),
            ),
            colour=material_colour(i),
        )
        for i, name in enumerate(room.materials)
    ]
    total = Row("all", (Cell(area(whole)), Cell("100 %"), Cell("")), style="total")
    return Table("Materials", "material", ("area in m²", "share", "surfaces"), (*rows, total))


def _surfaces(room: Room, material: int) -> str:
    names = [room.mesh.surfaces[k].name for k in np.flatnonzero(room.surface_material == material)]
    shown = ", ".join(shortened(name) for name in names[:_SURFACES_SHOWN])
    more = len(names) - _SURFACES_SHOWN
    return f"{shown} and {more} more" if more > 0 else shown


def position_table(scene: Scene) -> Table:
    """Return where sources and receivers stand, in metres."""
    points = [("source", p) for p in scene.sources] + [("receiver", p) for p in scene.receivers]
    return Table(
        "Positions in metres",
        "name",
        ("", "x", "y", "z"),
        tuple(
            Row(p.name, (Cell(kind, style="words"), *(Cell(number(v, 2)) for v in p.position_m)))
            for kind, p in points
        ),
    )
