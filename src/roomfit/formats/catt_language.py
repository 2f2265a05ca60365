"""The language of CATT-Acoustic's .geo files: statements, includes and expressions.

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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from roomfit.base.arguments import in_short
from roomfit.base.door import check_limit, read_text
from roomfit.base.errors import InputError
from roomfit.formats.model import finite, malformed, whole

_TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|([-+*/(),]))", re.ASCII
)
_MOST_TOKENS = 1000

Point = tuple[float, float, float]

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
_AXES = ("x", "y", "z")


def value_of(
    text: str,
    file: GeoFile,
    where: str,
    *,
    running: tuple[str, float] | None = None,
    lock: Callable[[Point, Point, Point], float] | None = None,
) -> float:
    """Return the value of an expression in the names of its file; refuse what is not finite.

    Numbers, constants, ``+ - * /``, brackets, sin, cos, tan, asin, acos, atan (degrees), sqrt,
    abs, ``x(4)``, ``y(4)``, ``z(4)`` for a coordinate of another corner; where they are given,
    the running number of a loop by its name, and ``lock(4 7 8)`` for the point on the plane
    through three corners.
    """

    def corners(call: ast.Call, count: int) -> list[Point]:
        arguments = call.args
        if len(arguments) == 1 and isinstance(arguments[0], ast.Tuple):
            arguments = arguments[0].elts
        numbers = [a.value for a in arguments if isinstance(a, ast.Constant)]
        if len(numbers) != len(arguments) or len(numbers) != count:
            what = f"{_name(call.func)}() needs {count} corner number{'s' if count > 1 else ''}"
            needed = f"whole numbers, {count} of them, between the brackets"
            raise malformed(what, where, text, needed)
        return [own_corner(file, whole(str(number), where), where) for number in numbers]

    def value(node: ast.expr) -> float:
        match node:
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.Name():
                name = _name(node)
                return running[1] if running and name == running[0] else constant(file, name, where)
            case ast.UnaryOp(operand=operand):
                return -value(operand) if isinstance(node.op, ast.USub) else value(operand)
            case ast.BinOp(left=left, right=right) if type(node.op) in _OPERATIONS:
                return _OPERATIONS[type(node.op)](value(left), value(right))
            case ast.Call(func=ast.Name(), args=[argument]) if _name(node.func) in _FUNCTIONS:
                return _FUNCTIONS[_name(node.func)](value(argument))
            case ast.Call(func=ast.Name()) if _name(node.func) in _AXES:
                return corners(node, 1)[0][_AXES.index(_name(node.func))]
            case ast.Call(func=ast.Name()) if _name(node.func) == "lock" and lock is not None:
                return lock(*corners(node, 3))
        raise _not_understood(text, where)

    try:
        return finite(repr(value(ast.parse(_in_python(text, where), mode="eval").body)), where)
    except (RecursionError, MemoryError):
        raise _too_long(where) from None
    except SyntaxError as error:
        if "nested" in str(error):
            raise _too_long(where) from None
        raise _not_understood(text, where) from None
    except (ZeroDivisionError, ValueError, OverflowError) as error:
        what = "an expression has no value"
        hint = "look for a division by zero or the root of a negative number"
        raise malformed(what, where, f"{text!r}: {error}", "a finite number", hint) from None


def _in_python(text: str, where: str) -> str:
    """Put an underscore before names (none is a word of Python then), commas between corners."""
    words: list[str] = []
    at, text = 0, text.rstrip()
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _not_understood(text, where)
        if len(words) > _MOST_TOKENS:
            raise _too_long(where)
        number, name, mark = match.groups()
        if number and words and words[-1][-1].isdigit():
            words.append(",")
        words.append(f"_{name.lower()}" if name else mark or re.sub(r"^0+(?=\d)", "", number))
        at = match.end()
    return " ".join(words)


def _name(node: ast.expr) -> str:
    """Return the name that `_in_python` put an underscore in front of."""
    return node.id[1:] if isinstance(node, ast.Name) else ""


def _too_long(where: str) -> InputError:
    what = "an expression is too long, or has too many brackets"
    hint = "give parts of it names, as constants of their own"
    return malformed(what, where, "more than can be worked out", "a shorter one", hint)


def _not_understood(text: str, where: str) -> InputError:
    return malformed(
        "an expression of the .geo file is not understood",
        where,
        repr(text.strip()[:80]),
        "numbers, constants, + - * / and brackets, sin, cos, tan, asin, acos, atan, sqrt, "
        "abs, x(), y(), z(), lock()",
        "let CATT-Acoustic export the room with everything worked out",
    )


def lock_on_plane(
    axis: int, point: Sequence[float], a: Point, b: Point, c: Point, where: str
) -> float:
    """Return the coordinate along `axis` of the point on the plane through a, b and c.

    Of `point` the one along `axis` is not used. Refused is a plane that runs along the axis, and
    three corners on one line.
    """
    u = [q - p for p, q in zip(a, b, strict=True)]
    v = [q - p for p, q in zip(a, c, strict=True)]
    normal = (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )
    size = math.sqrt(sum(n * n for n in normal))
    if abs(normal[axis]) <= 1e-9 * size or size == 0.0:
        raise malformed(
            "lock() has no solution",
            where,
            f"the plane of its three corners runs along {_AXES[axis]}",
            "three corners that are not on one line, of a plane that is not parallel to it",
            "lock another coordinate, or choose other corners",
        )
    i, j = (k for k in range(3) if k != axis)
    shift = normal[i] * (point[i] - a[i]) + normal[j] * (point[j] - a[j])
    return a[axis] - shift / normal[axis]


_MOST_FILES = 200
_WORD = re.compile(r"[A-Za-z_]\w*", re.ASCII)

# What concerns looks or the running of the program, not the room.
_WITHOUT_EFFECT = ("say", "debug", "debugon", "debugoff")


@dataclass(frozen=True, slots=True)
class Line:
    """One statement without its comment."""

    text: str
    where: str  # file and line

    def error(
        self, what: str, *, found: str | None = None, needed: str | None = None, hint: str = ""
    ) -> InputError:
        """Return an error about this line; its text is shown unless `found` says what is wrong."""
        found = self.text[:80] if found is None else found
        return InputError(what, where=self.where, found=found, needed=needed, hint=hint)


@dataclass(slots=True)
class CornerSource:
    """Where a corner comes from: three expressions in the words of one file."""

    file: GeoFile
    expressions: tuple[str, str, str]
    where: str
    running: tuple[str, float] | None = None  # name and value of a loop's number
    point: Point | None = None


@dataclass(slots=True)
class Shared:
    """What all files share: global constants, and corners by their final number."""

    constants: dict[str, tuple[GeoFile, Line]] = field(default_factory=dict)
    corners: dict[int, CornerSource] = field(default_factory=dict)
    values: dict[Line, float] = field(default_factory=dict)  # of constants worked out so far
    under_way: list[str] = field(default_factory=list)  # what is being evaluated
    mirrors: set[int] = field(default_factory=set)  # what any file's MIRROR adds to corners


@dataclass(slots=True)
class GeoFile:
    """The statements of one file, sorted by what they are about, and the names that it knows."""

    path: Path
    shared: Shared
    constants: list[tuple[str, Line]] = field(default_factory=list)  # "global" or "local"
    materials: list[Line] = field(default_factory=list)
    directives: dict[str, Line] = field(default_factory=dict)
    corners: list[Line] = field(default_factory=list)
    planes: list[Line] = field(default_factory=list)
    includes: list[Line] = field(default_factory=list)
    local: dict[str, Line] = field(default_factory=dict)  # constants of this file alone
    offset: int = 0  # what OFFSETCO adds to its corner numbers
    # what MIRROR adds to numbers of mirrored corners and planes
    mirror: tuple[int, int] | None = None
    shift: Point = (0.0, 0.0, 0.0)  # TRANSLATE


def read_files(path: Path) -> list[GeoFile]:
    """Return a file and, behind it, all that it includes; refuse one that includes itself.

    An included file comes after the whole of the file that names it, so that it may use constants
    defined below the INCLUDE.
    """
    files: list[GeoFile] = []
    _gather(Path(path), (), files, Shared())
    return files


def _gather(path: Path, above: tuple[Path, ...], files: list[GeoFile], shared: Shared) -> None:
    file = _sorted(GeoFile(path, shared))
    files.append(file)
    if len(files) > _MOST_FILES:
        what = "too many files are included"
        hint = f"include {_MOST_FILES - 1} files, or export the room as one file"
        raise malformed(what, str(path), f"{len(files)}", f"at most {_MOST_FILES}", hint)
    for line in file.includes:
        inner = _included(line, path.parent)
        if inner.resolve() in (*above, path.resolve()):
            raise line.error("a file includes itself", found=inner.name)
        _gather(inner, (*above, path.resolve()), files, shared)


def _included(line: Line, folder: Path) -> Path:
    """Return the file that INCLUDE names: its ending may be missing, its case differ."""
    name = line.text.split(None, 1)[1].strip().strip('"').replace("\\", "/")
    wanted = folder / name
    options = (wanted, wanted.with_name(wanted.name + ".geo"))
    try:
        beside = sorted(wanted.parent.iterdir()) if wanted.parent.is_dir() else []
    except (OSError, ValueError):
        beside = []
    lower = [option.name.lower() for option in options]
    for candidate in (*options, *(f for f in beside if f.name.lower() in lower)):
        if candidate in beside:
            return candidate
    raise line.error(
        "an included file does not exist",
        found=name,
        needed=f"{wanted.name} or {wanted.name}.geo in {wanted.parent}",
    )


def _sorted(file: GeoFile) -> GeoFile:
    section = ""
    plane: list[str] = []
    began = ""
    for number, raw in enumerate(read_text(file.path, "room file").split("\n"), start=1):
        where = f"{file.path}, line {number}"
        text = raw.split(";", 1)[0].strip()
        if plane or (section == "planes" and text.startswith("[")):
            began = began or where
            plane.append(text)
            check_limit("statement_letters", sum(map(len, plane)) + len(plane), began)
            _close_planes(file, plane, began)
            began = began if plane else ""
            continue
        word = (_WORD.match(text) or [""])[0].lower()
        check_limit("statement_letters", len(text), where)
        if text:
            section = _sort(file, section, word, Line(text, where))
    if plane:
        what = "a plane is not closed"
        needed = "[number name / corners / material]"
        hint = "the file may be cut short: export it again"
        raise InputError(what, where=began, found=" ".join(plane)[:60], needed=needed, hint=hint)
    return file


def _close_planes(file: GeoFile, pending: list[str], where: str) -> None:
    """Move whole planes from the pending text to the file."""
    text = " ".join(pending)
    while "]" in text:
        inner, text = text.split("]", 1)
        file.planes.append(Line(inner.split("[", 1)[1] if "[" in inner else inner, where))
        text = text.strip()
        if text and not text.startswith("["):
            raise _unknown(Line(text, where))
    pending[:] = [text] if text else []


def _sort(file: GeoFile, section: str, word: str, line: Line) -> str:
    """Assign a statement to its list and return the section that applies afterwards."""
    alone = line.text.lower() == word
    if alone and word in ("corners", "planes", "markers"):
        return word
    if section == "markers" or word in _WITHOUT_EFFECT:
        return section
    if word in ("global", "local"):
        file.constants.append((word, line))
        check_limit("constants", len(file.constants), line.where)
    elif word == "abs" and section != "corners":
        file.materials.append(line)
    elif word == "include" and len(line.text.split(None, 1)) == 2:
        file.includes.append(line)
    elif word in ("offsetco", "offsetpl", "mirror", "translate", "object"):
        if word in file.directives:
            raise line.error("a statement occurs twice in one file", found=word)
        if file.corners or file.planes:
            raise line.error(
                f"{word.upper()} is below corners or planes",
                needed="a place above CORNERS",
                hint="move the line up",
            )
        file.directives[word] = line
    elif section == "corners" and (line.text[0].isdigit() or word == "loop"):
        file.corners.append(line)
    else:
        raise _unknown(line)
    return section


def _unknown(line: Line) -> InputError:
    return line.error(
        "a statement of the .geo file is not supported",
        needed="ABS, GLOBAL, LOCAL, INCLUDE, OFFSETCO, OFFSETPL, MIRROR, OBJECT with TRANSLATE, "
        "CORNERS with loop(), PLANES",
        hint="let CATT-Acoustic (or TUCT) export the room with everything worked out, or export "
        "it as OBJ",
    )


_NUMBERS_DEEPEST = 100


def constant(file: GeoFile, name: str, where: str) -> float:
    """Return the value of a constant, of this file or global, by its name in lower case."""
    shared = file.shared
    if name not in file.local and name not in shared.constants:
        known = sorted({*file.local, *shared.constants})
        needed = f"one of {in_short(known)}" if known else "a definition: there is none"
        hint = f"write GLOBAL {name} = and its value above CORNERS"
        raise malformed("a constant is not defined", where, name, needed, hint)
    owner, line = (file, file.local[name]) if name in file.local else shared.constants[name]
    # once: constants that double each other would be worked out 2 ** n times
    if line not in shared.values:
        with _evaluating(shared, f"constant {name} of {owner.path.name}", where):
            shared.values[line] = value_of(line.text, owner, line.where)
    return shared.values[line]


def own_corner(file: GeoFile, number: int, where: str) -> Point:
    """Return a corner by the number that a file writes for it, before TRANSLATE.

    Refused is a corner of another file where TRANSLATE moves this one.
    """
    x, y, z = corner_of(file.shared, number + file.offset, where)
    if not any(file.shift):
        return x, y, z
    source = file.shared.corners.get(number + file.offset)
    if source is None or source.file is not file:
        what = "an object that TRANSLATE moves refers to a corner outside it"
        needed = "corners of its own file, and not their mirror images"
        hint = "give the corner in the file of the object, or remove TRANSLATE"
        raise malformed(what, where, f"corner {number}", needed, hint)
    return x - file.shift[0], y - file.shift[1], z - file.shift[2]


@contextmanager
def _evaluating(shared: Shared, what: str, where: str) -> Iterator[None]:
    """Refuse circles and endless chains."""
    way = shared.under_way
    if what in way or len(way) > _NUMBERS_DEEPEST:
        raise malformed(
            "numbers of the .geo file go in a circle, or refer to each other too often",
            where,
            " -> ".join([*way[-4:], what]),
            f"a chain of {_NUMBERS_DEEPEST} at most that ends in a number",
            f"write a number in place of {what}",
        )
    way.append(what)
    try:
        yield
    finally:
        way.pop()


def corner_of(shared: Shared, number: int, where: str) -> Point:
    """Return a corner in metres by its final number; one that is a mirror image by its original."""
    source = shared.corners.get(number)
    if source is None:
        original = _original(shared, number)
        if original is None:
            needed = f"one of {in_short([str(n) for n in shared.corners])}"
            hint = f"add a corner {number} below CORNERS, or name another one"
            raise malformed("no corner has this number", where, str(number), needed, hint)
        x, y, z = corner_of(shared, original, where)
        return -x, y, z
    if source.point is None:
        with _evaluating(shared, f"corner {number}", where):
            source.point = _worked_out(source)
    return source.point


def _original(shared: Shared, number: int) -> int | None:
    """Return the number of the corner whose mirror image this number means."""
    for offset in sorted(shared.mirrors):
        source = shared.corners.get(number - offset)
        if source and source.file.mirror and source.file.mirror[0] == offset:
            return number - offset
    return None


def _worked_out(source: CornerSource) -> Point:
    def value(axis: int, lock: Callable[[Point, Point, Point], float] | None = None) -> float:
        return value_of(
            source.expressions[axis], source.file, source.where, running=source.running, lock=lock
        )

    point = [0.0, 0.0, 0.0]
    locked = [k for k in range(3) if re.search(r"(?i)\block\s*\(", source.expressions[k])]
    if len(locked) > 1:
        what = "a corner has more than one lock()"
        needed = "one at most: two coordinates fix the third on a plane"
        hint = "write numbers or x(), y(), z() for the others"
        raise malformed(what, source.where, f"{len(locked)} of them", needed, hint)
    for axis in (0, 1, 2):
        if axis not in locked:
            point[axis] = value(axis)
    for axis in locked:
        point[axis] = value(axis, partial(lock_on_plane, axis, point, where=source.where))
    x, y, z = (p + s for p, s in zip(point, source.file.shift, strict=True))
    return x, y, z
