"""The room in space: materials half transparent, sources and receivers with their names.

Absorption over frequency, one panel a material.

How sure the answer is, to be looked at: what is identifiable, profiles, a posterior's corner.

Measured and predicted energy decay curves: one pair at a time, one panel a band.

The edges that an eye sees of a room: where faces meet at an angle, or materials do.

A plan of the room as a drawing that prints and needs no script.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from roomfit.geometry.mesh import area_vectors_m2, corners_m, triangle_areas_m2
from roomfit.report.figures import most_tied_band, shown_profiles
from roomfit.report.html.parts import (
    ACCENT,
    DASH,
    GRID,
    INK,
    MANY_PANELS,
    SECOND,
    Cell,
    Figure,
    Plot,
    Row,
    Table,
    area,
    base_layout,
    count,
    frequency_axis,
    hertz,
    label,
    material_colour,
    number,
    outer_titles,
    panel_axes,
    panel_layout,
    panel_title,
    rounded,
    shortened,
)
from roomfit.report.html.tables import given, mean_abs_jnd, pair_title
from roomfit.results import Answer, ComparedPair, Decay
from roomfit.scene import Point, Room, Scene, material_areas_m2, triangle_material
from roomfit.typing import BoolArray, FloatArray, IntArray
from roomfit.uncertainty.profile import RISE95, Profile, profile_curve

_ABSORPTION_PICTURE_LEVELS = {"range": [-0.03, 1.03], "tickvals": [0.0, 0.25, 0.5, 0.75, 1.0]}


def absorption_plot(answer: Answer) -> Plot:
    """Return absorption with 95 % bars: filled where identifiable, hollow where not.

    The last panel is the mean of the room by area.
    """
    n = len(answer.materials)
    layout, height_px = panel_layout(
        n + 1, frequency_axis(answer.bands.centres_hz), _ABSORPTION_PICTURE_LEVELS
    )
    layout["annotations"] = [
        *(panel_title(layout, i, _title(answer, i)) for i in range(n)),
        panel_title(layout, n, "<b>mean of the room</b>, by area"),
        *outer_titles("band centre (Hz)", "absorption coefficient"),
    ]
    return Plot(
        "absorption",
        {"data": _absorption_picture_traces(answer), "layout": layout},
        height_px,
        f"Absorption coefficient over frequency with 95 % intervals, "
        f"{count(n, 'material')} and the mean of the room; the table below holds every number.",
        "Above each panel: in how many bands the material is identifiable. Points with bars: "
        "absorption and its 95 % interval. Filled: identifiable. Hollow: not "
        "identifiable, the number may come from what was assumed beforehand. Diamonds: given.",
    )


def _title(answer: Answer, material: int) -> str:
    found = int(answer.identifiable[material].sum())
    if len(answer.materials) < MANY_PANELS:
        name = label(answer.materials[material], 20)
        return f"<b>{name}</b>: {found} of {len(answer.bands)} identifiable"
    return f"<b>{label(answer.materials[material], 16)}</b>: {found} of {len(answer.bands)}"


def _absorption_picture_traces(answer: Answer) -> list[Figure]:
    held = given(answer)
    kinds = (
        ("identifiable", answer.identifiable & ~held, "circle", ACCENT),
        ("not identifiable", ~answer.identifiable & ~held, "circle", "#ffffff"),
        ("given", held, "diamond", INK),
    )
    traces = []
    for name, chosen, symbol, fill in kinds:
        marker = {
            "symbol": symbol,
            "size": 8,
            "color": fill,
            "line": {"color": INK if fill == INK else ACCENT, "width": 1.8},
        }
        first = True
        for i in np.flatnonzero(chosen.any(axis=1)):
            values = (answer.absorption[i], answer.lower95[i], answer.upper95[i])
            trace = _bars(answer, int(i), name, chosen[i], *values)
            traces.append(trace | {"marker": marker, "legendgroup": name, "showlegend": first})
            first = False
    everywhere = np.ones(len(answer.bands), dtype=np.bool_)
    mean = _bars(
        answer, len(answer.materials), "mean of the room", everywhere, *answer.mean_absorption
    )
    marker = {"symbol": "square", "size": 7, "color": INK, "line": {"color": INK, "width": 1.5}}
    return [*traces, mean | {"marker": marker, "showlegend": False}]


def _bars(
    answer: Answer,
    panel: int,
    name: str,
    chosen: BoolArray,
    value: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> Figure:
    centres, a, low, high = (v[chosen] for v in (answer.bands.centres_hz, value, lower, upper))
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": rounded(centres, 1),
        "y": rounded(a, 4),
        "error_y": {
            "type": "data",
            "symmetric": False,
            "array": rounded(np.maximum(high - a, 0.0), 4),
            "arrayminus": rounded(np.maximum(a - low, 0.0), 4),
            "thickness": 1.4,
            "width": 3,
            "color": "#555555",
        },
        "text": [
            f"{hertz(f)}: {number(m, 3)} ({number(b, 3)} to {number(t, 3)}), {name}"
            for f, m, b, t in zip(centres, a, low, high, strict=True)
        ],
        "hoverinfo": "text",
        **panel_axes(panel),
    }


_MOST_MATERIALS, _MOST_DRAWS = 6, 500
_ROW_PX = 26


def identifiability_plot(answer: Answer) -> Plot:
    """Return a matrix of materials by bands: the darker, the narrower the 95 % interval."""
    width, held = answer.upper95 - answer.lower95, given(answer)
    names = [label(name, 22) for name in answer.materials]
    bands = [hertz(float(f)) for f in answer.bands.centres_hz]
    height_px = 150 + _ROW_PX * len(names)
    layout = base_layout(height_px)
    layout["margin"] |= {"l": 150, "t": 20}
    layout["xaxis"] = {"title": {"text": "band centre"}, "type": "category", "ticks": ""}
    layout["yaxis"] = {"type": "category", "autorange": "reversed", "ticks": ""}
    marks = np.where(held, "given", np.where(answer.identifiable, "\N{CHECK MARK}", ""))
    data = {
        "type": "heatmap",
        "x": bands,
        "y": names,
        "z": [rounded(row, 3) for row in width],
        "text": marks.tolist(),
        "texttemplate": "%{text}",
        "zmin": 0.0,
        "zmax": 1.0,
        "colorscale": [[0.0, "#08306b"], [0.2, "#2f7fbc"], [0.5, "#a6cde4"], [1.0, "#f7fbff"]],
        "colorbar": {"title": {"text": "width"}, "thickness": 14},
        "xgap": 2,
        "ygap": 2,
        "hovertemplate": "%{y}, %{x}: interval %{z} wide %{text}<extra></extra>",
    }
    return Plot(
        "identifiable",
        {"data": [data], "layout": layout},
        height_px,
        "Matrix of materials by bands: width of the 95 % interval; the tables hold every number.",
        "Width of the 95 % interval of every coefficient, dark where it is narrow. A tick marks "
        "what is identifiable.",
    )


def profile_plot(answer: Answer) -> Plot | None:
    """Return the profiles that took the place of Gaussian intervals; None where there are none."""
    shown = shown_profiles(answer)
    if not shown:
        return None
    x_axis: Figure = {"rangemode": "tozero"}
    layout, height_px = panel_layout(len(shown), x_axis, {"range": [0.0, 5.0]})
    for key in layout:
        if key.startswith("xaxis"):
            layout[key].pop("matches", None)
    layout["annotations"] = [
        *(
            panel_title(
                layout,
                i,
                f"<b>{label(answer.materials[line.entry], 20)}</b>, "
                f"{hertz(float(answer.bands.centres_hz[band]))}",
            )
            for i, (band, line) in enumerate(shown)
        ),
        *outer_titles("absorption coefficient", "rise of the cost"),
    ]
    traces = [t for i, s in enumerate(shown) for t in _profile_traces(answer, i, *s)]
    return Plot(
        "profiles",
        {"data": traces, "layout": layout},
        height_px,
        "Profiles of the likelihood of single coefficients; their ends are in the table.",
        "How the cost rises when one coefficient is moved and all else is fitted again, misfit "
        "taken out. The 95 % interval ends where the curve meets the dotted line at 1.92; bands "
        "beside are taken for another standard deviation where absorption changes fast.",
    )


def _profile_traces(answer: Answer, panel: int, band: int, line: Profile) -> list[Figure]:
    free, rise = profile_curve(line, 60)
    at = 0.5 * (1.0 + np.tanh(0.5 * free))
    a, low, high = (
        float(x[line.entry, band]) for x in (answer.absorption, answer.lower95, answer.upper95)
    )
    axes, first = panel_axes(panel), panel == 0
    common = {"type": "scatter", "hoverinfo": "skip", "showlegend": first, **axes}
    return [
        common
        | {
            "mode": "lines",
            "name": "profile",
            "legendgroup": "profile",
            "x": rounded(at, 4),
            "y": rounded(rise, 3),
            "line": {"color": ACCENT, "width": 1.6},
            "hoverinfo": "x+y",
        },
        common
        | {
            "mode": "lines",
            "name": "1.92",
            "legendgroup": "end",
            "x": rounded(np.array([min(low, at.min()), max(high, at.max())]), 4),
            "y": [round(RISE95, 3)] * 2,
            "line": {"color": INK, "width": 1, "dash": "dot"},
        },
        common
        | {
            "mode": "markers",
            "name": "answer and its 95 % interval",
            "legendgroup": "answer",
            "x": [round(a, 4)],
            "y": [0.15],
            "error_x": {
                "type": "data",
                "symmetric": False,
                "array": [round(high - a, 4)],
                "arrayminus": [round(a - low, 4)],
                "color": SECOND,
                "thickness": 2,
            },
            "marker": {"color": SECOND, "size": 7},
            "text": [f"{number(a, 3)} ({number(low, 3)} to {number(high, 3)})"],
            "hoverinfo": "text",
        },
    ]


def corner_plot(answer: Answer) -> Plot | None:
    """Return samples of the band whose materials hang together most; None where there are none."""
    band = most_tied_band(answer.samples)
    draws = None if band is None else answer.samples[band]
    if band is None or draws is None:
        return None
    free = np.flatnonzero(np.ptp(draws, axis=0) > 0.0)[:_MOST_MATERIALS]
    some = draws[:: max(len(draws) // _MOST_DRAWS, 1)]
    height_px = 140 + 110 * len(free)
    layout = base_layout(height_px)
    layout["margin"] |= {"l": 80, "t": 20}
    layout["hovermode"] = False
    data = {
        "type": "splom",
        "dimensions": [
            {"label": label(answer.materials[i], 14), "values": rounded(some[:, i], 4)}
            for i in free
        ],
        "showupperhalf": False,
        "diagonal": {"visible": False},
        "marker": {"size": 3, "color": ACCENT, "opacity": 0.45},
    }
    centre = hertz(float(answer.bands.centres_hz[band]))
    return Plot(
        "corner",
        {"data": [data], "layout": layout},
        height_px,
        f"Samples of the absorption coefficients at {centre}, each material against each other.",
        f"Samples of the posterior at {centre}, the band whose materials hang together most: each "
        "point is one set of absorption coefficients that explains the data. Narrow clouds along a "
        "slope: only a sum is known.",
    )


LOWEST_DB = -45.0
_DECAY_PICTURE_LEVELS = {"range": [LOWEST_DB, 2.0], "tickvals": [-40, -30, -20, -10, 0]}
# About six characters a number: this keeps all curves of most reports within half a megabyte.
_NUMBERS, _FEWEST, _MOST = 80_000, 24, 120


def decay_of(pair: ComparedPair) -> Decay | None:
    """Return the curves of a pair; None where its values came without a recording."""
    decay: Decay | None = getattr(pair, "decay", None)
    if decay is None or not np.size(decay.time_s):
        return None
    known = np.isfinite(decay.measured_db) | np.isfinite(decay.predicted_db)
    return decay if known.any() else None


def decay_plot(answer: Answer) -> tuple[Plot, list[dict[str, Any]]] | None:
    """Return the picture of the pair that fits worst, and the curves of every pair for the page.

    Returns
    -------
    (Plot, list) or None
        Each element of the list holds ``title``, ``time``, ``measured`` and ``predicted`` (one
        list a band) and ``heads`` (words above each panel). The pair that the picture begins
        with has ``chosen`` true. None where no pair has curves.
    """
    drawn = [(pair, decay) for pair in answer.pairs if (decay := decay_of(pair)) is not None]
    if not drawn:
        return None
    n_points = int(np.clip(_NUMBERS / (2 * len(drawn) * len(answer.bands)), _FEWEST, _MOST))
    curves = [_curves(answer, pair, decay, n_points) for pair, decay in drawn]
    off = np.nan_to_num([mean_abs_jnd(pair) for pair, _ in drawn], nan=-1.0)
    worst = int(np.argmax(off))
    for i, curve in enumerate(curves):
        curve["chosen"] = i == worst
    return _plot(answer, curves[worst], len(drawn)), curves


def _plot(answer: Answer, curve: dict[str, Any], n_pairs: int) -> Plot:
    n = len(answer.bands)
    layout, height_px = panel_layout(n, {"rangemode": "tozero"}, _DECAY_PICTURE_LEVELS)
    layout["annotations"] = [
        *(panel_title(layout, j, head) for j, head in enumerate(curve["heads"])),
        *outer_titles("time after emission (s)", "energy decay curve (dB)"),
    ]
    return Plot(
        "decay",
        {"data": _decay_picture_traces(curve, n), "layout": layout},
        height_px,
        f"Measured and predicted energy decay curves of {count(n_pairs, 'pair')}, one panel a "
        "band; the tables below hold the parameters derived from them.",
        "Energy left in the room relative to the whole, after each time; above each panel T20, "
        "measured → predicted. The picture begins with the pair whose parameters are furthest off.",
    )


def _decay_picture_traces(curve: dict[str, Any], n_bands: int) -> list[Figure]:
    looks = (
        ("measured", {"color": INK, "width": 2.0}),
        ("predicted", {"color": SECOND, "width": 2.2, "dash": "dash"}),
    )
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "legendgroup": name,
            "showlegend": j == 0,
            "x": curve["time"],
            "y": curve[name][j],
            "line": line,
            "hovertemplate": "%{y:.1f} dB at %{x:.3f} s",
            **panel_axes(j),
        }
        for j in range(n_bands)
        for name, line in looks
    ]


def _curves(answer: Answer, pair: ComparedPair, decay: Decay, n_points: int) -> dict[str, Any]:
    time_s = np.asarray(decay.time_s)
    either = np.fmax(decay.measured_db, decay.predicted_db).max(axis=0, initial=LOWEST_DB - 1.0)
    shown = np.flatnonzero(np.fmax(either, LOWEST_DB - 1.0) > LOWEST_DB)
    last = int(shown[-1]) + 1 if shown.size else len(time_s)
    kept = np.unique(np.linspace(0, max(last - 1, 0), n_points).round().astype(int))
    return {
        "title": pair_title(pair),
        "time": rounded(time_s[kept], 4),
        "measured": [rounded(_seen(row[kept]), 1) for row in decay.measured_db],
        "predicted": [rounded(_seen(row[kept]), 1) for row in decay.predicted_db],
        "heads": [_head(answer, pair, j) for j in range(len(answer.bands))],
    }


def _seen(levels_db: FloatArray) -> FloatArray:
    """Return the levels down to where the picture ends."""
    return np.where(levels_db > LOWEST_DB - 15.0, levels_db, np.nan)


def _head(answer: Answer, pair: ComparedPair, band: int) -> str:
    head = f"<b>{hertz(float(answer.bands.centres_hz[band]))}</b>"
    t20 = pair.parameters.get("T20_s")
    if t20 is None or not np.isfinite(t20.measured[band]) or not np.isfinite(t20.predicted[band]):
        return head
    measured, predicted = number(t20.measured[band], 2), number(t20.predicted[band], 2)
    return f"{head}: T20 {measured} → {predicted} s"


_SAME_PLANE = 0.9995
"""Cosine between normals above which two faces look flat together, 1.8 degrees."""


def outline_m(room: Room, at_most: int) -> FloatArray:
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
    several = np.bincount(owner, minlength=len(lines)) == 2
    first = triangle[order[starts]]
    second = triangle[order[np.minimum(starts + 1, len(order) - 1)]]
    flat = several & _alike(room, first, second)
    edges = room.mesh.vertices_m[lines[~flat]]
    if len(edges) <= at_most:
        return np.asarray(edges)
    lengths = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1)
    longest = np.argsort(-lengths, kind="stable")[:at_most]
    diagonal = np.linalg.norm(np.ptp(room.mesh.vertices_m, axis=0))
    return np.asarray(edges[longest[lengths[longest] >= diagonal / 20.0]])


def _alike(
    room: Room, first: IntArray, second: IntArray
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    normals = area_vectors_m2(room.mesh)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)
    material = triangle_material(room)
    cosine = np.einsum("ij,ij->i", normals[first], normals[second])
    return np.asarray((np.abs(cosine) > _SAME_PLANE) & (material[first] == material[second]))


_HEIGHT_PX = 520
_ROOM_PICTURE_MOST_EDGES = 3000
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
    ends = outline_m(room, _ROOM_PICTURE_MOST_EDGES)
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


_WIDTH, _MARGIN, _TALLEST = 420.0, 34.0, 520.0
_ROOM_PLAN_MOST_EDGES = 1500
_LETTER = 6.6


@dataclass(frozen=True, slots=True)
class Mark:
    """A source or receiver on the plan: its place, and where its name begins or ends."""

    name: str
    kind: str
    x: float
    y: float
    text_x: float
    text_y: float
    anchor: str


@dataclass(frozen=True, slots=True)
class Plan:
    """Lines and marks in the units of the drawing, y downwards; `bar` is one metre long."""

    width: float
    height: float
    lines: tuple[tuple[float, float, float, float], ...]
    marks: tuple[Mark, ...]
    bar: float
    size: str


def room_plan(scene: Scene) -> Plan:
    """Return the room seen from above, x to the right and y upwards, to scale."""
    vertices = scene.room.mesh.vertices_m
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    inner = _WIDTH - 2.0 * _MARGIN
    scale = min(inner / max(size[0], 1e-9), (_TALLEST - 2.0 * _MARGIN) / max(size[1], 1e-9))
    width, height = size[:2] * scale + 2.0 * _MARGIN

    def onto(x_m: float, y_m: float) -> tuple[float, float]:
        x, y = _MARGIN + (x_m - low[0]) * scale, height - _MARGIN - (y_m - low[1]) * scale
        return round(float(x), 1), round(float(y), 1)

    flat = {
        tuple(sorted((onto(*a[:2]), onto(*b[:2]))))
        for a, b in outline_m(scene.room, _ROOM_PLAN_MOST_EDGES)
    }
    lines = tuple((*a, *b) for a, b in sorted(flat) if a != b)
    places = [
        (p.name, kind, *onto(float(p.position_m[0]), float(p.position_m[1])))
        for kind, points in (("source", scene.sources), ("receiver", scene.receivers))
        for p in points
    ]
    told = " \N{MULTIPLICATION SIGN} ".join(number(float(v), 2) for v in size)
    return Plan(
        round(float(width), 1), round(float(height), 1), lines, _labelled(places, float(width)),
        round(float(scale), 2), f"{told} m",
    )  # fmt: skip


def _labelled(places: list[tuple[str, str, float, float]], width: float) -> tuple[Mark, ...]:
    """Put each name beside its mark, at the first of four places that no other name takes."""
    taken: list[tuple[float, float, float, float]] = [
        (x - 5.0, y - 5.0, x + 5.0, y + 5.0) for _, _, x, y in places
    ]
    marks = []
    for name, kind, x, y in places:
        text = shortened(name, 16)
        length = _LETTER * len(text)
        choices = (
            ("start", x + 8.0, y + 4.0, (x + 6.0, y - 7.0, x + 8.0 + length, y + 6.0)),
            ("end", x - 8.0, y + 4.0, (x - 8.0 - length, y - 7.0, x - 6.0, y + 6.0)),
            ("middle", x, y - 9.0, (x - length / 2, y - 20.0, x + length / 2, y - 7.0)),
            ("middle", x, y + 18.0, (x - length / 2, y + 7.0, x + length / 2, y + 20.0)),
        )
        free = [
            c for c in choices
            if c[3][0] >= 0.0 and c[3][2] <= width and not any(_overlap(c[3], t) for t in taken)
        ]  # fmt: skip
        anchor, text_x, text_y, box = (free or choices)[0]
        taken.append(box)
        marks.append(Mark(text, kind, x, y, round(text_x, 1), round(text_y, 1), anchor))
    return tuple(marks)


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
