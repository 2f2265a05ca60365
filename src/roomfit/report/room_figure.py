"""The room as one figure: in space, in plan and from two sides; and its visible edges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from roomfit.base.typing import FloatArray, IntArray
from roomfit.report.figures import literal
from roomfit.report.wording import OKABE_ITO, material_colour
from roomfit.room.mesh import area_vectors_m2, corners_m
from roomfit.room.scene import Room, Scene, triangle_material, wall_materials

_SAME_PLANE = 0.9995
"""Cosine between normals above which two faces look flat together, 1.8 degrees."""

MOST_FACES, MOST_EDGES = 2500, 1500
"""Of more visible faces, the largest are drawn: a hundred bytes each in the report."""

_SOURCE, _RECEIVER = OKABE_ITO[1], "#222222"
_SOURCE_NAME = "#8A3C00"
_WIDTH_IN, _GAP_IN, _BELOW_IN = 10.2, 0.75, 1.2
_SPACE_IN = (6.9, 4.4)
_UPRIGHT = 0.3
"""Vertical part of a unit normal below which a wall stands and above one less which it lies."""
_MOST_NAMES, _MOST_STEMS, _MOST_IN_LEGEND = 24, 16, 18
_LETTER_PT, _NAME_PT = 5.0, 8.0
# Viewed from the south-south-west, 30 degrees above the floor.
_AZIMUTH, _ELEVATION = np.radians(-118.0), np.radians(30.0)
_AXES = ("x (m)", "y (m)", "z (m)")


def room_figure(scene: Scene) -> Figure:
    """Return the room from above one corner, its plan and two side views, to scale.

    In space the walls towards the viewer are left out, so that its inside shows; the
    colours are those of `material_colour`. The plan names the materials of floor and ceiling.
    """
    edges = outline_m(scene.room)
    vertices = scene.room.mesh.vertices_m
    low, size = vertices.min(axis=0), np.maximum(np.ptp(vertices, axis=0), 1e-6)
    views = ((0, 1, "plan"), (0, 2, "side (x, z)"), (1, 2, "side (y, z)"))
    across_m, tall_m = sum(size[i] for i, _, _ in views), max(size[1:])
    scale = float(min((_WIDTH_IN - 3.0 * _GAP_IN) / across_m, 3.4 / tall_m))
    extent = np.maximum(np.ptp(vertices @ projection()[:2].T, axis=0), 1e-6)
    space_scale = float(min(np.array(_SPACE_IN) / extent))
    entries = min(len(wall_materials(scene.room)), _MOST_IN_LEGEND) + 2
    below_in = tall_m * scale + _BELOW_IN
    above_in = max(extent[1] * space_scale + 0.5, 0.2 * entries + 0.3)
    figure = Figure(figsize=(_WIDTH_IN, above_in + below_in))
    FigureCanvasAgg(figure)

    def panel(left_in: float, bottom_in: float, wide_in: float, tall_in: float) -> Axes:
        width_in, height_in = _WIDTH_IN, above_in + below_in
        place = (left_in / width_in, bottom_in / height_in, wide_in / width_in, tall_in / height_in)
        return figure.add_axes(place)

    width, tall = extent * space_scale
    middle = below_in + 0.5 * (above_in - tall)
    space = panel(0.1 + 0.5 * (_SPACE_IN[0] - width), middle, width, tall)
    _draw_space(space, scene, space_scale)
    _draw_legend(figure, scene)
    left_in = _GAP_IN - 0.15
    for right, up, title in views:
        axes = panel(left_in, 0.6, size[right] * scale, size[up] * scale)
        if up == 1:
            title += _draw_walls(axes, scene)
        axes.set_xlim(low[right], low[right] + size[right])
        axes.set_ylim(low[up], low[up] + size[up])
        axes.set_title(title, fontsize=9, loc="left")
        _draw_view(axes, scene, edges, (right, up), scale)
        left_in += size[right] * scale + _GAP_IN
    return figure


def _draw_walls(axes: Axes, scene: Scene) -> str:
    """Draw upright walls in their colours; return the materials of floor and ceiling in words."""
    room, owner = scene.room, triangle_material(scene.room)
    outwards = area_vectors_m2(room.mesh)
    area_m2 = np.linalg.norm(outwards, axis=1)
    normal = outwards / np.where(area_m2 > 0.0, area_m2, 1.0)[:, None]
    upright = np.flatnonzero((np.abs(normal[:, 2]) < _UPRIGHT) & (area_m2 > 0.0))
    upright = upright[np.argsort(-area_m2[upright], kind="stable")[:MOST_FACES]]
    corners = corners_m(room.mesh)[upright][:, :, :2]
    along = np.stack([-normal[upright, 1], normal[upright, 0]], axis=1)
    at = np.einsum("ncx,nx->nc", corners, along)
    rows = np.arange(len(upright))
    ends = np.stack([corners[rows, at.argmin(axis=1)], corners[rows, at.argmax(axis=1)]], axis=1)
    colours = [material_colour(int(i)) for i in owner[upright]]
    look: dict[str, Any] = {"linewidths": 6.0, "clip_on": False, "zorder": 0.9}
    axes.add_collection(LineCollection(list(ends), colors=colours, **look))
    words = ""
    for what, sign in (("floor", -1.0), ("ceiling", 1.0)):
        level = sign * normal[:, 2] > 1.0 - _UPRIGHT
        sums = np.bincount(owner[level], area_m2[level], len(room.materials))
        names = [literal(room.materials[k], 18) for k in np.argsort(-sums)[:2] if sums[k] > 0.0]
        words += f"\n{what} {', '.join(names)}" if names else ""
    return words


def drawn_faces(room: Room) -> IntArray:
    """Return the triangles that are drawn in space, farthest first, the largest of many.

    Those whose side in the air faces the viewer, and both sides of sheets.
    """
    towards = projection()[2]
    away = area_vectors_m2(room.mesh) @ towards
    sheet = np.array([s.double_sided for s in room.mesh.surfaces])[room.mesh.triangle_surface]
    observed = np.flatnonzero((away < 0.0) | (sheet & (away != 0.0)))
    largest = observed[np.argsort(-np.abs(away[observed]), kind="stable")[:MOST_FACES]]
    depth = corners_m(room.mesh)[largest].mean(axis=1) @ towards
    return largest[np.argsort(depth, kind="stable")]


def projection() -> FloatArray:
    """Return the axes of the picture in the room: to the right, up, and towards the viewer."""
    flat = np.cos(_ELEVATION)
    towards = np.array([np.cos(_AZIMUTH) * flat, np.sin(_AZIMUTH) * flat, np.sin(_ELEVATION)])
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


def draw_faces(
    axes: Axes,
    room: Room,
    faces: IntArray,
    colours: Sequence[Any],
    edge_colours: Sequence[Any],
    *,
    zorder: float = 1.0,
) -> None:
    """Draw triangles in space."""
    onto = projection()[:2]
    # edges of the same colour close the gaps between neighbours
    filled = PolyCollection(
        list(corners_m(room.mesh)[faces] @ onto.T), facecolors=colours, edgecolors=edge_colours,
        linewidths=0.5, closed=True, clip_on=False, zorder=zorder,
    )  # fmt: skip
    axes.add_collection(filled)


def draw_edges(axes: Axes, room: Room) -> None:
    """Draw the edges of the room in space, and fit the axes to it."""
    edges, onto = outline_m(room), projection()[:2]
    thin = 0.9 if len(edges) <= 300 else 0.4
    look: dict[str, Any] = {"colors": "#444444", "linewidths": thin, "clip_on": False}
    axes.add_collection(LineCollection(list(edges @ onto.T), **look))
    flat = room.mesh.vertices_m @ onto.T
    axes.set_xlim(flat[:, 0].min(), flat[:, 0].max())
    axes.set_ylim(flat[:, 1].min(), flat[:, 1].max())
    axes.set_axis_off()


def _draw_space(axes: Axes, scene: Scene, scale: float) -> None:
    room, onto, faces = scene.room, projection()[:2], drawn_faces(scene.room)
    colours = [material_colour(int(i)) for i in triangle_material(room)[faces]]
    draw_faces(axes, room, faces, colours, colours)
    draw_edges(axes, room)
    if len(scene.sources) + len(scene.receivers) <= _MOST_STEMS:
        floor = float(room.mesh.vertices_m[:, 2].min())
        for p in (*scene.sources, *scene.receivers):
            foot = np.array([*p.position_m[:2], floor])
            # no grey, which would turn with the page: these lines lie on pale walls
            right, up = onto @ np.array([p.position_m, foot]).T
            axes.plot(right, up, ":", color="#222223", lw=0.9)
    _draw_points(axes, scene, onto, scale)


def _draw_view(
    axes: Axes, scene: Scene, edges: FloatArray, along: tuple[int, int], scale: float
) -> None:
    """Draw edges and points in a plan or from a side."""
    flat = np.round(edges[:, :, along], 4)
    # edges above each other are one line, and those along the view are none
    lines = {tuple(sorted((tuple(a), tuple(b)))) for a, b in flat.tolist() if a != b}
    axes.add_collection(
        LineCollection(sorted(lines), colors="#444444", linewidths=0.9, clip_on=False)
    )
    _draw_points(axes, scene, np.eye(3)[list(along)], scale)
    for axis, k, most in ((axes.xaxis, along[0], 6), (axes.yaxis, along[1], 5)):
        axis.set_label_text(_AXES[k], fontsize=9)
        axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_points(axes: Axes, scene: Scene, onto: FloatArray, scale: float) -> None:
    """Draw sources and receivers; their names to the right where nothing else stands."""
    marks = (
        (scene.receivers, "o", _RECEIVER, _RECEIVER, 5.0),
        (scene.sources, "D", _SOURCE, _SOURCE_NAME, 6.5),
    )
    end_pt = axes.get_xlim()[1] * scale * 72.0 + _LETTER_PT
    names, at = [], []
    for points, marker, colour, ink, size in marks:
        flat = np.array([p.position_m for p in points]).reshape(-1, 3) @ onto.T
        look: dict[str, Any] = {"mec": "white", "mew": 0.8, "clip_on": False, "zorder": 4}
        axes.plot(*flat.T, marker, color=colour, ms=size, **look)
        names += [(literal(p.name, 16), ink) for p in points]
        at += list(flat)
    taken = [(x - 4.0, y - 4.0, x + 4.0, y + 4.0) for x, y in np.array(at) * scale * 72.0]
    for (name, ink), point in zip(names[:_MOST_NAMES], at, strict=False):
        x, y = point * scale * 72.0
        box = (x + 6.0, y - 5.0, x + 6.0 + _LETTER_PT * len(name), y + 5.0)
        if box[2] > end_pt or any(_overlap(box, other) for other in taken):
            continue  # the table of positions has the name
        taken.append(box)
        axes.annotate(
            name, point, xytext=(6.0, 0.0), textcoords="offset points", va="center",
            fontsize=_NAME_PT, color=ink, zorder=5, annotation_clip=False,
            bbox={"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none", "alpha": 0.75},
        )  # fmt: skip


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _draw_legend(figure: Figure, scene: Scene) -> None:
    """Name the marks and the colours, those of many materials in the table only."""
    common: dict[str, Any] = {"ls": "none", "mec": "white", "mew": 0.8}
    handles: list[Artist] = [
        Line2D([], [], marker="D", color=_SOURCE, ms=7, label="source", **common),
        Line2D([], [], marker="o", color=_RECEIVER, ms=6, label="receiver", **common),
    ]
    names = wall_materials(scene.room)
    handles += [
        Patch(facecolor=material_colour(i), edgecolor="#777777", label=literal(name, 28))
        for i, name in enumerate(names[:_MOST_IN_LEGEND])
    ]
    if len(names) > _MOST_IN_LEGEND:
        handles.append(Patch(facecolor="none", label="others: in the table"))
    figure.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.7, 0.99), frameon=False, fontsize=9
    )


def outline_m(room: Room, at_most: int = MOST_EDGES) -> FloatArray:
    """Return the visible edges, shape (n_edges, 2 ends, 3), in metres.

    An edge is left out where two triangles of one material lie in one plane. Of more than
    `at_most`, the longest are kept that are no shorter than a twentieth of the room's diagonal:
    the walls of a hall without the legs of its chairs.
    """
    corners = room.mesh.triangles.astype(np.int64)
    ends = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    triangle = np.repeat(np.arange(len(corners)), 3)
    lines, owner = np.unique(ends, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    order = np.argsort(owner, kind="stable")
    starts = np.searchsorted(owner[order], np.arange(len(lines)))
    first = triangle[order[starts]]
    second = triangle[order[np.minimum(starts + 1, len(order) - 1)]]
    normals = area_vectors_m2(room.mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)
    is_plane = np.abs(np.einsum("ij,ij->i", normals[first], normals[second])) > _SAME_PLANE
    material = triangle_material(room)
    is_flat = is_plane & (material[first] == material[second])
    is_flat &= np.bincount(owner, minlength=len(lines)) == 2
    edges = room.mesh.vertices_m[lines[~is_flat]]
    if len(edges) <= at_most:
        return np.asarray(edges)
    lengths = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1)
    longest = np.argsort(-lengths, kind="stable")[:at_most]
    diagonal = np.linalg.norm(np.ptp(room.mesh.vertices_m, axis=0))
    return np.asarray(edges[longest[lengths[longest] >= diagonal / 20.0]])
