"""Numbers of a .geo file: constants, corners of other corners, and the arithmetic around them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from roomfit.errors import InputError
from roomfit.files.rooms.text import finite, whole

_TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_]\w*)|([-+*/(),]))", re.ASCII
)
_DEEPEST = 40

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
_AXES = "xyz"


class Names(Protocol):
    """What the names in an expression stand for."""

    def constant(self, name: str, where: str) -> float:
        """Return the value of a constant, its name in lower case."""

    def corner(self, number: int, where: str) -> Point:
        """Return a corner by the number that its file writes."""


@dataclass(slots=True)
class _Reader:
    """An expression on its way from left to right."""

    tokens: list[str]
    names: Names
    where: str
    lock: Callable[[Point, Point, Point], float] | None
    at: int = 0
    depth: int = 0

    def peek(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def take(self) -> str:
        token = self.peek()
        self.at += 1
        return token


def value_of(
    text: str,
    names: Names,
    where: str,
    lock: Callable[[Point, Point, Point], float] | None = None,
) -> float:
    """Return what an expression amounts to.

    Numbers, constants, ``+ - * /``, brackets, sin, cos, tan, asin, acos, atan (degrees), sqrt,
    abs, ``x(4)``, ``y(4)``, ``z(4)`` for a coordinate of another corner and, where `lock` is
    given, ``lock(4 7 8)`` for the place on the plane through three corners.

    Raises
    ------
    InputError
        Anything else, a name that is not known, or a value that is not a finite number.
    """
    reader = _Reader(_tokens(text, where), names, where, lock)
    try:
        value = _sum(reader)
    except (ZeroDivisionError, ValueError, OverflowError) as error:
        raise InputError(
            "an expression has no value", where=where, found=f"{text!r}: {error}"
        ) from None
    if reader.peek():
        raise _not_understood(text, where, reader.peek())
    return finite(repr(value), where)


def _tokens(text: str, where: str) -> list[str]:
    tokens, at = [], 0
    while at < len(text.rstrip()):
        match = _TOKEN.match(text, at)
        if match is None:
            raise _not_understood(text, where, text[at:].strip()[:20])
        tokens.append(match.group(0).strip())
        at = match.end()
    return tokens


def _not_understood(text: str, where: str, token: str) -> InputError:
    return InputError(
        "an expression of the .geo file is not understood",
        where=where,
        found=f"{token!r} in {text.strip()[:80]!r}" if token else repr(text.strip()[:80]),
        needed="numbers, constants, + - * / and brackets, sin, cos, tan, asin, acos, atan, sqrt, "
        "abs, x(), y(), z(), lock()",
    )


def _sum(reader: _Reader) -> float:
    value = _product(reader)
    while reader.peek() in ("+", "-"):
        sign = 1.0 if reader.take() == "+" else -1.0
        value += sign * _product(reader)
    return value


def _product(reader: _Reader) -> float:
    value = _factor(reader)
    while reader.peek() in ("*", "/"):
        if reader.take() == "*":
            value *= _factor(reader)
        else:
            value /= _factor(reader)
    return value


def _factor(reader: _Reader) -> float:
    sign = 1.0
    while reader.peek() in ("+", "-"):
        sign = -sign if reader.take() == "-" else sign
    token = reader.take()
    if token == "(":
        return sign * _bracket(reader)
    if token[:1].isdigit() or token[:1] == ".":
        return sign * float(token)
    if not token[:1].isalpha() and token[:1] != "_":
        raise _not_understood(" ".join(reader.tokens), reader.where, token)
    name = token.lower()
    if reader.peek() != "(":
        return sign * reader.names.constant(name, reader.where)
    reader.take()
    if name in _FUNCTIONS:
        return sign * _FUNCTIONS[name](_bracket(reader))
    if name in _AXES:
        (number,) = _numbers(reader, name, 1)
        return sign * reader.names.corner(number, reader.where)[_AXES.index(name)]
    if name == "lock" and reader.lock is not None:
        a, b, c = (reader.names.corner(n, reader.where) for n in _numbers(reader, name, 3))
        return sign * reader.lock(a, b, c)
    raise _not_understood(" ".join(reader.tokens), reader.where, f"{token}(")


def _bracket(reader: _Reader) -> float:
    reader.depth += 1
    if reader.depth > _DEEPEST:
        raise InputError("an expression has too many brackets", where=reader.where)
    value = _sum(reader)
    reader.depth -= 1
    if reader.take() != ")":
        raise _not_understood(" ".join(reader.tokens), reader.where, "a bracket that stays open")
    return value


def _numbers(reader: _Reader, name: str, count: int) -> list[int]:
    """Return the corner numbers up to the closing bracket."""
    numbers: list[int] = []
    while reader.peek() not in (")", ""):
        token = reader.take()
        if token != ",":
            numbers.append(whole(token, reader.where))
    if reader.take() != ")" or len(numbers) != count:
        raise InputError(
            f"{name}() needs {count} corner number{'s' if count > 1 else ''}",
            where=reader.where,
            found=" ".join(reader.tokens),
        )
    return numbers


def lock_on_plane(
    axis: int, point: Sequence[float], a: Point, b: Point, c: Point, where: str
) -> float:
    """Return the coordinate along `axis` of the point on the plane through a, b and c.

    Parameters
    ----------
    axis : {0, 1, 2}
    point : three floats
        The one along `axis` is not looked at.

    Raises
    ------
    InputError
        The plane runs along the axis, or the three corners stand on one line.
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
        raise InputError(
            "lock() finds no place",
            where=where,
            found=f"the plane of its three corners runs along {_AXES[axis]}",
            needed="three corners that are not on one line, of a plane that is not parallel to it",
        )
    i, j = (k for k in range(3) if k != axis)
    shift = normal[i] * (point[i] - a[i]) + normal[j] * (point[j] - a[j])
    return a[axis] - shift / normal[axis]
