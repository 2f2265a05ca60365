"""A plan of the room as a drawing that prints and needs no script."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roomfit.report.html.room_outline import outline_m
from roomfit.report.html.wording import number, shortened
from roomfit.scene.scene import Scene

_WIDTH, _MARGIN, _TALLEST = 420.0, 34.0, 520.0
_MOST_EDGES = 1500
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
        tuple(sorted((onto(*a[:2]), onto(*b[:2])))) for a, b in outline_m(scene.room, _MOST_EDGES)
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
