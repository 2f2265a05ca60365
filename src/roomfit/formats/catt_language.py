"""The language of CATT-Acoustic's .geo files: statements, includes, expressions and corners.

Constants and corners of all files of a room are evaluated when they are needed. The format is
described in the manual's "Short GEO, LOC input file syntax reminder" [1]_, and shown by the files
MASTER.GEO and REFLECT.GEO of its tutorial.

References
----------
.. [1] CATT, "CATT-Acoustic v8.0 with TUCT, Introduction Manual", appendix 2 (2010).
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections import ChainMap, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from roomfit.base.arguments import in_short
from roomfit.base.door import check_limit, read_text
from roomfit.base.errors import InputError
from roomfit.formats.model import finite, malformed, whole

Point = tuple[float, float, float]

_TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|([-+*/(),]))", re.ASCII
)
# CATT-Acoustic's angles are degrees: loop(1, i, 0, 45, 9, ...) takes steps of 9 degrees.
_FUNCTIONS: dict[str, Callable[[float], float]] = {
    "sin": lambda v: math.sin(math.radians(v)),
    "cos": lambda v: math.cos(math.radians(v)),
    "tan": lambda v: math.tan(math.radians(v)),
    "asin": lambda v: math.degrees(math.asin(v)),
    "acos": lambda v: math.degrees(math.acos(v)),
    "atan": lambda v: math.degrees(math.atan(v)),
    "sqrt": math.sqrt,
    "abs": abs,
}
_OPERATIONS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_SECTIONS = ("corners", "planes", "markers")
_DIRECTIVES = {"offsetco": 1, "offsetpl": 1, "mirror": 2, "translate": 3, "object": None}  # numbers
# What concerns looks or the running of the program, not the room.
_WITHOUT_EFFECT = ("say", "debug", "debugon", "debugoff")
_MOST_FILES = 200
_MOST_STEPS = 10_000
_MOST_TOKENS = 1000
_DEEPEST = 100


class Line(NamedTuple):
    """One statement without its comment."""

    text: str
    where: str  # file and line

    def error(self, what: str, needed: str, found: str | None = None, hint: str = "") -> InputError:
        """Return an error about this line; its text is shown unless `found` says what is wrong."""
        return malformed(what, self.where, self.text[:80] if found is None else found, needed, hint)


class _Corner(NamedTuple):
    """Where a corner comes from: three expressions in the words of one file."""

    file: GeoFile
    expressions: list[str]
    line: Line
    running: dict[str, float]  # value of a loop's number, by its name


@dataclass(slots=True)
class _Shared:
    """What all files of a room share."""

    constants: dict[str, tuple[GeoFile, Line]] = field(default_factory=dict)
    corners: dict[int, _Corner] = field(default_factory=dict)  # by final number
    images: dict[int, int] = field(default_factory=dict)  # of mirrored corners, to the original
    known: dict[str, Any] = field(default_factory=dict)  # constants and corners worked out so far
    under_way: list[str] = field(default_factory=list)  # what is being worked out


@dataclass(slots=True, eq=False)
class GeoFile:
    """The statements of one file by their first word, and what they define."""

    shared: _Shared
    lines: dict[str, list[Line]]
    constants: ChainMap[str, tuple[GeoFile, Line]]  # by lower name: of this file, then global ones
    numbers: dict[str, list[float]] = field(default_factory=dict)  # behind directives

    def added(self, word: str, place: int = 0) -> int:
        """Return what a directive adds to numbers of corners or planes, 0 without it."""
        value = self.numbers.get(word, [0.0, 0.0])[place]
        return whole(f"{value:.17g}", self.lines[word][0].where) if value else 0


def read_files(path: Path) -> list[GeoFile]:
    """Return a file and, behind it, all that it includes, with constants and corners defined.

    An included file comes after the whole of the file that names it, so that it may use constants
    defined below the INCLUDE.
    """
    files: list[GeoFile] = []
    shared = _Shared()
    _gather(Path(path), (), files, shared)
    for file in files:
        for line in (*file.lines["global"], *file.lines["local"]):
            match = re.fullmatch(r"(\w+)\s+([A-Za-z_]\w*)\s*=\s*([^=\"]+)", line.text, re.ASCII)
            if match is None:
                needed = "GLOBAL or LOCAL, a name, = and a number or an expression"
                raise line.error("a constant of the .geo file is not understood", needed)
            names = file.constants.maps[match[1].lower() == "global"]
            if match[2].lower() in names:
                raise line.error("a constant is given twice", "each name once", match[2])
            names[match[2].lower()] = file, Line(match[3], line.where)
    for file in files:
        _obey_directives(file)
    for file in files:
        for line in file.lines["corners"]:
            _add_corners(file, line)
    for number, (file, _, line, _) in shared.corners.items():
        image = number + file.added("mirror")
        if file.lines["mirror"] and (image in shared.corners or image in shared.images):
            what = "a corner and the mirror image of another have the same number"
            found, hint = f"{image}, the image of corner {number}", "let MIRROR add a larger number"
            raise line.error(what, f"another number than {image}", found, hint)
        if file.lines["mirror"]:
            shared.images[image] = number
    return files


def _gather(path: Path, above: tuple[Path, ...], files: list[GeoFile], shared: _Shared) -> None:
    files.append(GeoFile(shared, _statements(path), ChainMap({}, shared.constants)))
    above = (*above, path.resolve())
    for line in files[-1].lines["include"]:
        inner = _included(line, path.parent)
        if inner.resolve() in above or len(files) >= _MOST_FILES:
            what = "a file includes itself, or too many are included"
            raise line.error(what, f"at most {_MOST_FILES}, each not within itself", inner.name)
        _gather(inner, above, files, shared)


def _included(line: Line, folder: Path) -> Path:
    """Return the file that INCLUDE names: its ending may be missing, its case differ."""
    name = line.text.split(None, 1)[1].strip().strip('"').replace("\\", "/")
    wanted = folder / name
    try:
        beside = sorted(wanted.parent.iterdir())
    except (OSError, ValueError):
        beside = []
    options = [wanted, wanted.with_name(f"{wanted.name}.geo")]
    lower = [option.name.lower() for option in options]
    for candidate in (*options, *(f for f in beside if f.name.lower() in lower)):
        if candidate in beside:
            return candidate
    needed = f"{wanted.name} or {wanted.name}.geo in {wanted.parent}"
    raise line.error("an included file does not exist", needed, name)


def _statements(path: Path) -> dict[str, list[Line]]:
    """Return the statements of a file by their first word, lines of sections by the section."""
    found: dict[str, list[Line]] = defaultdict(list)
    section = plane = began = ""
    for number, raw in enumerate(read_text(path, "room file").split("\n"), start=1):
        line = Line(raw.split(";", 1)[0].strip(), f"{path}, line {number}")
        if plane or (section == "planes" and line.text.startswith("[")):
            began = began if plane else line.where
            *closed, plane = f"{plane} {line.text}".split("]")
            check_limit("statement_letters", sum(map(len, closed)) + len(plane), began)
            for text in (*closed, plane) if plane.strip() else closed:
                if not text.strip().startswith("["):
                    raise _unknown(Line(text.strip(), began))
            found["planes"] += [Line(text.split("[", 1)[1], began) for text in closed]
            plane = plane if plane.strip() else ""
        elif line.text:
            check_limit("statement_letters", len(line.text), line.where)
            section = _sorted_in(found, section, line)
    if plane:
        needed, hint = "[number name / corners / material]", "the file may be cut short"
        raise Line(plane, began).error("a plane is not closed", needed, plane.strip()[:60], hint)
    return found


def _sorted_in(found: dict[str, list[Line]], section: str, line: Line) -> str:
    """Put a statement where it belongs and return the section that applies afterwards."""
    word = re.split(r"\W", line.text.lower(), maxsplit=1, flags=re.ASCII)[0]
    if line.text.lower() == word and word in _SECTIONS:
        return word
    if section == "markers" or word in _WITHOUT_EFFECT:
        return section
    if section == "corners" and (line.text[0].isdigit() or word == "loop"):
        word = "corners"
    elif word in _DIRECTIVES:
        if word in found:
            raise line.error("a statement occurs twice in one file", "it once", word)
        if "corners" in found or "planes" in found:
            what, needed = f"{word.upper()} is below corners or planes", "a place above CORNERS"
            raise line.error(what, needed, hint="move the line up")
    elif not (
        word in ("global", "local")
        or (word == "abs" and section != "corners")
        or (word == "include" and len(line.text.split()) > 1)
    ):
        raise _unknown(line)
    found[word].append(line)
    if word in ("global", "local"):
        check_limit("constants", len(found["global"]) + len(found["local"]), line.where)
    return section


def _unknown(line: Line) -> InputError:
    return line.error(
        "a statement of the .geo file is not supported",
        "ABS, GLOBAL, LOCAL, INCLUDE, OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE, "
        "CORNERS with loop(), PLANES",
        hint="let CATT-Acoustic (or TUCT) export the room with everything worked out, or export "
        "it as OBJ",
    )


def _obey_directives(file: GeoFile) -> None:
    for word, count in _DIRECTIVES.items():
        for line in file.lines[word] if count else ():
            words = line.text.split()[1:]
            if len(words) != count:
                raise line.error(f"{word.upper()} needs another number of words", f"{count}")
            file.numbers[word] = [value_of(text, file, line) for text in words]
            if word == "translate" and not file.lines["object"]:
                needed = "a line OBJECT: it moves objects alone"
                raise line.error("TRANSLATE without OBJECT", needed)


def _add_corners(file: GeoFile, line: Line) -> None:
    corners, added = file.shared.corners, file.added("offsetco")

    def add(number: int, expressions: list[str], running: dict[str, float]) -> None:
        number += added
        if number in corners:
            needed = f"a number of its own: {corners[number].line.where} has it"
            hint = "OFFSETCO keeps the corners of included files apart"
            raise line.error("a corner number is given twice", needed, str(number), hint)
        corners[number] = _Corner(file, expressions, line, running)
        check_limit("corners", len(corners), line.where)

    if line.text[0].isdigit():
        number, *expressions = split_outside(line.text, " ")
        if len(expressions) != 3:
            what = "a corner needs a number and three coordinates"
            raise line.error(what, "number x y z, expressions without blanks, as 2*w-1")
        add(whole(number, line.where), expressions, {})
        return
    match = re.fullmatch(r"loop\s*\((.*)\)", line.text, re.ASCII | re.IGNORECASE)
    words = split_outside(match[1], ",") if match else []
    if len(words) != 8 or not re.fullmatch(r"[A-Za-z_]\w*", words[1], re.ASCII):
        needed = "loop(first number, name, start, stop, step, x, y, z)"
        raise line.error("a loop of the .geo file is not understood", needed)
    first, start, stop, step = (value_of(words[k], file, line) for k in (0, 2, 3, 4))
    steps = (stop - start) / step if step else -1.0
    if not 0.0 <= steps + 1e-9 <= _MOST_STEPS:
        what = "a loop that does not end, or has no step"
        needed = f"at most {_MOST_STEPS} steps from start to stop, as in loop(1,a,0,90,10,...)"
        raise line.error(what, needed, f"{start:g} to {stop:g} by {step:g}")
    for k in range(int(steps + 1e-9) + 1):
        add(whole(f"{first + k:.17g}", line.where), words[5:], {words[1].lower(): start + k * step})


def split_outside(text: str, mark: str) -> list[str]:
    """Split at a mark outside of brackets, or into words where the mark is a blank."""
    words, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth <= 0 and (letter == mark or (mark == " " and letter.isspace())):
            words.append("")
        else:
            words[-1] += letter
    words = [word.strip() for word in words]
    return [word for word in words if word] if mark == " " else words


def value_of(
    text: str,
    file: GeoFile,
    line: Line,
    running: Mapping[str, float] = MappingProxyType({}),
    lock: Callable[..., float] | None = None,
) -> float:
    """Return the value of an expression in the names of its file; refuse what is not finite.

    Numbers, constants, ``+ - * /``, brackets, sin, cos, tan, asin, acos, atan (degrees), sqrt,
    abs, ``x(4)``, ``y(4)``, ``z(4)`` for a coordinate of another corner; where they are given,
    the running number of a loop by its name, and ``lock(4 7 8)`` for the point on the plane
    through three corners.
    """

    def corner(number: float) -> Point:
        return _own_corner(file, whole(f"{number:.17g}", line.where), line)

    def value(node: ast.expr) -> float:
        match node:
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.Name(id=name):
                return running[name[1:]] if name[1:] in running else _constant(file, name[1:], line)
            case ast.UnaryOp(operand=operand):
                return -value(operand) if isinstance(node.op, ast.USub) else value(operand)
            case ast.BinOp(left=left, op=op, right=right):
                return _OPERATIONS[type(op)](value(left), value(right))
            case ast.Call(func=ast.Name(id=name), args=arguments):
                if len(arguments) == 1 and isinstance(arguments[0], ast.Tuple):
                    arguments = arguments[0].elts
                numbers = map(value, arguments)
                if name in ("_x", "_y", "_z"):
                    return corner(*numbers)["xyz".index(name[1])]
                if name == "_lock" and lock:
                    return lock(*map(corner, numbers))
                return _FUNCTIONS[name[1:]](*numbers)
        raise KeyError

    try:
        return finite(repr(value(ast.parse(_in_python(text), mode="eval").body)), line.where)
    except (ZeroDivisionError, ValueError, OverflowError) as error:
        needed, found = "a finite number: no division by 0, no root below 0", f"{text!r}: {error}"
        raise line.error("an expression has no value", needed, found) from None
    except (LookupError, TypeError, SyntaxError, RecursionError, MemoryError) as error:
        is_long = isinstance(error, RecursionError | MemoryError) or "nested" in str(error)
        what = "an expression of the .geo file is not understood"
        raise line.error(
            "an expression is too long, or has too many brackets" if is_long else what,
            "numbers, constants, + - * / and brackets, sin, cos, tan, asin, acos, atan, sqrt, "
            "abs, x(), y(), z(), lock()",
            repr(text.strip()[:80]),
            "let CATT-Acoustic export the room with everything worked out",
        ) from None


def _in_python(text: str) -> str:
    """Put an underscore before names (none is a word of Python then), commas between corners."""
    words: list[str] = []
    at, text = 0, text.rstrip()
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise SyntaxError
        if len(words) > _MOST_TOKENS:
            raise MemoryError
        number, name, mark = match.groups()
        if number and words and words[-1][-1].isdigit():
            words.append(",")
        words.append(f"_{name.lower()}" if name else mark or re.sub(r"^0+(?=\d)", "", number))
        at = match.end()
    return " ".join(words)


def _constant(file: GeoFile, name: str, line: Line) -> float:
    """Return the value of a constant, of this file or global, by its name in lower case."""
    if name not in file.constants:
        needed = f"one of {in_short(sorted(file.constants)) or 'those above: there is none'}"
        hint = f"write GLOBAL {name} = and its value above CORNERS"
        raise line.error("a constant is not defined", needed, name, hint)
    owner, own = file.constants[name]
    what = f"constant {name} ({own.where})"
    return float(_once(file.shared, what, line, lambda: value_of(own.text, owner, own)))


def _once(shared: _Shared, what: str, line: Line, work: Callable[[], Any]) -> Any:
    """Work something out once; refuse circles and endless chains.

    Constants that double each other would be worked out 2 ** n times.
    """
    way = shared.under_way
    if what in way or len(way) > _DEEPEST:
        what_is_wrong = "numbers of the .geo file go in a circle, or refer to each other too often"
        needed, found = f"a chain of {_DEEPEST} at most to a number", " -> ".join([*way[-4:], what])
        raise line.error(what_is_wrong, needed, found, f"write a number in place of {what}")
    if what not in shared.known:
        way.append(what)
        try:
            shared.known[what] = work()
        finally:
            way.pop()
    return shared.known[what]


def _own_corner(file: GeoFile, number: int, line: Line) -> Point:
    """Return a corner by the number that a file writes for it, before TRANSLATE."""
    number += file.added("offsetco")
    found = corner_of(file.shared, number, line)
    source = file.shared.corners.get(number)
    if "translate" in file.numbers and (source is None or source.file is not file):
        what = "an object that TRANSLATE moves refers to a corner outside it"
        needed = "corners of its own file, and not their mirror images"
        raise line.error(what, needed, f"corner {number}")
    x, y, z = np.subtract(found, file.numbers.get("translate", 0.0)).tolist()
    return x, y, z


def corner_of(shared: _Shared, number: int, line: Line) -> Point:
    """Return a corner in metres by its final number; one that is a mirror image by its original."""
    if number in shared.images:
        x, y, z = corner_of(shared, shared.images[number], line)
        return -x, y, z
    if number not in shared.corners:
        needed = f"one of {in_short([str(n) for n in shared.corners])}"
        raise line.error("no corner has this number", needed, str(number))
    work = partial(_worked_out, shared.corners[number])
    x, y, z = _once(shared, f"corner {number}", line, work)
    return x, y, z


def _worked_out(corner: _Corner) -> Point:
    file, expressions, line, running = corner
    point = [0.0, 0.0, 0.0]
    locked = [k for k in range(3) if re.search(r"(?i)\block\s*\(", expressions[k])]
    if len(locked) > 1:
        needed = "one at most: two coordinates fix the third on a plane"
        raise line.error("a corner has more than one lock()", needed)

    def on_plane(*corners: Point) -> float:
        """Return the coordinate that puts the point on the plane through three corners."""
        a, b, c = np.array(corners)
        normal, axis = np.cross(b - a, c - a), locked[0]
        if not abs(normal[axis]) > 1e-9 * np.linalg.norm(normal):
            needed = "three corners off one line, of a plane that is not parallel to it"
            found = f"the plane of its three corners runs along {'xyz'[axis]}"
            raise line.error("lock() has no solution", needed, found)
        i, j = (k for k in range(3) if k != axis)
        shift = normal[i] * (point[i] - a[i]) + normal[j] * (point[j] - a[j])
        return float(a[axis] - shift / normal[axis])

    for axis in sorted(range(3), key=lambda k: k in locked):
        lock = on_plane if axis in locked else None
        point[axis] = value_of(expressions[axis], file, line, running, lock)
    x, y, z = np.add(point, file.numbers.get("translate", 0.0)).tolist()
    return x, y, z
