"""Draw pipeline.svg: from a room and measured responses to absorption with its intervals.

python docs/pictures/pipeline.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

PICTURE = Path(__file__).with_suffix(".svg")
_WIDTH, _HEIGHT = 860, 300
_LINE, _INK, _QUIET = "#444444", "#222222", "#666666"
_DATA, _VERB = "#f4f4f1", "#dbe9f4"


@dataclass(frozen=True)
class Box:
    """A rectangle with a title and small lines below; an operation is rounded, data are not."""

    x: int
    y: int
    width: int
    title: str
    lines: tuple[str, ...] = ()
    verb: bool = False

    @property
    def height(self) -> int:
        return 34 + 16 * len(self.lines)

    @property
    def middle(self) -> int:
        return self.y + self.height // 2


ROOM = Box(10, 20, 165, "scene", ("room, materials,", "positions, air"))
TRACE = Box(225, 28, 90, "tracing", ("once",), verb=True)
PATHS = Box(365, 20, 180, "paths", ("time and number of hits", "on each material"))
WEIGH = Box(595, 28, 120, "response", ("weight and filter",), verb=True)
PREDICTED = Box(595, 128, 120, "predicted", ("energy", "of windows"))
FILES = Box(10, 236, 165, "measurement", ("impulse responses",))
FILTER = Box(225, 236, 90, "signals", ("filter bank",), verb=True)
MEASURED = Box(365, 236, 180, "observed", ("energy of windows, noise",))
FIT = Box(595, 236, 120, "objective", ("fitted per band",), verb=True)
ANSWER = Box(755, 136, 95, "result", ("absorption,", "intervals,", "findings"))
BOXES = (ROOM, TRACE, PATHS, WEIGH, PREDICTED, FILES, FILTER, MEASURED, FIT, ANSWER)


def draw() -> str:
    """Return the picture as SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'width="{_WIDTH}" height="{_HEIGHT}" font-family="Helvetica, Arial, sans-serif">',
        "<title>A room is traced once; its paths are reweighted until they explain the "
        "measurement.</title>",
        f'<defs><marker id="tip" markerWidth="9" markerHeight="8" refX="8" refY="4" orient="auto">'
        f'<path d="M0,0 L9,4 L0,8 z" fill="{_LINE}"/></marker></defs>',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        *(_box(box) for box in BOXES),
        *(_right(a, b) for a, b in ((ROOM, TRACE), (TRACE, PATHS), (PATHS, WEIGH))),
        *(_right(a, b) for a, b in ((FILES, FILTER), (FILTER, MEASURED), (MEASURED, FIT))),
        _down(WEIGH, PREDICTED),
        _down(PREDICTED, FIT),
        _bent(FIT.x + FIT.width, FIT.middle, 802, ANSWER.y + ANSWER.height),
        _bent(802, ANSWER.y, WEIGH.x + WEIGH.width, WEIGH.middle, first="up"),
        _note(725, WEIGH.middle - 26, "next trial, until"),
        _note(725, WEIGH.middle - 9, "the energies agree"),
        _note(14, 140, "The course of a ray is independent of absorption:"),
        _note(14, 158, "the room is traced once, and reweighting has an"),
        _note(14, 176, "exact derivative in every coefficient."),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _box(box: Box) -> str:
    centre = box.x + box.width // 2
    radius, fill = (16, _VERB) if box.verb else (2, _DATA)
    shapes = [
        f'<rect x="{box.x}" y="{box.y}" width="{box.width}" height="{box.height}" rx="{radius}" '
        f'fill="{fill}" stroke="{_LINE}"/>',
        f'<text x="{centre}" y="{box.y + 22}" text-anchor="middle" font-size="15" '
        f'font-weight="bold" fill="{_INK}">{box.title}</text>',
    ]
    for number, line in enumerate(box.lines):
        shapes.append(
            f'<text x="{centre}" y="{box.y + 39 + 16 * number}" text-anchor="middle" '
            f'font-size="12.5" fill="{_INK}">{line}</text>'
        )
    return "\n".join(shapes)


def _right(start: Box, end: Box) -> str:
    return _path(f"M{start.x + start.width},{start.middle} H{end.x - 2}")


def _down(start: Box, end: Box) -> str:
    return _path(f"M{start.x + start.width // 2},{start.y + start.height} V{end.y - 2}")


def _bent(x: int, y: int, to_x: int, to_y: int, first: str = "right") -> str:
    """Return a line with one corner: first along x and then along y, or the other way."""
    return _path(f"M{x},{y} H{to_x} V{to_y}" if first == "right" else f"M{x},{y} V{to_y} H{to_x}")


def _path(course: str) -> str:
    return f'<path d="{course}" fill="none" stroke="{_LINE}" marker-end="url(#tip)"/>'


def _note(x: int, y: int, text: str) -> str:
    return f'<text x="{x}" y="{y}" font-size="13" fill="{_QUIET}">{text}</text>'


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8")
