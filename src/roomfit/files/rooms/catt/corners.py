"""Constants, directives and corners of every file of a room, put where expressions find them."""

from __future__ import annotations

import re

from roomfit.errors import InputError
from roomfit.files.rooms.catt.expressions import value_of
from roomfit.files.rooms.catt.numbers import CornerSource, FileNames, Shared
from roomfit.files.rooms.catt.statements import GeoFile, Line
from roomfit.files.rooms.text import whole

_MOST_STEPS = 10_000


def names_of(files: list[GeoFile]) -> tuple[Shared, list[FileNames]]:
    """Return what the expressions of each file know.

    Raises
    ------
    InputError
        A constant is given twice, or a statement's numbers are not what they must be.
    """
    shared = Shared()
    owners = [FileNames(shared, file) for file in files]
    for owner in owners:
        for kind, line in owner.file.constants:
            name, expression = _definition(line)
            known = shared.constants if kind == "global" else owner.local
            if name in known:
                raise InputError("a constant is given twice", where=line.where, found=name)
            if kind == "global":
                shared.constants[name] = (owner, expression)
            else:
                owner.local[name] = expression
    for owner in owners:
        _obey_directives(owner)
    for owner in owners:
        for line in owner.file.corners:
            _add_corners(owner, line)
    _check_images(shared)
    return shared, owners


def _check_images(shared: Shared) -> None:
    """Two corners must not share a number, one of them as a mirror image."""
    images: dict[int, CornerSource] = {}
    for number, source in shared.corners.items():
        if source.names.mirror is None:
            continue
        image = number + source.names.mirror[0]
        other = shared.corners.get(image) or images.get(image)
        if other is not None:
            raise InputError(
                "a corner and the mirror image of another have the same number",
                where=other.where,
                found=f"{image}, the image of corner {number}",
                hint="let MIRROR add a larger number",
            )
        images[image] = source


def _definition(line: Line) -> tuple[str, Line]:
    match = re.fullmatch(r"\w+\s+([A-Za-z_]\w*)\s*=\s*([^=\"]+)", line.text, re.ASCII)
    if match is None:
        raise InputError(
            "a constant of the .geo file is not understood",
            where=line.where,
            found=line.text[:80],
            needed="GLOBAL or LOCAL, a name, = and a number or an expression",
        )
    return match.group(1).lower(), Line(match.group(2), line.where)


def _obey_directives(owner: FileNames) -> None:
    def numbers(word: str, count: int) -> list[float] | None:
        line = owner.file.directives.get(word)
        if line is None:
            return None
        words = line.text.split()[1:]
        if len(words) != count:
            raise InputError(
                f"{word.upper()} needs {count} number{'s' if count > 1 else ''}",
                where=line.where,
                found=line.text[:80],
            )
        return [value_of(text, owner, line.where) for text in words]

    offset = numbers("offsetco", 1)
    mirror = numbers("mirror", 2)
    shift = numbers("translate", 3)
    if offset:
        owner.offset = _integer(offset[0], owner, "offsetco")
    if mirror:
        owner.mirror = (
            _integer(mirror[0], owner, "mirror"),
            _integer(mirror[1], owner, "mirror"),
        )
        owner.shared.mirrors.add(owner.mirror[0])
    if shift:
        if "object" not in owner.file.directives:
            raise InputError(
                "TRANSLATE without OBJECT", where=owner.file.directives["translate"].where
            )
        owner.shift = (shift[0], shift[1], shift[2])


def _integer(value: float, owner: FileNames, word: str) -> int:
    if value != int(value) or value < 0:
        where = owner.file.directives[word].where
        raise InputError("a whole number was expected", where=where, found=f"{value:g}")
    return int(value)


def _add_corners(owner: FileNames, line: Line) -> None:
    if not line.text[0].isdigit():
        _add_loop(owner, line)
        return
    words = split_words(line.text)
    if len(words) != 4:
        raise InputError(
            "a corner needs a number and three coordinates",
            where=line.where,
            found=line.text[:80],
            hint="write an expression without blanks, as in 2*w-1",
        )
    source = CornerSource(owner, (words[1], words[2], words[3]), line.where)
    _add(owner.shared, whole(words[0], line.where) + owner.offset, source)


def _add(shared: Shared, number: int, source: CornerSource) -> None:
    if number in shared.corners:
        raise InputError(
            "a corner number is given twice",
            where=source.where,
            found=str(number),
            hint=f"the first one: {shared.corners[number].where}; OFFSETCO keeps included files "
            "apart",
        )
    shared.corners[number] = source


def _add_loop(owner: FileNames, line: Line) -> None:
    """Read ``loop(first, i, start, stop, step, x, y, z)``: one corner for each value of i."""
    match = re.fullmatch(r"loop\s*\((.*)\)", line.text, re.ASCII | re.IGNORECASE)
    arguments = split_words(match.group(1), ",") if match else []
    if len(arguments) != 8 or not re.fullmatch(r"[A-Za-z_]\w*", arguments[1], re.ASCII):
        raise InputError(
            "a loop of the .geo file is not understood",
            where=line.where,
            found=line.text[:80],
            needed="loop(first number, name, start, stop, step, x, y, z)",
        )
    number, start, stop, step = (value_of(arguments[k], owner, line.where) for k in (0, 2, 3, 4))
    steps = (stop - start) / step if step else -1.0
    if number != int(number) or number < 0 or not 0.0 <= steps + 1e-9 <= _MOST_STEPS:
        raise InputError("a loop that does not end, or has no step", where=line.where)
    for k in range(int(steps + 1e-9) + 1):
        running = (arguments[1].lower(), start + k * step)
        expressions = (arguments[5], arguments[6], arguments[7])
        source = CornerSource(owner, expressions, line.where, running)
        _add(owner.shared, int(number) + k + owner.offset, source)


def split_words(text: str, mark: str = " ") -> list[str]:
    """Split at a mark (or at white space) outside brackets.

    Examples
    --------
    >>> split_words("5 x(4) -w/2 lock(4 7 8)")
    ['5', 'x(4)', '-w/2', 'lock(4 7 8)']
    """
    words, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if depth <= 0 and (letter == mark or (mark == " " and letter.isspace())):
            words.append("")
        else:
            words[-1] += letter
    words = [word.strip() for word in words]
    return [word for word in words if word] if mark == " " else words
