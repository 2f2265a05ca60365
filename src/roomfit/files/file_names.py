"""Recordings by their names: templates such as ``DIR/{source}_{receiver}.wav``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from roomfit.base.errors import InputError


def shape_of(
    template: str, known: Mapping[str, str] | None = None, one_of: Iterable[str] = ()
) -> re.Pattern[str]:
    """Return the pattern of names of a template; {source} and {receiver} are groups, * any text.

    Parameters
    ----------
    template : str
    known : mapping, optional
        The source and the receiver, where they are given.
    one_of : iterable of str, optional
        Names that either may have, in letters of any case; left out: any.

    Raises
    ------
    InputError
        It lacks {source} or {receiver}, or they name a folder.

    Examples
    --------
    >>> shape_of("ir/{source}_{receiver}.wav").fullmatch("ir/LS1_MP2.wav")["receiver"]
    'MP2'
    """
    keys = set(re.findall(r"\{(\w+)\}", template))
    if keys != {"source", "receiver"} or "{" in str(Path(template).parent):
        raise InputError(
            "a template of recordings without source or receiver, or with other keys",
            found=repr(template),
            needed="{source} and {receiver} in the name of the file, as in "
            "'DIR/{source}_{receiver}.wav'",
            hint="name what differs between the files of two pairs",
        )
    shape = re.escape(Path(template).as_posix()).replace(r"\*", "[^/]*")
    any_name = "|".join(re.escape(n) for n in sorted(one_of, key=len, reverse=True)) or "[^/]+?"
    for key in keys:
        first, again = f"(?P<{key}>{any_name})", f"(?P={key})"
        if known is not None:
            first = again = re.escape(known[key])
        place = rf"\{{{key}\}}"
        shape = shape.replace(place, first, 1).replace(place, again)
    return re.compile(shape, re.IGNORECASE if any_name != "[^/]+?" else 0)


def files_of_shape(folder: Path, template: str) -> list[str]:
    """Return the files that have the shape of a template, relative to a folder, by name.

    Hidden files are left out, such as those that macOS writes beside others (``._LS1_MP1.wav``).

    Raises
    ------
    InputError
        See `shape_of`.
    """
    shape, below = shape_of(template), folder / Path(template).parent
    files = sorted(below.iterdir()) if below.is_dir() else []
    files = [f for f in files if f.is_file() and not f.name.startswith(".")]
    names = [Path(os.path.relpath(f, folder)).as_posix() for f in files]
    return [name for name in names if shape.fullmatch(name)]
