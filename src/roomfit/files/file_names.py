"""Recordings by their names: templates such as ``DIR/{source}_{receiver}.wav``."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path

from roomfit.base.arguments import in_short
from roomfit.base.errors import InputError, located
from roomfit.files.responses import RESPONSE_SUFFIXES

_MOST_NAMES = 2 / 3


def shape_of(
    template: str, known: Mapping[str, str] | None = None, one_of: Iterable[str] = ()
) -> re.Pattern[str]:
    """Return the pattern of names of a template; {source} and {receiver} are groups, * any text.

    Either may be `known`, or `one_of` some names in letters of any case.
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
    """
    shape, below = shape_of(template), folder / Path(template).parent
    names = [Path(os.path.relpath(f, folder)).as_posix() for f in _visible(below)]
    return [name for name in names if shape.fullmatch(name)]


def matching_files(
    folder: Path, template: str | None, known: Iterable[str] = ()
) -> dict[str, tuple[str, str]]:
    """Return source and receiver by the name of each recording, relative to a folder.

    The template is as ``"responses/{source}_{receiver}.wav"``; * stands for any text. Without, of
    `recordings_in` the folder those whose names hold two of the known ones, the source first; where
    none does, those of that shape, if most have it, else all of one source. The case of letters of
    known names does not matter. A name that may be split at several places is split where both
    parts are known.
    """
    if template is None:
        stems = {name: Path(name).stem for name in recordings_in(folder)}
        pairs = {name: _known_in(stem, known) for name, stem in stems.items()}
        if found := {name: (pair[0], pair[1]) for name, pair in pairs.items() if len(pair) == 2}:
            return found
        split = {name: stem.partition("_") for name, stem in stems.items()}
        found = {name: (a, b) for name, (a, mark, b) in split.items() if a and mark and b}
        mostly = len(found) >= _MOST_NAMES * len(stems)
        return found if mostly else {name: ("S1", stem) for name, stem in stems.items()}
    with located("--recordings"):
        names, spelled = files_of_shape(folder, template), {n.casefold(): n for n in known}
        shapes = [shape_of(template, one_of=spelled.values())] if spelled else []
        shapes.append(shape_of(template))
    if not names:
        below = folder / Path(template).parent
        raise InputError(
            "no recording has a name of this shape",
            where=str(below),
            found=in_short(_recordings(below)) or "no recordings",
            needed=template,
            hint="put {source} and {receiver} where names differ, and * for other text",
        )
    matches = (next(filter(None, (s.fullmatch(name) for s in shapes))) for name in names)
    return {
        m[0]: (spelled.get(a.casefold(), a), spelled.get(b.casefold(), b))
        for m in matches
        for a, b in [(m["source"], m["receiver"])]
    }


def _known_in(stem: str, known: Iterable[str]) -> list[str]:
    """Return the known names that a file's name holds as whole words, in their order in it."""
    # some file systems take letters and their dots apart
    text = unicodedata.normalize("NFC", stem)
    starts = {}
    for name in sorted(known, key=len, reverse=True):
        word = re.escape(unicodedata.normalize("NFC", name))
        match = re.search(rf"(?<![^\W_]){word}(?![^\W_])", text, re.IGNORECASE)
        if match:
            starts[match.start()] = name
            text = text[: match.start()] + " " * len(match[0]) + text[match.end() :]
    return [starts[at] for at in sorted(starts)]


def recordings_in(folder: Path) -> list[str]:
    """Return recordings by their endings, relative to a folder; else those one folder below it."""
    own = _recordings(folder)
    if own or not folder.is_dir():
        return own
    below = {f.name: _recordings(f) for f in sorted(folder.iterdir()) if f.name[0] != "."}
    filled = {name: files for name, files in below.items() if files}
    if len(filled) > 1:
        raise InputError(
            "several folders hold recordings",
            where=str(folder),
            found=in_short([f"{name} ({len(files)} files)" for name, files in filled.items()]),
            needed="--recordings 'DIR/{source}_{receiver}.wav', of one of them",
            hint="or move the recordings into one folder",
        )
    return [f"{name}/{file}" for name, files in filled.items() for file in files]


def _visible(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return [f for f in files if f.is_file() and not f.name.startswith(".")]


def _recordings(folder: Path) -> list[str]:
    chosen = [f for f in _visible(folder) if f.suffix.lower() in RESPONSE_SUFFIXES]
    # exports of REW are texts, and not every text is one
    return [f.name for f in chosen if f.suffix.lower() != ".txt"] or [f.name for f in chosen]
