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
from roomfit.files.tables import is_word, words_of

FILL_IN = "FILL IN"
"""What `roomfit init` leaves to be filled in."""
_MOST_NAMES = 2 / 3


def shape_of(
    template: str, known: Mapping[str, str] | None = None, one_of: Iterable[str] = ()
) -> re.Pattern[str]:
    """Return the pattern of names of a template; {source} and {receiver} are groups, * any text.

    Either may be `known`, or `one_of` some names in letters of any case.
    """
    keys = set(re.findall(r"\{(\w+)\}", template))
    if keys != {"source", "receiver"} or "{" in str(Path(template).parent):
        what = "a template of recordings without source or receiver, or with other keys"
        needed = "{source} and {receiver} in the name of the file: 'DIR/{source}_{receiver}.wav'"
        hint = "name what differs between the files of two pairs"
        raise InputError(what, found=repr(template), needed=needed, hint=hint)
    shape = re.escape(Path(template).as_posix()).replace(r"\*", "[^/]*")
    # side by side, a name ends with its number
    unknown = r"[^/\d]*\d+" if "}{" in template else "[^/]+?"
    any_name = "|".join(re.escape(n) for n in sorted(one_of, key=len, reverse=True)) or unknown
    for key in keys:
        first, again = f"(?P<{key}>{any_name})", f"(?P={key})"
        if known is not None:
            first = again = re.escape(known[key])
        place = rf"\{{{key}\}}"
        shape = shape.replace(place, first, 1).replace(place, again)
    return re.compile(shape, re.IGNORECASE if any_name != unknown else 0)


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
    `recordings_in` the folder those whose names hold two of the known ones, the source first unless
    words say otherwise; where none does, those that name a source and a receiver by such words and
    numbers, or have that shape, if most do; else all of one source, a blank where it is in doubt.
    The case of letters of known names does not matter, nor without a template zeros before numbers.
    A name that may be split at several places is split where both parts are known.
    """
    if template is None:
        stems = {name: Path(name).stem for name in recordings_in(folder)}
        pairs = {name: _known_in(stem, known) for name, stem in stems.items()}
        if found := {name: (p[0], p[1]) for name, p in pairs.items() if len(p) == 2}:
            return found
        for split in (_by_words, _at_underscore):
            pairs_by_shape = {name: split(stem) for name, stem in stems.items()}
            found = {name: (p[0], p[1]) for name, p in pairs_by_shape.items() if len(p) == 2}
            if found and len(found) >= _MOST_NAMES * len(stems):
                return found
        left = {*known} - {name for pair in pairs.values() for name in pair} or {"S1"}
        named = any(words_of("source_in").search(stem) for stem in stems.values())
        source = FILL_IN if named or len(left) > 1 else left.pop()
        return {name: (source, (pairs[name] or [stem])[0]) for name, stem in stems.items()}
    with located("--recordings"):
        names, spelled = files_of_shape(folder, template), {n.casefold(): n for n in known}
        shapes = [shape_of(template, one_of=spelled.values())] if spelled else []
        shapes.append(shape_of(template))
    if not names:
        below, what = folder / Path(template).parent, "no recording has a name of this shape"
        listed = in_short(_recordings(below)) or "no recordings"
        hint = "put {source} and {receiver} where names differ, and * for other text"
        raise InputError(what, where=str(below), found=listed, needed=template, hint=hint)
    matches = (next(filter(None, (s.fullmatch(name) for s in shapes))) for name in names)
    return {
        m[0]: (spelled.get(a.casefold(), a), spelled.get(b.casefold(), b))
        for m in matches
        for a, b in [(m["source"], m["receiver"])]
    }


def _known_in(stem: str, known: Iterable[str]) -> list[str]:
    """Return the known names that a file's name holds, in their order in it.

    As whole words, or two side by side, the longest first. Zeros before numbers do not matter, nor
    signs but those between two numbers; a name that is there as it stands goes before others.
    """
    ways: dict[tuple[int, bool, str], str] = {}
    for name in known:
        # some file systems take letters and their dots apart
        own = unicodedata.normalize("NFC", name)
        runs = [run.lstrip("0") or "0" for run in re.findall(r"\d+|[^\W\d_]+", own)]
        # a sign between two numbers may not be left out: R1.1 is not R11
        way = r"[\W_]*".join(f"(?<!\\d)0*{run}" if run.isdigit() else run for run in runs)
        size = -len("".join(runs))
        ways[size, False, re.escape(own)] = ways[size, True, way or re.escape(own)] = name
    if not ways:
        return []
    names = [ways[key] for key in sorted(ways)]
    either = "|".join(f"({way})" for _, _, way in sorted(ways))
    text = unicodedata.normalize("NFC", stem)
    run = re.compile(rf"(?<![^\W_])(?:{either})(?:(?!(?<=\d)\d)(?:{either}))?(?![^\W_])", re.I)
    hits = [i % len(names) for m in run.finditer(text) for i, g in enumerate(m.groups()) if g]
    found = list(dict.fromkeys(names[i] for i in hits))
    kinds = ("receiver_name", "source_name")  # the source stands first, unless words say otherwise
    is_turned = [is_word(k, n.lower()) for k, n in zip(kinds, found, strict=False)] == [True, True]
    return found[::-1] if is_turned else found


def _by_words(stem: str) -> list[str]:
    """Return source and receiver that words with numbers name, as in S1R12 or src 1 - mic 2."""
    found = [words_of(kind).findall(stem) for kind in ("source_in", "receiver_in")]
    return [own[0] for own in found if len(own) == 1]


def _at_underscore(stem: str) -> list[str]:
    """Return both parts of a name, nothing where the second is called as a source is."""
    parts = [part for part in stem.partition("_")[::2] if part]
    return [] if words_of("source_in").search("".join(parts[1:])) else parts


def recordings_in(folder: Path) -> list[str]:
    """Return recordings by their endings, relative to a folder; else those one folder below it."""
    own = _recordings(folder)
    if own or not folder.is_dir():
        return own
    below = {f.name: _recordings(f) for f in sorted(folder.iterdir()) if f.name[0] != "."}
    filled = {name: files for name, files in below.items() if files}
    if len(filled) > 1:
        what, hint = "several folders hold recordings", "or move the recordings into one folder"
        found = in_short([f"{name} ({len(files)} files)" for name, files in filled.items()])
        needed = "--recordings 'DIR/{source}_{receiver}.wav', of one of them"
        raise InputError(what, where=str(folder), found=found, needed=needed, hint=hint)
    return [f"{name}/{file}" for name, files in filled.items() for file in files]


def _visible(folder: Path) -> list[Path]:
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    return [f for f in files if f.is_file() and not f.name.startswith(".")]


def _recordings(folder: Path) -> list[str]:
    chosen = [f for f in _visible(folder) if f.suffix.lower() in RESPONSE_SUFFIXES]
    # exports of REW are texts, and not every text is one
    return [f.name for f in chosen if f.suffix.lower() != ".txt"] or [f.name for f in chosen]
